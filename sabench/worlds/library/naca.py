"""NACA four-digit sections, closed at the trailing edge.

Jacobs, Ward and Pinkerton, NACA report 460 (1933), with the last coefficient changed so that the
edge closes.
"""

import numpy as np
import numpy.typing as npt

from sabench.utils.arrays import F64

_LAST = -0.1036  # of x^4: with the report's -0.1015 the trailing edge is 0.2 % of the chord thick


def half_thickness(x: npt.ArrayLike, ratio: float) -> F64:
    """Compute half thickness at x, both in chords, of a largest thickness `ratio`."""
    at = np.asarray(x, dtype=np.float64)
    polynomial = at * (-0.1260 + at * (-0.3516 + at * (0.2843 + _LAST * at)))
    return np.asarray(5.0 * ratio * (0.2969 * np.sqrt(at) + polynomial))


def camber(x: npt.ArrayLike, height: float, position: float) -> tuple[F64, F64]:
    """Compute mean line and its slope at x, in chords.

    Its largest height is at `position`; a height of 0 is a straight line.
    """
    at = np.asarray(x, dtype=np.float64)
    if not height:
        return np.zeros_like(at), np.zeros_like(at)
    part = np.where(at < position, position, 1.0 - position)  # each side is a parabola
    off = (at - position) / part
    return np.asarray(height * (1.0 - off**2)), np.asarray(-2.0 * height * off / part)


def section(digits: str, stations: int) -> tuple[F64, F64]:
    """Compute upper and lower side (stations + 1, 2) in chords.

    Both start at the leading edge, 0, and share the trailing edge, 1.

    Thickness is laid off at right angles to the mean line; stations are closest at the edges.
    """
    x = (1.0 - np.cos(np.linspace(0.0, np.pi, stations + 1))) / 2.0
    mean, slope = camber(x, int(digits[0]) / 100.0, int(digits[1]) / 10.0)
    thick = half_thickness(x, int(digits[2:]) / 100.0)
    thick[-1] = 0.0  # of rounding
    normal = np.column_stack([-slope, np.ones_like(x)]) / np.hypot(1.0, slope)[:, None]
    line = np.column_stack([x, mean])
    return line + thick[:, None] * normal, line - thick[:, None] * normal
