"""Adapters of samples for libraries of machine learning; each needs its library."""
