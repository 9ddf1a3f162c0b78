"""Samples that are generated into shards, and the maker of one shard."""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sabench.dataset.shards import Kept, SampleRecord, Shard, ShardFolder, plan_shards
from sabench.dataset.writer import list_setups
from sabench.scenes import build_rig
from sabench.scenes.nominal_cameras import nominal_cameras
from sabench.simulation.camera_view import render
from sabench.simulation.frames import Frames
from sabench.simulation.recording.parts import JOB, Job, read_job
from sabench.simulation.recording.schedule import Task
from sabench.simulation.streaming import Sample, SampleMaker
from sabench.utils.arrays import F32
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, complete_or_nothing, read_json

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
    kept: Kept

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
        """Write it to the folder in which its shards are made.

        Raises InputError if shards of something else are there.
        """
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
        own = {"samples": self.samples, "split": list(self.shares), "shard size": self.size}
        kept = {key: list(v) if key == "truth" else v for key, v in asdict(self.kept).items()}
        return {**own, **kept, "scene": self.job.scene.hash, "stream": self.job.key}

    def changes(self, root: Path) -> list[str]:
        """List what differs from the job whose shards are in a folder, if there is one."""
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
    kept = Kept(tuple(plan["truth"]), plan["compression"])
    return ShardJob(job, plan["samples"], tuple(plan["split"]), plan["shard size"], kept)


class ShardMaker:
    """Maker of the shards of one job in a folder."""

    def __init__(self, job: ShardJob, root: Path) -> None:
        self._job, self._folder, self._key = job, ShardFolder(root), job.job.key
        self._shards, self._shape = job.shards, job.shape
        self._maker = SampleMaker(job.job.scene, job.job.seed, job.job.renderer)

    def __call__(self, task: Task) -> None:
        """Make the shard of a task, unless it is there and intact."""
        shard, own = self._shards[task.frame], self._job.job
        if self._folder.read(shard, own.seed, self._key) is None:
            samples = (self._record(int(number)) for number in shard.numbers)
            self._folder.write(shard, samples, self._shape, self._job.kept, (own.seed, self._key))

    def _record(self, number: int) -> SampleRecord:
        one = self._maker.make(number)
        nominal = nominal_cameras(one.scene, one.rig.cameras, one.seed)
        setup, true = list_setups(one.scene, one.rig, nominal)
        light = self._radiance(one) if "radiance" in self._job.kept.truth else None
        made = (one.images, one.particles, one.views, light)
        return SampleRecord(number, one.seed, one.drawn, one.redrawn, setup, true, *made)

    def _radiance(self, one: Sample) -> F32:
        """Render a sample once more, without noise."""
        frames = Frames(one.scene, one.rig, one.seed, self._job.job.renderer)
        cameras = range(len(one.rig.cameras))
        contents = (frames.at(number) for number in range(one.scene.frames))
        light = [[render(content, n).radiance() for n in cameras] for content in contents]
        return np.array(light, dtype=np.float32)
