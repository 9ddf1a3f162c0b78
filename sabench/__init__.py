"""sabench: physically based synthetic data for volumetric velocimetry, and benchmarks of algorithms on it."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from sabench.utils.version import __version__

if TYPE_CHECKING:
    from sabench.dataset.reader import open_dataset
    from sabench.scenes import load_scene
    from sabench.simulation.pipeline import generate
    from sabench.tasks.solve_and_score import score, solve

__all__ = ["__version__", "generate", "load_scene", "open_dataset", "score", "solve"]

_HOMES = {
    "generate": "simulation.pipeline",
    "load_scene": "scenes",
    "open_dataset": "dataset.reader",
    "score": "tasks.solve_and_score",
    "solve": "tasks.solve_and_score",
}


def __getattr__(name: str) -> Any:
    """Import the public functions when they are first used, so that `import sabench` stays light."""
    if name not in _HOMES:
        raise AttributeError(f"module 'sabench' has no attribute {name!r}")
    return getattr(importlib.import_module(f"sabench.{_HOMES[name]}"), name)
