"""Section 3.2.1: cameras that are triggered up to 125 us too early or too late.

The thesis calls what software triggers leave too large for synthetic aperture PIV, and triggers by
hardware. In continuous light, a late camera sees particles where they are later; in pulsed light
it sees them where the others do, or misses the pulse: its image is dark and is left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sabench.api import VolumePair
from sabench.api.make import make_algorithm, make_solver
from sabench.evaluation.suite_loading import override
from sabench.evaluation.thesis.common import Item, additive, claim, coarsen, make_row, settings
from sabench.metrics.averages import root_mean_square
from sabench.scenes import Scene, load_scene
from sabench.scenes.exposures import recorded_part
from sabench.simulation.in_memory import Shot, simulate
from sabench.utils.arrays import F64, Bool
from sabench.utils.progress import console
from sabench.utils.rng import stream
from sabench.worlds.advection import advect
from sabench.worlds.tracers import TOLERANCE, require_flow

SEEDS = 3
SKEW_S, GAP_S = 125e-6, 250e-6
SPEEDS_MM_S = (50.0, 200.0, 500.0, 1000.0)  # in continuous light
STEPS_S = (500e-6, 400e-6, 300e-6)  # between two pulses about the gap
_CAMERAS, _PEAK_MM, _EXPOSURE_S = 9, 0.3, 20e-6
_WINDOW, _OVERLAP, _MARGIN_MM = (40, 40, 16), 0.5, 3.0
_SIZE_MM, _PIXELS = (14.0, 14.0, 10.0), 400
_LARGE = 0.1  # pixels


@dataclass(frozen=True)
class Light:
    """Light of a case: continuous, or two pulses that straddle the gap."""

    label: str
    speed_mm_s: float
    timing: dict[str, Any]
    energy: float

    @property
    def step_s(self) -> float:
        """Time between the two frames."""
        pulses = self.timing.get("pulses_s", [0.0])
        return float(pulses[1] - pulses[0] if len(pulses) == 2 else 1.0 / self.timing["rate_hz"])


@dataclass(frozen=True)
class _Cost:
    """Figures of one case and seed; lengths in pixels."""

    images: float
    q: float
    u: float
    w: float
    lost: float


def lights() -> list[Light]:
    """List the cases. In continuous light the motion between frames is the same."""
    long = 2.0 * SKEW_S + 1.5 * _EXPOSURE_S
    continuous = [
        Light(
            f"continuous light, {speed / 1000.0:g} m/s",
            speed,
            {"rate_hz": speed / _PEAK_MM, "duration_s": long},
            long / _EXPOSURE_S,
        )
        for speed in SPEEDS_MM_S
    ]
    pulsed = [
        Light(
            f"pulses {step * 1e6:.0f} us apart",
            _PEAK_MM / STEPS_S[0],
            {"rate_hz": 10.0, "pulses_s": [0.0, step], "gap_s": GAP_S},
            1.0,
        )
        for step in STEPS_S
    ]
    return continuous + pulsed


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure what skew costs in pixels, Q and velocity error, beside exact triggers."""
    large: list[float] = []
    for light in lights():
        for name, skew in (("together", 0.0), ("+-125 us", SKEW_S)):
            costs = [_measure(light, skew, seed, pixels) for seed in seeds]
            label = f"{light.label}, {name}"
            if skew:
                own = [cost.images for cost in costs]
                lost = f"{100.0 * np.mean([cost.lost for cost in costs]):.0f} % of images lost"
                yield make_row(f"{label}: r.m.s. shift of images, pixels", None, own, lost)
                large += [light.speed_mm_s / 1000.0] if np.mean(own) > _LARGE else []
            yield make_row(f"{label}: Q, additive", None, [cost.q for cost in costs])
            yield make_row(f"{label}: r.m.s. error of u, pixels", None, [c.u for c in costs])
            yield make_row(f"{label}: r.m.s. error of w, pixels", None, [c.w for c in costs])
    yield claim(
        "skew of +-125 us",
        "too large for flows",
        min(large, default=None),
        bool(large),
        f"m/s: slowest flow in continuous light with images off by more than {_LARGE:g} pixels",
    )


def scene_of(light: Light, skew_s: float, seed: int) -> Scene:
    """Make nine cameras, triggered at random, over a core of the thesis's ring."""
    delays = stream(seed, "trigger skew").uniform(-skew_s, skew_s, _CAMERAS)
    base = load_scene("array-9")
    values: dict[str, Any] = {
        "volume.size_mm": list(_SIZE_MM),
        "grid.crop_mm": [_MARGIN_MM, _MARGIN_MM, 0.0],
        "cameras.rows": _PIXELS,
        "cameras.columns": _PIXELS,
        "particles.per_mm3": 2.0,
        "frames": 2,
        "timing": {**light.timing, "skew_s": delays.tolist()},
        "sensor.exposure_s": _EXPOSURE_S if "duration_s" in light.timing else 5e-3,
        "illumination.pulse_energy_mj": light.energy * base.light.pulse_energy_mj,
        "flow": {
            "generator": "vortex_ring",
            "center_mm": [-10.0, 0.0, 0.0],
            "peak_mm_s": light.speed_mm_s,
        },
    }
    return override(base, values, light.label)


def _measure(light: Light, skew_s: float, seed: int, pixels: int | None) -> _Cost:
    scene = coarsen(scene_of(light, skew_s, seed), pixels)
    recorded = [
        np.array([_records(scene, frame, camera) for camera in range(_CAMERAS)])
        for frame in range(2)
    ]
    shots = [
        _without(simulate(scene, seed=seed, frame=frame), ~own)
        for frame, own in enumerate(recorded)
    ]
    one, other = (make_solver("asa", {}).solve(shot.observation).volume for shot in shots)
    grid = shots[0].observation.grid
    solver: Any = make_algorithm("piv3d", settings("piv3d", _WINDOW, _OVERLAP, grid))
    field = solver.solve(VolumePair(one, other, grid, light.step_s))
    places = field.positions_mm.reshape(-1, 3)
    inner = np.abs(places[:, :2]).max(axis=1) <= _SIZE_MM[0] / 2.0 - _MARGIN_MM
    exact = _displacements(scene, places[inner], light.step_s)
    measured = field.velocity_mm_s.reshape(-1, 3)[inner] * light.step_s
    off = (measured - exact) / scene.grid.voxel_mm[0]
    cost = _Cost(
        _shift_px(shots[0]),
        float(np.mean([additive(shot).quality().best for shot in shots])),
        root_mean_square(off[:, 0]),
        root_mean_square(off[:, 2]),
        1.0 - float(np.mean(recorded)),
    )
    console.print(f"{light.label}, {skew_s * 1e6:.0f} us, seed {seed}: {cost}", markup=False)
    return cost


def _records(scene: Scene, frame: int, camera: int) -> bool:
    timing = scene.timing
    return timing is not None and recorded_part(timing, scene.sensor, frame, camera) is not None


def _without(shot: Shot, lost: Bool) -> Shot:
    """Leave out the cameras whose images are dark, as anyone would."""
    kept = np.flatnonzero(~lost)
    seen = shot.observation
    cameras = tuple(seen.cameras[number] for number in kept)
    observation = replace(seen, images=seen.images[kept], cameras=cameras)
    return replace(shot, observation=observation, views=[shot.views[number] for number in kept])


def _shift_px(shot: Shot) -> float:
    """Compute how far images are from where particles are at the frame's time."""
    place = shot.particles.position_mm
    off = [
        (view.pixel - camera.project(place)[0])[view.visible]
        for camera, view in zip(shot.observation.cameras, shot.views, strict=True)
    ]
    return root_mean_square(np.linalg.norm(np.concatenate(off), axis=1))


def _displacements(scene: Scene, points: F64, step_s: float) -> F64:
    """Compute exact displacements (n, 3) about points between the frames, mm."""
    flow, tolerance = require_flow(scene), TOLERANCE * max(scene.volume.size_mm)
    middle = step_s / 2.0
    return np.asarray(
        advect(flow, points, middle, step_s, tolerance)
        - advect(flow, points, middle, 0.0, tolerance)
    )
