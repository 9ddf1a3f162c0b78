"""How far a velocity field is from the true one."""

from __future__ import annotations

import numpy as np

from sabench.utils.arrays import F64

_PRECISION = 90.0  # percent; thesis, table 2.2


def precision_interval(errors: F64) -> F64:
    """Half widths (3,) of the intervals about zero that hold 90 % of errors (n, 3); thesis, section 2.3.3."""
    return np.asarray(np.percentile(np.abs(errors), _PRECISION, axis=0))


def response(found: F64, true: F64) -> float:
    """The part of the true variation that is found: slope of found over true velocities (n, 3), each less its mean. For a wave: its amplitude."""
    about = (
        [values - values.mean(axis=0) for values in (found, true)] if len(true) else [found, true]
    )
    power = float(np.sum(about[1] ** 2))
    return float(np.sum(about[0] * about[1])) / power if power > 0.0 else float("nan")
