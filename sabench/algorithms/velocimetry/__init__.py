"""Velocimetry: window correlation of volumes, and of images of a light sheet."""

from sabench.algorithms.velocimetry.multipass import Plan, evaluate, evaluate_once
from sabench.algorithms.velocimetry.parameters import (
    CorrelationParameters,
    VolumeCorrelationParameters,
)
from sabench.algorithms.velocimetry.sheet import Sheet, find_sheet, light_in_sheet

__all__ = [
    "CorrelationParameters",
    "Plan",
    "Sheet",
    "VolumeCorrelationParameters",
    "evaluate",
    "evaluate_once",
    "find_sheet",
    "light_in_sheet",
]
