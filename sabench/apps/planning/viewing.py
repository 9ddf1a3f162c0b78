"""Lines of sight of an array through its volume, and the quantities of a plan.

Everything is in the fluid, behind the wall, so that the thesis's equations of parallel cameras in
plain air hold for cameras of any direction behind any wall.
"""

from dataclasses import dataclass

import numpy as np

from sabench.geometry.common_view import lattice_of, pixel_size_mm, seen_by, seen_by_all
from sabench.geometry.refraction import trace_to_points
from sabench.scenes import Rig, Scene
from sabench.utils.arrays import F64


@dataclass(frozen=True)
class Quantity:
    """One figure of a plan.

    Attributes
    ----------
    key : its name in tables and JSON, with the unit.
    value : None where the scene has no such figure.
    meaning : one line.
    source : equation or method that it comes from; numbers in brackets are those of Belden's
        thesis.
    """

    key: str
    value: float | None
    meaning: str
    source: str

    @property
    def text(self) -> str:
        """Value with three digits, a missing one as a dash."""
        if self.value is None:
            return "-"
        return f"{self.value:,.0f}" if 1e3 <= abs(self.value) < 1e7 else f"{self.value:.3g}"


@dataclass(frozen=True)
class Advice:
    """Warning of a plan.

    Attributes
    ----------
    key : key of the scene, or option of the command, to change.
    sentence : what is wrong and how to change it.
    """

    key: str
    sentence: str


@dataclass(frozen=True)
class Section:
    """Figures of one subject with their warnings."""

    title: str
    quantities: tuple[Quantity, ...]
    advice: tuple[Advice, ...] = ()

    def value(self, key: str) -> float | None:
        """Return the value of a quantity.

        Raises
        ------
        KeyError
            No quantity of this key.
        """
        return {quantity.key: quantity.value for quantity in self.quantities}[key]


_STEPS = 4001  # along the volume's middle line
_REACH = 4.0  # searched depth on either side, in volume depths or image widths


@dataclass(frozen=True)
class Viewing:
    """Volume as the cameras of a rig see it.

    Attributes
    ----------
    center_mm : (3,) middle of the volume.
    axis : number of the volume's edge that runs along the lines of sight: 0, 1 or 2.
    sign : 1 if the cameras look along it, -1 if against it.
    depth_mm : length of that edge.
    directions : (camera, 3) unit vectors of light paths at the middle, away from the cameras; NaN
        for cameras without one.
    """

    rig: Rig
    center_mm: F64
    axis: int
    sign: float
    depth_mm: float
    directions: F64

    @property
    def forward(self) -> F64:
        """Unit vector (3,) of the edge along the lines of sight, away from the cameras."""
        return np.asarray(self.sign * np.eye(3)[self.axis])

    def at(self, share: float) -> F64:
        """Give a point (3,) of the middle line: 0 on the front face, 1 on the back face."""
        return self.center_mm + (share - 0.5) * self.depth_mm * self.forward

    def pixel_mm(self, share: float) -> float:
        """Compute the width of the innermost camera's pixel on the middle line; see `at`."""
        return pixel_size_mm([self.rig.cameras[self.inner]], self.at(share))

    @property
    def pixels_mm(self) -> F64:
        """Widths (camera,) of all cameras' pixels at the middle."""
        return np.array([pixel_size_mm([camera], self.center_mm) for camera in self.rig.cameras])

    @property
    def inner(self) -> int:
        """Number of the camera nearest to the middle of the array."""
        centers = np.array([camera.center_mm for camera in self.rig.cameras])
        return int(np.argmin(np.linalg.norm(centers - centers.mean(axis=0), axis=1)))

    def face(self, share: float, size_mm: F64) -> F64:
        """Make 5 x 5 points (25, 3) of a section of the volume; see `at`."""
        steps = np.linspace(-0.5, 0.5, 5)
        across = [edge for edge in range(3) if edge != self.axis]
        points = np.tile(self.at(share), (25, 1))
        first, second = np.meshgrid(steps, steps)
        points[:, across[0]] += first.ravel() * size_mm[across[0]]
        points[:, across[1]] += second.ravel() * size_mm[across[1]]
        return points

    @property
    def partings(self) -> F64:
        """Distances (camera, camera) of lines of sight per unit of depth.

        2 tan(angle / 2): cameras all around a tank have them, too.
        """
        cosine = np.clip(np.abs(self.directions @ self.directions.T), 0.0, 1.0)
        return np.asarray(2.0 * np.sqrt((1.0 - cosine) / (1.0 + cosine)))

    @property
    def inner_pair(self) -> tuple[int, int] | None:
        """Innermost camera and its nearest neighbour; None for one camera."""
        centers, inner = np.array([camera.center_mm for camera in self.rig.cameras]), self.inner
        if len(centers) < 2:
            return None
        distance = np.linalg.norm(centers - centers[inner], axis=1)
        distance[inner] = np.inf
        return inner, int(np.argmin(distance))

    @property
    def plane_spacing_ratio(self) -> float | None:
        """Ratio dZ / dX of the innermost pair, from its lines of sight.

        A step dZ moves the lines apart by the difference of slopes times dZ, which is a pixel's
        width dX for the next focal plane: (s_o + Z) / (D s_o) for parallel cameras in plain air,
        equation 2.11.
        """
        if (pair := self.inner_pair) is None:
            return None
        inner = self.directions[list(pair)]
        with np.errstate(divide="ignore", invalid="ignore"):  # a line of sight along the planes
            first, second = inner / (inner @ self.forward)[:, None]
            return _inverse(float(np.linalg.norm(first - second)))

    @property
    def elongation(self) -> float | None:
        """Length over width of a particle that all cameras reconstruct.

        The inverse of the largest parting of two cameras.
        """
        return _inverse(float(np.nanmax(self.partings)))

    @property
    def shares_seen(self) -> F64:
        """Share of the volume (camera,) on each camera's image."""
        points = lattice_of(self.rig.grid)
        return np.array([seen_by(camera, points).mean() for camera in self.rig.cameras])

    @property
    def share_common(self) -> float:
        """Share of the volume that all cameras see."""
        return float(seen_by_all(self.rig.cameras, lattice_of(self.rig.grid)).mean())

    @property
    def share_scored(self) -> float:
        """Share of the scored part of the volume that all cameras see."""
        grid, points = self.rig.grid, lattice_of(self.rig.grid, 33)
        points = points[grid.in_scored(grid.to_voxels(points))]
        return float(seen_by_all(self.rig.cameras, points).mean())

    @property
    def common_depth_mm(self) -> float:
        """Length of the middle line that all cameras see, about the volume's middle."""
        camera = self.rig.cameras[0]
        width = self.pixel_mm(0.5) * max(camera.rows, camera.columns)
        steps = np.linspace(-1.0, 1.0, _STEPS) * _REACH * max(self.depth_mm, width)
        visible = seen_by_all(self.rig.cameras, self.center_mm + steps[:, None] * self.forward)
        middle = _STEPS // 2
        if not visible[middle]:
            return 0.0
        unseen = np.flatnonzero(~visible)
        before, after = unseen[unseen < middle], unseen[unseen > middle]
        first = before[-1] + 1 if len(before) else 0
        last = after[0] - 1 if len(after) else _STEPS - 1
        return float(steps[last] - steps[first])


def compute_viewing(scene: Scene, rig: Rig) -> Viewing:
    """Find the lines of sight at a volume's middle, and the edge along them."""
    center = np.asarray(scene.volume.center_mm)
    paths = [
        trace_to_points(camera.wall, np.asarray(camera.center_mm), center[None])
        for camera in rig.cameras
    ]
    directions = np.concatenate([path.arriving for path in paths])
    directions[~np.concatenate([path.valid for path in paths])] = np.nan
    axis = int(np.argmax(np.nanmean(np.abs(directions), axis=0)))
    sign = -1.0 if np.nanmean(directions[:, axis]) < 0.0 else 1.0
    return Viewing(rig, center, axis, sign, scene.volume.size_mm[axis], directions)


def _inverse(value: float) -> float | None:
    """Give 1 / value, None for parallel lines of sight."""
    return 1.0 / value if np.isfinite(value) and value > 1e-12 else None
