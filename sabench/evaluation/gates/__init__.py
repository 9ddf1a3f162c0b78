"""Regression gates: comparison of a suite's scores with a baseline."""
