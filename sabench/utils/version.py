"""Version of sabench."""

__version__ = "0.1.0"
