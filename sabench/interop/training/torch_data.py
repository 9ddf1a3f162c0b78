"""Samples as data sets of PyTorch: `pip install 'sabench[torch]'`."""

from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch.utils.data import Dataset, IterableDataset, get_worker_info

from sabench.dataset.sample_set import AnySample, Batch, SampleSet, make_batch

Tensors = dict[str, Any]


class TorchSamples(Dataset):  # type: ignore[misc]
    """Stored samples by index, for a `DataLoader` that shuffles and makes batches.

    Parameters
    ----------
    particles : as for `Batch.arrays`, to have their positions as well.
    """

    def __init__(self, samples: SampleSet, particles: int | None = None) -> None:
        self._samples, self._particles = samples, particles

    def __len__(self) -> int:
        return len(self._samples)

    def __getitem__(self, index: int) -> Tensors:
        """Read a sample as tensors."""
        arrays = make_batch([self._samples[index]]).arrays(self._particles)
        return {name: torch.from_numpy(value)[0] for name, value in arrays.items()}


class TorchBatches(IterableDataset):  # type: ignore[misc]
    """Batches of a stream or a data set, for a `DataLoader` of `batch_size=None`.

    Its workers share the batches; their order does not depend on the number of workers.

    Parameters
    ----------
    batches : called with the argument `part`, as `functools.partial(sabench.stream, "quick",
        batch=32)` or `functools.partial(samples.batches, 32)`.
    particles : as for `Batch.arrays`, to have their positions as well.
    """

    def __init__(
        self, batches: Callable[..., Iterator[Batch[AnySample]]], particles: int | None = None
    ) -> None:
        self._batches, self._particles = batches, particles

    def __iter__(self) -> Iterator[Tensors]:
        worker = get_worker_info()
        part = (0, 1) if worker is None else (worker.id, worker.num_workers)
        for batch in self._batches(part=part):
            arrays = batch.arrays(self._particles)
            yield {name: torch.from_numpy(value) for name, value in arrays.items()}
