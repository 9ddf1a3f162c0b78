"""Scene files.

Their tables, their loading, and the rig of cameras that they describe.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sabench.scenes.build import Rig, build_rig
    from sabench.scenes.bundled import find
    from sabench.scenes.json_schema import scene_schema
    from sabench.scenes.loading import load_scene, parse_scene
    from sabench.scenes.scene import Scene
    from sabench.scenes.world import BubbleWorld, ParticleWorld, TargetWorld, World

__all__ = [
    "BubbleWorld",
    "ParticleWorld",
    "Rig",
    "Scene",
    "TargetWorld",
    "World",
    "build_rig",
    "find",
    "load_scene",
    "parse_scene",
    "scene_schema",
]

_HOMES = {
    "BubbleWorld": "world",
    "ParticleWorld": "world",
    "Rig": "build",
    "Scene": "scene",
    "TargetWorld": "world",
    "World": "world",
    "build_rig": "build",
    "find": "bundled",
    "load_scene": "loading",
    "parse_scene": "loading",
    "scene_schema": "json_schema",
}


def __getattr__(name: str) -> Any:
    """Import public names when they are first used: finding a file needs no schema."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
