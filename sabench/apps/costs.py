"""Time, memory and disk space of commands, from a measured part of their work."""

import functools
import glob
import math
import os
import shutil
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np

from sabench import plugins
from sabench.dataset.arrays import group_of, named_arrays, write_arrays
from sabench.dataset.cameras import CamerasFile
from sabench.dataset.hdf5 import create_hdf5
from sabench.dataset.reader import open_dataset
from sabench.dataset.shards import ShardContents
from sabench.evaluation.record_schema import Record
from sabench.evaluation.records import key_of
from sabench.evaluation.reproduction import load_reproduction
from sabench.evaluation.runner import COMPUTED, describe_run, known_records
from sabench.evaluation.suite_loading import load_suite, read_secret
from sabench.evaluation.suites import Only, SceneCase
from sabench.evaluation.timed_solving import reference_s
from sabench.geometry.camera import Camera
from sabench.images.tiff_exr import write_exr, write_tiff
from sabench.scenes import ParticleWorld, Rig, Scene, build_rig, load_scene
from sabench.simulation.camera_view import record_image, render_camera_view
from sabench.simulation.frames import FrameContent
from sabench.simulation.pipeline import renderer_of
from sabench.simulation.recording.parts import Job, Part
from sabench.simulation.recording.recorders import recorder_of
from sabench.simulation.recording.schedule import RecordingTask
from sabench.simulation.shard_job import SampleMaker, ShardJob, ShardMaker
from sabench.tasks.external_programs import is_program
from sabench.tasks.solve_and_score import describe_solver
from sabench.tasks.visible_files import hide_from_solvers
from sabench.utils import memory
from sabench.utils.arrays import F64
from sabench.utils.backend import Renderer, choose_renderer
from sabench.utils.errors import InputError
from sabench.utils.processes.call import call_isolated
from sabench.utils.progress import say

_TRIAL_S = 2.0  # of a measurement, until which it goes on with larger images
_NOTICE_S, _NOTICE_BYTES, _SMALL_PX = 60.0, 1e9, 5e6
_STORED = ("disk", "results")  # costs of data and results that a suite may delete


@dataclass(frozen=True)
class Costs:
    """Costs of a command.

    Attributes
    ----------
    seconds : time of the parts whose time is known.
    memory, disk : bytes; None where unknown.
    results : bytes on the disk that results take at most, as their arrays are compressed.
    unknown : whether other parts take unknown time.
    """

    seconds: float = 0.0
    memory: float | None = 0.0
    disk: float = 0.0
    results: float = 0.0
    unknown: bool = False

    def __add__(self, other: "Costs") -> "Costs":
        """Add the costs of a command that runs afterwards."""
        known = self.memory is not None and other.memory is not None
        peak = max(self.memory or 0.0, other.memory or 0.0) if known else None
        seconds, disk = self.seconds + other.seconds, self.disk + other.disk
        results, unknown = self.results + other.results, self.unknown or other.unknown
        return Costs(seconds, peak, disk, results, unknown)

    def __str__(self) -> str:
        """Name time, memory and disk space."""
        span = "unknown"
        if self.seconds > 0.0:
            words = "at least" if self.unknown else "roughly"
            span = f"{words} {timedelta(seconds=math.ceil(self.seconds))}"
        peak = "unknown" if self.memory is None else f"about {_size(self.memory)}"
        more = f" and at most {_size(self.results)} of results" if self.results else ""
        return f"time {span}, memory {peak}, disk {_size(self.disk)}{more}"


def announce(costs: Costs, target: Path, *, dry_run: bool) -> None:
    """Print costs above a minute or 1 GB; in a dry run, print any and exit.

    Raises InputError if the disk of `target` is too small.
    """
    disk = next(path for path in (target.absolute(), *target.absolute().parents) if path.exists())
    free = shutil.disk_usage(disk).free
    if dry_run:
        room = f"{_size((memory.available_mb() or 0.0) * 1e6)} of memory, {_size(free)} of disk"
        print(f"{target}: {costs}; free: {room}")
        raise SystemExit(0)
    unfinished = target.parent.glob(f".{glob.escape(target.name)}.*/**/*")
    if costs.disk > (left := free + sum(one.stat().st_size for one in unfinished if one.is_file())):
        raise InputError(
            f"{target}: expected {_size(costs.disk)} of free disk space, got {_size(left)}; "
            "choose another disk, or generate less"
        )
    largest = max(costs.memory or 0.0, costs.disk + costs.results)
    if costs.seconds > _NOTICE_S or largest > _NOTICE_BYTES:
        say(f"{target}: {costs}")


def _size(count: float) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{max(1.0, count / 1e6):.0f} MB"


def _count_pixels(optics: Rig | CamerasFile) -> int:
    return sum(camera.rows * camera.columns for camera in optics.cameras)


def cost_of_generation(
    scene: Scene, seed: int, backend: Renderer, jobs: int, *, exact: bool
) -> Costs:
    """Estimate the costs of `generate`; raises as it does.

    Two cameras' images are rendered in growing windows and extrapolated to all images. Unless
    `exact`, small scenes, which take seconds, cost nothing.
    """
    label, renderer = scene.title, renderer_of(scene, backend, scene.title)
    pixels = scene.frames * _count_pixels(build_rig(scene, label))
    if not exact and pixels < (_SMALL_PX if isinstance(scene.world, ParticleWorld) else 1e5):
        return Costs()
    recorder, start = recorder_of(scene, seed, renderer, label), time.perf_counter()
    entries = recorder.frame(0, lambda frame: Part({}))
    first = frame_s = time.perf_counter() - start
    for number in range(1, min(scene.frames, 3)):  # kernels of a flow load in the second frame
        if frame_s < _TRIAL_S:
            start = time.perf_counter()
            entries = recorder.frame(number, lambda frame: Part({}))
            frame_s = time.perf_counter() - start
    assert recorder.last is not None
    truth = sum(array.nbytes for value, _ in entries for array in named_arrays(value, "").values())
    start_s, view = _measure_view(recorder.last) if recorder.views else (0.0, np.zeros(3))
    images, crew = scene.frames * recorder.views, min(jobs, os.cpu_count() or 1)
    seconds = first + start_s + (scene.frames * frame_s + images * view[0]) / crew
    return Costs(seconds, jobs * view[2], scene.frames * truth + images * view[1])


def _measure_view(frame: FrameContent) -> tuple[float, F64]:
    """Measure seconds to start, and seconds, bytes and peak (3,) of one image."""
    cameras, points = frame.rig.cameras, list[tuple[float, F64]]()
    _render(frame, _crop(cameras[0], 16, 0.5))  # loads the renderer and its kernels
    start = time.perf_counter()
    for side in (16, 8, 4, 2, 1):
        cold = _render(frame, _crop(cameras[0], side, 0.5))[0]
        warm = [
            _render(frame, _crop(cameras[n % len(cameras)], side, place))
            for n, place in ((1, 0.5), (2, 0.125))
        ]
        points.append((side**-2.0, np.mean(warm, axis=0)))
        took = float(points[-1][1][0])
        late = time.perf_counter() - start > _TRIAL_S or 6.0 * took > _TRIAL_S
        if late and side < 16:
            break
    (before, low), (part, high) = points[0], points[-1]
    slope = np.maximum(high - low, 0.0) / (part - before)
    return max(cold - took, 0.0), high + slope * (1.0 - part)


def _crop(camera: Camera, side: int, place: float) -> Camera:
    """Cut 1 / side of a camera's rows and columns; `place` is 0 to 1 between edges."""
    rows, columns = max(camera.rows // side, 1), max(camera.columns // side, 1)
    column, row = camera.principal_point_px
    down, right = int((camera.rows - rows) * place), int((camera.columns - columns) * place)
    return replace(
        camera, rows=rows, columns=columns, principal_point_px=(column - right, row - down)
    )


def _render(frame: FrameContent, camera: Camera) -> F64:
    """Measure seconds, stored bytes and peak memory (3,) of one image."""
    start, frame = time.perf_counter(), replace(frame, rig=replace(frame.rig, cameras=(camera,)))
    view = render_camera_view(frame, 0)
    with tempfile.TemporaryDirectory() as folder:
        grey, light, truth = (Path(folder) / name for name in ("a.tif", "a.exr", "a.h5"))
        write_tiff(grey, record_image(frame, view, 0))
        write_exr(light, view.radiance().astype(np.float32))
        with create_hdf5(truth) as (file, _):
            for part in (view.sight, view.particles):
                if part is not None:
                    write_arrays(file, part, group_of(type(part), 0, camera.name))
        stored = sum(file.stat().st_size for file in (grey, light, truth))
    return np.array([time.perf_counter() - start, stored, (memory.peak_mb() or 0.0) * 1e6])


def cost_of_samples(
    scene: Scene, samples: int, kept: dict[str, Any], common: dict[str, Any], *, exact: bool
) -> Costs:
    """Estimate the costs of `generate_samples` from a small shard; raises as it does.

    `kept` and `common` are arguments of it.
    """
    contents = {key: kept[key] for key in ("truth", "compression") if key in kept}
    seed, backend = common["seed"], common["backend"]
    pixels = scene.frames * _count_pixels(build_rig(scene, scene.title))
    if not exact and samples * pixels < _SMALL_PX:
        return Costs()
    renderer = choose_renderer("splat" if backend == "auto" else backend)
    maker, times = SampleMaker(scene, seed, renderer), [time.perf_counter()]
    for number in range(2):
        maker.make(number)
        times.append(time.perf_counter())
    took = times[2] - times[1]
    count = min(samples, max(1, int(_TRIAL_S / 2.0 / took)), 16)
    job = ShardJob(
        Job(scene, seed, renderer, scene.title), count, (1.0,), count, ShardContents(**contents)
    )
    with tempfile.TemporaryDirectory() as folder:
        job.write(Path(folder))
        start = time.perf_counter()
        ShardMaker(job, Path(folder))(RecordingTask(0))
        each = (time.perf_counter() - start) / count
        files = [path.stat().st_size for path in Path(folder).glob("data/*/*.h5")]
    crew = min(common["jobs"], os.cpu_count() or 1)
    seconds = max(times[1] - times[0] - took, 0.0) + samples * each / crew
    return Costs(
        seconds, common["jobs"] * (memory.peak_mb() or 0.0) * 1e6, samples * sum(files) / count
    )


def cost_of_solving(
    records: Sequence[Record], head: Record, optics: Rig | CamerasFile, frames: int
) -> Costs:
    """Estimate a solver's costs from its records and the reference kernel.

    Records of bundled scenes serve others, scaled by voxels in tasks with volumes, else by pixels.
    """
    volumes = head["task"] in ("reconstruction", "velocimetry")
    largest = 4.0 * frames * math.prod(optics.grid.shape) * (head["task"] == "reconstruction")
    keys = ("reference_s", "seconds", "peak_mb")
    own = [one for one in records if all(one.get(key) for key in keys)]
    own = [one for one in own if all(one[key] == head[key] for key in ("solver", "parameters"))]
    fitting, ratio = [one for one in own if one["scene_hash"] == head["scene_hash"]], 1.0
    if not fitting:
        for name in sorted({one["scene"] for one in own} & set(plugins.list_scenes())):
            scene = load_scene(name)
            if fitting := [one for one in own if one["scene_hash"] == scene.hash]:
                sizes = (
                    math.prod(one.grid.shape) if volumes else _count_pixels(one)
                    for one in (optics, build_rig(scene, name))
                )
                ratio = next(sizes) / next(sizes)
                break
    if not fitting:
        return Costs(0.0, None, results=largest, unknown=True)
    rate = float(np.median([one["seconds"] / one["reference_s"] for one in fitting]))
    peak = max(one["peak_mb"] for one in fitting) * 1e6 * max(ratio, 1.0)
    return Costs(frames * ratio * rate * _measure_reference()[1], peak, results=largest)


@functools.cache
def _measure_reference() -> tuple[float, float]:
    """Measure seconds to start a child process, and of the reference kernel in it."""
    start = time.perf_counter()
    reference = float(call_isolated(reference_s, doing="reference kernel"))
    return time.perf_counter() - start, reference


def cost_of_solve(solver: str, dataset: Path, parameters: dict[str, Any], *, exact: bool) -> Costs:
    """Estimate the costs of `solve`; unknown for programs, and without a record.

    Unless `exact`, small data sets cost nothing.
    """
    data = open_dataset(dataset)
    if not exact and data.setup.frames * _count_pixels(data.setup) < _SMALL_PX:
        return Costs()
    if is_program(solver):
        return Costs(0.0, None, unknown=True)
    task, given = describe_solver(solver, parameters)
    head: Record = {"solver": solver, "task": task, "parameters": given}
    head["scene_hash"] = getattr(data.contents, "scene_hash", None)
    return cost_of_solving(_records(), head, data.setup, data.setup.frames)


def _records(leaderboard: Path = Path("leaderboard")) -> list[Record]:
    bundled = plugins.bundled_folder("leaderboard")
    return [one for folder in (bundled, leaderboard) for one in known_records(folder).values()]


def cost_of_suite(
    path: str,
    work: Path,
    leaderboard: Path,
    only: Only,
    secret: Path | None,
    jobs: int,
    *,
    fresh: bool,
) -> Costs:
    """Estimate the costs of `run`: of data sets and results that it lacks.

    One data set of each scene and renderer is measured; others are scaled by their pixels. The
    start of two child processes stands for what checks, scores and figures of a result take.
    """
    with hide_from_solvers(secret):
        suite, cases = load_suite(path, read_secret(secret) if secret else None)
        heads = [
            (case, [describe_run(case, entry, path) for entry in case.solvers])
            for case in only.select(cases)
        ]
    records = _records(leaderboard)
    known = {} if fresh else known_records(leaderboard)
    total, rates = Costs(), dict[tuple[str, str], tuple[Costs, int]]()
    for case, runs in heads:
        lacking = [head for head in runs if key_of(head, COMPUTED) not in known]
        optics: Rig | CamerasFile
        if isinstance(case, SceneCase):
            optics, frames = build_rig(case.scene, case.name), case.scene.frames
        else:
            optics, frames = case.data.setup, case.data.setup.frames
        parts = [cost_of_solving(records, head, optics, frames) for head in lacking]
        if lacking and isinstance(case, SceneCase) and (fresh or not case.folder(work).is_dir()):
            pixels = frames * _count_pixels(optics)
            if (case.base, case.renderer) not in rates:
                asked: Renderer = "mitsuba" if case.renderer == "mitsuba" else "splat"
                made = cost_of_generation(case.scene, case.seed, asked, jobs, exact=True)
                rates[case.base, case.renderer] = made, pixels
            made, measured = rates[case.base, case.renderer]
            ratio = pixels / measured
            parts.append(replace(made, seconds=made.seconds * ratio, disk=made.disk * ratio))
        costs = sum(parts, Costs(2 * len(lacking) * _measure_reference()[0] if lacking else 0.0))
        join = sum if suite.keep_data else max
        disk, results = (join([getattr(one, key) for one in (total, costs)]) for key in _STORED)
        total = replace(total + costs, disk=disk, results=results)
    return total


def cost_of_reproduction(
    names: Sequence[str], seeds: int | None, pixels: int | None, *, exact: bool
) -> Costs:
    """Estimate the time of `reproduce` from that of a seed, which is stated.

    Unless `exact`, a trial on small images costs nothing; the time of one is unknown.
    """
    package = load_reproduction()
    chosen = [package.MEASUREMENTS[name] for name in package.resolve(names)]
    if pixels:
        return Costs(0.0, None, unknown=True) if exact else Costs()
    slower = _measure_reference()[1] / package.REFERENCE_S
    seconds = sum(one.seconds * (seeds or one.seeds) for one in chosen)
    return Costs(slower * seconds, None, unknown=any(not one.seconds for one in chosen))
