"""Shards: sets of samples, their checks, cards and imports."""

import csv
import json
import pickle
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import sabench
from sabench.dataset import sample_set, schema
from sabench.dataset.copies import pack_samples
from sabench.dataset.import_recording import check_numbers
from sabench.dataset.sample_set import SampleSet
from sabench.images.image_files import Files
from sabench.utils.files import sha256
from tests.helpers.refusals import check_sentence, refused
from tests.helpers.sample_sets import COUNT, make
from tests.unit.simulation.test_streaming import make_scene


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> SampleSet:
    return make(tmp_path_factory.mktemp("samples") / "set")


@pytest.mark.slow
def test_places_count_from_both_ends(samples: SampleSet) -> None:
    numbers = [one.number for one in samples]
    assert len(samples) == len(numbers) == COUNT
    assert [samples[place].number for place in range(COUNT)] == numbers
    assert samples[-1].number == numbers[-1]
    assert [one.number for one in samples[3:9:2]] == numbers[3:9:2]
    assert samples[np.int64(2)].number == numbers[2]
    for place in (COUNT, -COUNT - 1):
        with refused(kind=IndexError):
            samples[place]


@pytest.mark.slow
def test_batches_hold_every_sample_once(samples: SampleSet) -> None:
    batches = list(samples.batches(4))
    assert [len(batch.images) for batch in batches] == [4, 4, 4, 4, 4, 1]
    assert np.concatenate([one.numbers for one in batches]).tolist() == [x.number for x in samples]
    np.testing.assert_array_equal(batches[1].images[2], samples[6].images)
    assert np.shares_memory(np.from_dlpack(batches[0].images), batches[0].images)


def test_shuffled_batches_depend_on_the_seed_alone(samples: SampleSet) -> None:
    def order(shuffle: int | None = None, start: int = 0) -> list[int]:
        batches = samples.batches(4, shuffle=shuffle, start=start)
        return [int(n) for batch in batches for n in batch.numbers]

    assert order(shuffle=1) == order(shuffle=1) != order(shuffle=2)
    assert sorted(order(shuffle=1)) == sorted(order())
    assert order(shuffle=1, start=2) == order(shuffle=1)[8:]


def test_an_epoch_opens_files_once(samples: SampleSet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sample_set, "_OPEN", 2)
    fresh = sabench.open_samples(samples.root)
    closed: list[str] = []
    for _, store in fresh._stores:
        name = getattr(store, "entry").name  # noqa: B009
        monkeypatch.setattr(store, "close", lambda name=name: closed.append(name))
    numbers = [int(n) for batch in fresh.batches(3, shuffle=5) for n in batch.numbers]
    assert sorted(numbers) == list(range(COUNT))
    assert len(closed) == len(set(closed)) == len(fresh._stores) - 2


def test_parts_share_an_epoch(samples: SampleSet) -> None:
    every = [batch.numbers.tolist() for batch in samples.batches(2)]
    for k in range(3):
        part = [batch.numbers.tolist() for batch in samples.batches(2, start=1, part=(k, 3))]
        assert part == [one for place, one in enumerate(every) if place and place % 3 == k]


def test_parts_share_a_stream() -> None:
    def numbers(k: int, n: int) -> list[list[int]]:
        made = sabench.stream(make_scene(), seed=2, batch=2, samples=9, part=(k, n))
        return [batch.numbers.tolist() for batch in made]

    assert numbers(0, 2) == [[0, 1], [4, 5], [8]]
    assert numbers(1, 2) == [[2, 3], [6, 7]]


def test_splits_are_selected_by_name(samples: SampleSet) -> None:
    test = samples.split("test")
    assert len(test) == samples.splits["test"] < COUNT
    assert test.splits == {"test": len(test)}
    again = sabench.open_samples(samples.root, "test")
    assert [one.number for one in again] == [one.number for one in test]
    with refused():
        samples.split("evaluation")


def test_arrays_are_padded_with_what_is_no_particle(samples: SampleSet) -> None:
    batch = next(samples.batches(3))
    arrays = batch.arrays(50)
    assert arrays["images"].shape == (3, 2, 4, 48, 64)
    assert arrays["position_mm"].shape == (3, 2, 50, 3)
    for row, one in enumerate(batch.samples):
        there = arrays["present"][row, 1]
        own = one.particles[1].position_mm
        np.testing.assert_array_equal(arrays["position_mm"][row, 1][there], own)
        assert not arrays["position_mm"][row, 1][~there].any()
    with refused():
        batch.arrays(5)


def test_displacements_come_from_batches_on_disk_too(samples: SampleSet) -> None:
    (positions, moves), *_ = next(samples.batches(2)).displacements_mm()
    assert len(positions) > 10
    np.testing.assert_allclose(moves, np.tile([0.1, 0.0, 0.0], (len(moves), 1)), atol=1e-9)


def test_another_process_opens_files_of_its_own(samples: SampleSet) -> None:
    first = samples[0].images
    again = pickle.loads(pickle.dumps(samples))
    assert len(pickle.dumps(samples)) < 50_000
    np.testing.assert_array_equal(again[0].images, first)


def test_few_files_are_open(samples: SampleSet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sample_set, "_OPEN", 2)
    fresh = sabench.open_samples(samples.root)
    for one in fresh:
        _ = one.particles
    assert 1 <= len([store for _, store in fresh._stores if getattr(store, "_files", None)]) <= 2


def test_frames_of_version_1_are_samples(tmp_path: Path) -> None:
    data = sabench.generate(make_scene(frames=3), tmp_path / "v1", seed=3, backend="splat")
    frames = sabench.open_samples(data.root)
    assert (len(frames), frames.splits) == (3, {"train": 3})
    one = frames[2]
    np.testing.assert_array_equal(one.images[0, 1], data.raw_image(1, 2))
    np.testing.assert_array_equal(one.observation().images, data.observation(2).images)
    assert len(one.particles[0]) == len(data.particles(2))
    assert one.views[0][3].photons.shape == data.views(2)[3].photons.shape
    assert one.radiance.shape == (1, 4, 48, 64)
    assert (one.drawn, one.redrawn, one.seed) == ({}, 0, 3)
    assert one.true_cameras == data.true_cameras
    assert one.setup.frames == 1
    with refused("frame 1"):
        one.observation(1)


def test_groups_of_pulses_are_samples(tmp_path: Path) -> None:
    flow = {"generator": "linear_flow", "velocity_mm_s": [100.0, 0.0, 0.0]}
    scene = make_scene(frames=4, timing={"pulses_s": [0.0, 1e-4], "rate_hz": 10.0}, flow=flow)
    data = sabench.generate(scene, tmp_path / "pairs", seed=3, backend="splat")
    frames = sabench.open_samples(data.root)
    assert len(frames) == 2
    one = frames[1]
    np.testing.assert_array_equal(one.images[1, 0], data.raw_image(0, 3))
    assert one.setup.time_s(1) - one.setup.time_s(0) == pytest.approx(1e-4)


def test_what_is_no_data_set_is_refused(tmp_path: Path, samples: SampleSet) -> None:
    with refused():
        sabench.open_samples(tmp_path)
    with refused("batch"):
        next(samples.batches(0))
    with refused():
        sabench.open_dataset(samples.root)


def test_a_damaged_shard_is_named(samples: SampleSet, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(samples.root, tmp_path / "copy"))
    file = copy / "observation" / "train-00000.h5"
    file.write_bytes(file.read_bytes()[:2000])
    with refused("train-00000.h5"):
        _ = sabench.open_samples(copy)[0]
    file.unlink()
    with refused("train-00000.h5"):
        _ = sabench.open_samples(copy)[0]


@pytest.fixture
def copy(samples: SampleSet, tmp_path: Path) -> Path:
    return Path(shutil.copytree(samples.root, tmp_path / "copy"))


def test_verify_names_a_shard_that_is_cut_off(copy: Path) -> None:
    file = copy / "observation" / "train-00001.h5"
    file.write_bytes(file.read_bytes()[:999])
    (fault,) = sabench.verify(copy)
    check_sentence(fault, "train-00001.h5", "999")


def test_verify_names_shards_that_are_swapped(copy: Path) -> None:
    one, other = copy / "truth" / "train-00000.h5", copy / "truth" / "train-00001.h5"
    one.rename(copy / "x")
    other.rename(one)
    (copy / "x").rename(other)
    faults = sabench.verify(copy)
    assert len(faults) == 2
    check_sentence(faults[0], "train-00000.h5", "truth/train-00001.h5")


def test_verify_names_a_shard_that_is_doubled_or_missing(copy: Path) -> None:
    shutil.copyfile(copy / "truth" / "train-00000.h5", copy / "truth" / "train-00002.h5")
    (copy / "truth" / "test-00000.h5").unlink()
    shutil.copyfile(copy / "truth" / "train-00001.h5", copy / "truth" / "train-00009.h5")
    missing, double, unknown = sorted(sabench.verify(copy))
    check_sentence(missing, "test-00000.h5")
    check_sentence(double, "train-00002.h5", "train-00000.h5")
    check_sentence(unknown, "train-00009.h5")


def forge(folder: Path, **keys: Any) -> None:
    """Write a manifest whose hashes are right."""
    manifest = json.loads((folder / "manifest.json").read_text()) | keys
    files = {name: schema.FileEntry(**one) for name, one in manifest["files"].items()}
    for shard in manifest["shards"]:
        for name in list(shard["files"]):
            path = folder / name
            shard["files"][name] = {"bytes": path.stat().st_size, "sha256": sha256(path)}
        files |= {name: schema.FileEntry(**one) for name, one in shard["files"].items()}
    manifest["content_hash"] = schema.content_hash(files)
    (folder / "manifest.json").write_text(schema.seal(manifest))


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda shards: shards[1:], "train-00000"),
        (lambda shards: [*shards, shards[0]], "train-00000"),
        (lambda shards: [{**shards[0], "split": "test"}, *shards[1:]], "train"),
        (lambda shards: [{**shards[0], "last": 0}, *shards[1:]], "train-00000"),
    ],
)
def test_verify_finds_shards_that_leave_the_plan(copy: Path, change: Any, key: str) -> None:
    """The manifest's own hashes are right: a shard of another split would leak samples."""
    shards = json.loads((copy / "manifest.json").read_text())["shards"]
    forge(copy, shards=change(shards))
    check_sentence(" ".join(sabench.verify(copy)), key)


def test_verify_finds_samples_of_another_split_in_a_shard(copy: Path) -> None:
    with h5py.File(copy / "observation" / "test-00000.h5", "r+") as shard:
        shard["number"][0] = 0
    forge(copy)
    (fault,) = sabench.verify(copy)
    check_sentence(fault, "test-00000.h5: number")


def test_the_observation_side_tells_nothing_of_the_truth(copy: Path, tmp_path: Path) -> None:
    blind = pack_samples(copy, tmp_path / "blind", blind=True)
    assert sabench.verify(blind) == []
    samples = sabench.open_samples(blind, "test")
    assert samples[0].observation().images.shape == (4, 48, 64)
    for name in ("particles", "views", "drawn", "seed", "radiance", "true_cameras"):
        with refused():
            getattr(samples[0], name)
    names = {path.name for path in blind.iterdir()}
    assert names == {"manifest.json", "observation", "samples.csv"}
    told = (blind / "manifest.json").read_text()
    secret = json.loads((copy / "manifest.json").read_text())
    for key in ("seed", "key", "scene", "scene_hash", "renderer", "truth"):
        assert f'"{key}"' not in told
    assert secret["key"] not in told


def test_the_index_tells_where_each_sample_lies_and_the_card_counts_them(
    samples: SampleSet,
) -> None:
    with (samples.root / "samples.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == COUNT
    for row, one in zip(rows, samples, strict=True):
        assert int(row["number"]) == one.number
        assert row["shard"].startswith(row["split"])
        with h5py.File(samples.root / "observation" / f"{row['shard']}.h5") as shard:
            assert shard["number"][int(row["row"])] == one.number
    assert sabench.verify(samples.root) == []
    text = (samples.root / "README.md").read_text()
    for name, count in samples.splits.items():
        assert f"| {name} | {count} |" in text
    assert "2 frame(s) by 4 camera(s) of 48 x 64 pixels" in text


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of rdflib
def test_mlcroissant_finds_no_fault_and_reads_the_index(samples: SampleSet) -> None:
    croissant = pytest.importorskip("mlcroissant", reason="mlcroissant is not installed")
    data = croissant.Dataset(jsonld=samples.root / "croissant.json")
    assert not data.metadata.ctx.issues.errors
    rows = list(data.records("samples"))
    assert [int(row["samples/number"]) for row in rows] == [one.number for one in samples]


def test_croissant_names_all_shards(samples: SampleSet) -> None:
    values = json.loads((samples.root / "croissant.json").read_text())
    sets = {one["name"]: one for one in values["distribution"]}
    for side in ("observation", "truth"):
        found = set(samples.root.glob(sets[side]["includes"]))
        assert found == set(Path(samples.root / side).iterdir())


EVERY = slice(None)


def taken(**names: list[str]) -> Files:
    return {name: tuple(Path(one) for one in files) for name, files in names.items()}


def test_a_gap_that_others_do_not_have_is_named() -> None:
    """With as many files in the range, too."""
    there = {"a": (1, 2, 3), "b": (1, 3, 4)}
    files = {name: [f"{name}/B000{n}.tif" for n in numbers] for name, numbers in there.items()}
    with_gap = taken(**files)
    for chosen in (EVERY, slice(0, 2)):
        with refused("b: ", "number 2"):
            check_numbers(with_gap, chosen, [])


@pytest.mark.parametrize(
    ("names", "key"),
    [
        ({"a": ["a1_7.tif", "a1_9.tif"], "b": ["b2_7.tif", "b2_9.tif"]}, None),  # 8 is nowhere
        ({"a": ["1_cam1.tif", "2_cam1.tif"], "b": ["1_cam2.tif", "2_cam2.tif"]}, None),
        ({"a": ["a.tif"], "b": ["b.tif"]}, None),
        (
            {"a": ["0.tif", "101.tif", "200.tif"], "b": ["1.tif", "99.tif", "201.tif"]},
            None,
        ),  # times
        ({"a": ["early.tif", "late.tif"], "b": ["x.tif", "y.tif"]}, None),
        ({"a": ["1.tif", "2.tif", "3.tif"], "b": ["1.tif", "2.tif"]}, None),  # counts tell the end
        ({"a": ["a1.tif", "a2.tif"], "b": ["b11.tif", "b12.tif"]}, "1 of a, 11 of b"),
    ],
)
def test_frames_without_a_gap_are_taken(names: dict[str, list[str]], key: str | None) -> None:
    """Cameras that begin with other numbers are said."""
    notes: list[str] = []
    check_numbers(taken(**names), EVERY, notes)
    assert len(notes) == (key is not None)
    for note in notes:
        check_sentence(note, str(key))
