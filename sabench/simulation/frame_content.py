"""Content of one frame: bubbles, bodies, tracers or a calibration target."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sabench.api import Material
from sabench.api.truth import Bubbles, Particles, Solid, Target
from sabench.geometry.frames import Pose
from sabench.scenes import Rig, Scene
from sabench.simulation.rendering.particle_light import Scatterers
from sabench.utils.arrays import F64, Bool
from sabench.utils.rng import stream


@dataclass(frozen=True)
class Tracers:
    """Tracers of one frame and how they scatter.

    Attributes
    ----------
    particles : at the middle of the pulse.
    positions_mm : their positions (n, 3) in the middle of equal parts of the pulse; one array for a
        short pulse.
    scatterers : how they scatter; None for isotropic scattering.
    illuminated : (n,) whether the laser reaches each; None where nothing throws shadows.
    share : of the pulse that is recorded.
    exposed : gives the particles and positions of the part of the pulse that a camera records, by
        its number in the rig, and its share; None where all cameras record the whole pulse.
    """

    particles: Particles
    positions_mm: tuple[F64, ...]
    scatterers: Scatterers | None
    illuminated: Bool | None = None
    share: float = 1.0
    exposed: Callable[[int], tuple[Particles, tuple[F64, ...], float]] | None = None

    def of_camera(self, number: int) -> Tracers:
        """Give the tracers as one camera records them, by its number in the rig."""
        if self.exposed is None:
            return self
        particles, positions, share = self.exposed(number)
        return replace(self, particles=particles, positions_mm=positions, share=share, exposed=None)


@dataclass(frozen=True)
class FrameContent:
    """Objects of one frame, with the optics, the seed and the renderer.

    Attributes
    ----------
    scene : with the laser as it is in this frame.
    rig : the true optics.
    seed, number : of the data set, and of the frame.
    renderer : mitsuba or splat.
    bubbles : None in a scene without bubbles and bodies.
    bodies : closed surfaces and what they are made of.
    target, pose : the calibration target, and its position and rotation.
    """

    scene: Scene
    rig: Rig
    seed: int
    number: int
    renderer: str
    bubbles: Bubbles | None = None
    bodies: tuple[tuple[Solid, Material], ...] = ()
    tracers: Tracers | None = None
    target: Target | None = None
    pose: Pose | None = None

    @property
    def solids(self) -> list[Solid]:
        """Surfaces of the bodies."""
        return [solid for solid, _ in self.bodies]

    def path_seed(self, camera: int) -> int:
        """Seed of the random light paths to one camera, by its number in the rig."""
        return int(stream(self.seed, "light paths", self.number, camera).integers(1 << 20))

    def sensor_noise(self, camera: int) -> np.random.Generator:
        """Random numbers of one camera's sensor, by its number in the rig."""
        return stream(self.seed, "sensor", self.number, camera)
