"""Samples through the package datasets of Hugging Face."""

from typing import Any

import numpy as np
import pytest

from tests.helpers.sample_sets import make

datasets: Any = pytest.importorskip("datasets", reason="the package datasets is not installed")

from sabench.interop.training.hugging_face import hugging_face_samples  # noqa: E402


def test_samples_are_read_in_their_order(tmp_path: Any) -> None:
    samples = make(tmp_path / "set").split("train")
    given = hugging_face_samples(samples, 50)
    assert given.features["images"].shape == (2, 4, 48, 64)
    rows = list(given.with_format("numpy"))
    assert [int(one["number"]) for one in rows] == [one.number for one in samples]
    np.testing.assert_array_equal(rows[3]["images"], samples[3].images)
    own = samples[3].particles[1].position_mm
    np.testing.assert_allclose(rows[3]["position_mm"][1][rows[3]["present"][1]], own, rtol=1e-6)
    again = given.skip(2).take(1).map(lambda one: {"bright": np.max(one["images"])})
    assert next(iter(again))["bright"] == samples[2].images.max()
    assert given.num_shards == len(samples)
