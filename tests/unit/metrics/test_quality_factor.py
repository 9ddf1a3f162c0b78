"""Quality factor and detection: cases counted on paper, and slow counts of the same rules."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage

from sabench.metrics.particle_detection import Counts, count_challenge, count_thesis, detect
from sabench.metrics.quality_factor import quality
from sabench.utils.arrays import F32, F64, Bool

Rule = Callable[[F64, F64], Counts]
Masked = Callable[[F64, F64, Bool, Bool], Counts]
Slow = Callable[[F64, F64], list[tuple[int, int]]]


def random_volume(seed: int) -> F32:
    return np.random.default_rng(seed).exponential(size=(6, 7, 9)).astype(np.float32)


def test_quality_is_the_cosine_between_the_volumes() -> None:
    a, b = random_volume(5), random_volume(6)
    flat_a, flat_b = a.astype(np.float64).ravel(), b.astype(np.float64).ravel()
    expected = flat_a @ flat_b / np.linalg.norm(flat_a) / np.linalg.norm(flat_b)
    for scale in np.array([1.0, 1e-6, 1e6], np.float32):
        assert quality(scale * a, b) == pytest.approx(expected, rel=1e-7)
        assert quality(scale * b, b) == pytest.approx(1.0, abs=1e-7)
    assert quality(a.transpose(2, 0, 1), b.transpose(2, 0, 1)) == pytest.approx(expected, rel=1e-12)
    assert quality(a, b) == pytest.approx(expected, rel=1e-12)
    assert quality(0.0 * a, b) == quality(a, 0.0 * b) == 0.0


def labelled_centroids(volume: F32) -> F64:
    lit = (volume > 0.0) & (volume >= np.quantile(volume[volume > 0.0], 0.1))
    labels, count = ndimage.label(lit, structure=np.ones((3, 3, 3)))
    z, y, x = np.nonzero(labels)
    weight, component = volume[z, y, x].astype(np.float64), labels[z, y, x]
    sums = [
        np.bincount(component, weights=weight * axis, minlength=count + 1)[1:]
        for axis in (1, x, y, z)
    ]
    return np.stack(sums[1:], axis=1) / sums[0][:, None]


@pytest.mark.parametrize("lit", [0.02, 0.2, 1.0])
@pytest.mark.parametrize("shape", [(9, 14, 23), (1, 20, 30), (12, 1, 30), (12, 20, 1), (1, 1, 40)])
def test_detect_agrees_with_labels(shape: tuple[int, int, int], lit: float) -> None:
    rng = np.random.default_rng(5)
    volume = np.where(rng.random(shape) < lit, rng.exponential(size=shape), 0.0).astype(np.float32)
    volume.flat[0] = 1.0
    assert_array_equal(detect(volume), labelled_centroids(volume))


@pytest.mark.parametrize("value", [1.0, 0.3, 7.5])
def test_detect_finds_particles_of_equal_brightness(value: float) -> None:
    """A solver may return a volume of zeros and ones. A single bright voxel is one particle."""
    volume = np.zeros((5, 6, 7), dtype=np.float32)
    volume[1, 2, 3] = value
    assert_allclose(detect(volume), [[3.0, 2.0, 1.0]])
    volume[4, 5, 6] = value
    assert_allclose(detect(volume), [[3.0, 2.0, 1.0], [6.0, 5.0, 4.0]])


def everything(points: F64) -> Bool:
    return np.ones(len(points), dtype=np.bool_)


def thesis(detections: F64, truths: F64) -> Counts:
    return count_thesis(detections, truths, everything(detections), everything(truths))


def challenge(detections: F64, truths: F64) -> Counts:
    return count_challenge(detections, truths, everything(detections), everything(truths))


def points(*rows: tuple[float, float, float]) -> F64:
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


TRUTH = points((10.0, 20.0, 30.0))


@pytest.mark.parametrize("count", [thesis, challenge])
def test_nothing_found_and_nothing_there(count: Rule) -> None:
    nothing = np.empty((0, 3))
    assert count(nothing, TRUTH) == Counts(1, 0, 0, None)
    assert count(TRUTH, nothing) == Counts(0, 1, 0, None)
    assert count(nothing, nothing) == Counts(0, 0, 0, None)
    assert count(TRUTH, nothing).ghost_percent is None
    assert count(nothing, nothing).ghost_percent == 0.0


@pytest.mark.parametrize(
    ("x", "z", "matched"), [(1.5, 0.0, 1), (0.9, 1.2, 1), (math.nextafter(1.5, 2.0), 0.0, 0)]
)
def test_thesis_radius_includes_its_border(x: float, z: float, matched: int) -> None:
    offset = (x, 0.0, z)
    counts = thesis(points(offset), points((0.0, 0.0, 0.0)))
    assert counts.matched == matched
    assert counts.rms == (pytest.approx(math.hypot(*offset)) if matched else None)


def test_challenge_radius_excludes_its_border_and_takes_the_largest_component() -> None:
    origin = points((0.0, 0.0, 0.0))
    assert challenge(points((0.99, -0.99, 0.99)), origin).matched == 1  # 1.71 voxels away
    assert challenge(points((math.nextafter(1.0, 0.0), 0.0, 0.0)), origin).matched == 1
    for offset in ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.2, 0.1, 1.2)):
        assert challenge(points(offset), origin).matched == 0


@pytest.mark.parametrize("count", [thesis, challenge])
def test_duplicates_are_ghosts(count: Rule) -> None:
    counts = count(np.vstack([TRUTH + 0.3, TRUTH - 0.1, TRUTH + 0.2, TRUTH + 9.0]), TRUTH)
    assert (counts.truths, counts.detections, counts.matched) == (1, 4, 1)
    assert counts.ghost_percent == 300.0
    assert counts.recall == 1.0
    assert counts.precision == 0.25
    assert counts.rms == pytest.approx(0.1 * math.sqrt(3.0))  # the nearest of the three


@pytest.mark.parametrize("count", [count_thesis, count_challenge])
def test_a_pair_counts_where_its_truth_lies(count: Masked) -> None:
    inside, outside = points((5.0, 5.0, 5.0)), points((9.4, 5.0, 5.0))
    near_inside, near_outside = points((5.4, 5.0, 5.0)), points((9.0, 5.0, 5.0))
    yes, no = np.array([True]), np.array([False])
    # the detection has slipped over the border
    assert count(near_inside, inside, no, yes) == Counts(1, 1, 1, 5.4 - 5.0)
    assert count(near_outside, outside, yes, no) == Counts(0, 0, 0, None)
    assert count(near_outside, inside, yes, yes) == Counts(1, 1, 0, None)
    assert count(near_outside, inside, no, yes) == Counts(1, 0, 0, None)


def slow_thesis(detections: F64, truths: F64) -> list[tuple[int, int]]:
    """The nearest of those within 1.5 voxels of a truth that have it as their nearest truth."""
    pairs = []
    distance = [[math.dist(d, t) for t in truths] for d in detections]
    for j in range(len(truths)):
        mine = [(r[j], i) for i, r in enumerate(distance) if r[j] <= 1.5 and r[j] == min(r)]
        pairs += [(min(mine)[1], j)] if mine else []
    return pairs


def slow_challenge(detections: F64, truths: F64) -> list[tuple[int, int]]:
    """The closest pair of what is left, again and again."""
    pairs: list[tuple[int, int]] = []
    close = np.abs(detections[:, None] - truths[None]).max(axis=2) < 1.0
    near = [(math.dist(detections[i], truths[j]), int(i), int(j)) for i, j in np.argwhere(close)]
    while near:
        _, i, j = min(near)
        pairs.append((i, j))
        near = [pair for pair in near if pair[1] != i and pair[2] != j]
    return pairs


@pytest.mark.parametrize(
    ("count", "slow"), [(count_thesis, slow_thesis), (count_challenge, slow_challenge)]
)
@pytest.mark.parametrize("seed", range(3))
def test_counts_agree_with_all_pairs(count: Masked, slow: Slow, seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = [9.0, 7.0, 5.0]  # so crowded that rules meet: a truth every two voxels
    truths, detections = rng.uniform(0.0, size, (70, 3)), rng.uniform(0.0, size, (110, 3))
    scored_truths, scored_detections = truths[:, 0] > 1.5, detections[:, 0] > 1.5
    found = count(detections, truths, scored_detections, scored_truths)
    pairs = slow(detections, truths)
    inside = [(i, j) for i, j in pairs if scored_truths[j]]
    alone = set(np.flatnonzero(scored_detections)) - {i for i, _ in pairs}
    rms = math.sqrt(np.mean([math.dist(detections[i], truths[j]) ** 2 for i, j in inside]))
    assert found.rms == pytest.approx(rms, rel=1e-12)
    counts = int(scored_truths.sum()), len(inside) + len(alone), len(inside)
    assert found == Counts(*counts, found.rms)
    assert len(inside) < len(pairs)
    assert 0 < len(inside) < scored_truths.sum()
