"""Velocimetry: three-dimensional correlation of pairs of volumes."""

from sabench.algorithms.velocimetry.multipass import Plan, evaluate, evaluate_once

__all__ = ["Plan", "evaluate", "evaluate_once"]
