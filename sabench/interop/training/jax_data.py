"""Batches as arrays of JAX: `pip install 'sabench[jax]'`."""

from collections.abc import Iterable, Iterator
from typing import Any

import jax

from sabench.dataset.sample_set import AnySample, Batch


def jax_batches(
    batches: Iterable[Batch[AnySample]], particles: int | None = None
) -> Iterator[dict[str, Any]]:
    """Put batches of a stream or of stored samples on JAX's device.

    All but the last have the same shapes, so that a compiled step is compiled once.

    Parameters
    ----------
    particles : as for `Batch.arrays`, to have their positions as well.
    """
    for batch in batches:
        yield jax.device_put(batch.arrays(particles))
