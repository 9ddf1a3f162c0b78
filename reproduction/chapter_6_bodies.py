"""Flow behind bodies, and three phases in one picture: chapter 6."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sabench.algorithms.bubbles import image_diameter_px, separate_phases
from sabench.api import FoundParticles, ImageSequence, Observation
from sabench.api.truth import BODY, Bubbles, Particles, Sight
from sabench.evaluation.reproduction import Item
from sabench.metrics.bubble_detection import detection_scores
from sabench.metrics.particle_detection import challenge_pairs
from sabench.metrics.velocity_error import evaluation_lattice, sample_velocity
from sabench.plotting.drawing import Curve, Figure, Panel
from sabench.scenes import Scene, build_rig, load_scene
from sabench.simulation.camera_view import record_image, render_camera_view
from sabench.simulation.frames import Frames
from sabench.simulation.in_memory import Shot, observation_of, simulate_sequence
from sabench.utils.arrays import F64, Bool
from sabench.worlds.bubbles_and_bodies import Phases
from sabench.worlds.library.overlaps import contains

from . import common

_SCENES = {"reef": "flow-behind-reef", "propeller": "flow-behind-propeller"}
_SOLVERS = ("ray_triangulation", "bayesian_ipr")
_FIELD = "msa, piv3d"
_WINDOW, _OVERLAP = (32, 32, 16), 0.75
# cameras of the 3 x 3 grid, row by row: a cross, all
_CAMERAS = {5: (1, 3, 4, 5, 7), 9: tuple(range(9))}
_HIDDEN = {"none": (0.0, 0.0), "up to a third": (0.0, 0.34), "more": (0.34, 1.0)}
_NEAR = 4  # particles around a node, which tell how much of it is hidden
Figures = dict[tuple[int, str, str], float]  # cameras, solver and what: its figure


@dataclass(frozen=True)
class _Seen:
    """Two frames of some cameras, with the share (n,) of hidden views."""

    cases: tuple[Observation, ...]
    shots: tuple[Shot, ...]
    times_s: tuple[float, ...]
    hidden: tuple[F64, ...]


def flow_behind_bodies(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure recall, ghosts and velocity errors; the thesis shows no such flow.

    Tracers move with a viscous flow around a body at rest, which hides some of them from some of
    the cameras. Recall and velocity errors are given over the share of the cameras that do not see
    a particle, and over the number of cameras.
    """
    for body, name in _SCENES.items():
        scene = common.coarsen(load_scene(name), pixels)
        draws: list[Figures] = []
        for seed in seeds:
            shots = tuple(simulate_sequence(scene, seed=seed, backend="mitsuba"))
            draws.append(_measure(scene, seed, shots))
            common.report(f"{body}, seed {seed}: measured")
            if seed == seeds[0]:
                # draw the middle camera's image, its brightest pixels cut
                case = shots[0].observation
                view = case.images[len(case.images) // 2].astype(np.float64)
                panels = (common.image_panel("", np.minimum(view, np.percentile(view, 99.0))),)
                yield Figure(
                    f"flow-behind-{body}", f"tracers around a {body}", panels, inch=(5.5, 4.4)
                )
        for cameras, solver, what in draws[0]:
            values = [figures[cameras, solver, what] for figures in draws]
            yield common.finite_row(f"{body}, {cameras} cameras, {solver}: {what}", values)
        yield _flow_figure(body, draws)


def _measure(scene: Scene, seed: int, shots: tuple[Shot, ...]) -> Figures:
    out: Figures = {}
    times = tuple(scene.time_s(frame) for frame in range(2))
    for count, chosen in _CAMERAS.items():
        cases = tuple(_only(shot.observation, chosen) for shot in shots)
        recorded = _Seen(cases, shots, times, tuple(_hidden(shot, chosen) for shot in shots))
        out[count, "all", "hidden views, %"] = 100.0 * float(recorded.hidden[0].mean())
        for solver in _SOLVERS:
            # find the particles of the first frame; recall and ghosts in percent
            hit, scored, ghosts = _match(
                solver, recorded.cases[0], recorded.times_s[0], recorded.shots[0].particles
            )
            figures = {"recall, %": _percent(hit[scored])}
            for name, inside in _classes(recorded.hidden[0]):
                figures[f"recall, hidden from {name}, %"] = _percent(hit[scored & inside])
            for what, value in (figures | {"ghosts, %": ghosts}).items():
                out[count, solver, what] = value
        for what, value in _velocities(scene, seed, recorded).items():
            out[count, _FIELD, what] = value
    return out


def _only(case: Observation, chosen: tuple[int, ...]) -> Observation:
    cameras = tuple(case.cameras[number] for number in chosen)
    return replace(case, images=case.images[list(chosen)], cameras=cameras)


def _hidden(shot: Shot, chosen: tuple[int, ...]) -> F64:
    """Compute the share (n,) of the cameras that do not see each particle lit."""
    lit = [shot.views[number].visible & (shot.views[number].photons > 0.0) for number in chosen]
    return np.asarray(1.0 - np.mean(lit, axis=0))


def _classes(hidden: F64) -> Iterator[tuple[str, Bool]]:
    """Group places by the share of the cameras that they are hidden from."""
    for name, (low, high) in _HIDDEN.items():
        inside = hidden <= high if high == 0.0 else (hidden > low) & (hidden <= high)
        yield name, np.asarray(inside)


def _match(
    solver: str, case: Observation, time_s: float, particles: Particles
) -> tuple[Bool, Bool, float]:
    """Find the particles of one frame and match them with the true ones.

    Returns which true particles (n,) are found, which are in the scored part, and the ghosts in
    percent of the found ones there.
    """
    grid = case.grid
    sequence = ImageSequence(case.cameras, grid, (time_s,), lambda _: case)
    estimate: FoundParticles = next(iter(common.run(solver, sequence)))
    places, true = grid.to_voxels(estimate.position_mm), grid.to_voxels(particles.position_mm)
    i, j = challenge_pairs(places, true)
    hit, ghost = np.zeros(len(true), dtype=np.bool_), np.ones(len(places), dtype=np.bool_)
    hit[j], ghost[i] = True, False
    scored = grid.in_scored(true)
    ghosts = int((ghost & grid.in_scored(places)).sum())
    return hit, scored, 100.0 * ghosts / max(int(hit[scored].sum()), 1)


def _percent(hit: Bool) -> float:
    return 100.0 * float(hit.mean()) if len(hit) else float("nan")


def _velocities(scene: Scene, seed: int, recorded: _Seen) -> dict[str, float]:
    """Compute root mean square errors of displacements in voxels, in the fluid."""
    from scipy.spatial import cKDTree

    grid = recorded.cases[0].grid
    start, end = recorded.times_s
    pair = common.reconstruct("msa", recorded.cases, end - start)
    field = common.run("piv3d", pair, **common.settings("piv3d", _WINDOW, _OVERLAP, grid))
    points = evaluation_lattice(grid).positions_mm.reshape(-1, 3)
    for body, _ in Phases(scene, seed).bodies(0):
        points = points[~contains(body, points)]
    velocity, measured = sample_velocity(field, points)
    exact = common.exact_displacements(scene, points, start, end, seed)
    error = np.linalg.norm((velocity * (end - start) - exact) / np.asarray(grid.voxel_mm), axis=1)
    near = cKDTree(recorded.shots[0].particles.position_mm).query(points, k=_NEAR)[1]
    hidden = recorded.hidden[0][near].mean(axis=1)
    figures = {"yield, %": _percent(measured), "rms, voxel": _rms(error[measured])}
    for name, inside in _classes(hidden):
        figures[f"rms, hidden from {name}, voxel"] = _rms(error[measured & inside])
    return figures


def _rms(error: F64) -> float:
    return float(np.sqrt((error**2).mean())) if len(error) else float("nan")


def _flow_figure(body: str, draws: Sequence[Figures]) -> Figure:
    """Draw recall and velocity error over hidden views and cameras."""
    labels = list(_HIDDEN)
    recall = [
        _curve(solver, [(9, solver, f"recall, hidden from {name}, %") for name in labels], draws)
        for solver in _SOLVERS
    ]
    recalled = [
        _curve(solver, [(count, solver, "recall, %") for count in _CAMERAS], draws, list(_CAMERAS))
        for solver in _SOLVERS
    ]
    errors = [
        _curve(
            f"{count} cameras",
            [(count, _FIELD, f"rms, hidden from {name}, voxel") for name in labels],
            draws,
        )
        for count in _CAMERAS
    ]
    over = "hidden from: 0 none, 1 up to a third, 2 more"
    panels = (
        Panel("nine cameras", over, "recall, %", tuple(recall)),
        Panel("all particles", "cameras", "recall, %", tuple(recalled)),
        Panel(_FIELD, over, "rms error, voxel", tuple(errors)),
    )
    return Figure(f"flow-behind-{body}-scores", f"recall and errors around a {body}", panels)


def _curve(
    label: str,
    keys: Sequence[tuple[int, str, str]],
    draws: Sequence[Figures],
    x: Sequence[float] | None = None,
) -> Curve:
    values = [[row.get(key, np.nan) for row in draws] for key in keys]
    return common.curve_of_means(label, x or range(len(keys)), values)


_LARGEST_MM = 1.6  # as the solvers take it
_BUBBLES, _TRACERS = ("rim_fit", "separated_bubbles"), ("bayesian_ipr", "separated_tracers")
_KEYS = ("recall", "precision", "radius_percent", "plane_mm", "depth_mm")


@dataclass(frozen=True)
class _Shot:
    """One frame, and the truth of its three phases."""

    case: Observation
    bubbles: Bubbles
    particles: Particles
    lit: Bool
    sights: tuple[Sight, ...]


def three_phases(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure each phase with and without separation; the thesis shows no such flow.

    The images are separated by phase, and each phase is scored: bubbles, tracers, and the outline
    of the body. The same solvers on the raw images show what separation gains.
    """
    scene = common.coarsen(load_scene("three-phases"), pixels)
    draws: list[dict[str, float]] = []
    for seed in seeds:
        shot = _record(scene, seed)
        visible = np.mean([sight.visible for sight in shot.sights], axis=0)
        out: dict[str, float] = {}
        for name in _BUBBLES:
            scores = detection_scores(common.run(name, shot.case), shot.bubbles, visible)
            out |= {f"bubbles, {name}: {key}": scores[key] for key in _KEYS}
        # compare the body's pixels with those that show it: intersection over union
        body = separate_phases(shot.case, image_diameter_px(shot.case, _LARGEST_MM)).body
        true = np.stack([sight.number <= BODY for sight in shot.sights])
        draws.append(out | _tracers(shot) | {"body: intersection over union": overlap(body, true)})
        common.report(f"three phases, seed {seed}: measured")
        if seed == seeds[0]:
            # draw one view and its three parts
            case = shot.case
            parts = separate_phases(case, image_diameter_px(case, _LARGEST_MM))
            middle = len(case.images) // 2
            shown = {
                "one view": case.images[middle],
                "bubbles": parts.bubbles.images[middle],
                "tracers": parts.tracers.images[middle],
                "body": parts.body[middle],
            }
            panels = tuple(common.image_panel(name, image) for name, image in shown.items())
            yield Figure("three-phases", "three phases", panels, across=2, inch=(4.6, 3.6))
    for what in draws[0]:
        yield common.finite_row(what, [figures[what] for figures in draws])


def _record(scene: Scene, seed: int) -> _Shot:
    frame = Frames(scene, build_rig(scene, scene.title), seed).at(0)
    views = [render_camera_view(frame, number) for number in range(len(frame.rig.cameras))]
    case = observation_of(frame, [record_image(frame, v, n) for n, v in enumerate(views)])
    sights = tuple(view.sight for view in views if view.sight is not None)
    images = [view.particles for view in views if view.particles is not None]
    if frame.bubbles is None or frame.tracers is None:
        raise ValueError(f"{scene.title}: expected bubbles and tracers")
    share = np.mean([image.visible & (image.photons > 0.0) for image in images], axis=0)
    return _Shot(case, frame.bubbles, frame.tracers.particles, share > 0.5, sights)


def _tracers(shot: _Shot) -> dict[str, float]:
    """Compute recall of all tracers and of those seen by most, and ghosts."""
    out: dict[str, float] = {}
    for name in _TRACERS:
        hit, scored, ghosts = _match(name, shot.case, 0.0, shot.particles)
        out |= {
            f"tracers, {name}: recall": float(hit[scored].mean()),
            f"tracers, {name}: recall of those seen": float(hit[scored & shot.lit].mean()),
            f"tracers, {name}: ghosts, %": ghosts,
        }
    return out


def overlap(found: Bool, true: Bool) -> float:
    """Compute intersection over union of pixels; 1 where both are empty."""
    union = int((found | true).sum())
    return float((found & true).sum() / union) if union else 1.0
