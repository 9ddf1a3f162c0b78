"""Analysis of a plunging jet from its bubbles.

Source: thesis, section 5.5. Bins are 20 mm along Y and 8 mm along R. Y_p is the mean of the depth
where the concentration drops and the bin above. D_eq is where the concentration at the bin above
falls to 5 % (`edge`) of its largest there. The angle is that of a cone from the point of impact to
D_eq at Y_p, as the values of table 5.2 are. C_tot is the part of a cone a tenth wider that is air.
C_Y is a sum over R without a weight (equation 5.17). The scaling is that of equation 5.18.
"""

import warnings
from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeWarning, curve_fit

from sabench.utils.arrays import F64
from sabench.worlds.library.plunging_jet import MARGIN

DEPTH_MM, RADIUS_MM = 20.0, 8.0  # bins
_CLOUD = 0.2  # of the largest C_Y
_FIT_BINS = 4  # with bubbles: fewer do not show a scaling of two numbers


@dataclass(frozen=True)
class JetFigures:
    """Concentration of bubbles (depth, radius), and figures derived from it.

    NaN stands for what cannot be determined.

    Attributes
    ----------
    depth_mm, radius_mm : centres of the bins.
    total : C_Y (depth,), mm.
    largest : C_max (depth,).
    half_radius_mm : R_.5 (depth,).
    penetration_mm, equivalent_mm, angle_deg : Y_p, D_eq, half angle of the cone.
    cone_percent : C_tot, of the cone down to Y_p.
    weight, width : A and s of equation 5.18.
    """

    depth_mm: F64
    radius_mm: F64
    concentration: F64
    total: F64
    largest: F64
    half_radius_mm: F64
    penetration_mm: float
    equivalent_mm: float
    angle_deg: float
    cone_percent: float
    weight: float
    width: float


def analyse(
    center_mm: F64, radius_mm: F64, impact_mm: F64, depth_mm: float, edge: float, frames: int = 1
) -> JetFigures:
    """Analyse the bubbles below a jet that points along +Y.

    Parameters
    ----------
    center_mm, radius_mm : (n, 3) and (n,) bubbles of all frames together.
    impact_mm : (3,) point where the jet meets the surface.
    depth_mm : largest depth of counted bubbles below it.
    edge : fraction of the largest concentration at a depth where the cloud ends.
    frames : number of frames that the bubbles are from.
    """
    across, depth, along = (center_mm - impact_mm).T
    away = np.hypot(across, along)
    depths = np.arange(0.0, depth_mm + 1e-9, DEPTH_MM)
    outer = max(RADIUS_MM, float(away.max(initial=0.0)))
    radii = np.arange(0.0, outer + RADIUS_MM, RADIUS_MM)
    volume = 4.0 / 3.0 * np.pi * radius_mm**3
    air, *_ = np.histogram2d(depth, away, bins=(depths, radii), weights=volume)
    space = np.pi * np.diff(radii**2)[None] * DEPTH_MM
    concentration = air / space / frames
    y, r = (edges[:-1] + np.diff(edges) / 2.0 for edges in (depths, radii))
    total = 2.0 * np.pi * concentration.sum(axis=1) * RADIUS_MM
    largest = concentration.max(axis=1, initial=0.0)
    half = np.array([_falls_to(r, row, 0.5) for row in concentration])
    drop = _drop(total)
    penetration = equivalent = float("nan")
    if drop is not None:
        penetration = float(y[drop] + y[drop - 1]) / 2.0
        equivalent = 2.0 * _falls_to(r, concentration[drop - 1], edge)
    angle = float(np.rad2deg(np.arctan2(equivalent / 2.0, penetration)))
    slope = MARGIN * equivalent / 2.0 / penetration  # of a cone a tenth wider than D_eq
    inside = (depth > 0.0) & (depth <= penetration) & (away <= slope * depth)
    percent = 100.0 * float(volume[inside].sum()) / (np.pi * slope**2 * penetration**3 / 3.0)
    weight = width = float("nan")
    if np.isfinite(penetration) and np.count_nonzero(total) >= _FIT_BINS:
        weight, width = fit_total((y - y[total.argmax()]) / penetration, total / total.max())
    profiles = y, r, concentration, total, largest, half
    return JetFigures(*profiles, penetration, equivalent, angle, percent / frames, weight, width)


def _falls_to(r: F64, profile: F64, fraction: float) -> float:
    """Find the radius where a profile falls to a fraction of its maximum, or NaN."""
    if not len(profile) or profile.max() <= 0.0:
        return float("nan")
    start = int(profile.argmax())
    level = fraction * profile[start]
    below = np.flatnonzero(profile[start:] <= level)
    if not len(below):
        return float(r[-1])
    k = start + int(below[0])
    return float(np.interp(level, [profile[k], profile[k - 1]], [r[k], r[k - 1]]))


def _drop(total: F64) -> int | None:
    """Find the bin with the smallest concentration relative to that above it.

    Bins below a fifth of the peak do not count: below the cloud, where bubbles are few, any bin may
    be empty.
    """
    top = int(total.argmax()) if len(total) else 0
    if not len(total) or total[top] <= 0.0 or top + 1 >= len(total):
        return None
    part = total[top + 1 :] / np.maximum(total[top:-1], 1e-300)
    part[total[top:-1] < _CLOUD * total[top]] = np.inf
    return top + 1 + int(np.argmin(part))


def fit_total(scaled: F64, share: F64) -> tuple[float, float]:
    """Fit A and s of equation 5.18 to relative C_Y at scaled depths (n,)."""

    def law(x: F64, weight: float, width: float) -> F64:
        return np.asarray(weight * np.exp(-(x**2) / (2.0 * width**2)) + (1.0 - weight))

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OptimizeWarning)
            (weight, width), _ = curve_fit(law, scaled, share, p0=(0.9, 0.2), maxfev=4000)
    except RuntimeError:
        return float("nan"), float("nan")
    return float(weight), abs(float(width))
