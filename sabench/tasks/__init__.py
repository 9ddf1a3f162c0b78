"""What a kind of solver sees, returns and is scored by: one module per track, found by its name."""

from __future__ import annotations

import importlib
from types import ModuleType


def of(name: str) -> ModuleType:
    """The module of a track, imported when it is needed."""
    return importlib.import_module(f"{__name__}.{name}")
