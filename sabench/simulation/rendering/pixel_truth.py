"""True visibility of bubbles and bodies, along refracted lines of sight.

Lines of sight are the camera's own (`Camera.back_project`), bubbles are met by their equation and
bodies by Mitsuba's search for triangles. No images come from the renderer, which gives depths and
masks of straight rays.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sabench.api.truth import BODY, NOTHING, Bubbles, Sight, Solid
from sabench.geometry.camera import Camera
from sabench.geometry.refraction import length_to_fluid
from sabench.utils import backend
from sabench.utils.arrays import F32, F64, I32, I64, Bool
from sabench.utils.compiled import numba
from sabench.utils.threads import on_cores

# lines of sight across a pixel, for shares of bubbles; odd, so that one is the pixel's own
_FINER = 5
_AROUND, _STEPS = 48, 8  # points of a contour, and steps of the secant method to each


def see(camera: Camera, bubbles: Bubbles, bodies: Sequence[Solid] = ()) -> Sight:
    """Compute what each pixel of one camera sees, without the lens's blur."""
    # starts and unit directions (rows, columns, 3) of lines of sight in the fluid, and the path
    # lengths (rows, columns) before it
    row, column = np.indices((camera.rows, camera.columns), dtype=np.float64)
    pixels = np.column_stack([column.ravel(), row.ravel()])
    rays, outwards = camera.back_project(pixels), camera.directions(pixels)[0]
    before = length_to_fluid(camera.wall, np.asarray(camera.center_mm), outwards)
    starts, directions = (one.reshape(*row.shape, 3) for one in (rays.origins_mm, rays.directions))
    pixel, _ = camera.project(bubbles.center_mm) if len(bubbles) else (np.zeros((0, 2)), None)
    contour = outlines(camera, bubbles, pixel)
    shape = (camera.rows * _FINER, camera.columns * _FINER)
    near, number = np.full(shape, np.inf, dtype=np.float32), np.full(shape, NOTHING, dtype=np.int32)
    if bodies:
        _bodies(starts, directions, bodies, near, number)
    # first and last rows, then columns, of the finer lines that may meet a bubble
    boxes = np.zeros((len(contour), 4), dtype=np.int32)
    known = np.isfinite(contour).all(axis=(1, 2))
    edges = contour[known].min(axis=1), contour[known].max(axis=1)
    low, high = ((np.asarray(edge) + 0.5) * _FINER for edge in edges)
    for side, (axis, limit) in enumerate(((1, shape[0]), (0, shape[1]))):
        boxes[known, 2 * side] = np.clip(np.floor(low[:, axis]) - 2, 0, limit)
        boxes[known, 2 * side + 1] = np.clip(np.ceil(high[:, axis]) + 2, 0, limit)
    whole = np.zeros(len(bubbles), dtype=np.int64)
    _cover(starts, directions, bubbles.center_mm, bubbles.to_ball, boxes, near, number, whole)
    seen = np.bincount(number[number >= 0], minlength=len(bubbles))[: len(bubbles)]
    middle = slice(_FINER // 2, None, _FINER)
    first, distance = number[middle, middle].copy(), near[middle, middle].astype(np.float64)
    distance[first == NOTHING] = np.nan
    positions = starts + directions * distance[..., None]
    given = depth_of(camera, positions), before.reshape(row.shape) + distance, contour
    depth, path, outline = (one.astype(np.float32) for one in given)
    return Sight(first, depth, path, _shares(seen, whole, contour), pixel, outline)


def outlines(camera: Camera, bubbles: Bubbles, pixel: F64) -> F64:
    """Compute outlines (n, 48, 2) of bubbles, where lines of sight touch them.

    `pixel` (n, 2) are the images of their centres.

    From the centre's image outwards, the distance of a line of sight from the centre (in radii of
    the ball that the bubble is an image of) grows almost evenly, so that the secant method finds
    where it is one.
    """
    angles = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    count = len(bubbles)
    if not count:
        return np.zeros((0, _AROUND, 2))
    lengths = np.full((count, _AROUND), 1e-2)
    shortest = np.zeros_like(lengths)
    at_shortest = _distances(camera, bubbles, np.repeat(pixel[:, None], _AROUND, axis=1)) ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        for _ in range(_STEPS):
            pixels = pixel[:, None] + lengths[..., None] * directions
            here = _distances(camera, bubbles, pixels) ** 2
            scale = (here - at_shortest) / (lengths**2 - shortest**2)
            step = np.sqrt(np.maximum(lengths**2 + (1.0 - here) / scale, 1e-12))
            shortest, at_shortest = lengths, here
            lengths = np.where(np.abs(here - 1.0) < 1e-10, lengths, step)
            lengths = np.where(lengths == shortest, shortest * (1.0 + 1e-13), lengths)
    return np.asarray(pixel[:, None] + lengths[..., None] * directions)


def _distances(camera: Camera, bubbles: Bubbles, pixels: F64) -> F64:
    """Compute distances (n, m) of lines of sight from bubble centres, in ball radii."""
    count, around = pixels.shape[:2]
    rays = camera.back_project(np.nan_to_num(pixels.reshape(-1, 2), nan=-1e6))
    offset = rays.origins_mm.reshape(count, around, 3) - bubbles.center_mm[:, None]
    p = np.einsum("nij,nmj->nmi", bubbles.to_ball, offset)
    d = np.einsum("nij,nmj->nmi", bubbles.to_ball, rays.directions.reshape(count, around, 3))
    along = np.sum(p * d, axis=-1) / np.sum(d * d, axis=-1)
    return np.asarray(np.linalg.norm(p - along[..., None] * d, axis=-1))


def depth_of(camera: Camera, places_mm: F64) -> F64:
    """Compute depths (...) of positions (..., 3).

    Along the wall's normal from its outer face; without a wall, along the camera's axis from its
    pinhole.
    """
    if camera.wall:
        return camera.wall.depth_of(places_mm)
    return np.asarray((places_mm - np.asarray(camera.center_mm)) @ np.asarray(camera.rotation)[2])


def _shares(seen: Any, whole: Any, contour: F64) -> F64:
    """Compute visible shares (n,) of outlines.

    Of the lines that meet a bubble, those that meet it first, times the share of the bubble that is
    in the image.
    """
    x, y = contour[..., 0], contour[..., 1]
    area = (
        0.5 * np.abs(np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1))
        if len(contour)
        else np.zeros(0)
    )
    # of the curve, not of its chords
    area = area / (np.sin(2.0 * np.pi / _AROUND) / (2.0 * np.pi / _AROUND))
    with np.errstate(invalid="ignore", divide="ignore"):
        inside = np.minimum(whole / (area * _FINER**2), 1.0)
        # few lines tell the area badly
        inside = np.where(whole > 20 * _FINER, inside, np.where(whole > 0, 1.0, 0.0))
        return np.where(
            whole > 0,
            np.nan_to_num(seen / np.maximum(whole, 1) * np.where(inside > 0.98, 1.0, inside)),
            0.0,
        )


def _bodies(starts: F64, directions: F64, bodies: Sequence[Solid], near: F32, number: I32) -> None:
    search = BodySearch(bodies)
    for down in range(_FINER):
        for across in range(_FINER):
            part = slice(down, None, _FINER), slice(across, None, _FINER)
            # between the pixels by differences, as lines bend by far less than a pixel's own angle
            start, direction = (
                lines
                + (down - _FINER // 2) / _FINER * np.gradient(lines, axis=0)
                + (across - _FINER // 2) / _FINER * np.gradient(lines, axis=1)
                for lines in (starts, directions)
            )
            distance, which = search.first(start.reshape(-1, 3), direction.reshape(-1, 3))
            near[part] = distance.reshape(starts.shape[:2])
            number[part] = np.where(which < 0, NOTHING, BODY - which).reshape(starts.shape[:2])


@numba.njit(cache=True, error_model="numpy")
def _cover(
    starts: Any,
    directions: Any,
    centers: Any,
    to_ball: Any,
    boxes: Any,
    near: Any,
    number: Any,
    whole: Any,
) -> None:
    """Enter bubbles that are first along lines of sight, and count all hits."""
    rows, columns = starts.shape[:2]
    p, d = np.empty(3), np.empty(3)
    for n in range(len(centers)):
        for i in range(boxes[n, 0], boxes[n, 1]):
            v = (i + 0.5) / _FINER - 0.5
            row = min(max(int(np.floor(v)), 0), rows - 2)
            down = v - row
            for j in range(boxes[n, 2], boxes[n, 3]):
                u = (j + 0.5) / _FINER - 0.5
                column = min(max(int(np.floor(u)), 0), columns - 2)
                across = u - column
                for k in range(3):
                    p[k] = _bilinear(starts, row, column, down, across, k) - centers[n, k]
                    d[k] = _bilinear(directions, row, column, down, across, k)
                a = b = c = 0.0
                for k in range(3):
                    pk = to_ball[n, k, 0] * p[0] + to_ball[n, k, 1] * p[1] + to_ball[n, k, 2] * p[2]
                    dk = to_ball[n, k, 0] * d[0] + to_ball[n, k, 1] * d[1] + to_ball[n, k, 2] * d[2]
                    a += dk * dk
                    b += pk * dk
                    c += pk * pk
                inside = b * b - a * (c - 1.0)
                if inside >= 0.0:
                    whole[n] += 1
                    distance = (-b - np.sqrt(inside)) / a
                    if 0.0 < distance < near[i, j]:
                        near[i, j] = distance
                        number[i, j] = n


@numba.njit(cache=True, inline="always")
def _bilinear(lines: Any, row: int, column: int, down: float, across: float, k: int) -> Any:
    upper = lines[row, column, k] * (1.0 - across) + lines[row, column + 1, k] * across
    lower = lines[row + 1, column, k] * (1.0 - across) + lines[row + 1, column + 1, k] * across
    return upper * (1.0 - down) + lower * down


def meets(bubbles: Bubbles, starts_mm: F64, directions: F64) -> Bool:
    """Find which lines from points (n, 3) along unit vectors meet a bubble."""
    out = np.zeros(len(starts_mm), dtype=np.bool_)
    if len(bubbles):
        lines = np.ascontiguousarray(starts_mm), np.ascontiguousarray(directions)
        widest = bubbles.semi_axes_mm.max(axis=1)
        on_cores(_meet, len(out), *lines, bubbles.center_mm, bubbles.to_ball, widest, out)
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _meet(
    jobs: slice, starts: Any, directions: Any, centers: Any, to_ball: Any, radius: Any, out: Any
) -> None:
    for i in range(jobs.start, jobs.stop):
        for n in range(len(centers)):
            along = across = 0.0
            for k in range(3):
                along += (centers[n, k] - starts[i, k]) * directions[i, k]
            for k in range(3):
                across += (starts[i, k] + along * directions[i, k] - centers[n, k]) ** 2
            if along <= 0.0 or across >= radius[n] * radius[n]:
                continue
            a = b = c = 0.0
            for k in range(3):
                pk = dk = 0.0
                for m in range(3):
                    pk += to_ball[n, k, m] * (starts[i, m] - centers[n, m])
                    dk += to_ball[n, k, m] * directions[i, m]
                a += dk * dk
                b += pk * dk
                c += pk * pk
            if b * b >= a * (c - 1.0):
                out[i] = True
                break


_ODD = np.array([0.8017837, 0.2672612, 0.5345225])  # a direction in which few bodies have edges


def mesh_of(mi: Any, solid: Solid, origin: F64, **how: Any) -> Any:
    """Convert a body to a mesh of Mitsuba's, with further arguments of `mi.Mesh`."""
    mesh = mi.Mesh("body", len(solid.vertices_mm), len(solid.faces), **how)
    values = mi.traverse(mesh)
    values["vertex_positions"] = (solid.vertices_mm - origin).astype(np.float32).ravel()
    values["faces"] = solid.faces.astype(np.uint32).ravel()
    values.update()
    return mesh


class BodySearch:
    """Search for the first body along many lines."""

    def __init__(self, bodies: Sequence[Solid]) -> None:
        self._mi = mi = backend.mitsuba()
        # single precision: small numbers near the bodies
        middles = [solid.vertices_mm.mean(axis=0) for solid in bodies]
        self._origin = origin = np.asarray(np.mean(middles, axis=0))
        self._radius = max(
            float(np.linalg.norm(solid.vertices_mm - origin, axis=1).max()) for solid in bodies
        )
        meshes = {f"body_{n}": mesh_of(mi, solid, origin) for n, solid in enumerate(bodies)}
        self._scene = mi.load_dict({"type": "scene", **meshes})

    def first(self, starts_mm: F64, directions: F64) -> tuple[F64, I64]:
        """Find the first body along lines.

        Returns the distance (n,), inf for none, and the body's number (n,), -1 for none.
        """
        mi = self._mi
        known = np.asarray(np.isfinite(directions).all(axis=1))
        start = np.where(known[:, None], starts_mm - self._origin, 0.0)
        direction = np.where(known[:, None], directions, [0.0, 0.0, 1.0])
        ahead = np.maximum(-np.sum(start * direction, axis=1) - 1.01 * self._radius, 0.0)
        near = start + ahead[:, None] * direction
        ray = mi.Ray3f(
            mi.Point3f(near.T.astype(np.float32)), mi.Vector3f(direction.T.astype(np.float32))
        )
        met = self._scene.ray_intersect_preliminary(ray, True)
        valid = np.array(met.is_valid()) & known
        which = np.full(len(known), -1, dtype=np.int64)
        for number, shape in enumerate(self._scene.shapes()):
            which[np.array(met.shape == mi.ShapePtr(shape)) & valid] = number
        return np.where(valid, np.array(met.t, dtype=np.float64) + ahead, np.inf), which

    def contains(self, points_mm: F64) -> Bool:
        """Find which points (n, 3) lie in a body.

        A line from such a point to the outside leaves bodies more often than it enters them.
        """
        mi = self._mi
        position = mi.Point3f((points_mm - self._origin).T.astype(np.float32))
        direction = mi.Vector3f(*(float(v) for v in _ODD))
        balance = np.zeros(len(points_mm), dtype=np.int64)
        active = np.ones(len(points_mm), dtype=np.bool_)
        while active.any():
            met = self._scene.ray_intersect(mi.Ray3f(position, direction), mi.Bool(active))
            active &= np.array(met.is_valid())
            along = met.n.x * direction.x + met.n.y * direction.y + met.n.z * direction.z
            outwards = np.array(along) > 0.0
            balance += np.where(active, np.where(outwards, 1, -1), 0)
            position = mi.Point3f(met.spawn_ray(direction).o)
        return np.asarray(balance > 0)
