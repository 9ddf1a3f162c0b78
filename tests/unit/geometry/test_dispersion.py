"""Refractive indices of named materials against published values."""

import pytest

from sabench.scenes.materials import refractive_index, water_in_vacuum
from tests.helpers.refusals import refused

PUBLISHED = [
    # SCHOTT, data sheet of N-BK7
    ("BK7", 486.1327, 1.52238, 1e-5),
    ("BK7", 587.5618, 1.51680, 1e-5),
    ("BK7", 1060.0, 1.50669, 1e-5),
    # Malitson (1965), table I
    ("fused silica", 486.133, 1.46313, 1e-5),
    ("fused silica", 656.272, 1.45637, 1e-5),
    # Sultanova et al. (2009), measured
    ("acrylic", 587.6, 1.491, 1e-3),
    ("acrylic", 632.8, 1.489, 1e-3),
    # Rubin (1985)
    ("soda-lime glass", 587.6, 1.523, 1e-3),
    ("air", 532.0, 1.0, 0.0),
]


@pytest.mark.parametrize(("name", "nm", "index", "within"), PUBLISHED)
def test_indices_are_the_published_ones(name: str, nm: float, index: float, within: float) -> None:
    assert refractive_index(name, nm) == pytest.approx(index, abs=within)


@pytest.mark.parametrize(
    ("celsius", "index"),
    [(0.0, 1.33395), (10.0, 1.33369), (20.0, 1.33299), (30.0, 1.33192), (50.0, 1.32894)],
)
def test_water_is_that_of_the_handbook(celsius: float, index: float) -> None:
    """CRC Handbook: index of water at 589.26 nm, relative to air, by temperature."""
    assert refractive_index("water", 589.26, celsius) == pytest.approx(index, abs=6e-5)


@pytest.mark.parametrize(
    ("micrometre", "index"), [(0.2265, 1.394527), (0.589, 1.334344), (1.01398, 1.326135)]
)
def test_water_is_that_of_the_table_of_r9_97(micrometre: float, index: float) -> None:
    """IAPWS R9-97, table 3: 0 degrees Celsius, 0.1 MPa, 999.843 kg/m^3."""
    assert water_in_vacuum(micrometre, 0.0, 999.843) == pytest.approx(index, abs=2e-6)


@pytest.mark.parametrize(
    ("name", "nm", "celsius", "got"),
    [
        ("bk 7", 532.0, 20.0, "bk 7"),
        ("acrylic", 355.0, 20.0, "355"),
        ("water", 532.0, 120.0, "120"),
    ],
)
def test_what_is_not_known_is_named(name: str, nm: float, celsius: float, got: str) -> None:
    with refused(got, kind=ValueError):
        refractive_index(name, nm, celsius)
