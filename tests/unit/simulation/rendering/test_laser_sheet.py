"""The laser sheet against its energy, and its window against Snell's law."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.constants import c, h

from sabench.scenes.illumination import Illumination
from sabench.simulation.rendering.lamps import enter_fluid, fluence
from tests.helpers.refusals import refused

CENTER = np.array([3.0, -2.0, 30.0])


def sheet(**changes: Any) -> Illumination:
    values = {"pulse_energy_mj": 3.0, "thickness_mm": 2.0, "height_mm": 8.0}
    return Illumination.model_validate(values | changes)


@pytest.mark.parametrize("profile", ["top-hat", "gaussian"])
def test_sheet_holds_the_energy_of_its_pulse(profile: str) -> None:
    light = sheet(height_mm=40.0, sheet_normal=(0.0, 3.0, 4.0), profile=profile)
    across = np.linspace(-6.0, 6.0, 24_001)
    center = np.array([1.0, -2.0, 30.0])
    positions = center + across[:, None] * [0.0, 0.6, 0.8] + [7.0, 0.0, 0.0]
    photons = np.trapezoid(fluence(light, center, positions), across) * 40.0
    assert photons * h * c / 532e-9 * 1e3 == pytest.approx(3.0, rel=1e-3)


def test_gaussian_sheet_falls_to_e_minus_2_at_half_its_width() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [9.0, 9.0, -1.0]])
    values = fluence(sheet(height_mm=40.0, profile="gaussian"), np.zeros(3), points)
    np.testing.assert_allclose(values[1:] / values[0], math.exp(-2.0), rtol=1e-12)


@pytest.mark.parametrize("kind", ["top-hat", "gaussian"])
def test_a_profile_along_the_height_holds_the_energy(kind: str) -> None:
    light = sheet(profile="gaussian", height_profile=kind)
    y, z = np.meshgrid((np.arange(480) - 239.5) * 0.05, np.linspace(-5.0, 5.0, 401), indexing="ij")
    points = np.stack([np.full(y.size, 40.0), y.ravel(), z.ravel()], axis=1)
    photons = fluence(light, np.zeros(3), points).sum() * 0.05 * 0.025
    assert photons * h * c / 532e-9 * 1e3 == pytest.approx(3.0, rel=5e-3)
    middle, edge = fluence(light, np.zeros(3), np.array([[0.0, 0.0, 0.0], [0.0, 4.0, 0.0]]))
    assert edge / middle == pytest.approx(1.0 if kind == "top-hat" else math.exp(-2.0))
    beyond = fluence(light, np.zeros(3), np.array([[0.0, 4.01, 0.0]]))[0]
    assert (beyond == 0.0) == (kind == "top-hat")


def entering(**changes: Any) -> Illumination:
    window = {"point_mm": [-40.0, 0.0, 0.0], "normal": [1.0, 0.0, 0.0]}
    return sheet(**{"entry": window} | changes)


def test_a_sheet_at_right_angles_to_its_window_only_loses_what_is_reflected() -> None:
    found = enter_fluid(entering(shift_mm=0.3), CENTER, 1.333)
    assert found.pulse_energy_mj == pytest.approx(3.0 * (1.0 - (0.333 / 2.333) ** 2), rel=1e-12)
    assert found.shift_mm == pytest.approx(0.3)
    assert (found.thickness_mm, found.height_mm) == pytest.approx((2.0, 8.0))
    np.testing.assert_allclose(found.direction, (1.0, 0.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(found.sheet_normal, (0.0, 0.0, 1.0), atol=1e-12)


def refract(direction: np.ndarray, normal: np.ndarray, ratio: float) -> np.ndarray:
    """Snell's law with vectors (Glassner), as a second derivation."""
    cosine = direction @ normal
    along = math.sqrt(1 - ratio**2 * (1 - cosine**2)) - ratio * cosine
    return np.asarray(ratio * direction + along * normal)


def test_every_ray_of_a_slanted_sheet_goes_where_the_sheet_in_the_fluid_is() -> None:
    along, normal = np.array([0.8, 0.36, 0.48]), np.array([0.6, -0.48, -0.64])
    layers = [{"index": 1.52, "thickness_mm": 6.0}]
    window = {"point_mm": [-40.0, 0.0, 0.0], "normal": [1.0, 0.1, -0.2], "layers": layers}
    light = entering(direction=along.tolist(), sheet_normal=normal.tolist(), entry=window)
    found, inward = enter_fluid(light, CENTER, 1.333), np.array([1.0, 0.1, -0.2])
    inward /= np.linalg.norm(inward)
    inside, glass = refract(along, inward, 1.0 / 1.333), refract(along, inward, 1.0 / 1.52)
    np.testing.assert_allclose(found.direction, inside, atol=1e-12)
    turned, height = np.asarray(found.sheet_normal), np.cross(normal, along)
    rising = np.cross(turned, inside)
    middle = 0.0
    for across, up in ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 4.0), (1.0, -4.0)):
        start = CENTER + across * normal + up * height
        depth = (start - np.array([-40.0, 0.0, 0.0])) @ inward
        place = start - depth / (along @ inward) * along + 6.0 / (glass @ inward) * glass
        offset = (place - CENTER) @ turned - (found.shift_mm or 0.0)
        assert offset == pytest.approx(across * found.thickness_mm / 2.0, abs=1e-9)
        if across == 0.0:
            middle = place @ rising if up == 0.0 else middle
            assert abs(place @ rising - middle) == pytest.approx(abs(up) * found.height_mm / 8.0)
    area = light.thickness_mm * light.height_mm / (along @ inward)  # of the window that is lit
    assert found.thickness_mm * found.height_mm == pytest.approx(area * (inside @ inward))


def test_polarisation_stays_across_the_light() -> None:
    along = (0.8, 0.0, 0.6)
    for field in ((0.0, 1.0, 0.0), (-0.6, 0.0, 0.8), (-0.36, 0.8, 0.48)):
        light = entering(direction=along, sheet_normal=(0.0, 1.0, 0.0), polarisation=field)
        found = enter_fluid(light, CENTER, 1.333)
        assert found.polarisation is not None
        turned = np.asarray(found.polarisation)
        assert turned @ np.asarray(found.direction) == pytest.approx(0.0, abs=1e-12)
        assert np.linalg.norm(turned) == pytest.approx(1.0)
        assert turned[1] == pytest.approx(field[1])  # across the plane of incidence


@pytest.mark.parametrize(
    "window",
    [
        {"point_mm": [40.0, 0.0, 0.0], "normal": [1.0, 0.0, 0.0]},
        {"point_mm": [-40.0, 0.0, 0.0], "normal": [-1.0, 0.0, 0.0]},
        {"point_mm": [0.0, 0.0, 60.0], "normal": [0.0, 0.0, -1.0]},
    ],
)
def test_a_window_that_the_light_does_not_pass_is_refused(window: dict[str, Any]) -> None:
    with refused("illumination.entry"):
        enter_fluid(entering(entry=window), CENTER, 1.333)
