"""Predictions of the thesis: plane spacing, ghosts, operations, histograms.

These are functions of numbers only.

Equation and table numbers are those of J. Belden, "Synthetic Aperture Imaging for Three Dimensional
Resolution of Fluid Flows", MIT.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

Algorithm = Literal["asa", "msa", "mart", "mfg-mart", "mlos-sart", "mlos-smart"]


def magnification(z_mm: float, s_i_mm: float, s_o_mm: float) -> float:
    """Compute the magnification M(Z) = -s_i / (s_o + Z).

    s_i and s_o are the lens's distances from the sensor and from the plane Z = 0.
    """
    return -s_i_mm / (s_o_mm + z_mm)


def pixel_in_volume_mm(pixel_mm: float, magnification: float) -> float:
    """Compute a pixel's width dX = -p / M at the plane of magnification M.

    Equation 2.5.
    """
    return -pixel_mm / magnification


def image_shift_mm(
    baseline_mm: float, z_a_mm: float, z_b_mm: float, s_i_mm: float, s_o_mm: float
) -> float:
    """Compute the shift of an image that refocuses from plane Z_A to Z_B.

    Equation 2.6. The shift is on the camera's sensor; the baseline is from the first camera.
    """
    return baseline_mm * (
        magnification(z_b_mm, s_i_mm, s_o_mm) - magnification(z_a_mm, s_i_mm, s_o_mm)
    )


def plane_spacing_ratio(
    baseline_ratio: float, pixel_mm: float, z_mm: float, s_o_mm: float
) -> float:
    """Compute the plane spacing ratio dZ / dX of equation 2.10.

    dZ / dX = (1 / D + Z / (D s_o)) / (1 - dX / (D s_o)), where a shift by one pixel leads to the
    next focal plane.
    `baseline_ratio` is D, the distance of the cameras' centres / s_o; `pixel_mm` is dX, a pixel's
    width at Z (equation 2.5); Z and s_o, the cameras' distance, are from the volume's front.
    """
    return first_order_spacing_ratio(baseline_ratio, z_mm, s_o_mm) / (
        1.0 - pixel_mm / (baseline_ratio * s_o_mm)
    )


def first_order_spacing_ratio(baseline_ratio: float, z_mm: float, s_o_mm: float) -> float:
    """Approximate the plane spacing ratio by equation 2.11, for dX << D s_o.

    dZ / dX = 1 / D + Z / (D s_o). Arguments as in `plane_spacing_ratio`.
    """
    return (1.0 + z_mm / s_o_mm) / baseline_ratio


def planes(depth_mm: float, spacing_mm: float) -> float:
    """Compute the number of focal planes in a volume's depth, N = Z_o / dZ.

    Equation 2.12.
    """
    return depth_mm / spacing_mm


@dataclass(frozen=True)
class Setup:
    """Quantities with counts of operations in Table 3.1.

    Attributes
    ----------
    cameras : N.
    voxels : N_vox of the whole volume.
    iterated_voxels : mean number of voxels that an iteration considers (MART, MFG-MART).
    lit_voxels : N_n.z.vox, voxels above zero after the first guess (MLOS).
    path_voxels : L, mean length of a pixel's line of sight.
    iterations : k_t.
    """

    cameras: int
    voxels: float = 3.75e7
    iterated_voxels: float = 0.0
    lit_voxels: float = 0.0
    path_voxels: float = 0.0
    iterations: int = 0


TABLE_3_1: dict[Algorithm, Setup] = {
    "asa": Setup(9),
    "msa": Setup(9),
    "mart": Setup(4, iterated_voxels=1.1e7, path_voxels=30.0, iterations=5),
    "mfg-mart": Setup(4, iterated_voxels=6e6, path_voxels=20.0, iterations=5),
    "mlos-sart": Setup(4, lit_voxels=3.38e5, iterations=5),
    "mlos-smart": Setup(4, lit_voxels=3.38e5, iterations=5),
}


def operations(algorithm: Algorithm, setup: Setup) -> tuple[float, float]:
    """Count operations of the first pass over the volume and of all iterations.

    Equations 3.6, 3.7, 3.10 to 3.13. Equations 3.12 and 3.13 are those of one iteration; Table 3.1
    has five. See docs/physics/theory.md where the table departs from the equations.
    """
    n, rounds = setup.cameras, setup.iterations
    mart = 4.0 * rounds * n * setup.iterated_voxels * (8.0 * setup.path_voxels + 4.0)
    counts = {
        "asa": (setup.voxels * (26 * n + 1), 0.0),
        "msa": (27.0 * n * setup.voxels, 0.0),
        "mart": (0.0, mart),
        "mfg-mart": (setup.voxels * (8 * n + 1), mart),
        "mlos-sart": (120.0 * n * setup.voxels, rounds * (24 * n + 4) * setup.lit_voxels),
        "mlos-smart": (120.0 * n * setup.voxels, rounds * (24 * n + 3) * setup.lit_voxels),
    }
    return counts[algorithm]


@dataclass(frozen=True)
class Normality:
    """Distance of values from a normal distribution; all three are 0 for that one.

    Attributes
    ----------
    skewness, excess_kurtosis : of all values; particles, which are bright outliers, raise both.
    distance : Kolmogorov's, the largest difference of two cumulative distributions: of the core,
        the values below mean + 3 standard
        deviations, and of the normal distribution with the core's mean and standard deviation; 1/2
        for a core of one value.
    """

    skewness: float
    excess_kurtosis: float
    distance: float


def normality(values: npt.ArrayLike) -> Normality:
    """Fit a Gaussian to the intensities of an image or of a refocused plane.

    Section 2.2.3, figures 2-4 and 2-15.

    Raises ValueError: fewer than two different values.
    """
    flat = np.asarray(values, dtype=np.float64).ravel()
    if not flat.size or flat.min() == flat.max():
        raise ValueError(
            f"normality: expected at least two different values, got {len(np.unique(flat))}"
        )
    standard = _standardise(flat)
    core = _standardise(np.sort(standard[standard < 3.0]))
    expected, steps = ndtr(core), np.arange(len(core) + 1) / len(core)
    distance = max(float(np.max(expected - steps[:-1])), float(np.max(steps[1:] - expected)))
    return Normality(float(np.mean(standard**3)), float(np.mean(standard**4) - 3.0), distance)


def _standardise(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    centred = values - values.mean()
    spread = centred.std()
    return np.asarray(centred / spread) if values.min() < values.max() else np.zeros_like(values)
