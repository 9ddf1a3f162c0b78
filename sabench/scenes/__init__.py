"""Scene files.

Their tables, their loading, and the rig of cameras that they describe.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sabench.utils.lazy_names import lazy_names

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
__getattr__ = lazy_names(__name__, _HOMES)
