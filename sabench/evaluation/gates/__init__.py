"""Regression gates: comparison of a suite's figures with a baseline."""
