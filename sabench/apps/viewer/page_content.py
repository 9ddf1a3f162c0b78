"""Content of a page as JSON, and its arrays, joined and compressed into text."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.apps.viewer.contents import Contents, Frame
from sabench.apps.viewer.pictures import (
    Stack,
    camera_pictures,
    has_images,
    is_bright,
    refocused_stack,
    volume_stack,
)
from sabench.apps.viewer.points import KINDS, Cloud, link_to_earlier, shown_share, thin
from sabench.apps.viewer.surroundings import Surroundings, rounded
from sabench.dataset.reader import Dataset
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.volume_polynomials import fit_volume_polynomials
from sabench.utils.arrays import F64, Bool

_ALIGNMENT = 8  # bytes: where arrays may begin
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
            self.index.append([kind, self._size, data.size])
            padded = content + bytes(-len(content) % _ALIGNMENT)
            self._parts.append(padded)
            self._size += len(padded)
        return self._known[key]

    def text(self) -> str:
        """Compress everything by deflate, and write it in base 64."""
        return base64.b64encode(zlib.compress(b"".join(self._parts), 9)).decode()


_FAR = 1.5  # of the volume's size, from its middle: what is farther away is left out
_BEYOND = 0.05  # of the volume's size, on either side: how far projections hold
_LEVELS, _STEPS = 65_535, 32_767  # of positions, and of velocities
_USUAL = 95.0  # percentile of speeds that has the brightest colour
_PICTURES_BYTES = 5_000_000


def content_of(contents: Contents) -> tuple[dict[str, Any], str, list[str]]:
    """Describe contents for the page.

    Returns the values, the arrays as text, and sentences on what is left out.
    """
    near, notes = _leave_out_far(contents)
    particles = [one.particles for one in near]
    share = shown_share(particles)
    if share < 1.0:
        count = sum(len(one) for one in particles)
        notes.append(
            f"Particles are thinned: about {share * count:.0f} of {count} are drawn, "
            f"{100.0 * share:.3g} % of each kind; counts are of all."
        )
    packer = Packer()
    values = {
        "title": contents.title,
        "facts": contents.facts,
        "kinds": KINDS,
        "labels": contents.labels,
        "rig": contents.surroundings.describe(),
        "share": share,
        **_frames(near, thin(particles, share), packer),
        "totals": contents.totals(),
        "sort": contents.sort,
        "vectors": contents.sort == "Vectors",
        "backlit": contents.data is not None and is_bright(contents.data),
        **_seen(contents, notes),
        "arrays": packer.index,
        "notes": [*contents.notes, *notes],
    }
    return values, packer.text(), [*contents.notes, *notes]


def _leave_out_far(contents: Contents) -> tuple[list[Frame], list[str]]:
    """Drop particles far outside the volume, and say how many."""
    around = contents.surroundings
    size = around.high_mm - around.low_mm
    frames, dropped = [], 0
    for one in contents.frames:
        off = np.abs(one.particles.position_mm - around.center_mm)
        inside: Bool = np.asarray((off <= _FAR * size).all(axis=1))
        dropped += int((~inside).sum())
        own = one.particles.select(inside)
        frames.append(Frame(one.number, one.time_s, own, one.bubbles, one.solids))
    text = f"{dropped} particles farther outside the volume than its size are left out."
    return frames, [text] if dropped else []


def _frames(frames: Sequence[Frame], shown: Sequence[Cloud], packer: Packer) -> dict[str, Any]:
    if not frames:
        return {"frames": []}
    every = [*shown, *(one.bubbles for one in frames)]
    low, size = _box([one.position_mm for one in shown])
    speeds = np.concatenate([np.linalg.norm(one.velocity_mm_s, axis=1) for one in every])
    speeds = speeds[np.isfinite(speeds)]
    fastest = max(float(speeds.max(initial=0.0)), 1e-9)
    usual = float(np.percentile(speeds, _USUAL)) if len(speeds) else 0.0
    described = []
    for number, (frame, own) in enumerate(zip(frames, shown, strict=True)):
        earlier = number - 1 if number else None
        described.append(
            {
                "number": frame.number,
                "time": frame.time_s,
                "particles": _particles(
                    own, None if earlier is None else shown[earlier], low, size, fastest, packer
                ),
                "bubbles": _bubbles(frame.bubbles, fastest, packer),
                "solids": [
                    {
                        "vertices": packer.add(one.vertices_mm.astype(np.float32)),
                        "faces": packer.add(one.faces.astype(np.uint32)),
                    }
                    for one in frame.solids
                ],
            }
        )
    return {
        "linked": any((one.trajectory >= 0).any() for one in shown) and len(frames) > 1,
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
    cloud: Cloud, earlier: Cloud | None, low: F64, size: F64, fastest: float, packer: Packer
) -> dict[str, Any]:
    levels = np.rint((cloud.position_mm - low) / size * _LEVELS)
    return {
        "count": len(cloud),
        "position": packer.add(levels.astype(np.uint16)),
        "kind": packer.add(cloud.kind),
        "before": packer.add(link_to_earlier(cloud, earlier).astype(np.int32)),
        "velocity": packer.add(_short_velocities(cloud, fastest)),
    }


def _bubbles(cloud: Cloud, fastest: float, packer: Packer) -> dict[str, Any]:
    shapes = np.zeros((0, 3, 3)) if cloud.shape_mm is None else cloud.shape_mm
    return {
        "count": len(cloud),
        "position": packer.add(cloud.position_mm.astype(np.float32)),
        "kind": packer.add(cloud.kind),
        "shape": packer.add(shapes.astype(np.float32)),
        "velocity": packer.add(_short_velocities(cloud, fastest)),
    }


def _short_velocities(cloud: Cloud, fastest: float) -> Any:
    """Scale velocities to 16 bits; unknown ones have the lowest number."""
    steps = np.rint(cloud.velocity_mm_s / fastest * _STEPS)
    return np.where(np.isfinite(steps), steps, -_STEPS - 1).astype(np.int16)


def _seen(contents: Contents, notes: list[str]) -> dict[str, Any]:
    """Describe the cameras' images, projections into them and stacks of planes."""
    maps = projections(contents.surroundings)
    data = contents.data
    if data is None or not has_images(data):
        return {"maps": maps, "pictures": {}, "stacks": []}
    frames = [one.number for one in contents.frames]
    pictures, complete = camera_pictures(data, frames, _PICTURES_BYTES)
    if not complete:
        notes.append(f"Images of the first {len(pictures)} frames are shown.")
    described = [one.describe() for one in _stacks(contents, data, notes)]
    return {"maps": maps, "pictures": pictures, "stacks": described}


def _stacks(contents: Contents, data: Dataset, notes: list[str]) -> list[Stack]:
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
    """Replace each camera by polynomials in a box around the volume.

    None for a camera without a light path to all of it.
    """
    beyond = _BEYOND * (around.high_mm - around.low_mm)
    made = []
    for camera in around.cameras:
        own = _projection(camera, around.low_mm - beyond, around.high_mm + beyond)
        made.append(own or _projection(camera, around.low_mm, around.high_mm))
    return made


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
