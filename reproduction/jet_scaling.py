"""Scaling laws of a plunging jet, and its concentration from five points.

Source: thesis, section 5.5.3. With Y* = (Y - Y_m) / Y_p, C_max falls linearly from its largest
value at Y_m on both sides (figure 5-30c), C over R is Gaussian (equation 5.19), and C_Y follows
from C_max and R_.5 (equation 5.22) or from equation 5.18.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from sabench.metrics.plunging_jet import DEPTH_MM, JetFigures
from sabench.utils.arrays import F64
from sabench.worlds.library.plunging_jet import FALL, LN2, RISE, rotation_from_y

_AROUND = 2.0  # R / R_.5 up to which the radial law is compared: beyond, both are small
TOTAL = float(np.pi**1.5 / np.sqrt(LN2))  # of equation 5.22


@dataclass(frozen=True)
class FivePoints:
    """Five measurements that predict the concentration everywhere (section 5.5.3).

    Attributes
    ----------
    least, largest : smallest and largest C_max.
    peak_mm : Y_m, depth of the largest.
    half_radius_mm : R_.5 at Y_m.
    penetration_mm : Y_p.
    weight, width : A and s of equation 5.18, which are constants of all jets.
    """

    least: float
    largest: float
    peak_mm: float
    half_radius_mm: float
    penetration_mm: float
    weight: float = 0.903
    width: float = 0.1894

    def scaled_depth(self, y: F64) -> F64:
        """Compute Y* = (Y - Y_m) / Y_p."""
        return np.asarray((np.asarray(y) - self.peak_mm) / self.penetration_mm)

    def on_axis(self, y: F64) -> F64:
        """Compute C_max from the two lines of figure 5-30c."""
        scaled = self.scaled_depth(y)
        line = np.clip(1.0 + np.where(scaled < 0.0, RISE, FALL) * scaled, 0.0, 1.0)
        return np.asarray(self.least + (self.largest - self.least) * line)

    def total(self, y: F64) -> F64:
        """Compute C_Y in mm: equation 5.22 at Y_m, and 5.18 from there."""
        gauss = np.exp(-(self.scaled_depth(y) ** 2) / (2.0 * self.width**2))
        peak = TOTAL * self.largest * self.half_radius_mm
        return np.asarray(peak * (self.weight * gauss + 1.0 - self.weight))

    def concentration(self, y: F64, r: F64) -> F64:
        """Compute C(Y, R), equation 5.19, with R_.5 from equation 5.22."""
        half = self.total(y) / (TOTAL * self.on_axis(y))
        return np.asarray(self.on_axis(y) * np.exp(-LN2 * np.asarray(r) ** 2 / half**2))


def five_points(jet: JetFigures) -> FivePoints:
    """Take the five measurements from an analysed jet.

    The smallest C_max is that of a bin with bubbles.

    Raises ValueError: no bubbles, or no penetration depth.
    """
    if not jet.largest.any() or not np.isfinite(jet.penetration_mm):
        raise ValueError("jet: expected one with bubbles and a penetration depth")
    top = int(jet.largest.argmax())
    return FivePoints(
        float(jet.largest[jet.largest > 0.0].min()),
        float(jet.largest[top]),
        float(jet.depth_mm[top]),
        float(jet.half_radius_mm[top]),
        jet.penetration_mm,
    )


def scaled_maximum(jet: JetFigures) -> tuple[F64, F64]:
    """Compute Y* and C*, the scaled maximum of equation 5.23, of each depth (n,)."""
    least, top = float(jet.largest.min()), int(jet.largest.argmax())
    scaled = (jet.depth_mm - jet.depth_mm[top]) / jet.penetration_mm
    return scaled, (jet.largest - least) / (float(jet.largest[top]) - least)


def slopes(jets: Sequence[JetFigures]) -> tuple[float, float]:
    """Fit the slopes of C* over Y* on both sides of Y_m (figure 5-30c).

    Both lines go through 1 at Y_m. The rising region begins where C* stops falling towards the
    surface; the falling one ends at the penetration depth. NaN for a region without bins.
    """
    rising, falling = [], []
    for jet in jets:
        y, c = scaled_maximum(jet)
        top = start = int(c.argmax())
        while start > 0 and c[start - 1] < c[start]:
            start -= 1
        end = int(np.searchsorted(jet.depth_mm, jet.penetration_mm))
        rising.append((y[start:top], c[start:top]))
        falling.append((y[top + 1 : end], c[top + 1 : end]))
    return _through_one(rising), _through_one(falling)


def _through_one(parts: list[tuple[F64, F64]]) -> float:
    y, c = (np.concatenate(column) for column in zip(*parts, strict=True))
    return float(np.sum(y * (c - 1.0)) / np.sum(y**2)) if len(y) else float("nan")


def radial_points(jet: JetFigures) -> tuple[F64, F64]:
    """Scale the concentrations down to the penetration depth.

    Returns R / R_.5 and C / C_max (n,), which lie on one curve by equation 5.19. Depths without
    bubbles are left out.
    """
    rows = (jet.largest > 0.0) & (jet.depth_mm < jet.penetration_mm)
    r = jet.radius_mm[None] / jet.half_radius_mm[rows, None]
    c = jet.concentration[rows] / jet.largest[rows, None]
    return np.asarray(r.ravel()), np.asarray(c.ravel())


def radial_slope(jet: JetFigures) -> float:
    """Fit k of C / C_max = exp(-k (R / R_.5)^2) up to R = 2 R_.5.

    It is ln 2 in equation 5.19.

    NaN without bubbles.
    """
    r, c = radial_points(jet)
    near = r <= _AROUND
    if not near.any():
        return float("nan")

    def error(k: float) -> float:
        return float(np.sum((c[near] - np.exp(-k * r[near] ** 2)) ** 2))

    return float(minimize_scalar(error, bounds=(0.01, 5.0), method="bounded").x)


def total_factor(jet: JetFigures) -> float:
    """Compute the median of C_Y / (C_max R_.5) down to Y_p: `TOTAL` by equation 5.22."""
    rows = (jet.largest > 0.0) & (jet.depth_mm < jet.penetration_mm)
    if not rows.any():
        return float("nan")
    return float(np.median((jet.total / (jet.largest * jet.half_radius_mm))[rows]))


def explained_share(points: FivePoints, jet: JetFigures) -> float:
    """Compute the share of the mean square of C(Y, R) that a prediction explains.

    One is a perfect prediction.
    """
    model = points.concentration(jet.depth_mm[:, None], jet.radius_mm[None])
    return 1.0 - float(np.mean((model - jet.concentration) ** 2) / np.mean(jet.concentration**2))


_SWEEPS = 3
_FEWEST = 5  # bubbles of a bin whose spread counts


def find_tilt(center_mm: F64, impact_mm: F64) -> tuple[float, float]:
    """Find the angles between a jet's axis and +Y, towards +X and towards +Z.

    They are in degrees.
    The axis is the straight line through the point of impact from which bubbles (n, 3) lie least
    far sideways, in units of the cloud's width at their depth.

    Raises ValueError: too few bubbles below the point of impact.
    """
    position = center_mm - np.asarray(impact_mm)
    position = position[position[:, 1] > 0.0]
    if len(position) < _FEWEST:
        raise ValueError(
            f"center_mm: expected {_FEWEST} bubbles below the jet, got {len(position)}"
        )
    y = position[:, 1]
    slope = np.zeros(2)
    for _ in range(_SWEEPS):
        aside = position[:, [0, 2]] - slope * y[:, None]
        # compute the mean square distance (n,) from the axis in a bubble's bin of depth
        bins = (y // DEPTH_MM).astype(np.int64)
        count = np.bincount(bins)
        sums = np.bincount(bins, np.sum(aside**2, axis=1))
        overall = float(np.mean(np.sum(aside**2, axis=1)))
        enough = count >= _FEWEST
        weight = 1.0 / np.where(enough, sums / np.maximum(count, 1), overall)[bins]
        slope = np.sum(weight[:, None] * y[:, None] * position[:, [0, 2]], axis=0) / np.sum(
            weight * y**2
        )
    return tuple(np.rad2deg(np.arctan(slope)).tolist())


def straighten(center_mm: F64, impact_mm: F64, tilt_deg: tuple[float, float]) -> F64:
    """Rotate bubbles (n, 3) about the point of impact so that the jet's axis is +Y."""
    impact = np.asarray(impact_mm)
    return np.asarray((center_mm - impact) @ rotation_from_y(tilt_deg) + impact)
