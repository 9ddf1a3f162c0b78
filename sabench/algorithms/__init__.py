"""Building blocks of solvers, by kind of algorithm.

Each package names its public functions: `from sabench.algorithms.refocus import refocus_sum`.
"""
