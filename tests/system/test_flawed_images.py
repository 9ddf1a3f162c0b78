"""Solvers on images with hot pixels, glints and a reflection against the same without them."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.flawed_images import (
    VOLUMES,
    cases_of,
    measure,
    part_of_standard,
)
from sabench.api import Camera
from sabench.dataset.reader import build_observation
from sabench.images.preprocessing import Gaussian, SlidingMinimum
from sabench.simulation.in_memory import Shot, simulate

_LOSS = 0.01  # of Q, over what no reflection covers
_FEW = 0.05  # of F1: one of the few dozen particles that this small part leaves


@pytest.fixture(scope="module")
def shots() -> dict[float, Shot]:
    """Shots by particles per pixel: few for particle solvers, for volumes more in a larger part.

    In a smaller part, where the reflection covers most particles, Q scatters by more than the loss.
    """
    return {
        density: simulate(part_of_standard(small, density, 9), seed=2)
        for density, small in ((0.02, True), (0.05, False))
    }


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name == "asa" else pytest.mark.slow)
        for name in ("asa", "msa", "block_mart", "mlos_sart", "bayesian_ipr")
    ],
)
def test_flaws_cost_next_to_nothing(name: str, shots: dict[float, Shot]) -> None:
    shot, kind = (shots[0.05], "q") if name in VOLUMES else (shots[0.02], "f1")
    cases = dict(cases_of(shot, 2))
    clean = measure(name, shot, cases["clean"], 2)
    assert float(clean[kind]) > 0.3
    for flaws in ("each", "all"):
        scores = measure(name, shot, cases[flaws], 2)
        whole = kind if flaws == "each" else f"{kind}_open"
        loss = _LOSS if name in VOLUMES else _FEW
        assert float(scores[whole]) > float(clean[whole]) - loss, flaws


def test_preprocessing_neither_spreads_hot_pixels_nor_darkens_reflections(
    shots: dict[float, Shot],
) -> None:
    case = dict(cases_of(shots[0.05], 2))["all"]
    nominal = tuple(camera for camera in case.cameras if isinstance(camera, Camera))
    steps = (
        SlidingMinimum(step="sliding_minimum"),
        Gaussian(step="gaussian"),
    )
    made = build_observation(case.images, nominal, case.grid, (case.black_dn, case.white_dn), steps)
    raw = case.repaired.flaws
    assert made.flaws is not None
    assert raw.unknown.any()
    for before, after in zip(raw, made.repaired.flaws, strict=True):
        np.testing.assert_array_equal(before, after)
    levels = made.images[~raw.covered]
    assert levels.max() < 0.3 * made.white_dn  # full-well pixels are gone
