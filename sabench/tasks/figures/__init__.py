"""Figures of results: bubbles and velocity fields."""
