"""Samples in shards: the same bytes whoever makes them, and splits apart."""

import itertools
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from filelock import FileLock

import sabench
from sabench.dataset.sample_set import SampleSet
from sabench.dataset.shards import plan_shards, split_of
from sabench.simulation import shard_job
from sabench.simulation.recording import parts as recording_parts
from sabench.simulation.recording.schedule import RecordingTask, UnfinishedError
from sabench.simulation.shard_job import stream
from tests.conftest import Command
from tests.helpers.commands import limit_files, refuse, succeed
from tests.helpers.refusals import refused
from tests.helpers.sample_sets import COUNT, SHARES, SIZE, make, scene
from tests.unit.simulation.test_streaming import make_scene, vary


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> SampleSet:
    return make(tmp_path_factory.mktemp("samples") / "whole")


@pytest.mark.slow
def test_stored_samples_are_those_of_the_stream(whole: SampleSet) -> None:
    assert len(whole) == COUNT
    for batch in stream(scene(), seed=4, batch=7, samples=COUNT):
        for one in batch.samples:
            stored = next(other for other in whole if other.number == one.number)
            np.testing.assert_array_equal(stored.images, one.images)
            assert (stored.seed, stored.drawn, stored.redrawn) == (one.seed, one.drawn, 0)
            for frame in range(2):
                mine, true = stored.particles[frame], one.particles[frame]
                np.testing.assert_array_equal(mine.position_mm, true.position_mm)
                np.testing.assert_array_equal(mine.id, true.id)
                for seen, view in zip(stored.views[frame], one.views[frame], strict=True):
                    np.testing.assert_array_equal(seen.pixel, view.pixel)
                    np.testing.assert_array_equal(seen.visible, view.visible)
                    np.testing.assert_allclose(seen.sigma_px, view.sigma_px, rtol=1e-6)
            assert stored.true_cameras == one.rig.cameras


@pytest.mark.slow
def test_solvers_see_the_nominal_cameras_of_each_sample(whole: SampleSet) -> None:
    first, other = whole[0], whole[1]
    by_stream = next(stream(scene(), seed=4, start=first.number)).samples[0]
    seen, expected = first.observation(1), by_stream.observation(1)
    np.testing.assert_array_equal(seen.images, expected.images)
    assert seen.cameras == expected.cameras != first.true_cameras
    assert other.observation(1).cameras != seen.cameras
    with refused("frame 2"):
        first.observation(2)


def test_no_sample_is_in_two_splits_or_in_the_wrong_one(whole: SampleSet) -> None:
    numbers = {name: [one.number for one in whole.split(name)] for name in whole.splits}
    assert sorted(itertools.chain(*numbers.values())) == list(range(COUNT))
    assert set(whole.splits) == {"train", "validation", "test"}
    for name, own in numbers.items():
        assert {split_of(number, SHARES) for number in own} == {name}
    stored: dict[str, set[int]] = {}  # what lies in the files, whatever the manifest says
    for file in sorted(whole.root.glob("observation/*.h5")):
        with h5py.File(file) as shard:
            stored.setdefault(file.stem.rpartition("-")[0], set()).update(shard["number"][:])
    assert stored == {name: set(own) for name, own in numbers.items()}


def test_more_samples_leave_full_shards_as_they_are() -> None:
    few, many = (plan_shards(count, SHARES, SIZE) for count in (200, 300))
    later = {shard.name: shard.numbers.tolist() for shard in many}
    full = [shard for shard in few if len(shard.numbers) == SIZE]
    assert len(full) > 40
    for shard in full:
        assert later[shard.name] == shard.numbers.tolist()


@pytest.mark.slow
def test_the_bytes_do_not_depend_on_workers(whole: SampleSet, tmp_path: Path) -> None:
    assert make(tmp_path / "again", jobs=2).content_hash == whole.content_hash
    assert [path.name for path in tmp_path.iterdir()] == ["again"]


@pytest.mark.slow
def test_an_interrupted_run_resumes(
    whole: SampleSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It stops in the middle of the third shard; a finished one is then cut off."""
    made = shard_job.ShardMaker._record
    count = iter(range(100))

    def stops(self: Any, number: int) -> Any:
        if next(count) == 2 * SIZE + 1:
            raise KeyboardInterrupt
        return made(self, number)

    monkeypatch.setattr(shard_job.ShardMaker, "_record", stops)
    with pytest.raises(KeyboardInterrupt):
        make(tmp_path / "set")
    folder = tmp_path / ".set.shards"
    assert len(list(folder.glob("data/truth/*.h5"))) == 2
    assert not (tmp_path / "set").exists()
    shard = folder / "data" / "truth" / "train-00001.h5"
    shard.write_bytes(shard.read_bytes()[:-10])
    numbers: list[int] = []

    def counted(self: Any, number: int) -> Any:
        numbers.append(number)
        return made(self, number)

    monkeypatch.setattr(shard_job.ShardMaker, "_record", counted)
    assert make(tmp_path / "set").content_hash == whole.content_hash
    assert len(numbers) == COUNT - SIZE  # the first shard was not made again


@pytest.mark.slow_but_first
@pytest.mark.parametrize(
    ("key", "change"),
    [
        ("seed", {"seed": 5}),
        ("samples", {"samples": 22}),
        ("shard size", {"size": 5}),
        ("compression", {"compression": "gzip"}),
    ],
)
def test_shards_of_something_else_are_not_resumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, key: str, change: dict[str, Any]
) -> None:
    begin(tmp_path, monkeypatch)
    with refused(key):
        make(tmp_path / "set", **change)
    if key == "seed":
        assert len(make(tmp_path / "set", overwrite=True, **change)) == COUNT


def test_other_versions_of_the_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begin(tmp_path, monkeypatch)
    monkeypatch.setattr(recording_parts, "code_hash", lambda: "0" * 64)
    with refused():
        make(tmp_path / "set")


def begin(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = shard_job.ShardMaker.__call__

    def stops(self: Any, task: RecordingTask) -> None:
        if task.frame:
            raise KeyboardInterrupt
        done(self, task)

    with monkeypatch.context() as patch:
        patch.setattr(shard_job.ShardMaker, "__call__", stops)
        with pytest.raises(KeyboardInterrupt):
            make(folder / "set")


@pytest.mark.slow
def test_a_shard_that_fails_is_named_and_the_others_are_kept(
    whole: SampleSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker that is killed costs its shard only."""
    killed = """
import os, signal, sys
from sabench.simulation import shard_job
made = shard_job.ShardMaker.__call__
def dies(self, task):
    if task.frame == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    made(self, task)
shard_job.ShardMaker.__call__ = dies
"""
    (tmp_path / "sitecustomize.py").write_text(killed)
    with monkeypatch.context() as patch:
        patch.syspath_prepend(str(tmp_path))
        with refused("train-00001", "SIGKILL", kind=UnfinishedError):
            make(tmp_path / "set", jobs=2)
    shards = len(plan_shards(COUNT, SHARES, SIZE))
    assert len(list(tmp_path.glob(".set.shards/entries/*.json"))) == shards - 1
    assert make(tmp_path / "set").content_hash == whole.content_hash


@pytest.mark.slow
def test_a_full_disk_ends_in_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit on the size of files stands in for it; the first shard was there before."""
    begin(tmp_path, monkeypatch)
    (tmp_path / "scene.toml").write_text(scene().to_toml())
    before = {file: file.stat().st_mtime_ns for file in tmp_path.glob(".set.shards/data/*/*.h5")}
    script = f"""
import sys
from tests.helpers.sample_sets import make
from sabench.cli import main
main.app = lambda **_: make(__import__("pathlib").Path({str(tmp_path)!r}) / "set")
main.main()
"""
    words = [sys.executable, "-c", script]
    refuse(subprocess.run(words, capture_output=True, text=True, preexec_fn=limit_files))
    after = {file: file.stat().st_mtime_ns for file in tmp_path.glob(".set.shards/data/*/*.h5")}
    assert after == before
    assert len(before) == 2


@pytest.mark.slow
def test_options_choose_truth_and_compression(whole: SampleSet, tmp_path: Path) -> None:
    light = make(tmp_path / "light", samples=3, truth=["radiance"], compression="gzip")
    plain = make(tmp_path / "none", samples=3, truth=[])
    stored = next(one for one in whole if one.number == light[0].number)
    np.testing.assert_array_equal(light[0].images, stored.images)
    assert light[0].radiance.shape == light[0].images.shape
    bright = light[0].images > 2000
    assert light[0].radiance[bright].mean() > 3.0 * light[0].radiance.mean()
    assert plain[0].drawn == stored.drawn  # drawn values are always there
    for samples in (light, plain):
        assert sabench.verify(samples.root) == []
        with refused():
            _ = samples[0].particles


def test_impossible_input_is_refused(tmp_path: Path) -> None:
    cases: list[tuple[str, dict[str, Any]]] = [
        ("samples", {"samples": 0}),
        ("split", {"split": (0.0,)}),
        ("truth", {"truth": ["all"]}),
        ("truth", {"truth": ["views"]}),
        ("compression", {"compression": "zip"}),
        ("seed", {"seed": -1}),
        ("", {"samples": 10**9}),
    ]
    bad = make_scene(vary=vary(particles__count={"choices": [20, -1]}))
    for key, options in [*cases, ("particles.count", {"scene": bad})]:
        with refused(key):
            make(tmp_path / "set", **options)
        assert not list(tmp_path.iterdir())


def test_the_command_says_what_it_made(command: Command, tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(make_scene().to_toml())
    words = ["generate", "s.toml", "-o", "d", "--samples", "6", "--split", "50/50", "--seed", "3"]
    done = succeed(command(*words, "--shard-size", "2", "--truth", "none", "--compression", "gzip"))
    assert "train, " in done.stdout
    assert "validation samples, hash" in done.stdout
    assert "6 samples" in command("verify", "d").stdout
    for shares in ("a/b", "80/20"):
        refuse(command("generate", "s.toml", "-o", "d", "--samples", "6", "--split", shares))
    refuse(command("solve", "msa", "d", "-o", "r.h5"))


@pytest.mark.slow
def test_dask_workers_make_shards(whole: SampleSet, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    one = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**one) as cluster:
        again = make(tmp_path / "again", scheduler=cluster.scheduler_address)
    assert again.content_hash == whole.content_hash


def test_two_runs_do_not_write_one_set(tmp_path: Path) -> None:
    (tmp_path / ".set.shards").mkdir()
    with FileLock(tmp_path / ".set.shards" / "lock"), refused():
        make(tmp_path / "set")
    assert (tmp_path / ".set.shards" / "lock").exists()
