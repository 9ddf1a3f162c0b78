"""The thesis's algorithm for bubbles in dense flows."""

import numpy as np
from pydantic import Field

from sabench.algorithms.bubbles import (
    PLANES,
    STEP,
    WINDOW,
    FeaturePeaks,
    attenuate,
    compute_potential,
    darkness,
    drop_duplicates,
    find_blots,
    find_depth,
    find_edges,
    find_ellipses,
)
from sabench.algorithms.refocus import find_edge_on
from sabench.api import (
    F32,
    F64,
    I64,
    BubbleSolver,
    Detections,
    Grid,
    Observation,
    Parameters,
    progress_bar,
)

_NEAR = 5  # planes from a bubble to a peak that confirms it
_MARGIN = 3  # voxels around what is looked at


class LocalFeatureParameters(Parameters):
    """Thresholds of peaks, edges and bubbles."""

    least_peak: float = Field(
        4.5, gt=0.0, description="logarithm of the feature potential that makes a peak"
    )
    least_edge: float = Field(
        0.01, gt=0.0, lt=1.0, description="gradient of darkness per voxel that makes an edge"
    )
    least_part: float = Field(
        0.5, gt=0.0, le=1.0, description="part of an ellipse that must have edges"
    )
    least_aspect: float = Field(
        0.4,
        gt=0.0,
        le=1.0,
        description="short over long axis below which an ellipse is a part of an outline",
    )
    largest_mm: float = Field(3.0, gt=0.0, description="largest semi-axis")
    small_px: float = Field(
        4.0,
        gt=0.0,
        description="equivalent diameter in voxels below which a feature is thresholded",
    )


class LocalFeature(BubbleSolver):
    """Bubbles at peaks of the feature potential in twice attenuated planes.

    Hough's transform finds ellipses around each group of peaks.
    """

    name = "local_feature"
    references = ("J. Belden, MIT thesis, section 5.4.3", "Y. Xie and Q. Ji, ICPR 2002")
    Parameters = LocalFeatureParameters

    def skip(self, case: Observation) -> str | None:
        """Skip cameras that see planes of constant Z edge-on."""
        return find_edge_on(case.cameras, case.grid)

    def solve(self, case: Observation) -> Detections:
        """Detect bubbles by steps 1 to 4 of the section."""
        volume = darkness(case)
        for _ in range(2):
            attenuate(volume, compute_potential(volume, STEP), STEP)
        peaks = FeaturePeaks.find(
            np.log1p(compute_potential(volume, STEP)), self.parameters.least_peak
        )
        bubbles = self._bubbles(volume, peaks, case.grid)
        return _detections(
            drop_duplicates(bubbles, case.grid.voxel_mm[2] / case.grid.voxel_mm[0]), case.grid
        )

    def _bubbles(self, volume: F32, peaks: FeaturePeaks, grid: Grid) -> F64:
        """Grow the bubbles (n, 7) of all groups, each from the strongest peak left.

        Columns are the outline, the part of it that has edges, and the plane.
        """
        largest = self.parameters.largest_mm / grid.voxel_mm[0]
        free = np.ones(len(peaks.weight), dtype=np.bool_)
        bubbles = []
        for first in progress_bar(range(len(free)), "peaks"):
            if not free[first]:
                continue
            group = peaks.group(first, free, int(np.ceil(largest / STEP)))
            free[group] = False
            for bubble in self._features(volume, peaks, group, largest):
                if peaks.within(bubble, _NEAR).any():
                    free &= ~peaks.within(bubble, PLANES)
                    bubbles.append(bubble)
        return np.array(bubbles, dtype=np.float64).reshape(-1, 7)

    def _features(self, volume: F32, peaks: FeaturePeaks, group: I64, largest: float) -> list[F64]:
        """Find ellipses of a group in its mean plane, each then in its own.

        Without one, small features at its strongest peak.
        """
        windows = peaks.position[group, 1:] * STEP
        plane = peaks.plane(group)
        shapes = self._ellipses(
            volume, plane, windows.min(axis=0), windows.max(axis=0) + WINDOW, largest
        )
        bubbles = [
            bubble
            for shape in shapes
            if (bubble := self._refocus(volume, shape, plane, largest)) is not None
        ]
        return bubbles or self._small(volume, peaks.position[group[0]])

    def _ellipses(self, volume: F32, plane: int, low: I64, high: I64, largest: float) -> F64:
        """Find outlines (n, 6) within a box of rows and columns of a plane."""
        chosen: LocalFeatureParameters = self.parameters
        top, left = np.maximum(low - _MARGIN, 0)
        bottom, right = np.maximum(high + _MARGIN, 0)
        dark = np.ascontiguousarray(volume[plane, top:bottom, left:right])
        out = find_ellipses(
            find_edges(dark, chosen.least_edge), largest, chosen.least_aspect, chosen.least_part
        )
        out[:, :2] += left, top
        return out

    def _refocus(self, volume: F32, shape: F64, plane: int, largest: float) -> F64 | None:
        """Refocus an outline: find the plane where it is darkest, and the outline there.

        None if it is not there any more.
        """
        depth = float(plane)
        for _ in range(2):
            depth = find_depth(volume, shape, round(depth))
            low, high = (
                np.floor(shape[1::-1] + side * shape[2]).astype(np.int64) for side in (-1.0, 1.0)
            )
            again = self._ellipses(volume, round(depth), low, high + 1, largest)
            apart = np.hypot(*(again[:, :2] - shape[:2]).T)
            if not len(again) or apart.min() > 0.5 * shape[3]:
                return None
            shape = again[apart.argmin()]
        return np.append(shape, depth)

    def _small(self, volume: F32, peak: I64) -> list[F64]:
        """Find features around a peak that are too small for votes.

        They are taken as circles, since their outlines are unknown.
        """
        chosen: LocalFeatureParameters = self.parameters
        plane, (top, left) = int(peak[0]), np.maximum(peak[1:] * STEP - _MARGIN, 0)
        size = WINDOW + 2 * _MARGIN
        dark = np.ascontiguousarray(volume[plane, top : top + size, left : left + size])
        circles = [
            np.array([x + left, y + top, r, r, 0.0, 0.0])
            for x, y, r in find_blots(dark, chosen.least_edge, chosen.small_px)
        ]
        return [np.append(circle, find_depth(volume, circle, plane)) for circle in circles]


def _detections(bubbles: F64, grid: Grid) -> Detections:
    """Make ellipsoids of outlines.

    The third axis is as long as the longer one in the image.
    """
    voxel, low = np.asarray(grid.voxel_mm), np.asarray(grid.low_mm)
    _, _, a, b, angle, _, _ = bubbles.T
    cosine, sine = np.cos(angle), np.sin(angle)
    across = np.array([[a * cosine, -b * sine], [a * sine, b * cosine]]).transpose(2, 0, 1)
    directions, axes, _ = np.linalg.svd(voxel[:2, None] * across)  # voxels need not be square
    x, y = directions[:, 0, 0], directions[:, 1, 0]
    rotation = np.tile(np.eye(3), (len(bubbles), 1, 1))
    rotation[:, :2, :2] = np.array([[x, y], [-y, x]]).transpose(2, 0, 1)
    return Detections(bubbles[:, [0, 1, 6]] * voxel + low, axes[:, [0, 1, 0]], rotation)
