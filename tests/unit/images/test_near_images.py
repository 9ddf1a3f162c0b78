"""Neighbours in images against all pairs."""

from __future__ import annotations

import itertools

import numpy as np

from sabench.images.near_images import near_images


def test_neighbours_are_those_of_all_pairs() -> None:
    rng = np.random.default_rng(3)
    pixels = rng.uniform(0.0, 60.0, (3, 400, 2))
    pixels[0, 5], pixels[1, 7], pixels[2, :, 1] = np.nan, [1e7, -1e9], 4.0
    reach = np.array([1.5, 3.0, 0.2])
    starts, near = near_images(pixels, reach)
    apart = np.linalg.norm(pixels[:, :, None] - pixels[:, None], axis=3)
    both = (apart <= reach[:, None, None]).any(axis=0)
    np.fill_diagonal(both, False)
    assert both.sum() > 1000
    found = np.zeros_like(both)
    found[np.repeat(np.arange(400), np.diff(starts)), near] = True
    np.testing.assert_array_equal(found, both)
    assert all((np.diff(near[a:b]) > 0).all() for a, b in itertools.pairwise(starts))


def test_no_images_have_no_neighbours() -> None:
    starts, near = near_images(np.zeros((2, 0, 2)), np.ones(2))
    assert starts.tolist() == [0]
    assert not len(near)
    starts, near = near_images(np.full((2, 3, 2), np.nan), np.ones(2))
    assert starts.tolist() == [0, 0, 0, 0]
    assert not len(near)
