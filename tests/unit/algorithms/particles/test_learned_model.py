"""Typical light, and how it differs, of particles that noise half hides."""

from types import SimpleNamespace

import numpy as np
import pytest

from sabench.algorithms.particles import learned_model
from sabench.algorithms.particles.joint_fit import even_covariance


@pytest.mark.parametrize("noise", [0.01, 1.0, 2.0])
def test_light_differs_as_much_in_dim_images(monkeypatch: pytest.MonkeyPatch, noise: float) -> None:
    common, count, typical, sigma = 0.2, 4000, 25.0, np.full((4, 2), 0.7)
    rng = np.random.default_rng(4)
    true = rng.normal(0.0, common, (count, 1)) + rng.normal(0.0, 0.03, (count, 4))
    relative = noise * np.sqrt(4.0 * np.pi * 0.7**2) / typical  # of a light that is fitted
    seen = true + rng.normal(0.0, relative, true.shape)
    search = SimpleNamespace(
        typical=np.full(4, typical),
        noise=np.full(4, noise),
        sigma=sigma,
        covariance=even_covariance(4, 0.1, 0.4),
    )
    monkeypatch.setattr(learned_model, "_find_lone", lambda _: np.arange(count))
    for _ in range(20):  # the most probable logarithms under the prior that was learned last
        both = search.covariance + relative**2 * np.eye(4)
        search.light = typical * np.exp(seen @ np.linalg.inv(both) @ search.covariance)
        search.typical = np.full(4, typical)
        learned_model.learn_light(search)  # type: ignore[arg-type]
    shared = (search.covariance.sum() - np.trace(search.covariance)) / 12.0
    assert np.sqrt(shared) == pytest.approx(common, rel=0.1)
