"""Content of a page: JSON, arrays and pictures, joined and compressed into text."""

import base64
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.algorithms.bubbles.backlit_images import transmission
from sabench.algorithms.refocus import find_edge_on, refocus_on_surface, refocus_sum
from sabench.api import Observation
from sabench.apps.viewer.contents import Frame, PageContents
from sabench.apps.viewer.points import ObjectCloud, link_to_earlier, shown_share, thin
from sabench.apps.viewer.surroundings import Surroundings, rounded
from sabench.dataset.reader import Dataset
from sabench.dataset.schema import image_name
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.geometry.volume_polynomials import fit_volume_polynomials
from sabench.plotting.kinds import DEFINITION, KINDS
from sabench.plotting.pictures import BRIGHTEST, GAMMA, grey_levels, join_blocks
from sabench.utils.arrays import F32, F64, U8, Bool, triple
from sabench.utils.progress import progress_bar

_PLANES = 40
_SLICE_PX, _LONGEST_PX = 480, 1024
_QUALITY = 80
_DARKEST = 20.0  # percentile shown as black


@dataclass(frozen=True)
class Planes:
    """Position of a stack of parallel planes.

    Attributes
    ----------
    corner_mm : (3,) outer corner of the first plane's first pixel.
    across_mm, down_mm : (3,) edges of a plane, along its columns and its rows.
    step_mm : (3,) from a plane to the next one.
    """

    corner_mm: F64
    across_mm: F64
    down_mm: F64
    step_mm: F64


@dataclass(frozen=True)
class PlaneStack:
    """Planes of the volume as pictures (plane, row, column) of grey values."""

    name: str
    place: Planes
    pictures: U8

    def describe(self) -> dict[str, Any]:
        """Describe the stack as the page's JSON holds it."""
        return {
            "name": self.name,
            "corner": rounded(self.place.corner_mm),
            "across": rounded(self.place.across_mm),
            "down": rounded(self.place.down_mm),
            "step": rounded(self.place.step_mm, 6),
            "planes": [compress(picture) for picture in self.pictures],
        }


def compress(grey: U8) -> str:
    """Compress a grey picture (row, column) to a URL that holds it."""
    import cv2

    _, data = cv2.imencode(".webp", grey, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    return "data:image/webp;base64," + base64.b64encode(data.tobytes()).decode()


def camera_pictures(
    data: Dataset, frames: Sequence[int], most_bytes: int
) -> tuple[dict[int, list[str]], bool]:
    """Compress every camera's image of the first frame, and of as many more as fit.

    Says also whether all frames did.
    """
    pictures: dict[int, list[str]] = {}
    for frame in progress_bar(frames, "images"):
        encoded = [compress(image) for image in _grey_images(data, frame)]
        most_bytes -= sum(map(len, encoded))
        if most_bytes < 0 and pictures:
            return pictures, False
        pictures[frame] = encoded
    return pictures, True


def has_images(data: Dataset) -> bool:
    """Return whether a data set has images; that of a target may have none."""
    first = image_name(data.setup.cameras[0].name, 0, "tif")
    return first in data.contents.files or data.references is not None


def is_bright(data: Dataset) -> bool:
    """Return whether images are bright, with dark objects, as before a backlight."""
    levels = data.setup.sensor
    middle = (levels.black_dn + levels.white_dn) / 2.0
    return has_images(data) and float(np.median(data.raw_image(0, 0))) > middle


def _grey_images(data: Dataset, frame: int) -> Iterator[U8]:
    """Scale a frame's images to 8 bits; dim particles are raised."""
    images = data.raw_images(frame)
    light = images.astype(np.float32) - np.float32(data.setup.sensor.black_dn)
    top = np.percentile(light, BRIGHTEST)
    block = -(-max(images.shape[1:]) // _LONGEST_PX)
    shown = grey_levels(light, float(max(top, 1.0)), 1.0 if is_bright(data) else GAMMA)
    yield from join_blocks(shown, block)


def refocused_stack(data: Dataset, frame: int) -> PlaneStack:
    """Refocus a frame on planes through the volume, at right angles to the view."""
    case, backlit = data.observation(frame), is_bright(data)
    images = transmission(case) if backlit else case.normalised_images()
    axis, sign = _viewing_axis(case)
    if axis == 2 and find_edge_on(case.cameras, case.grid) is None:
        planes, place = _by_slabs(case, images)
    else:
        planes, place = _plane_by_plane(case, images, axis, sign)
    low, high = np.percentile(planes, [1.0 if backlit else _DARKEST, BRIGHTEST])
    shown = grey_levels(planes - np.float32(low), float(high - low), 1.0 if backlit else GAMMA)
    return PlaneStack("refocused images", place, shown)


def volume_stack(volume: F32, grid: Grid) -> PlaneStack:
    """Join the planes of a reconstruction (z, y, x) to as many as a page holds."""
    thick = -(-volume.shape[0] // _PLANES)
    block = -(-max(volume.shape[1:]) // _SLICE_PX)
    padded = np.pad(volume, ((0, -len(volume) % thick), (0, 0), (0, 0)))
    joined = join_blocks(padded.reshape(-1, thick, *volume.shape[1:]).max(axis=1), block)
    low, high = grid.box_mm
    place = _place_slabs(low, high - low, thick * grid.voxel_mm[2])
    # find the value shown as white; few voxels may be bright at all
    bright = joined[joined > 0.0]
    white = float(np.percentile(bright, BRIGHTEST)) if bright.size else 1.0
    return PlaneStack("reconstruction", place, grey_levels(joined, white, GAMMA))


def _place_slabs(low: F64, size: F64, thickness: float) -> Planes:
    """Place planes of constant Z in the middles of a box's slabs."""
    across, down, _ = np.diag(size)
    step = np.array([0.0, 0.0, thickness])
    return Planes(low + step / 2.0, across, down, step)


def _viewing_axis(case: Observation) -> tuple[int, int]:
    """Find the axis of the world that the cameras look along, and the sign."""
    middles = [np.array([[camera.columns / 2.0, camera.rows / 2.0]]) for camera in case.cameras]
    rays = [camera.back_project(at) for camera, at in zip(case.cameras, middles, strict=True)]
    mean = np.nanmean([ray.directions[0] for ray in rays], axis=0)
    axis = int(np.argmax(np.abs(mean)))
    return axis, -1 if mean[axis] < 0.0 else 1


def _by_slabs(case: Observation, images: F32) -> tuple[F32, Planes]:
    """Refocus planes of constant Z, at the data set's voxels where they are small."""
    low, high = case.grid.box_mm
    size, voxel = high - low, min(case.grid.voxel_mm[:2])
    pixel = max(float(size[:2].max()) / _SLICE_PX, voxel)
    finer = max(1, int(pixel / voxel))
    columns, rows = (max(1, round(float(edge / pixel * finer))) for edge in size[:2])
    shape = min(_PLANES, case.grid.shape[0]), rows, columns
    edges = size / shape[::-1]
    grid = Grid(triple(low + edges / 2.0), triple(edges), shape)
    planes = join_blocks(refocus_sum(images, case.cameras, grid), finer)
    return planes, _place_slabs(low, size, edges[2])


def _plane_by_plane(case: Observation, images: F32, axis: int, sign: int) -> tuple[F32, Planes]:
    """Refocus planes of any orientation, coarser: each point is projected on its own."""
    low, high = case.grid.box_mm
    place = _place_planes(low, high, axis, sign)
    edges = place.down_mm, place.across_mm
    pixel = 2.0 * max(np.linalg.norm(edge) for edge in edges) / _SLICE_PX
    rows, columns = (
        (np.arange(count) + 0.5) / count
        for count in (max(2, round(float(np.linalg.norm(edge) / pixel))) for edge in edges)
    )
    first = place.corner_mm + rows[:, None, None] * edges[0] + columns[:, None] * edges[1]
    planes = [
        refocus_on_surface(images, case.cameras, first + n * place.step_mm, "additive").values
        for n in progress_bar(range(_PLANES), "planes")
    ]
    return np.nan_to_num(np.stack(planes)), place


def _place_planes(low_mm: F64, high_mm: F64, axis: int, sign: int) -> Planes:
    """Place planes across an axis of a box; their front faces the cameras."""
    size, axes = high_mm - low_mm, np.eye(3)
    ahead, down = sign * axes[axis], axes[2 if axis == 1 else 1]
    across = np.cross(down, ahead)
    edges = abs(size @ across) * across, abs(size @ down) * down
    step = ahead * size[axis] / _PLANES
    middle = (low_mm + high_mm) / 2.0 - (_PLANES - 1) / 2.0 * step
    return Planes(middle - (edges[0] + edges[1]) / 2.0, *edges, step)


_NAMES = {"u1": "Uint8", "i2": "Int16", "u2": "Uint16", "i4": "Int32", "u4": "Uint32"}
_NAMES |= {"f4": "Float32"}


class Packer:
    """Collector of arrays; equal ones are stored once."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0
        self._known: dict[bytes, int] = {}
        self.index: list[list[Any]] = []

    def add(self, array: npt.NDArray[Any]) -> int:
        """Store an array; return its place in the index."""
        data = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
        kind = _NAMES[data.dtype.str[1:]]
        content = data.tobytes()
        key = kind.encode() + content
        if key not in self._known:
            self._known[key] = len(self.index)
            padding = bytes(-self._size % data.itemsize)  # where such arrays may begin
            self.index.append([kind, self._size + len(padding), data.size])
            padded = padding + content
            self._parts.append(padded)
            self._size += len(padded)
        return self._known[key]

    def text(self) -> str:
        """Compress everything by deflate, and write it in base 64."""
        return base64.b64encode(zlib.compress(b"".join(self._parts), 9)).decode()


_FAR = 1.5  # largest drawn distance from the volume's middle, in volume sizes
_USUAL = 95.0  # percentile of speeds that has the brightest colour
_PICTURES_BYTES = 5_000_000


def encode_contents(contents: PageContents) -> tuple[dict[str, Any], str, list[str]]:
    """Describe contents for the page.

    Returns the values, the arrays as text, and sentences on what is left out.
    """
    near, notes = _leave_out_far(contents)
    particles = [frame.particles for frame in near]
    share = shown_share(particles)
    if share < 1.0:
        count = sum(len(cloud) for cloud in particles)
        notes.append(
            f"Particles are thinned: about {share * count:.0f} of {count} are drawn, "
            f"{100.0 * share:.3g} % of each kind; counts are of all."
        )
    packer = Packer()
    values = {
        "title": contents.title,
        "facts": contents.facts,
        "kinds": KINDS,
        "definition": DEFINITION if "missed" in contents.labels else "",
        "labels": contents.labels,
        "rig": contents.surroundings.describe(),
        "share": share,
        **_frames(near, thin(particles, share), packer),
        "totals": contents.totals(),
        "sort": contents.sort,
        "vectors": contents.sort == "Vectors",
        "backlit": contents.data is not None and is_bright(contents.data),
        **_describe_views(contents, notes),
        "arrays": packer.index,
        "notes": [*contents.notes, *notes],
    }
    return values, packer.text(), [*contents.notes, *notes]


def _leave_out_far(contents: PageContents) -> tuple[list[Frame], list[str]]:
    """Drop particles far outside the volume, and say how many."""
    around = contents.surroundings
    size = around.high_mm - around.low_mm
    frames, dropped = [], 0
    for frame in contents.frames:
        off = np.abs(frame.particles.position_mm - around.center_mm)
        inside: Bool = np.asarray((off <= _FAR * size).all(axis=1))
        dropped += int((~inside).sum())
        particles = frame.particles.select(inside)
        frames.append(Frame(frame.number, frame.time_s, particles, frame.bubbles, frame.solids))
    text = f"{dropped} particles farther outside the volume than its size are left out."
    return frames, [text] if dropped else []


def _frames(
    frames: Sequence[Frame], shown: Sequence[ObjectCloud], packer: Packer
) -> dict[str, Any]:
    if not frames:
        return {"frames": []}
    every = [*shown, *(frame.bubbles for frame in frames)]
    low, size = _box([cloud.position_mm for cloud in shown])
    speeds = np.concatenate([np.linalg.norm(cloud.velocity_mm_s, axis=1) for cloud in every])
    speeds = speeds[np.isfinite(speeds)]
    fastest = max(float(speeds.max(initial=0.0)), 1e-9)
    usual = float(np.percentile(speeds, _USUAL)) if len(speeds) else 0.0
    described = []
    for number, (frame, cloud) in enumerate(zip(frames, shown, strict=True)):
        earlier = number - 1 if number else None
        described.append(
            {
                "number": frame.number,
                "time": frame.time_s,
                "particles": _particles(
                    cloud, None if earlier is None else shown[earlier], low, size, fastest, packer
                ),
                "bubbles": _bubbles(frame.bubbles, fastest, packer),
                "solids": [
                    {
                        "vertices": packer.add(solid.vertices_mm.astype(np.float32)),
                        "faces": packer.add(solid.faces.astype(np.uint32)),
                    }
                    for solid in frame.solids
                ],
            }
        )
    return {
        "linked": any((cloud.trajectory >= 0).any() for cloud in shown) and len(frames) > 1,
        "box": {"low": rounded(low, 6), "size": rounded(size, 6)},
        "fastest": fastest,
        "usual": usual,
        "frames": described,
    }


def _box(positions_mm: Sequence[F64]) -> tuple[F64, F64]:
    """Find the low corner and the size of a box that holds points."""
    every = np.concatenate(positions_mm)
    if not len(every):
        return np.zeros(3), np.ones(3)
    low = every.min(axis=0)
    return low, np.maximum(every.max(axis=0) - low, 1e-9)


def _particles(
    cloud: ObjectCloud,
    earlier: ObjectCloud | None,
    low: F64,
    size: F64,
    fastest: float,
    packer: Packer,
) -> dict[str, Any]:
    levels = np.rint((cloud.position_mm - low) / size * np.iinfo(np.uint16).max)
    return {
        "count": len(cloud),
        "position": packer.add(levels.astype(np.uint16)),
        "kind": packer.add(cloud.kind),
        "before": packer.add(link_to_earlier(cloud, earlier).astype(np.int32)),
        "velocity": packer.add(_short_velocities(cloud, fastest)),
    }


def _bubbles(cloud: ObjectCloud, fastest: float, packer: Packer) -> dict[str, Any]:
    shapes = np.zeros((0, 3, 3)) if cloud.shape_mm is None else cloud.shape_mm
    return {
        "count": len(cloud),
        "position": packer.add(cloud.position_mm.astype(np.float32)),
        "kind": packer.add(cloud.kind),
        "shape": packer.add(shapes.astype(np.float32)),
        "velocity": packer.add(_short_velocities(cloud, fastest)),
    }


def _short_velocities(cloud: ObjectCloud, fastest: float) -> Any:
    """Scale velocities to 16 bits; unknown ones have the lowest number."""
    limits = np.iinfo(np.int16)
    steps = np.rint(cloud.velocity_mm_s / fastest * limits.max)
    return np.where(np.isfinite(steps), steps, limits.min).astype(np.int16)


def _describe_views(contents: PageContents, notes: list[str]) -> dict[str, Any]:
    """Describe the cameras' images, projections into them and stacks of planes."""
    maps = projections(contents.surroundings)
    data = contents.data
    if data is None or not has_images(data):
        return {"maps": maps, "pictures": {}, "stacks": []}
    frames = [frame.number for frame in contents.frames]
    pictures, complete = camera_pictures(data, frames, _PICTURES_BYTES)
    if not complete:
        notes.append(f"Images of the first {len(pictures)} frames are shown.")
    described = [stack.describe() for stack in _stacks(contents, data, notes)]
    return {"maps": maps, "pictures": pictures, "stacks": described}


def _stacks(contents: PageContents, data: Dataset, notes: list[str]) -> list[PlaneStack]:
    """Make the stacks of planes of the first frame."""
    stacks = []
    if not data.shows_target:
        try:
            stacks.append(refocused_stack(data, 0))
        except ValueError:
            notes.append("Not refocused: some of the volume has no light path to a camera.")
    if contents.volume is not None:
        stacks.append(volume_stack(contents.volume, data.setup.grid))
    return stacks


def projections(around: Surroundings) -> list[dict[str, Any] | None]:
    """Replace each camera by polynomials in the volume.

    None for a camera without a light path to all of it.
    """
    return [_projection(camera, around.low_mm, around.high_mm) for camera in around.cameras]


def _projection(camera: CameraModel, low_mm: F64, high_mm: F64) -> dict[str, Any] | None:
    try:
        maps = fit_volume_polynomials([camera], low_mm, high_mm)
    except ValueError:
        return None
    return {
        "middle": rounded(maps.middle_mm, 6),
        "half": rounded(maps.half_mm, 6),
        "powers": maps.powers.tolist(),
        "coefficients": rounded(maps.coefficients[0], 6),
    }
