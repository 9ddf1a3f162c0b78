"""Samples through PyTorch's own loaders, with workers and without."""

import functools
from typing import Any

import numpy as np
import pytest

import sabench
from sabench.dataset.sample_set import SampleSet
from tests.helpers.sample_sets import COUNT, make
from tests.unit.simulation.test_streaming import make_scene

torch: Any = pytest.importorskip("torch", reason="PyTorch is not installed")

from torch.utils.data import DataLoader  # noqa: E402

from sabench.interop.training.torch_data import TorchBatches, TorchSamples  # noqa: E402


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> SampleSet:
    return make(tmp_path_factory.mktemp("samples") / "set")


def workers_of(count: int) -> dict[str, Any]:
    """Options of a loader: numba's threads, which this process has, do not survive a fork."""
    return {"num_workers": count, "multiprocessing_context": "spawn" if count else None}


@pytest.mark.parametrize("workers", [0, 2])
def test_a_loader_reads_every_sample_by_index(samples: SampleSet, workers: int) -> None:
    first = samples[0]  # its file is open here
    loader = DataLoader(
        TorchSamples(samples, 50), batch_size=5, shuffle=True, **workers_of(workers)
    )
    batches = list(loader)
    numbers = torch.cat([one["number"] for one in batches]).tolist()
    assert sorted(numbers) == list(range(COUNT))
    assert batches[0]["images"].dtype == torch.uint16
    assert batches[0]["position_mm"].shape == (5, 2, 50, 3)
    row = numbers.index(first.number)
    np.testing.assert_array_equal(batches[row // 5]["images"][row % 5].numpy(), first.images)


@pytest.mark.parametrize("workers", [0, 2])
def test_batches_have_one_order_for_any_number_of_workers(samples: SampleSet, workers: int) -> None:
    batches = TorchBatches(functools.partial(samples.batches, 4, shuffle=7))
    loader = DataLoader(batches, batch_size=None, **workers_of(workers))
    got = [one["number"].tolist() for one in loader]
    assert got == [one.numbers.tolist() for one in samples.batches(4, shuffle=7)]


def test_workers_share_a_stream() -> None:
    stream = functools.partial(sabench.stream, make_scene(), seed=2, batch=2, samples=6)
    batches = list(DataLoader(TorchBatches(stream, 300), batch_size=None, **workers_of(2)))
    assert [one["number"].tolist() for one in batches] == [[0, 1], [2, 3], [4, 5]]
    expected = next(sabench.stream(make_scene(), seed=2, start=5)).images
    np.testing.assert_array_equal(batches[2]["images"][1:].numpy(), expected)


def test_images_go_to_torch_without_a_copy(samples: SampleSet) -> None:
    images = next(samples.batches(2)).images
    tensor = torch.from_dlpack(images)
    images[0, 0, 0, 0, 0] = 4321
    assert int(tensor[0, 0, 0, 0, 0]) == 4321
