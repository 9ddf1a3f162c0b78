"""Generation of a data set: render a scene and store it with its truth."""

from __future__ import annotations

import contextlib
import functools
import glob
import shutil
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from sabench.api import Shown
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.writer import dataset_writer
from sabench.scenes import BubbleWorld, Scene, TargetWorld, build_rig, load_scene
from sabench.scenes.nominal_cameras import nominal_cameras
from sabench.simulation.recording.job import Job, record_task
from sabench.simulation.recording.parts import Parts
from sabench.simulation.recording.recorders import Recorder, recorder_of
from sabench.simulation.recording.schedule import Schedule, WorkerPool
from sabench.simulation.recording.workers import (
    InProcess,
    ProcessPool,
    UnfinishedError,
    dask_pool,
    run_schedule,
)
from sabench.simulation.renderer_choice import Renderer, choose_renderer
from sabench.simulation.size_check import check_affordable
from sabench.utils import memory
from sabench.utils.errors import InputError
from sabench.utils.files import refuse_existing
from sabench.utils.progress import progress_bar
from sabench.worlds.readable_codes import has_code


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
    scheduler : address of a Dask scheduler whose workers do the work, in place of `jobs`; they must
        see the folder of `out`.

    Raises
    ------
    InputError
        A bad scene or seed, an existing folder, no working Mitsuba when it was asked for, or frames
        that failed again and again.
    """
    if not 0 <= seed < 2**63:
        raise InputError(f"seed: expected 0 to 2^63 - 1, got {seed}")
    if jobs < 1:
        raise InputError(f"jobs: expected 1 or more, got {jobs}")
    loaded, target = scene if isinstance(scene, Scene) else load_scene(scene), Path(out).absolute()
    label = name or (loaded.title if isinstance(scene, Scene) else Path(scene).stem)
    job = Job(loaded, seed, _renderer(loaded, backend, label), label)
    refuse_existing(target, overwrite=overwrite)
    check_affordable(label, loaded, build_rig(loaded, label), target.parent)
    with _parts(target, job) as parts:
        recorder = recorder_of(loaded, seed, job.renderer, label)
        if scheduler:
            workers: WorkerPool = dask_pool(scheduler, parts.root)
        else:
            do = functools.partial(record_task, recorder, parts)
            workers = InProcess(do) if jobs == 1 else ProcessPool(parts.root, jobs)
        with contextlib.closing(workers):
            run_schedule(
                workers,
                Schedule(
                    loaded.frames, recorder.views, chained=recorder.chained, ahead=workers.ahead
                ),
                f"render {label} with {job.renderer}",
            )
        put_together(target, job, recorder, parts, overwrite=overwrite)
    return open_dataset(target)


@contextlib.contextmanager
def _parts(target: Path, job: Job) -> Iterator[Parts]:
    """Open the folder of a data set's parts, next to the data set.

    It is removed when the data set is complete, and kept for the next run after an interruption.
    """
    parts = Parts(target.parent / f".{target.name}.parts-{job.key[:16]}")
    job.write(parts.root)
    try:
        with FileLock(parts.root / "lock", timeout=0):
            yield parts
    except Timeout as error:
        raise InputError(
            f"{target}: expected nobody else at it, but another process is making this data set"
        ) from error
    except UnfinishedError:
        raise
    except InputError:  # what no other try would mend
        _forget(target)
        raise
    except BaseException:
        if parts.empty():
            _forget(target)
        raise
    _forget(target)


def _forget(target: Path) -> None:
    """Remove all parts of a data set, also those of another scene or seed."""
    for folder in target.parent.glob(f".{glob.escape(target.name)}.parts-*"):
        shutil.rmtree(folder, ignore_errors=True)


def put_together(
    target: Path, job: Job, recorder: Recorder, parts: Parts, *, overwrite: bool
) -> None:
    """Make the data set from all its parts."""
    rig = build_rig(job.scene, job.label)
    nominal = nominal_cameras(job.scene, rig.cameras, job.seed)
    with dataset_writer(
        target,
        job.label,
        job.scene,
        rig,
        nominal,
        job.seed,
        job.renderer,
        shows=_shows(job.scene),
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


def _shows(scene: Scene) -> tuple[Shown, ...]:
    """List kinds of objects in frames of bubbles and bodies; none for other scenes."""
    world = scene.world
    if not isinstance(world, BubbleWorld):
        return ()
    particles: tuple[Shown, ...] = ("particles",) if world.tracers else ()
    code: tuple[Shown, ...] = ("code",) if has_code(scene) else ()
    return (*particles, "bubbles", *code)


def _renderer(scene: Scene, asked: Renderer, label: str) -> str:
    """Choose the renderer of a scene; a target without lamps has no images."""
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
    if asked == "mitsuba":
        raise InputError(
            f"{label}: lighting: expected lamps to render a target by, got none; the backend splat "
            "needs none"
        )
    return "splat"
