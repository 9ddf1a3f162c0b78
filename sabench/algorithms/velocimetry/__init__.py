"""Velocimetry: three-dimensional correlation of pairs of volumes."""

from sabench.algorithms.velocimetry.multipass import (
    CorrelationParameters,
    Plan,
    evaluate,
    evaluate_once,
)

__all__ = ["CorrelationParameters", "Plan", "evaluate", "evaluate_once"]
