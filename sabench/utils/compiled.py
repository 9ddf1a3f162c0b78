"""Decorator of kernels that stay plain Python where numba is not installed.

Kernels that a score may call are decorated with this `njit`; what a score needs of whole volumes
and images is NumPy's in any case. Kernels of solvers and renderers use numba itself.
"""

from __future__ import annotations

from typing import Any

from sabench.utils.installed import can_compile

if can_compile:
    from numba import njit, prange
else:
    prange = range

    def njit(*function: Any, **options: Any) -> Any:
        """Leave a kernel as it is."""
        return function[0] if function else njit


__all__ = ["njit", "prange"]
