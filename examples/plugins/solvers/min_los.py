"""Minimum line of sight."""

import numpy as np
from pydantic import Field

from sabench.api import F32, F64, Bool, Observation, Parameters, Reconstruction, Solver


class MinLosParameters(Parameters):
    """Threshold of the reconstruction."""

    floor: float = Field(
        0.05,
        ge=0.0,
        description="smallest intensity that is kept, as a fraction of a bright particle's peak",
    )


class MinLos(Solver):
    """Minimum line of sight: a voxel is as bright as in its darkest view."""

    name = "min_los"
    references = ("Putze and Maas, Int. Arch. Photogramm. Remote Sens. XXXVII-B5 (2008) 33-38",)
    Parameters = MinLosParameters

    def skip(self, case: Observation) -> str | None:
        """Refuse a single camera, which sees no depth."""
        return "it needs two cameras" if len(case.cameras) < 2 else None

    def solve(self, case: Observation) -> Reconstruction:
        """Compute I = min_i I_i over the cameras i, zero below the floor."""
        x, y, z = case.grid.axes_mm
        volume = np.full(case.grid.shape, np.inf, dtype=np.float32)
        for image, camera in zip(case.images, case.cameras, strict=True):
            light = scaled(image.astype(np.float32) - np.float32(case.black_dn))
            for plane, depth in zip(volume, z, strict=True):
                points = np.stack(np.meshgrid(x, y, depth), axis=-1).reshape(-1, 3)
                pixels, valid = camera.project(points)
                seen = sampled(light, pixels, valid & camera.contains(pixels))
                np.minimum(plane, seen.reshape(plane.shape), out=plane)
        volume[volume < self.parameters.floor] = 0.0
        return Reconstruction(volume)


def scaled(light: F32) -> F32:
    """Scale an image (row, column) so that a bright particle's peak is 1."""
    bright = light[light > 0.1 * light.max()]
    peak = np.percentile(bright, 95) if bright.size else 1.0
    return np.asarray(np.maximum(light, 0.0) / peak, dtype=np.float32)


def sampled(light: F32, pixels: F64, valid: Bool) -> F32:
    """Read an image at the nearest pixels (n, 2) as (column, row); 0 where not valid."""
    values = np.zeros(len(pixels), dtype=np.float32)
    column, row = np.rint(pixels[valid]).astype(int).T
    values[valid] = light[row, column]
    return values
