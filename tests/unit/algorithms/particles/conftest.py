"""Maps of the box that the tests of particles share."""

import pytest

from sabench.geometry.volume_polynomials import VolumePolynomials, fit_volume_polynomials
from tests.helpers.particle_box import CAMERAS, HIGH, LOW


@pytest.fixture(scope="session")
def maps() -> VolumePolynomials:
    return fit_volume_polynomials(CAMERAS, LOW, HIGH)
