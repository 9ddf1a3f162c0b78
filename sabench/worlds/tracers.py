"""Tracers from frame to frame, their materials and their laser pulses."""

import functools
import tomllib
from dataclasses import replace

import numpy as np

from sabench.api import BodyFlow, Flow, Generator, Velocity
from sabench.api.make import generator_of
from sabench.api.truth import Particles
from sabench.geometry.rigid_motion import Domain
from sabench.scenes import Scene
from sabench.scenes.build import domain_of
from sabench.scenes.illumination import Illumination, Tracer
from sabench.utils.arrays import F64, I64, in_box, triple
from sabench.utils.errors import InputError
from sabench.utils.rng import stream
from sabench.worlds.advection import check_inertia, move_particles, velocity_of
from sabench.worlds.bubbles_and_bodies import Phases

_GOLDEN, _FIRST, _SECOND = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB


def material_numbers(tracer: Tracer, seed: int, ids: I64) -> I64:
    """Draw the materials (n,) of particles.

    They are 0 for the tracer's own, then those of its mixture. A particle keeps its material,
    whatever other particles there are: the draw is a hash of its number (SplitMix64, after Steele,
    Lea and Flood 2014).
    """
    if not tracer.mixture:
        return np.zeros(len(ids), dtype=np.int64)
    key = stream(seed, "materials").integers(1 << 63, dtype=np.uint64)
    with np.errstate(over="ignore"):
        mixed = (ids.astype(np.uint64) + key) * np.uint64(_GOLDEN)
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(_FIRST)
        mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(_SECOND)
    drawn = ((mixed ^ (mixed >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53
    bounds = np.cumsum([material.share for material in tracer.mixture])
    number = np.searchsorted(bounds, drawn, side="right") + 1
    return np.asarray(np.where(number > len(bounds), 0, number), dtype=np.int64)


# The light that a sphere scatters in one direction changes with the last hundredth of a percent of
# its diameter. Particles' diameters are rounded to a lattice, far finer than can be measured, so
# that particles share scattering computed exactly.
PER_OCTAVE = 2048  # 7 nm at 20 um
_UNIT_MM = 1e-3


def size_numbers(diameters_mm: F64) -> I64:
    """Compute the numbers of the lattice's nearest diameters; that of 1 um is 0."""
    return np.asarray(np.rint(PER_OCTAVE * np.log2(diameters_mm / _UNIT_MM)), dtype=np.int64)


def lattice_diameters_mm(numbers: I64) -> F64:
    """Compute the diameters of numbers."""
    return np.asarray(_UNIT_MM * np.exp2(numbers / PER_OCTAVE))


TOLERANCE = 1e-9  # of the volume's largest edge, per step of a particle's path
_SIZES = (0.01, 4000.0)  # size parameters, pi d n / lambda
_NEWER = 1 << 32  # ids of particles that enter in a frame start at so many times its number


def flow_of(scene: Scene, seed: int = 0) -> Flow | None:
    """Make the flow that carries a scene's particles; None where there is none.

    The bodies that a flow goes around depend on the seed.

    Raises InputError: a flow around bodies in a scene without bodies, or with bodies that move.
    """
    tracers = scene.world.tracers
    if tracers is None or tracers.flow is None:
        return None
    flow: Flow = generator_of(tracers.flow)
    if not isinstance(flow, BodyFlow):
        return flow
    where = f"{scene.title}: flow {flow.name}"
    if not scene.world.solids:
        raise InputError(f"{where}: expected solids that it goes around, got none")
    for number, body in enumerate(scene.world.solids):
        given = generator_of(body).parameters
        if any(given.velocity_mm_s) or any(given.spin_deg_s):
            raise InputError(f"{where}: expected bodies at rest, but solids.{number} moves")
    return _bodies_flow(scene.to_toml(), seed)


@functools.lru_cache(maxsize=2)
def _bodies_flow(text: str, seed: int) -> BodyFlow:
    """Make the flow around a scene's bodies; it is kept for other callers."""
    scene = Scene.model_validate(tomllib.loads(text))
    flow: BodyFlow = generator_of(scene.particle_world.flow or {})
    flow.surround([body for body, _ in Phases(scene, seed).bodies(0)], domain_of(scene))
    return flow


def require_flow(scene: Scene, seed: int = 0) -> Flow:
    """Make the flow of a scene; raises InputError for one without a flow."""
    if (flow := flow_of(scene, seed)) is None:
        raise InputError(f"{scene.title}: flow: expected a scene with a flow, got none")
    return flow


class Motion:
    """Tracers of all frames of a scene and seed.

    A frame depends on the frames before it: one that comes next is made from the last, any other
    from the first on. Either way gives the same.
    """

    def __init__(self, scene: Scene, seed: int) -> None:
        self._generator: Generator = generator_of(scene.particle_world.particles)
        self.scene, self.seed, self._flow = scene, seed, flow_of(scene, seed)
        if self._flow is not None:
            self._flow.check(domain_of(scene))
        self._last: tuple[int, Particles] | None = None

    @property
    def chained(self) -> bool:
        """True if a frame is made from the one before it."""
        return self._flow is not None

    @property
    def last(self) -> int | None:
        """The frame that was made last, if the next can be made from it."""
        return self._last[0] if self._last else None

    def resume(self, frame: int, particles: Particles) -> None:
        """Continue from a frame's particles that were made elsewhere."""
        self._last = frame, particles

    def at(self, frame: int) -> Particles:
        """Make the particles of a frame.

        Raises InputError: particles that move by themselves, in addition to a flow.
        """
        domain, time, flow = domain_of(self.scene), self.scene.time_s(frame), self._flow
        if flow is None:
            return self._generate(domain, self.seed, frame, time)
        if self._last and self._last[0] <= frame:
            number, particles = self._last
        else:
            number, particles = 0, self._generate(domain, self.seed, 0, 0.0)
            if np.any(particles.velocity_mm_s):
                raise InputError(
                    f"{self.scene.title}: particles: expected some that rest, for the flow to "
                    "carry them, got some that move by themselves"
                )
            inertia, given = self.scene.inertia, (particles.position_mm, particles.diameter_mm)
            start = self.scene.time_s(0)
            if inertia is not None:
                check_inertia(flow, inertia, *given, start, self.scene.title)
            velocity = velocity_of(flow, inertia, *given, start)
            particles = replace(particles, velocity_mm_s=velocity)
        while number < frame:
            number += 1
            particles = self._next(flow, domain, particles, number)
        self._last = number, particles
        return particles

    def move(self, particles: Particles, frame: int, delay_s: float) -> F64:
        """Move positions (n, 3) of a frame's particles some time later or earlier."""
        if delay_s == 0.0:
            return particles.position_mm
        if self._flow is None:
            return particles.position_mm + delay_s * particles.velocity_mm_s
        time = self.scene.time_s(frame)
        return self._carry(self._flow, particles, time, time + delay_s)

    def _carry(self, flow: Flow, particles: Particles, start_s: float, end_s: float) -> F64:
        size, position = particles.diameter_mm, particles.position_mm
        tolerance = TOLERANCE * max(self.scene.volume.size_mm)
        inertia = self.scene.inertia
        return move_particles(flow, inertia, position, size, start_s, end_s, tolerance)

    def _generate(self, domain: Domain, seed: int, frame: int, time_s: float) -> Particles:
        """Let the generator make particles.

        For Mie scattering, their diameters are rounded to the lattice of sizes.

        Raises InputError: diameters outside the range of Mie's series.
        """
        particles = self._generator.particles(domain, seed, frame, time_s)
        light = self.scene.light
        if light.scattering == "isotropic" or not len(particles):
            return particles
        unit = light.wavelength_nm * 1e-6 / (np.pi * self.scene.fluid_index)  # of a size parameter
        low, high = particles.diameter_mm.min(), particles.diameter_mm.max()
        if low < _SIZES[0] * unit or high > _SIZES[1] * unit:
            raise InputError(
                f"{self.scene.title}: particles: expected diameters of {_SIZES[0] * unit:.2g} to "
                f"{_SIZES[1] * unit:.2g} mm for Mie scattering at {light.wavelength_nm:g} nm, got "
                f"{low:.3g} to {high:.3g} mm"
            )
        rounded = lattice_diameters_mm(size_numbers(particles.diameter_mm))
        return replace(particles, diameter_mm=rounded)

    def _next(self, flow: Flow, domain: Domain, before: Particles, frame: int) -> Particles:
        """Advect particles by one frame, dropping and replacing those that leave.

        New ones: a second cloud that fills the volume at the end of the step is traced backwards,
        and those of its particles that come from outside are added. For a flow without divergence
        this keeps the density exactly, whatever the flow does at the faces.
        """
        start, end = self.scene.time_s(frame - 1), self.scene.time_s(frame)
        low, high = domain.low_mm, domain.low_mm + np.asarray(domain.size_mm)
        carried = self._carry(flow, before, start, end)
        stay = np.flatnonzero(in_box(carried, low, high))
        seed = int(stream(self.seed, "entering", frame).integers(1 << 62))
        fresh = self._generate(domain, seed, 0, 0.0)
        enter = np.flatnonzero(~in_box(self._carry(flow, fresh, end, start), low, high))
        # `take` is four times as fast as rows chosen by a mask
        position = np.concatenate([carried.take(stay, 0), fresh.position_mm.take(enter, 0)])
        diameter = np.concatenate([before.diameter_mm[stay], fresh.diameter_mm[enter]])
        ids = np.concatenate([before.id[stay], frame * _NEWER + fresh.id[enter]])
        velocity = velocity_of(flow, self.scene.inertia, position, diameter, end)
        return Particles(ids, position, diameter, velocity)


def sample_lattice(
    scene: Scene, frame: int, step_mm: tuple[float, float, float], seed: int = 0
) -> tuple[Velocity, F64]:
    """Sample a frame's exact velocities and gradients on a centred lattice.

    Gradients are (z, y, x, 3, 3) in 1/s.
    """
    flow = require_flow(scene, seed)
    counts = [
        int(size / step * (1.0 + 1e-12)) + 1
        for size, step in zip(scene.volume.size_mm, step_mm, strict=True)
    ]
    low = np.asarray(scene.volume.center_mm) - (np.array(counts) - 1) / 2.0 * np.asarray(step_mm)
    valid = np.ones(counts[::-1], dtype=np.bool_)
    field = Velocity(triple(low), step_mm, np.zeros((*valid.shape, 3)), valid)
    points, time = field.positions_mm.reshape(-1, 3), scene.time_s(frame)
    field.velocity_mm_s[:] = flow.velocity(points, time).reshape(field.velocity_mm_s.shape)
    return field, flow.gradient(points, time).reshape(*valid.shape, 3, 3)


def pulse(scene: Scene, seed: int, frame: int) -> Illumination:
    """Make the laser of one frame, with the pulse's energy and shift."""
    timing, light = scene.timing, scene.particle_world.illumination
    if timing is None:
        return light
    number = frame % len(timing.pulses_s)
    energy = timing.energy[number] if timing.energy else 1.0
    if timing.energy_spread:
        draw = float(stream(seed, "pulse energy", frame).standard_normal())
        energy *= max(0.0, 1.0 + timing.energy_spread * draw)
    shift = (light.shift_mm or 0.0) + (timing.shift_mm[number] if timing.shift_mm else 0.0)
    return light.model_copy(
        update={"pulse_energy_mj": light.pulse_energy_mj * energy, "shift_mm": shift}
    )
