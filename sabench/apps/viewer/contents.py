"""Contents of a page: surroundings, frames and names."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from sabench import tasks
from sabench.api import Calibration, Velocity
from sabench.api.truth import Solid
from sabench.apps.viewer import points as classify
from sabench.apps.viewer.points import Estimates, ObjectCloud, with_velocities
from sabench.apps.viewer.surroundings import Surroundings
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.common_view import propose_box
from sabench.geometry.grid import Grid
from sabench.plotting.kinds import KINDS
from sabench.scenes import BubbleWorld, Scene, build_rig
from sabench.scenes.build import build_walls
from sabench.simulation.frames import light_in_fluid
from sabench.utils.arrays import F32
from sabench.utils.progress import progress_bar

Sort = Literal["Particles", "Vectors", "Target"]
MOST_FRAMES = 50
_TRUTH = {"true": "true"}
_MATCHED = {
    "true": "true, of found ones",
    "found": "found",
    "missed": "missed",
    "ghost": "ghost",
    "duplicate": "ghost: duplicate",
}
_UNMATCHED = {"found": "found; no truth is known"}
_VECTORS = {"true": "true vector", "found": "measured vector", "ghost": "interpolated vector"}
_TARGET = {"true": "true point of the target", "found": "estimated point"}


@dataclass(frozen=True)
class Frame:
    """Objects at one instant."""

    number: int
    time_s: float
    particles: ObjectCloud
    bubbles: ObjectCloud
    solids: tuple[Solid, ...] = ()


@dataclass(frozen=True)
class PageContents:
    """Everything that a page shows.

    Attributes
    ----------
    title : of the page.
    facts : pairs of a label and its text.
    labels : names of the kinds of particles and bubbles, by `KINDS`.
    data : data set of the images; None for a rig.
    volume : reconstruction (z, y, x) of the first frame, where a result has one.
    sort : heading of what the particles are.
    notes : sentences on what is left out.
    """

    title: str
    facts: tuple[tuple[str, str], ...]
    surroundings: Surroundings
    frames: tuple[Frame, ...] = ()
    labels: dict[str, str] = field(default_factory=dict)
    data: Dataset | None = None
    volume: F32 | None = None
    sort: Sort = "Particles"
    notes: tuple[str, ...] = ()

    def totals(self) -> dict[str, dict[str, list[int]]]:
        """Count the particles and bubbles of each kind in every frame."""
        return {
            "particles": _totals([frame.particles for frame in self.frames]),
            "bubbles": _totals([frame.bubbles for frame in self.frames]),
        }


def _totals(clouds: Sequence[ObjectCloud]) -> dict[str, list[int]]:
    counts = np.array([cloud.counts() for cloud in clouds]).reshape(-1, len(KINDS))
    named = zip(KINDS, counts.T, strict=True)
    return {kind: column.tolist() for kind, column in named if column.any()}


def of_scene(scene: Scene, source: str) -> PageContents:
    """Collect the rig of a scene."""
    rig = build_rig(scene, source)
    facts = [("scene", source), *_rig_facts(rig.cameras, rig.grid)]
    return PageContents(scene.title, tuple(facts), _surround(rig.cameras, rig.grid, scene))


def of_cameras(cameras: Sequence[CameraModel], grid: Grid | None, source: str) -> PageContents:
    """Collect calibrated cameras; their volume is a grid's, or the box that all see.

    Raises
    ------
    InputError
        No grid, and no box that all cameras see.
    """
    low, high = propose_box(cameras) if grid is None else grid.box_mm
    scored = np.array([low, high] if grid is None else grid.scored_box_mm)
    notes = () if grid is not None else ("The volume is the box that all cameras see.",)
    facts = [("cameras", source), *_rig_facts(cameras, grid)]
    surroundings = Surroundings(tuple(cameras), low, high, scored)
    return PageContents(f"Cameras of {source}", tuple(facts), surroundings, notes=notes)


def of_dataset(data: Dataset, result: Result | None = None) -> PageContents:
    """Collect a data set's truth, or a result of it next to the truth.

    A data set without truth shows its images and what the result has.
    """
    setup = data.setup
    count = min(setup.frames, MOST_FRAMES)
    estimates = None if result is None else Estimates(data, result)
    frames = [_frame(data, n, estimates) for n in progress_bar(range(count), "frames")]
    notes = []
    if count < setup.frames:
        notes.append(f"The first {count} of {setup.frames} frames are shown.")
    if estimates is not None and estimates.peaks:
        notes.append("Particles of the result are local maxima of its volume.")
    scene = data.scene if data.has_truth else None
    cameras = data.true_cameras if data.has_truth else setup.cameras
    title = data.root.resolve().name if scene is None else scene.title
    origin = "recorded" if data.recorded else "simulated"
    truth = "with its truth" if data.has_truth else "without truth"
    facts = [("data set", f"{data.root.resolve().name}, {origin}, {truth}")]
    if result is not None:
        facts += [("result", f"{result.path.name}, {result.solver}, task {result.task}")]
    return PageContents(
        title,
        (*facts, *_rig_facts(setup.cameras, setup.grid)),
        _surround(cameras, setup.grid, scene, () if estimates is None else estimates.cameras),
        _fill_velocities(frames),
        _labels(data, result),
        data,
        None if estimates is None else estimates.volume,
        _sort(data, result),
        tuple(notes),
    )


def _frame(data: Dataset, number: int, estimates: Estimates | None) -> Frame:
    """Collect a frame: the estimates of a result, and the truth of everything else."""
    nothing = ObjectCloud.of_kind(np.zeros((0, 3)), 0)
    particles = None if estimates is None else estimates.particles(number)
    bubbles = None if estimates is None else estimates.bubbles(number)
    solids: tuple[Solid, ...] = ()
    if data.has_truth:
        world = data.scene.world
        if particles is None and data.shows_target:
            particles = classify.read_target_points(data, number)
        elif particles is None and "particles" in data.shows:
            particles = classify.true_particles(data, number)
        if isinstance(world, BubbleWorld):
            if bubbles is None and world.bubbles is not None:
                bubbles = classify.true_bubbles(data, number)
            solids = tuple(data.solids(number)) if world.solids else ()
    time_s = data.setup.time_s(number)
    return Frame(number, time_s, particles or nothing, bubbles or nothing, solids)


def _fill_velocities(frames: Sequence[Frame]) -> tuple[Frame, ...]:
    times = [frame.time_s for frame in frames]
    particles = with_velocities([frame.particles for frame in frames], times)
    bubbles = with_velocities([frame.bubbles for frame in frames], times)
    return tuple(
        Frame(frame.number, frame.time_s, cloud, round_ones, frame.solids)
        for frame, cloud, round_ones in zip(frames, particles, bubbles, strict=True)
    )


def _surround(
    cameras: Sequence[CameraModel],
    grid: Grid,
    scene: Scene | None,
    estimated: Sequence[CameraModel] = (),
) -> Surroundings:
    (low, high), scored = grid.box_mm, np.array(grid.scored_box_mm)
    around = Surroundings(tuple(cameras), low, high, scored, estimated=tuple(estimated))
    if scene is None:
        return around
    return replace(
        around,
        light=light_in_fluid(scene).illumination,
        backlight=scene.backlight,
        occluders=build_rig(scene).occluders,
        faces=build_walls(scene.wall),
    )


def _labels(data: Dataset, result: Result | None) -> dict[str, str]:
    if result is None:
        return _TRUTH
    kind = tasks.of(result.task).estimate
    if kind is Velocity:
        return _VECTORS
    if kind is Calibration:
        return _TARGET
    return _MATCHED if data.has_truth else _UNMATCHED


def _sort(data: Dataset, result: Result | None) -> Sort:
    if result is not None and tasks.of(result.task).estimate is Velocity:
        return "Vectors"
    return "Target" if data.shows_target else "Particles"


def _rig_facts(cameras: Sequence[CameraModel], grid: Grid | None) -> list[tuple[str, str]]:
    first = cameras[0]
    size = f"{len(cameras)} of {first.rows} x {first.columns} pixels"
    if grid is None:
        return [("array", size)]
    low, high = grid.box_mm
    edges = " x ".join(f"{edge:.4g}" for edge in high - low)
    return [("array", size), ("volume", f"{edges} mm")]
