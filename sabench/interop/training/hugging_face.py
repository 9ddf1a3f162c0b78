"""Samples as a data set of Hugging Face: `pip install 'sabench[datasets]'`."""

from collections.abc import Iterator, Sequence
from typing import Any

import datasets

from sabench.dataset.sample_set import SampleSet, make_batch

_PARTS = 64  # that workers share


def hugging_face_samples(samples: SampleSet, particles: int | None = None) -> Any:
    """Make an `IterableDataset`, which reads samples when they are asked for.

    Parameters
    ----------
    particles : as for `Batch.arrays`, to have their positions as well.
    """
    frames, cameras, rows, columns = samples[0].images.shape
    features = {
        "number": datasets.Value("int64"),
        "images": datasets.Array4D((frames, cameras, rows, columns), "uint16"),
    }
    if particles is not None:
        features["position_mm"] = datasets.Array3D((frames, particles, 3), "float64")
        features["present"] = datasets.Array2D((frames, particles), "bool")
    return datasets.IterableDataset.from_generator(
        _read,
        features=datasets.Features(features),
        gen_kwargs={
            "samples": samples,
            "particles": particles,
            "parts": list(range(min(_PARTS, len(samples)))),
        },
    )


def _read(
    samples: SampleSet, particles: int | None, parts: Sequence[int]
) -> Iterator[dict[str, Any]]:
    count = min(_PARTS, len(samples))
    for part in parts:
        for row in range(len(samples) * part // count, len(samples) * (part + 1) // count):
            arrays = make_batch([samples[row]]).arrays(particles)
            yield {name: value[0] for name, value in arrays.items()}
