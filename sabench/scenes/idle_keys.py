"""Keys of a scene that would change nothing, or that contradict others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from sabench.scenes.cameras import Cameras
from sabench.scenes.illumination import Illumination
from sabench.scenes.wall import CylinderSpec, WallSpec
from sabench.scenes.world import ParticleWorld, World


def idle_keys(
    world: World,
    walls: Sequence[WallSpec | CylinderSpec],
    cameras: Cameras,
    light: Illumination | None,
) -> Iterator[tuple[str, str]]:
    """Find keys that a world does not heed; yields pairs of a key and a sentence."""
    alone = isinstance(world, ParticleWorld)
    for number, wall in enumerate(walls):
        if isinstance(wall, WallSpec) and wall.mirrors and not alone:
            place = "wall" if len(walls) == 1 else f"wall.{number}"
            yield (
                f"{place}.mirrors",
                "expected a scene of particles alone: only theirs are mirrored",
            )
    if cameras.airy_rings and not alone:
        yield (
            "cameras.airy_rings",
            "expected a scene of particles alone: only their images have rings",
        )
    if cameras.airy_rings and cameras.particle_sigma_px is not None:
        yield "cameras.airy_rings", "expected none beside particle_sigma_px, which sets the image"
    if light and light.scattering == "isotropic" and light.polarisation is not None:
        yield "illumination.polarisation", 'expected none with scattering = "isotropic"'
