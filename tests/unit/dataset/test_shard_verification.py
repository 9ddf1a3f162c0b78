"""Verification of shards: every fault is named, whatever hashes the manifest has."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import h5py
import pytest

import sabench
from sabench.dataset import schema
from sabench.dataset.copies import pack_samples
from sabench.dataset.sample_set import SampleSet
from sabench.utils.errors import InputError
from sabench.utils.files import sha256
from tests.helpers.sample_sets import make


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> SampleSet:
    return make(tmp_path_factory.mktemp("samples") / "whole")


@pytest.fixture
def copy(whole: SampleSet, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole.root, tmp_path / "copy"))


def test_an_intact_set_has_no_faults(whole: SampleSet) -> None:
    assert sabench.verify(whole.root) == []


def test_verify_names_a_shard_that_is_cut_off(copy: Path) -> None:
    file = copy / "observation" / "train-00001.h5"
    file.write_bytes(file.read_bytes()[:999])
    (fault,) = sabench.verify(copy)
    assert "train-00001.h5" in fault
    assert "999 of" in fault


def test_verify_names_shards_that_are_swapped(copy: Path) -> None:
    one, other = copy / "truth" / "train-00000.h5", copy / "truth" / "train-00001.h5"
    one.rename(copy / "x")
    other.rename(one)
    (copy / "x").rename(other)
    faults = sabench.verify(copy)
    assert len(faults) == 2
    assert "train-00000.h5" in faults[0]
    assert "those of truth/train-00001.h5" in faults[0]


def test_verify_names_a_shard_that_is_doubled_or_missing(copy: Path) -> None:
    shutil.copyfile(copy / "truth" / "train-00000.h5", copy / "truth" / "train-00002.h5")
    (copy / "truth" / "test-00000.h5").unlink()
    shutil.copyfile(copy / "truth" / "train-00001.h5", copy / "truth" / "train-00009.h5")
    faults = sabench.verify(copy)
    assert [fault for fault in faults if "train-00009.h5: a file that the manifest" in fault]
    assert [fault for fault in faults if "train-00002.h5" in fault and "train-00000.h5" in fault]
    assert [fault for fault in faults if "test-00000.h5: missing" in fault]
    assert len(faults) == 3


def forge(folder: Path, **keys: Any) -> None:
    """Write a manifest whose hashes are right."""
    manifest = json.loads((folder / "manifest.json").read_text()) | keys
    files = {name: schema.FileEntry(**one) for name, one in manifest["files"].items()}
    for shard in manifest["shards"]:
        for name in list(shard["files"]):
            path = folder / name
            shard["files"][name] = {
                "bytes": path.stat().st_size,
                "sha256": sha256(path),
            }
        files |= {name: schema.FileEntry(**one) for name, one in shard["files"].items()}
    manifest["content_hash"] = schema.content_hash(files)
    (folder / "manifest.json").write_text(schema.seal(manifest))


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda shards: shards[1:], "train-00000 1 time(s), got 0"),
        (lambda shards: [*shards, shards[0]], "train-00000 1 time(s), got 2"),
        (lambda shards: [{**shards[0], "split": "test"}, *shards[1:]], "of train, got 4"),
        (lambda shards: [{**shards[0], "last": 0}, *shards[1:]], "train-00000: expected 4 samples"),
    ],
)
def test_verify_finds_shards_that_leave_the_plan(copy: Path, change: Any, named: str) -> None:
    """The manifest's own hashes are right: a shard of another split would leak samples."""
    shards = json.loads((copy / "manifest.json").read_text())["shards"]
    forge(copy, shards=change(shards))
    assert any(named in fault for fault in sabench.verify(copy)), sabench.verify(copy)


def test_verify_finds_samples_of_another_split_in_a_shard(copy: Path) -> None:
    file = copy / "observation" / "test-00000.h5"
    with h5py.File(file, "r+") as shard:
        shard["number"][0] = 0
    forge(copy)
    (fault,) = sabench.verify(copy)
    assert "test-00000.h5: number: expected the samples" in fault


def test_the_observation_side_tells_nothing_of_the_truth(copy: Path, tmp_path: Path) -> None:
    blind = pack_samples(copy, tmp_path / "blind", blind=True)
    assert sabench.verify(blind) == []
    samples = sabench.open_samples(blind, "test")
    assert samples[0].observation().images.shape == (4, 48, 64)
    for name in ("particles", "views", "drawn", "seed", "radiance", "true_cameras"):
        with pytest.raises(InputError, match="with its truth, got the observation side alone"):
            getattr(samples[0], name)
    names = {path.name for path in blind.iterdir()}
    assert names == {"manifest.json", "observation", "samples.csv"}
    told = (blind / "manifest.json").read_text()
    secret = json.loads((copy / "manifest.json").read_text())
    for key in ("seed", "key", "scene", "scene_hash", "renderer", "truth"):
        assert f'"{key}"' not in told
    assert secret["key"] not in told
