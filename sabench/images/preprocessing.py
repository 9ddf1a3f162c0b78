"""Preprocessing of images: background and differences of cameras.

The steps of the thesis's section 2.3.2, in any order.
"""

from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from sabench.utils.arrays import F32, U16
from sabench.utils.validation import validate

WHITE = int(np.iinfo(np.uint16).max)  # of processed images; their black is 0


class _Step(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class SlidingMinimum(_Step):
    """Subtract the least value of the pixels around each one."""

    step: Literal["sliding_minimum"] = Field(description="`sliding_minimum`")
    window_px: int = Field(10, ge=2, le=1000, description="edge of the square of pixels")

    def apply(self, images: F32) -> F32:
        """Apply the step to images (camera, row, column); no result is below zero."""
        import cv2  # takes long to load

        kernel = np.ones((self.window_px, self.window_px), dtype=np.uint8)
        return np.stack(
            [image - cv2.erode(image, kernel, borderType=cv2.BORDER_REPLICATE) for image in images]
        )


class Gaussian(_Step):
    """Convolve with a Gaussian."""

    step: Literal["gaussian"] = Field(description="`gaussian`")
    reach_px: int = Field(1, ge=1, le=50, description="half width of the kernel: 1 makes it 3 x 3")
    sigma_px: float = Field(0.5, gt=0.0, description="standard deviation of the Gaussian")

    def apply(self, images: F32) -> F32:
        """Apply the step to images (camera, row, column), mirrored beyond the edges."""
        import cv2

        size = 2 * self.reach_px + 1
        return np.stack([cv2.GaussianBlur(image, (size, size), self.sigma_px) for image in images])


class MatchHistograms(_Step):
    """Matching of cameras' grey values, by rank, to those of highest contrast."""

    step: Literal["match_histograms"] = Field(description="`match_histograms`")

    def apply(self, images: F32) -> F32:
        """Apply the step to images (camera, row, column); equal values stay equal."""
        best = np.sort(images[int(np.argmax(images.std(axis=(1, 2))))], axis=None)
        sums, out = np.concatenate([[0.0], np.cumsum(best, dtype=np.float64)]), images.copy()
        for image, matched in zip(images, out, strict=True):
            levels, rank, count = np.unique(image, return_inverse=True, return_counts=True)
            ends = np.cumsum(count)
            means = (sums[ends] - sums[ends - count]) / count
            if len(levels) > 1:
                matched[:] = means[rank].reshape(image.shape)
        return out


class Stretch(_Step):
    """Cut-off of each camera's darkest and brightest pixels; stretch of the rest.

    The rest fills the range.
    """

    step: Literal["stretch"] = Field(description="`stretch`")
    percent: float = Field(
        0.1, ge=0.0, lt=50.0, description="pixels cut off at either end of the range"
    )

    def apply(self, images: F32) -> F32:
        """Scale images (camera, row, column) to 0 to 1; no contrast becomes black."""
        out = np.zeros_like(images)
        for image, stretched in zip(images, out, strict=True):
            low, high = np.percentile(image, [self.percent, 100.0 - self.percent])
            if high > low:
                np.clip((image - low) / (high - low), 0.0, 1.0, out=stretched)
        return out


class TemporalMinimum(_Step):
    """Subtraction of each pixel's least value over all frames, as first step.

    It removes static light.
    """

    step: Literal["temporal_minimum"] = Field(description="`temporal_minimum`")


Step = Annotated[
    TemporalMinimum | SlidingMinimum | Gaussian | MatchHistograms | Stretch,
    Field(discriminator="step"),
]


class _Steps(_Step):
    steps: tuple[Step, ...]


def read_steps(tables: Sequence[dict[str, Any]], source: str) -> tuple[Step, ...]:
    """Make steps of tables of their keys; an InputError names faults after `source`."""
    return validate(_Steps, {"steps": tables}, source).steps


def takes_all_frames(steps: Sequence[Step]) -> bool:
    """Return whether steps need each pixel's least value over all frames."""
    return any(isinstance(step, TemporalMinimum) for step in steps)


def step_faults(steps: Sequence[Step], frames: int) -> Iterator[str]:
    """List what keeps steps from being applied to a number of frames."""
    if takes_all_frames(steps[1:]):
        yield "expected temporal_minimum as the first step, got it after another one"
    if takes_all_frames(steps) and frames < 2:
        yield f"temporal_minimum: expected two frames or more, got {frames}"


def preprocess(
    images: U16, black_dn: float, white_dn: float, steps: Sequence[Step], lowest: U16 | None = None
) -> U16:
    """Apply all steps to images (camera, row, column), from 0 to `WHITE`.

    Finer than grey values, which blurring would else round.

    Parameters
    ----------
    lowest : the same shape, each pixel's least grey value over all frames, for `TemporalMinimum`.
    """
    light = _light(images, black_dn, white_dn)
    for step in steps:
        if not isinstance(step, TemporalMinimum):
            light = step.apply(light)
        elif lowest is not None:
            light = np.maximum(light - _light(lowest, black_dn, white_dn), np.float32(0.0))
    return np.asarray(np.rint(np.clip(light, 0.0, 1.0) * WHITE), dtype=np.uint16)


def _light(images: U16, black_dn: float, white_dn: float) -> F32:
    """Scale grey values to 0 to 1."""
    light = (images.astype(np.float32) - np.float32(black_dn)) / np.float32(white_dn - black_dn)
    return np.asarray(np.clip(light, 0.0, 1.0))
