"""Chapter 3: operations, numbers of cameras, and triggers that are off."""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sabench.algorithms.tomography.problem import TomographyProblem
from sabench.api import Observation, Solver
from sabench.api.make import make_solver
from sabench.evaluation.reproduction import Item, Row
from sabench.evaluation.suite_loading import override
from sabench.metrics.averages import root_mean_square
from sabench.metrics.particle_detection import Counts, count_thesis, detect, ghost_ratio
from sabench.metrics.reconstruction_error import score_frame
from sabench.scenes import Scene, build_rig, load_scene
from sabench.scenes.exposures import recorded_part
from sabench.simulation.in_memory import Shot, simulate
from sabench.utils.arrays import Bool
from sabench.utils.rng import stream

from .chapter_2_cameras import CAMERAS, by_cameras
from .common import (
    cases,
    claim,
    coarsen,
    exact_displacements,
    make_row,
    per_pixel,
    reconstruct,
    report,
    run,
    settings,
    simulate_frame,
)
from .refocused_frames import METHODS, additive, count_methods, detection_rows
from .theory import TABLE_3_1, Algorithm, Setup, operations

_CASES: Mapping[Algorithm, str] = {
    "asa": "9-cameras",
    "msa": "9-cameras",
    "mart": "4-cameras",
    "mfg-mart": "4-cameras",
    "mlos-sart": "4-cameras",
    "mlos-smart": "4-cameras",
}
_STATED: Mapping[Algorithm, float] = {
    "asa": 8.81e9,
    "msa": 9.11e9,
    "mart": 2.15e11,
    "mfg-mart": 8.00e10,
    "mlos-sart": 1.81e10,
    "mlos-smart": 1.81e10,
}
_FEWER: Mapping[Algorithm, float] = {
    "mart": 16.3,
    "mfg-mart": 6.1,
    "mlos-sart": 1.4,
    "mlos-smart": 1.4,
}  # over MSA's operations: section 3.3.1
_WARM_PX = 50


def table_3_1(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Measure three rows for every algorithm, then the thesis's claims on ratios.

    Operations are by the thesis's formulas, with its numbers and with ours.
    """
    scenes = {case.name: coarsen(case.scene, pixels) for case in cases("table-3-1")}
    seconds: dict[Algorithm, list[float]] = {}
    for algorithm, name in _CASES.items():
        formula = sum(operations(algorithm, TABLE_3_1[algorithm]))
        yield make_row(
            f"{algorithm}: operations, the thesis's counts", _STATED[algorithm], [formula]
        )
        frames = [simulate_frame(scenes[name], seed).observation for seed in seeds]
        setups = [_setup(algorithm, frame) for frame in frames]
        yield make_row(
            f"{algorithm}: operations, our counts",
            None,
            [sum(operations(algorithm, setup)) for setup in setups],
            _describe(setups[0]),
        )
        seconds[algorithm] = _time_frames(algorithm, scenes[name], frames)
        yield make_row(f"{algorithm}: seconds", None, seconds[algorithm])
    for algorithm, fewer in _FEWER.items():
        pairs = zip(seconds[algorithm], seconds["msa"], strict=True)
        ratios = [slow / fast for slow, fast in pairs]
        yield make_row(
            f"{algorithm}: seconds over those of msa",
            fewer,
            ratios,
            "the thesis's is of operations",
            "smaller",
        )


def _setup(algorithm: Algorithm, frame: Observation) -> Setup:
    """Count what a solver visits of this frame, as the thesis's formulas do."""
    cameras, voxels = len(frame.cameras), float(np.prod(frame.grid.shape))
    if algorithm in ("asa", "msa"):
        return Setup(cameras, voxels)
    chosen = _solver(algorithm).parameters
    problem = TomographyProblem.from_case(frame, chosen)
    start = problem.mfg if algorithm == "mfg-mart" else problem.mlos
    lit_voxels = float(len(start(chosen.threshold).lines.support))
    lit_pixels = float((problem.measured.light >= chosen.threshold).sum()) / cameras
    return Setup(
        cameras,
        voxels,
        lit_voxels,
        lit_voxels,
        lit_voxels / max(lit_pixels, 1.0),
        chosen.iterations,
    )


def _describe(setup: Setup) -> str:
    illuminated = (
        f", {setup.lit_voxels:.3g} of them lit, {setup.path_voxels:.3g} on a line of sight"
        f", {setup.iterations} iterations"
        if setup.iterations
        else ""
    )
    return f"{setup.cameras} cameras, {setup.voxels:.3g} voxels{illuminated}"


def _solver(algorithm: Algorithm) -> Solver:
    return make_solver(algorithm.replace("-", "_"), {})


def _time_frames(algorithm: Algorithm, scene: Scene, frames: Sequence[Observation]) -> list[float]:
    """Measure the seconds of each frame; a small one compiles the kernels before."""
    solver = _solver(algorithm)
    solver.solve(simulate_frame(coarsen(scene, _WARM_PX), 1).observation)
    seconds = []
    for frame in frames:
        start = time.perf_counter()
        solver.solve(frame)
        seconds.append(time.perf_counter() - start)
    return seconds


_MOST = (9, 13)  # numbers of cameras at which the thesis finds most true particles
_SLICES = 20  # of 50 particles, for one seed
_POINTS = {"A1": ("mlos_sart", 1), "A2": ("mlos_smart", 1), "A3": ("mart", 5)}  # with iterations
_LEVEL = 1.0  # percent: true particles within this of their maximum have levelled off


def fig_3_6(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Measure the curves, the thesis's claims, and the points from the literature.

    They are compared with the theory of ghosts, and with tomography on few cameras: MART on four
    after Elsinga et al. (point E), and three algorithms on three after Atkinson and Soria (points
    A1 to A3).
    """
    curves: dict[str, list[_Point]] = {}
    for cameras, case in by_cameras(CAMERAS):
        frames = [count_methods(coarsen(case.scene, pixels), seed) for seed in seeds]
        for method in METHODS:
            where = f"at {per_pixel(case.scene):.3f} ppp, {method}"
            predicted = predicted_percent(case.scene)
            note = f"equation 3.14: {predicted:.3g} ghosts per 100 particles"
            true, ghosts = detection_rows(
                f"{cameras} cameras {where}", [frame[method] for frame in frames], note
            )
            curves.setdefault(where, []).append(
                _Point(cameras, true.measured, ghosts.measured, predicted)
            )
            yield from (true, ghosts)
    for where, curve in curves.items():
        yield from _claims(where, curve)
    yield from _elsinga_rows(seeds, pixels)
    yield from _atkinson_rows(seeds, next(iter(curves.values())))


@dataclass(frozen=True)
class _Point:
    """Percentages of true, ghost and predicted ghost particles of one array."""

    cameras: int
    true: float | None
    ghosts: float | None
    predicted: float


def predicted_percent(scene: Scene) -> float:
    """Compute ghosts per 100 particles by equation 3.14.

    A particle's image extends two standard deviations from its centre.
    """
    rig = build_rig(scene)
    area = np.pi * (2.0 * (scene.cameras.particle_sigma_px or 0.5)) ** 2
    return 100.0 * ghost_ratio(per_pixel(scene), len(rig.cameras), area, rig.grid.shape[0])


def _claims(where: str, curve: Sequence[_Point]) -> Iterator[Row]:
    ghosts = {point.cameras: point.ghosts for point in curve if point.ghosts}
    fewest, most = min(ghosts, default=0), max(ghosts, default=0)
    ratio = ghosts[most] / ghosts[fewest] if ghosts else None
    note = f"ghosts with {most} over ghosts with {fewest} cameras"
    yield claim(
        f"ghosts {where}",
        "fall with the number of cameras",
        ratio,
        ratio is not None and ratio < 1.0,
        note,
    )
    true = {point.cameras: point.true or 0.0 for point in curve}
    peak = max(true, key=lambda cameras: true[cameras])
    level = true[peak] - max(true[cameras] for cameras in _MOST)
    yield claim(
        f"true particles {where}",
        "peak or level off at 9 to 13 cameras",
        level,
        level <= _LEVEL,
        f"percent below the peak, at {peak} cameras",
    )
    off = [abs(np.log10(point.predicted / point.ghosts)) for point in curve if point.ghosts]
    wrong = float(max(off, default=0.0))
    yield claim(
        f"equation 3.14 {where}",
        "does not predict the ghosts",
        wrong,
        wrong > 1.0,
        "powers of ten between them at most",
    )


def _elsinga_rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Compare with MART: fewer particles missed, but ten times the ghosts.

    The thesis takes MART's figures from the literature.
    """
    scene, scores = coarsen(load_scene("elsinga-35x35x7"), pixels), []
    for seed in seeds:
        shot = simulate_frame(scene, seed)
        guess = make_solver("mart", {}).solve(shot.observation)
        scores.append(score_frame(shot.observation.grid, shot.particles, shot.views, guess))
    for key, heading in (("true_percent", "true %"), ("ghost_percent", "ghost %"), ("q", "Q")):
        values = [value for score in scores if (value := score[key]) is not None]
        yield make_row(
            f"4 cameras at 0.050 ppp after Elsinga et al., MART: {heading}", None, values
        )


def _atkinson_rows(seeds: Sequence[int], refocused: Sequence[_Point]) -> Iterator[Row]:
    """Count particles in slices of one voxel, which have no coarse copy.

    `refocused` is the curve of the lowest density.
    """
    slices = load_scene("atkinson-1000x1x200")
    by_point: dict[str, list[Counts]] = {point: [] for point in _POINTS}
    for seed in seeds:
        numbers = range(seed * _SLICES, (seed + 1) * _SLICES)
        shots = [simulate(slices, seed=number) for number in numbers]
        for point, (solver, iterations) in _POINTS.items():
            chosen = make_solver(solver, {"iterations": iterations})
            by_point[point].append(_add(_count(shot, chosen) for shot in shots))
    ghosts = []
    for point, (solver, iterations) in _POINTS.items():
        name = f"3 cameras at 0.017 ppp after Atkinson and Soria, {point}, {iterations} x {solver}"
        rows = detection_rows(name, by_point[point])
        ghosts.append(rows[-1].measured or 0.0)
        yield from rows
    fewer = [point.cameras for point in refocused if (point.ghosts or 0.0) < min(ghosts)]
    yield claim(
        "ghosts of A1 to A3",
        "more than of synthetic apertures",
        min(ghosts),
        bool(fewer),
        f"percent, of the best of them; at 0.05 ppp, refocusing has fewer with {fewer} cameras",
    )


def _count(shot: Shot, solver: Solver) -> Counts:
    grid, detected = shot.observation.grid, detect(solver.solve(shot.observation).volume)
    truth = grid.to_voxels(shot.particles.position_mm)
    return count_thesis(detected, truth, grid.in_scored(detected), grid.in_scored(truth))


def _add(slices: Iterable[Counts]) -> Counts:
    every = list(slices)
    return Counts(
        sum(counts.truths for counts in every),
        sum(counts.detections for counts in every),
        sum(counts.matched for counts in every),
        None,
    )


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


def section_3_2_1(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure the effect of skew on pixels, Q and velocity error.

    The thesis calls what software triggers leave too large for synthetic aperture PIV, and triggers
    by hardware. In continuous light, a late camera sees particles where they are later; in pulsed
    light it sees them where the others do, or misses the pulse: its image is dark and is left out.
    """
    large: list[float] = []
    for light in lights():
        for name, skew in (("together", 0.0), ("+-125 us", SKEW_S)):
            costs = [_measure(light, skew, seed, pixels) for seed in seeds]
            label = f"{light.label}, {name}"
            if skew:
                shifts = [cost.images for cost in costs]
                lost = f"{100.0 * np.mean([cost.lost for cost in costs]):.0f} % of images lost"
                yield make_row(f"{label}: r.m.s. shift of images, pixels", None, shifts, lost)
                large += [light.speed_mm_s / 1000.0] if np.mean(shifts) > _LARGE else []
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
        _without(simulate(scene, seed=seed, frame=frame), ~mask)
        for frame, mask in enumerate(recorded)
    ]
    pair = reconstruct("asa", [shot.observation for shot in shots], light.step_s)
    field = run("piv3d", pair, **settings("piv3d", _WINDOW, _OVERLAP, pair.grid))
    places = field.positions_mm.reshape(-1, 3)
    inner = np.abs(places[:, :2]).max(axis=1) <= _SIZE_MM[0] / 2.0 - _MARGIN_MM
    exact = exact_displacements(scene, places[inner], 0.0, light.step_s)
    measured = field.velocity_mm_s.reshape(-1, 3)[inner] * light.step_s
    off = (measured - exact) / scene.grid.voxel_mm[0]
    cost = _Cost(
        _shift_px(shots[0]),
        float(np.mean([additive(shot).quality().best for shot in shots])),
        root_mean_square(off[:, 0]),
        root_mean_square(off[:, 2]),
        1.0 - float(np.mean(recorded)),
    )
    report(f"{light.label}, {skew_s * 1e6:.0f} us, seed {seed}: {cost}")
    return cost


def _records(scene: Scene, frame: int, camera: int) -> bool:
    timing = scene.timing
    return timing is not None and recorded_part(timing, scene.sensor, frame, camera) is not None


def _without(shot: Shot, lost: Bool) -> Shot:
    """Leave out the cameras with dark images."""
    lit = np.flatnonzero(~lost)
    case = shot.observation
    cameras = tuple(case.cameras[number] for number in lit)
    observation = replace(case, images=case.images[lit], cameras=cameras)
    return replace(shot, observation=observation, views=[shot.views[number] for number in lit])


def _shift_px(shot: Shot) -> float:
    """Compute how far images are from where particles are at the frame's time."""
    place = shot.particles.position_mm
    off = [
        (view.pixel - camera.project(place)[0])[view.visible]
        for camera, view in zip(shot.observation.cameras, shot.views, strict=True)
    ]
    return root_mean_square(np.linalg.norm(np.concatenate(off), axis=1))
