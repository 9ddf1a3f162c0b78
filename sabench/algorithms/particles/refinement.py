"""Former place of two functions, for imports that still name it."""

from __future__ import annotations

from sabench.geometry.volume_polynomials import points_in_mm as in_mm
from sabench.images.particle_widths import peak_brightness

__all__ = ["in_mm", "peak_brightness"]
