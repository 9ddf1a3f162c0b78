"""Versions of sabench and of the data that it makes."""

__version__ = "0.1.0"

# Raise it when one scene, seed and renderer give other data than before, by more than rounding:
# results and records of the new data then do not count as results of the old ones.
SIMULATION = "3"
