"""Renderers: photons and truth of a camera's image."""
