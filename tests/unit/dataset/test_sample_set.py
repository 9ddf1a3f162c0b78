"""Samples on disk as a sequence: places, batches, splits, and frames of version 1."""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest

import sabench
from sabench.dataset import sample_set
from sabench.dataset.sample_set import SampleSet
from sabench.utils.errors import InputError
from tests.helpers.sample_sets import COUNT, make
from tests.unit.simulation.test_streaming import make_scene


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> SampleSet:
    return make(tmp_path_factory.mktemp("samples") / "set")


def test_places_count_from_both_ends(samples: SampleSet) -> None:
    numbers = [one.number for one in samples]
    assert len(samples) == len(numbers) == COUNT
    assert [samples[place].number for place in range(COUNT)] == numbers
    assert samples[-1].number == numbers[-1]
    assert [one.number for one in samples[3:9:2]] == numbers[3:9:2]
    assert samples[np.int64(2)].number == numbers[2]
    for place in (COUNT, -COUNT - 1):
        with pytest.raises(IndexError, match=f"expected 0 to {COUNT - 1}"):
            samples[place]


def test_batches_hold_every_sample_once(samples: SampleSet) -> None:
    batches = list(samples.batches(4))
    assert [len(batch.images) for batch in batches] == [4, 4, 4, 4, 4, 1]
    assert np.concatenate([one.numbers for one in batches]).tolist() == [x.number for x in samples]
    np.testing.assert_array_equal(batches[1].images[2], samples[6].images)


def test_shuffled_batches_depend_on_the_seed_alone(samples: SampleSet) -> None:
    def order(shuffle: int | None = None, start: int = 0) -> list[int]:
        batches = samples.batches(4, shuffle=shuffle, start=start)
        return [int(n) for batch in batches for n in batch.numbers]

    assert order(shuffle=1) == order(shuffle=1) != order(shuffle=2)
    assert sorted(order(shuffle=1)) == sorted(order())
    assert order(shuffle=1, start=2) == order(shuffle=1)[8:]


def test_a_shuffled_epoch_opens_each_file_once(
    samples: SampleSet, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    parts = [
        [batch.numbers.tolist() for batch in samples.batches(2, start=1, part=(k, 3))]
        for k in range(3)
    ]
    every = [batch.numbers.tolist() for batch in samples.batches(2)]
    for k, part in enumerate(parts):
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
    with pytest.raises(InputError, match="expected one of the splits train, validation, test"):
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
    with pytest.raises(InputError, match="expected at most 5 particles"):
        batch.arrays(5)


def test_displacements_come_from_batches_on_disk_too(samples: SampleSet) -> None:
    (positions, moves), *_ = next(samples.batches(2)).displacements_mm()
    assert len(positions) > 10
    np.testing.assert_allclose(moves, np.tile([0.1, 0.0, 0.0], (len(moves), 1)), atol=1e-9)


def test_numpy_hands_images_on_without_a_copy(samples: SampleSet) -> None:
    images = next(samples.batches(2)).images
    assert np.shares_memory(np.from_dlpack(images), images)


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
    opened = [store for _, store in fresh._stores if getattr(store, "_files", None)]
    assert 1 <= len(opened) <= 2


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
    with pytest.raises(InputError, match="frame 1: expected 0 to 0"):
        one.observation(1)


def test_groups_of_pulses_are_samples(tmp_path: Path) -> None:
    scene = make_scene(
        frames=4,
        timing={"pulses_s": [0.0, 1e-4], "rate_hz": 10.0},
        flow={"generator": "linear_flow", "velocity_mm_s": [100.0, 0.0, 0.0]},
    )
    data = sabench.generate(scene, tmp_path / "pairs", seed=3, backend="splat")
    frames = sabench.open_samples(data.root)
    assert len(frames) == 2
    one = frames[1]
    np.testing.assert_array_equal(one.images[1, 0], data.raw_image(0, 3))
    assert one.setup.time_s(1) - one.setup.time_s(0) == pytest.approx(1e-4)


def test_what_is_no_data_set_is_refused(tmp_path: Path, samples: SampleSet) -> None:
    with pytest.raises(InputError, match="expected a data set's manifest"):
        sabench.open_samples(tmp_path)
    with pytest.raises(InputError, match="batch: expected 1 or more"):
        next(samples.batches(0))
    with pytest.raises(InputError, match=r"open it with sabench\.open_samples"):
        sabench.open_dataset(samples.root)


def test_a_damaged_shard_is_named(samples: SampleSet, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(samples.root, tmp_path / "copy"))
    file = copy / "observation" / "train-00000.h5"
    file.write_bytes(file.read_bytes()[:2000])
    with pytest.raises(InputError, match=r"train-00000\.h5: expected an intact HDF5 file"):
        _ = sabench.open_samples(copy)[0]
    file.unlink()
    with pytest.raises(InputError, match=r"train-00000\.h5: expected a shard, found none"):
        _ = sabench.open_samples(copy)[0]
