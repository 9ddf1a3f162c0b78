"""Before and after refocusing: images on one scale, and particles out of refocused planes."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from sabench.api import Observation, Parameters
from sabench.arrays import F32

_BRIGHT = 95.0  # percentile of the lit pixels that becomes 1
_LIT = 0.1  # of the image's maximum


class ExtractionParameters(Parameters):
    """How particles are taken out of a refocused plane."""

    k: float = Field(3.0, ge=0.0, description="threshold = mean + k standard deviations of the plane")
    keep: Literal["reduced", "whole"] = Field("reduced", description="what stays of a value above the threshold: its excess, or all of it")


def normalised(case: Observation) -> F32:
    """Images as fractions of a bright particle's peak in the same camera, black level subtracted: (camera, row, column).

    Cameras see particles at different scattering angles and so at very different brightness; a common scale makes them count alike
    (the thesis matches histograms to the same end, section 2.3). The scale is the 95th percentile of the pixels that reach a tenth
    of the image's maximum, which is the same kind of pixel in a sparse and in a dense image.
    """
    images: F32 = np.maximum(case.images.astype(np.float32) - np.float32(case.black_dn), np.float32(0.0))
    for image in images:
        lit = image[image > _LIT * image.max()]
        image /= max(float(np.percentile(lit, _BRIGHT)) if len(lit) else 0.0, 1.0)
    return images


def extract(volume: F32, k: float, keep: Literal["reduced", "whole"]) -> F32:
    """Zero all that is below mean + k std of its plane; works in place on (z, y, x) and returns it.

    Source: thesis section 2.2.3; whether the threshold is subtracted is not stated there, so both are offered.
    """
    for plane in volume:
        threshold = np.float32(plane.mean(dtype=np.float64) + k * plane.std(dtype=np.float64))
        if keep == "reduced":
            np.maximum(plane - threshold, 0.0, out=plane)
        else:
            plane[plane <= threshold] = 0.0
    return volume
