"""sabench: physically based synthetic data for volumetric velocimetry, and benchmarks on it."""

__version__ = "0.1.0"
