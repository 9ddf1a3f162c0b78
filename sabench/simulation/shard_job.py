"""Independent samples of a scene: in memory batch after batch, and into shards.

A sample equals what `generate` makes of the scene with the sample's seed: other
particles, other noise, and other values of the keys that the scene's `vary` lists. Sample n depends
on the seed and n alone, so that a stream can resume anywhere, with any batch size.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sabench.api import Observation
from sabench.api.truth import Particles, ParticleView
from sabench.dataset.sample_set import Batch, make_batch
from sabench.dataset.shards import (
    SampleRecord,
    Shard,
    ShardContents,
    ShardFolder,
    check_shares,
    plan_shards,
    split_names,
    split_of,
)
from sabench.dataset.writer import list_setups
from sabench.images.preprocessing import takes_all_frames
from sabench.scenes import ParticleWorld, Rig, Scene, build_rig, load_scene, parse_scene
from sabench.scenes.focusing import nominal_cameras
from sabench.scenes.variation import draw_values, extremes, with_values
from sabench.simulation.camera_view import render_camera_view
from sabench.simulation.frames import Frames
from sabench.simulation.in_memory import observation_of, record_frame
from sabench.simulation.recording.parts import JOB, Job, read_job
from sabench.simulation.recording.schedule import RecordingTask
from sabench.utils import memory
from sabench.utils.arrays import F32, U16
from sabench.utils.backend import Renderer, choose_renderer, limit_kernels
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, complete_or_nothing, read_json
from sabench.utils.rng import stream as random_stream

Views = tuple[tuple[ParticleView, ...], ...]  # of each frame and camera
_SMALL_PX = 4_000_000  # of all cameras: threads that meet cost more time than they save
_MOST_DRAWS = 1000  # of one sample's values: none of them gives a scene that can be


@dataclass(frozen=True)
class Sample:
    """One sample.

    Attributes
    ----------
    number : in the stream.
    scene, seed : it is what `simulate` makes of these.
    drawn : values of the keys that vary.
    redrawn : how often these were drawn again, as no such scene can be.
    images : (frame, camera, row, column) grey values.
    particles : true particles of each frame, the same rows for the same `id`.
    views : their true images in each frame and camera.
    rig : true cameras, grid and occluders.
    """

    number: int
    scene: Scene
    seed: int
    drawn: dict[str, Any]
    redrawn: int
    images: U16
    particles: tuple[Particles, ...]
    views: Views
    rig: Rig

    def observation(self, frame: int = 0) -> Observation:
        """Build what a solver sees of a frame."""
        content = Frames(self.scene, self.rig, self.seed, "splat").assemble(frame)
        every = takes_all_frames(self.scene.preprocessing or ())
        lowest = self.images.min(axis=0) if every else None
        return observation_of(content, list(self.images[frame]), lowest)


def stream(
    scene: Scene | str | Path,
    *,
    seed: int = 0,
    batch: int = 1,
    start: int = 0,
    samples: int | None = None,
    split: tuple[str, Sequence[float]] | None = None,
    backend: Renderer = "splat",
    key: str | None = None,
    part: tuple[int, int] = (0, 1),
) -> Iterator[Batch[Sample]]:
    """Make independent samples of a scene with particles.

    Parameters
    ----------
    scene : with particles alone; also a file, or the name of a bundled scene.
    batch : samples together; the last batch may have fewer.
    start : number of the first sample: the stream resumes as if those before had been made.
    samples : number after the last; by default the stream has no end.
    split : a name and shares, such as ("train", (80, 10, 10)): only the samples that `split_of`
        puts into "train", "validation" or "test".
    backend : "splat" or "mitsuba".
    key : that `stream_key` gave when the stream was begun, for one that goes on.
    part : (k, n) for every n-th batch from the k-th on: n processes share the work.

    Raises InputError as `simulate`; a range of `vary` with an impossible scene at its ends, unless
    impossible samples are redrawn; cameras that differ in number or size; another key.
    """
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    if key is not None and key != (now := stream_key(scene, seed=seed, backend=backend)):
        raise InputError(
            f"{scene.title}: expected the stream {key[:12]}, got {now[:12]}: the scene, the seed, "
            "the renderer, or the version of sabench or of a library that it renders with has "
            "changed since the stream began"
        )
    least = {"batch": (batch, 1), "start": (start, 0)}
    if samples is not None:
        least["samples"] = samples, start
    for name, (value, smallest) in least.items():
        if value < smallest:
            raise InputError(f"{name}: expected a number from {smallest} on, got {value}")
    numbers = itertools.count(start) if samples is None else iter(range(start, samples))
    if split is not None:
        if isinstance(split, str) or len(split) != 2:
            raise InputError(
                f'split: expected a name and shares, ("train", (80, 20)), got {split!r}'
            )
        name, shares = split
        check_shares(shares)
        if name not in (names := split_names(len(shares))):
            raise InputError(f"split: expected one of {', '.join(names)}, got {name!r}")
        if not shares[names.index(name)] > 0.0:
            raise InputError(f"split: expected a share of {name} above 0, got {list(shares)}")
        numbers = (number for number in numbers if split_of(number, shares) == name)
    return _batches(SampleMaker(scene, seed, choose_renderer(backend)), batch, numbers, part)


def stream_key(scene: Scene | str | Path, *, seed: int = 0, backend: Renderer = "splat") -> str:
    """Compute a hash of all that a stream's samples depend on but their numbers.

    That is the scene, the seed, the renderer, the code of sabench and the versions of libraries.
    """
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    return Job(scene, seed, choose_renderer(backend), scene.title).key


def _batches(
    maker: SampleMaker, batch: int, numbers: Iterator[int], part: tuple[int, int]
) -> Iterator[Batch[Sample]]:
    first, count = part
    for place in itertools.count():
        if not (chosen := list(itertools.islice(numbers, batch))):
            return
        if place % count == first:
            yield make_batch([maker.make(number) for number in chosen])


class SampleMaker:
    """Maker of the samples of one scene, which keeps what they share."""

    def __init__(self, scene: Scene, seed: int, renderer: str) -> None:
        if not isinstance(scene.world, ParticleWorld):
            raise InputError(f"{scene.title}: expected a scene with particles alone")
        memory.keep_freed()
        self.scene, self.seed, self.renderer = scene, seed, renderer
        self.rig = build_rig(scene, scene.title)
        if scene.vary is not None and scene.vary.impossible == "refuse":
            for drawn in extremes(scene.vary):
                self._possible(drawn, "at the ends of its ranges")

    def make(self, number: int) -> Sample:
        """Make a sample."""
        scene, rig, drawn, redrawn = self._choose(number)
        seed = int(random_stream(self.seed, "sample", number).integers(2**62))
        frames = Frames(scene, rig, seed, self.renderer)
        small = sum(camera.rows * camera.columns for camera in rig.cameras) < _SMALL_PX
        with limit_kernels(1) if small else contextlib.nullcontext():
            images, particles, views = _record(frames)
        return Sample(number, scene, seed, drawn, redrawn, images, particles, views, rig)

    def _choose(self, number: int) -> tuple[Scene, Rig, dict[str, Any], int]:
        """Draw a sample's values, again and again if the scene asks for it."""
        vary = self.scene.vary
        if vary is None:
            return self.scene, self.rig, {}, 0
        for attempt in range(_MOST_DRAWS):
            drawn = draw_values(vary, self.seed, number, attempt)
            try:
                return *self._possible(drawn, f"sample {number}"), drawn, attempt
            except InputError:
                if vary.impossible == "refuse":
                    raise
        raise InputError(
            f"{self.scene.title}: vary: expected values of sample {number} that give a scene, got "
            f"none in {_MOST_DRAWS} draws"
        )

    def _possible(self, drawn: dict[str, Any], which: str) -> tuple[Scene, Rig]:
        """Make the scene and rig of some values; errors name these."""
        values = with_values(self.scene.to_dict(), drawn)
        try:
            scene = parse_scene(values, self.scene.title)
            return scene, build_rig(scene, self.scene.title)
        except InputError as error:
            named = ", ".join(f"{key} = {value}" for key, value in drawn.items())
            raise InputError(f"{error} (vary, {which}: {named})") from error


def _record(frames: Frames) -> tuple[U16, tuple[Particles, ...], Views]:
    """Record images (frame, camera, row, column), particles and their images."""
    images, particles, views = [], [], []
    for number in range(frames.scene.frames):
        content = frames.at(number)
        frame_images, frame_views = record_frame(content)
        images.append(frame_images)
        views.append(tuple(frame_views))
        if content.tracers is not None:
            particles.append(content.tracers.particles)
    return np.array(images), tuple(particles), tuple(views)


PLAN = "samples.json"


@dataclass(frozen=True)
class ShardJob:
    """Samples that are generated into shards.

    Attributes
    ----------
    size : samples of a full shard.
    """

    job: Job
    samples: int
    shares: tuple[float, ...]
    size: int
    kept: ShardContents

    @functools.cached_property
    def shards(self) -> list[Shard]:
        """Shards in the order of the manifest."""
        return plan_shards(self.samples, self.shares, self.size)

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Shape (frame, camera, row, column) of a sample's images."""
        scene = self.job.scene
        cameras = len(build_rig(scene, self.job.label).cameras)
        return scene.frames, cameras, scene.cameras.rows, scene.cameras.columns

    def write(self, root: Path) -> None:
        """Write it to its shards' folder; raises InputError if it holds other shards."""
        (root / "data").mkdir(parents=True, exist_ok=True)
        if changes := self.changes(root):
            raise InputError(
                f"{root}: expected to resume with what its shards were begun with, got another "
                f"{', '.join(changes)}; restore that to resume, or say --overwrite to begin anew"
            )
        self.job.write(root)
        with complete_or_nothing(root / PLAN, overwrite=True) as partial:
            partial.write_text(canonical_json(self._plan), encoding="utf-8")

    @property
    def _plan(self) -> dict[str, Any]:
        counts = {"samples": self.samples, "split": list(self.shares), "shard size": self.size}
        kept = {"truth": list(self.kept.truth), "compression": self.kept.compression}
        return {**counts, **kept, "scene": self.job.scene.hash, "stream": self.job.key}

    def changes(self, root: Path) -> list[str]:
        """List the differences from the job of the shards in a folder, if there is one."""
        if not (root / PLAN).is_file():
            return []
        before, now = read_json(root / PLAN), self._plan
        job = read_json(root / JOB)
        before |= {"seed": job["seed"], "renderer": job["renderer"]}
        now |= {"seed": self.job.seed, "renderer": self.job.renderer}
        changes = [key for key in now if before.get(key) != now[key]]
        if changes == ["stream"]:
            return ["version of sabench or of a library that it renders with"]
        return [key for key in changes if key != "stream"]


def read_shard_job(root: Path) -> ShardJob:
    """Read the job of a folder; raises as `read_job`."""
    job, plan = read_job(root), read_json(root / PLAN)
    kept = ShardContents(tuple(plan["truth"]), plan["compression"])
    return ShardJob(job, plan["samples"], tuple(plan["split"]), plan["shard size"], kept)


class ShardMaker:
    """Maker of the shards of one job in a folder."""

    def __init__(self, job: ShardJob, root: Path) -> None:
        self._job, self._folder, self._key = job, ShardFolder(root), job.job.key
        self._shards, self._shape = job.shards, job.shape
        self._maker = SampleMaker(job.job.scene, job.job.seed, job.job.renderer)

    def __call__(self, task: RecordingTask) -> None:
        """Make the shard of a task, unless it is there and intact."""
        shard, origin = self._shards[task.frame], (self._job.job.seed, self._key)
        if self._folder.read(shard, *origin) is None:
            samples = (self._record(int(number)) for number in shard.numbers)
            self._folder.write(shard, samples, self._shape, self._job.kept, origin)

    def _record(self, number: int) -> SampleRecord:
        one = self._maker.make(number)
        nominal = nominal_cameras(one.scene, one.rig.cameras, one.seed)
        setups = list_setups(one.scene, one.rig, nominal)
        light = self._radiance(one) if "radiance" in self._job.kept.truth else None
        head = number, one.seed, one.drawn, one.redrawn
        return SampleRecord(*head, *setups, one.images, one.particles, one.views, light)

    def _radiance(self, one: Sample) -> F32:
        """Render a sample once more, without noise."""
        frames = Frames(one.scene, one.rig, one.seed, self._job.job.renderer)
        cameras = range(len(one.rig.cameras))
        contents = (frames.at(number) for number in range(one.scene.frames))
        light = [
            [render_camera_view(content, n).radiance() for n in cameras] for content in contents
        ]
        return np.array(light, dtype=np.float32)
