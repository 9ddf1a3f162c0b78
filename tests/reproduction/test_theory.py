"""The thesis's equations against projections, counts by chance and its Table 3.1."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reproduction import theory
from reproduction.theory import TABLE_3_1, Algorithm, normality, operations, plane_spacing_ratio
from sabench.geometry.camera import Camera
from sabench.geometry.lens import Distortion
from sabench.metrics.particle_detection import ghost_ratio

S_O, S_I, PIXEL = 510.0, 102.0, 0.01  # mm: M(0) = -0.2


def parallel_camera(x_mm: float) -> Camera:
    """Make a camera of an array whose centres and sensors each lie in one plane.

    It looks along Z from Z = -S_O.
    """
    return Camera(
        name="camera_00",
        rows=1000,
        columns=1000,
        center_mm=(x_mm, 0.0, -S_O),
        rotation=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        principal_distance_mm=S_I,
        pixel_mm=PIXEL,
        principal_point_px=(499.5, 499.5),
        distortion=Distortion(),
        focal_length_mm=85.0,
        f_number=16.0,
    )


# Planes


@pytest.mark.parametrize("ratio", [0.1, 0.2, 0.4, 0.5])
@pytest.mark.parametrize("z_mm", [0.0, 5.0, 50.0])
def test_next_plane_is_where_the_image_moves_by_one_pixel(ratio: float, z_mm: float) -> None:
    """Equation 2.10 agrees with projection.

    The disparity of two cameras changes by one pixel from Z to Z + dZ.
    """
    width = theory.pixel_in_volume_mm(PIXEL, theory.magnification(z_mm, S_I, S_O))
    next_mm = z_mm + width * plane_spacing_ratio(ratio, width, z_mm, S_O)
    points = np.array([[3.0, -2.0, z_mm], [3.0, -2.0, next_mm]])
    seen = [parallel_camera(x).project(points)[0][:, 0] for x in (0.0, ratio * S_O)]
    disparity = seen[0] - seen[1]
    assert disparity[0] - disparity[1] == pytest.approx(1.0, abs=1e-9)
    assert theory.image_shift_mm(ratio * S_O, z_mm, next_mm, S_I, S_O) == pytest.approx(
        PIXEL, rel=1e-9
    )


def test_first_order_is_the_thesis_table_and_the_limit_of_the_exact_ratio() -> None:
    """Spacings of planes, dZ / dX.

    Table 2.1's at the front of 50 x 50 x 10 mm; and 1 / D plus a slope in Z.
    """
    for ratio, printed in ((0.2, 5.0), (0.4, 2.5), (0.5, 2.0)):
        assert theory.first_order_spacing_ratio(ratio, 0.0, S_O) == pytest.approx(printed)
        assert plane_spacing_ratio(ratio, 0.05, 0.0, S_O) == pytest.approx(printed, rel=1e-3)
    assert plane_spacing_ratio(0.4, 1e-9, 30.0, S_O) == pytest.approx(
        theory.first_order_spacing_ratio(0.4, 30.0, S_O), rel=1e-9
    )
    assert theory.planes(10.0, 0.05 * 2.5) == pytest.approx(80.0)


# Ghosts


@pytest.mark.parametrize(
    ("cameras", "area", "ppp", "depth"), [(2, 4, 0.05, 12), (3, 9, 0.03, 20), (4, 9, 0.04, 15)]
)
def test_ghosts_of_independent_images_follow_the_theory(
    cameras: int, area: int, ppp: float, depth: int
) -> None:
    """Simulated images light voxels as often as the theory says.

    Square images of `area` pixels lie at random positions, and every plane shifts them as
    refocusing does. A voxel counts the ways in which it is lit.
    """
    rng = np.random.default_rng(cameras)
    size, side = 300, math.isqrt(area)
    count = round(ppp * size**2)
    images = np.zeros((cameras, size, size))
    for image in images:
        row, column = rng.integers(size, size=(2, count))
        for a in range(side):
            for b in range(side):
                np.add.at(image, ((row + a) % size, (column + b) % size), 1.0)
    lit = sum(
        np.prod(
            [np.roll(image, (i * z, -i * z), axis=(0, 1)) for i, image in enumerate(images)], axis=0
        ).sum()
        for z in range(depth)
    )
    assert lit / count == pytest.approx(ghost_ratio(count / size**2, cameras, area, depth), rel=0.1)


# Operations


@pytest.mark.parametrize(
    ("algorithm", "initial", "total"),
    [
        ("asa", 8.81e9, 8.81e9),
        ("msa", 9.11e9, 9.11e9),
        ("mart", 0.0, 2.15e11),
        ("mfg-mart", 1.238e9, 8.00e10),
        ("mlos-sart", 1.80e10, 1.81e10),
        ("mlos-smart", 1.80e10, 1.81e10),
    ],
)
def test_operations_are_those_of_table_3_1(
    algorithm: Algorithm, initial: float, total: float
) -> None:
    """The table agrees to its printed digits.

    MLOS gives 1.817e10, which the table truncates to 1.81e10.
    """
    first, rest = operations(algorithm, TABLE_3_1[algorithm])
    assert first == pytest.approx(initial, rel=1e-3)
    assert first + rest == pytest.approx(total, rel=5e-3)


def test_ratios_in_the_thesis_text_are_those_of_thirteen_cameras() -> None:
    """The thesis's 16.3, 6.1 and 1.4 times fewer operations are of thirteen cameras.

    Section 3.3.1 states these ratios, but its table has nine cameras.
    """
    thirteen = sum(operations("msa", theory.Setup(13)))
    others = [sum(operations(name, TABLE_3_1[name])) for name in ("mart", "mfg-mart", "mlos-sart")]
    np.testing.assert_allclose(
        [other / thirteen for other in others], [16.3, 6.1, 1.4], rtol=0, atol=0.05
    )


def test_operations_grow_with_cameras_and_iterations() -> None:
    assert operations(
        "mart", theory.Setup(8, iterated_voxels=1e6, path_voxels=10.0, iterations=10)
    ) == (0.0, 4 * 10 * 8 * 1e6 * 84)
    assert operations("mlos-smart", theory.Setup(2, voxels=1e6, lit_voxels=1e4, iterations=3)) == (
        2.4e8,
        3 * 51 * 1e4,
    )


# Histograms


def test_normal_values_are_normal_and_particles_leave_the_core_so() -> None:
    plane = np.random.default_rng(1).normal(0.3, 0.05, (500, 500))
    clean = normality(plane)
    assert abs(clean.skewness) < 0.02
    assert abs(clean.excess_kurtosis) < 0.04
    assert clean.distance < 0.004
    plane[::40, ::40] += 0.7
    with_particles = normality(plane)
    assert with_particles.skewness > 0.1
    assert with_particles.excess_kurtosis > 0.5
    assert with_particles.distance < 0.01


def test_moments_and_distance_of_known_distributions() -> None:
    quantiles = (np.arange(20000) + 0.5) / 20000
    uniform = normality(quantiles)
    assert (uniform.skewness, uniform.excess_kurtosis) == pytest.approx((0.0, -1.2), abs=1e-3)
    u = math.sqrt(12.0) * (quantiles - 0.5)
    expected = np.abs(
        quantiles - np.array([0.5 * math.erfc(-value / math.sqrt(2.0)) for value in u])
    ).max()
    assert uniform.distance == pytest.approx(expected, abs=1e-4)
    exponential = normality(-np.log(quantiles))
    assert (exponential.skewness, exponential.excess_kurtosis) == pytest.approx(
        (2.0, 6.0), abs=0.15
    )


def test_the_mean_of_many_images_is_nearer_to_normal_than_one() -> None:
    """Section 2.2.3: the central limit theorem, with sparse, skewed images."""
    images = np.random.default_rng(2).gamma(0.3, size=(25, 200, 200))
    one, mean = normality(images[0]), normality(images.mean(axis=0))
    assert mean.distance < 0.2 * one.distance
    assert mean.skewness == pytest.approx(one.skewness / 5.0, rel=0.1)


def test_a_dark_image_with_few_particles_is_far_from_normal() -> None:
    image = np.zeros(1000)
    image[:10] = 1.0
    assert normality(image).distance == 0.5
    with pytest.raises(ValueError, match="expected at least two different values, got 1"):
        normality(np.ones(5))
