"""Keys of a scene that would change nothing, or that contradict others."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from sabench.scenes.wall import WallSpec
from sabench.scenes.world import ParticleWorld

if TYPE_CHECKING:
    from sabench.scenes.scene import Scene


def idle_keys(scene: Scene) -> Iterator[tuple[str, str]]:
    """Find keys that the scene's world does not heed; yields pairs of a key and a sentence."""
    alone = isinstance(scene.world, ParticleWorld)
    for number, wall in enumerate(scene.walls):
        if isinstance(wall, WallSpec) and wall.mirrors and not alone:
            place = "wall" if len(scene.walls) == 1 else f"wall.{number}"
            yield (
                f"{place}.mirrors",
                "expected a scene of particles alone: only theirs are mirrored",
            )
    if scene.cameras.airy_rings and not alone:
        yield (
            "cameras.airy_rings",
            "expected a scene of particles alone: only their images have rings",
        )
    if scene.cameras.airy_rings and scene.cameras.particle_sigma_px is not None:
        yield "cameras.airy_rings", "expected none beside particle_sigma_px, which sets the image"
    light = scene.illumination
    if light and light.scattering == "isotropic" and light.polarisation is not None:
        yield "illumination.polarisation", 'expected none with scattering = "isotropic"'
