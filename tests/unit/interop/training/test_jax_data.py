"""Batches as arrays of JAX, in a step that is compiled once."""

from typing import Any

import numpy as np
import pytest

from tests.helpers.sample_sets import make

jax: Any = pytest.importorskip("jax", reason="JAX is not installed")

from sabench.interop.training.jax_data import jax_batches  # noqa: E402


def test_batches_go_through_one_compiled_step(tmp_path: Any) -> None:
    samples = make(tmp_path / "set")
    traced = []

    @jax.jit
    def mean(batch: Any) -> Any:
        traced.append(1)
        return batch["images"].astype("float32").mean() + batch["position_mm"].sum()

    own = samples.split("train")
    batches = list(jax_batches(own.batches(3), 50))
    values = [float(mean(one)) for one in batches]
    assert len(traced) == (1 if len(own) % 3 == 0 else 2)
    first = next(own.batches(3))
    expected = first.images.mean() + first.arrays(50)["position_mm"].sum()
    assert values[0] == pytest.approx(expected, rel=1e-5)
    np.testing.assert_array_equal(batches[0]["images"], first.images)
