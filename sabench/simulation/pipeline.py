"""Generation of a data set: render a scene and store it with its truth."""

import contextlib
import functools
import glob
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from filelock import FileLock, Timeout

from sabench.api import Shown
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.writer import dataset_writer
from sabench.scenes import BubbleWorld, Rig, Scene, TargetWorld, build_rig, load_scene
from sabench.scenes.focusing import nominal_cameras
from sabench.simulation.recording.parts import Job, Parts
from sabench.simulation.recording.recorders import Recorder, record_task, recorder_of
from sabench.simulation.recording.schedule import (
    InProcess,
    ProcessPool,
    RecordingTask,
    Schedule,
    UnfinishedError,
    WorkerPool,
    run_schedule,
)
from sabench.utils import memory
from sabench.utils.backend import Renderer, choose_renderer
from sabench.utils.errors import InputError
from sabench.utils.files import check_replaceable, refuse_existing
from sabench.utils.progress import progress_bar
from sabench.utils.rng import stream
from sabench.worlds.bubbles_and_bodies import has_code

_WORKING_BYTES = 40  # per pixel in work: photons, radiance and noise as doubles, then grey values


def check_affordable(name: str, scene: Scene, rig: Rig, folder: Path, *, copies: int = 1) -> None:
    """Refuse a scene that cannot fit into memory or on the disk.

    One image at a time must fit into memory, and all images of all `copies` of the scene on the
    disk of the folder. Both are lower bounds: a scene that passes may still need too much.
    """
    pixels = scene.cameras.rows * scene.cameras.columns
    pictures = copies * scene.frames * len(rig.cameras)
    available, need = memory.available_mb(), pixels * _WORKING_BYTES / 1e6
    if available is not None and need > available:
        size = f"{scene.cameras.rows} x {scene.cameras.columns}"
        raise InputError(
            f"{name}: cameras: expected pictures that fit into memory, but one of {size} pixels "
            f"needs {need:.0f} MB where {available:.0f} are there"
        )
    world = scene.world
    if isinstance(world, TargetWorld) and world.lighting is None:  # without images
        return
    disk = next(path for path in (folder, *folder.parents) if path.exists())
    free = shutil.disk_usage(disk).free / 1e6
    stored = pixels * pictures * np.dtype(np.uint16).itemsize / 1e6
    if stored > free:
        key = "frames" if copies == 1 else "samples"
        raise InputError(
            f"{name}: {key}: expected a data set that fits on the disk, but {pictures} pictures "
            f"need {stored:.0f} MB where {free:.0f} are free"
        )


def generate(
    scene: Scene | str | Path,
    out: str | Path,
    *,
    seed: int = 0,
    backend: Renderer = "auto",
    name: str | None = None,
    overwrite: bool = False,
    jobs: int = 1,
    scheduler: str | None = None,
) -> Dataset:
    """Generate a data set, resuming an interrupted run.

    The bytes do not depend on the number or order of workers.

    Parameters
    ----------
    scene : a scene, a scene file, or the name of a bundled one.
    out : the folder to make.
    seed : of all random numbers.
    backend : the renderer: "mitsuba" (rays through the real wall), "splat" (analytic), or "auto":
        Mitsuba where it runs, else splat.
    name : of the scene in the manifest; by default the file's stem.
    overwrite : replace an existing data set.
    jobs : processes that share the work on this machine.
    scheduler : address of a Dask scheduler, in place of `jobs`; its workers must see the
        folder of `out`.

    Raises InputError for a bad scene or seed, an existing folder, no working Mitsuba when it was
    asked for, or frames that failed again and again.
    """
    loaded, label = load_checked(scene, name, seed, jobs=jobs)
    target, renderer = Path(out).absolute(), renderer_of(loaded, backend, label)
    job = Job(loaded, seed, renderer, label)
    refuse_existing(target, overwrite=overwrite)
    check_replaceable(target, "manifest.json")
    check_affordable(label, loaded, build_rig(loaded, label), target.parent)
    with _parts(target, job) as parts:
        recorder = recorder_of(loaded, seed, job.renderer, label)
        do = functools.partial(record_task, recorder, parts)
        with worker_pool(parts.root, do, jobs, scheduler) as workers:
            tasks = Schedule(
                loaded.frames, recorder.views, chained=recorder.chained, ahead=workers.ahead
            )
            run_schedule(workers, tasks, f"render {label} with {job.renderer}")
        put_together(target, job, recorder, parts, overwrite=overwrite)
    return open_dataset(target)


def load_checked(
    scene: Scene | str | Path, name: str | None, seed: int, **counts: int
) -> tuple[Scene, str]:
    """Check a seed and numbers from 1 on, and load the scene with its name in errors."""
    stream(seed, "scene")  # refuses a bad seed
    for key, count in counts.items():
        if not isinstance(count, int) or count < 1:
            raise InputError(f"{key}: expected 1 or more, got {count!r}")
    if isinstance(scene, Scene):
        return scene, name or scene.title
    return load_scene(scene), name or Path(scene).stem


def worker_pool(
    root: Path, do: Callable[[RecordingTask], None], jobs: int, scheduler: str | None
) -> contextlib.closing[WorkerPool]:
    """Open this process, some processes or the workers of a Dask scheduler as a pool.

    `root` is the job's folder. Raises InputError if Dask is not installed, or there is no scheduler
    at the address.
    """
    if not scheduler:
        return contextlib.closing(InProcess(do) if jobs == 1 else ProcessPool(root, jobs))
    try:
        from sabench.simulation.recording.dask_workers import DaskPool
    except ImportError as error:
        raise InputError(
            f"scheduler: expected the package distributed, got {error}: "
            "run pip install 'sabench[dask]'"
        ) from error
    return contextlib.closing(DaskPool(scheduler, root))


@contextlib.contextmanager
def locked(root: Path, target: Path) -> Iterator[None]:
    """Lock the folder of a data set, or say that another process makes it."""
    try:
        with FileLock(root / "lock", timeout=0):
            yield
    except Timeout as error:
        raise InputError(
            f"{target}: expected nobody else at it, but another process is making this data set"
        ) from error


@contextlib.contextmanager
def _parts(target: Path, job: Job) -> Iterator[Parts]:
    """Open the folder of a data set's parts, next to the data set.

    It is removed when the data set is complete, and kept for the next run after an interruption.
    """
    parts = Parts(target.parent / f".{target.name}.parts-{job.key[:16]}")
    job.write(parts.root)
    with locked(parts.root, target):
        try:
            yield parts
        except UnfinishedError:
            raise
        except BaseException as error:
            # after an InputError, another try would fail again
            if isinstance(error, InputError) or not any(parts.root.glob("views/*.npz")):
                _forget(target)
            raise
        _forget(target)


def _forget(target: Path) -> None:
    for folder in target.parent.glob(f".{glob.escape(target.name)}.parts-*"):
        shutil.rmtree(folder, ignore_errors=True)


def put_together(
    target: Path, job: Job, recorder: Recorder, parts: Parts, *, overwrite: bool
) -> None:
    """Make the data set from all its parts."""
    rig, world, shows = build_rig(job.scene, job.label), job.scene.world, list[Shown]()
    if isinstance(world, BubbleWorld):
        shows += ["particles"] if world.tracers else []
        shows += ["bubbles", "code"] if has_code(job.scene) else ["bubbles"]
    nominal = nominal_cameras(job.scene, rig.cameras, job.seed)
    with dataset_writer(
        target,
        job.label,
        job.scene,
        rig,
        nominal,
        job.seed,
        job.renderer,
        shows=tuple(shows),
        overwrite=overwrite,
    ) as writer:
        for frame in progress_bar(range(job.scene.frames), f"store {job.label}"):
            writer.store(parts.frame(frame).truth)
            for camera in rig.cameras[: recorder.views]:
                part = parts.view(frame, camera.name)
                writer.store(part.truth)
                for name, entry in part.files.items():
                    writer.take(parts.root / name, name, entry)
            memory.trim()
        recorder.finish(writer, parts)


def renderer_of(scene: Scene, asked: Renderer, label: str) -> str:
    """Choose a scene's renderer; raises InputError for one that cannot render it."""
    world = scene.world
    if isinstance(world, BubbleWorld):
        if asked == "splat":
            raise InputError(
                f"{label}: backend: expected mitsuba for bubbles and solids, got splat, which "
                "renders particles only"
            )
        return choose_renderer("mitsuba")
    if not isinstance(world, TargetWorld) or world.lighting is not None:
        return choose_renderer(asked)
    # a target without lamps has no images
    if asked == "mitsuba":
        raise InputError(
            f"{label}: lighting: expected lamps to render a target by, got none; the backend splat "
            "needs none"
        )
    return "splat"
