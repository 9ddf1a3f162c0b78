"""Laws of bubbles below a plunging jet.

Functions of depth Y below the surface and radius R from the jet's axis.

Source: J. Belden's thesis, section 5.5.3: equations 5.17 (total concentration C_Y = 2 pi times the
integral of C over R), 5.18 (C_Y), 5.19 (C over R), 5.22 (which ties R_.5 to both) and 5.23 (C_max),
figure 5-30c (its slopes), table 5.2 (penetration depth, diameter, total).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.integrate import quad

from sabench.geometry.rigid_motion import rotation_matrices
from sabench.utils.arrays import F64

LN2 = 0.69315  # as equation 5.19 writes it
EDGE = 0.05  # of the maximum: where the cloud ends
RISE, FALL = 2.21, -2.87  # slopes of the scaled maximum over the scaled depth, above and below Y_m
MARGIN = 1.1  # the cone of downward moving bubbles is a tenth wider than its angle


@dataclass(frozen=True)
class JetLaw:
    """One jet.

    Attributes
    ----------
    penetration_mm : Y_p.
    equivalent_mm : D_eq, the cloud's diameter at Y_p.
    total : mean void fraction in the cone down to Y_p.
    weight, width : A and s of equation 5.18.
    """

    penetration_mm: float
    equivalent_mm: float
    total: float
    weight: float = 0.903
    width: float = 0.1894

    @property
    def peak_mm(self) -> float:
        """Y_m, where C_Y is largest: the falling line of C_max ends at Y_p."""
        return self.penetration_mm * (1.0 + 1.0 / FALL)

    @property
    def angle_deg(self) -> float:
        """Half angle of the cone from the point of impact to the cloud's edge at Y_p."""
        return float(np.rad2deg(np.arctan2(self.equivalent_mm / 2.0, self.penetration_mm)))

    def scaled_depth(self, y: F64) -> F64:
        """Compute Y* = (Y - Y_m) / Y_p."""
        return np.asarray((np.asarray(y) - self.peak_mm) / self.penetration_mm)

    def total_over_peak(self, y: F64) -> F64:
        """Compute C_Y over its maximum, equation 5.18."""
        peak = np.exp(-(self.scaled_depth(y) ** 2) / (2.0 * self.width**2))
        return np.asarray(self.weight * peak + (1.0 - self.weight))

    def axis_over_peak(self, y: F64) -> F64:
        """Compute C_max over its maximum.

        How far it falls follows from the angle in table 5.2: the cloud is a cone between
        Y_m and Y_p.
        """
        scaled = self.scaled_depth(y)
        line = np.clip(np.where(scaled < 0.0, 1.0 + RISE * scaled, 1.0 + FALL * scaled), 0.0, 1.0)
        end = float(self.total_over_peak(np.array(self.penetration_mm)))
        least = end * self.peak_mm / self.penetration_mm
        return np.asarray(least + (1.0 - least) * line)

    def half_radius_mm(self, y: F64) -> F64:
        """Compute R_.5, equation 5.22."""
        end = np.array(self.penetration_mm)
        radius = self.equivalent_mm / 2.0 / np.sqrt(np.log(1.0 / EDGE) / LN2)  # at the end
        shape = self.total_over_peak(y) / self.axis_over_peak(y)
        return np.asarray(radius * shape / (self.total_over_peak(end) / self.axis_over_peak(end)))

    @cached_property
    def largest(self) -> float:
        """The void fraction on the axis at Y_m: that which makes the cone's mean `total`."""
        slope = MARGIN * np.tan(np.deg2rad(self.angle_deg))

        def inside(y: float) -> float:
            half, edge = float(self.half_radius_mm(np.array(y))), slope * y
            share = -float(np.expm1(-LN2 * edge**2 / half**2))
            return float(self.axis_over_peak(np.array(y))) * np.pi * half**2 / LN2 * share

        air, _ = quad(inside, 0.0, self.penetration_mm, limit=200, points=[self.peak_mm])
        return float(self.total * np.pi * slope**2 * self.penetration_mm**3 / 3.0 / air)

    def concentration(self, y: F64, r: F64) -> F64:
        """Compute the void fraction C(Y, R), equation 5.19."""
        profile = np.exp(-LN2 * np.asarray(r) ** 2 / self.half_radius_mm(y) ** 2)
        return np.asarray(self.largest * self.axis_over_peak(y) * profile)

    def air_mm2(self, y: F64) -> F64:
        """Compute the volume of air per depth: the integral of 2 pi R C over R."""
        peak = self.largest * self.axis_over_peak(y)
        return np.asarray(peak * np.pi * self.half_radius_mm(y) ** 2 / LN2)


def rotation_from_y(tilt_deg: tuple[float, float]) -> F64:
    """Make the rotation (3, 3) of least angle from +Y onto an axis.

    `tilt_deg` are the axis's angles to +Y as seen along Z (positive towards +X) and along X
    (positive towards +Z).
    """
    x, z = np.tan(np.deg2rad(tilt_deg))
    length = float(np.hypot(x, z))
    vector = np.array([z, 0.0, -x]) * (np.arctan(length) / length if length else 0.0)
    return rotation_matrices(vector)
