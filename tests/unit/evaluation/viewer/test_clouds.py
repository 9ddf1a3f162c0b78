"""Particles of frames: links, velocities, thinning and packing."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from sabench.apps.viewer import points
from sabench.apps.viewer.page_content import Packer
from sabench.apps.viewer.points import (
    FOUND,
    GHOST,
    MISSED,
    TRUE,
    Cloud,
    link_to_earlier,
    with_velocities,
)


def cloud_of(numbers: list[int], kind: int = FOUND, shift: float = 0.0) -> Cloud:
    position = np.array(numbers, dtype=np.float64)[:, None] + np.array([0.0, 10.0, 20.0]) + shift
    return Cloud.of_kind(position, kind, np.array(numbers, dtype=np.int64))


def test_links_follow_trajectories_in_any_order() -> None:
    earlier, later = cloud_of([3, 1, 2]), cloud_of([2, 7, 3])
    assert link_to_earlier(later, earlier).tolist() == [2, -1, 0]
    assert link_to_earlier(later, None).tolist() == [-1, -1, -1]


def test_true_and_estimated_trajectories_of_one_number_are_not_linked() -> None:
    earlier = cloud_of([1], TRUE) + cloud_of([1], GHOST)
    later = cloud_of([1], FOUND) + cloud_of([1], MISSED)
    assert link_to_earlier(later, earlier).tolist() == [1, 0]


def test_unknown_velocities_come_from_positions_and_known_ones_stay() -> None:
    first, second = cloud_of([1, 2]), cloud_of([2, 1, 5], shift=0.3)
    second.velocity_mm_s[0] = 7.0
    made = with_velocities([first, second], [0.0, 0.1])
    assert made[0].velocity_mm_s == pytest.approx(np.full((2, 3), 3.0))
    assert made[1].velocity_mm_s[:2] == pytest.approx(np.array([[7.0] * 3, [3.0] * 3]))
    assert np.isnan(made[1].velocity_mm_s[2]).all()
    assert np.isnan(first.velocity_mm_s).all()  # the clouds stay as they were


def test_thinning_keeps_trajectories_intact_and_the_share_of_each_kind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(points, "IN_FRAME", 5000)
    monkeypatch.setattr(points, "IN_ALL", 8000)
    rng = np.random.default_rng(2)
    numbers = np.arange(10_000)
    clouds = [cloud_of(rng.permutation(numbers).tolist()) for _ in range(2)]
    clouds[1].kind[::4] = GHOST
    share = points.shown_share(clouds)
    assert share == pytest.approx(0.4)
    first, second = points.thin(clouds, share)
    assert set(first.trajectory) == set(second.trajectory)
    assert len(first) == pytest.approx(4000, rel=0.05)
    assert (second.kind == GHOST).sum() == pytest.approx(1000, rel=0.1)


def test_objects_without_a_trajectory_are_thinned_at_random_but_repeatably() -> None:
    alone = Cloud.of_kind(np.random.default_rng(1).random((10_000, 3)), FOUND)
    one, other = (points.thin([alone], 0.25)[0] for _ in range(2))
    assert len(one) == pytest.approx(2500, rel=0.1)
    assert np.array_equal(one.position_mm, other.position_mm)


def unpack(packer: Packer) -> list[npt.NDArray[Any]]:
    """Read arrays as the page's script does."""
    content = zlib.decompress(base64.b64decode(packer.text()))
    types = {"Uint8": "u1", "Int16": "<i2", "Uint16": "<u2", "Int32": "<i4", "Float32": "<f4"}
    return [
        np.frombuffer(content, types[kind], count, offset) for kind, offset, count in packer.index
    ]


def test_arrays_come_back_from_a_page() -> None:
    arrays: list[npt.NDArray[Any]] = [
        np.array([1, 2, 3], dtype=np.uint8),
        np.array([[-5, 7]], dtype=np.int16),
        np.array([0.5, -2.5], dtype=np.float32),
        np.zeros(0, dtype=np.int32),
    ]
    packer = Packer()
    places = [packer.add(one) for one in arrays]
    back = unpack(packer)
    for array, place in zip(arrays, places, strict=True):
        assert np.array_equal(back[place], array.ravel())
    assert all(offset % 8 == 0 for _, offset, _ in packer.index)
