#!/usr/bin/env python3
"""Multiplicative synthetic aperture refocusing through a plane wall.

An external program that solves a data set without sabench: synthetic_aperture.py DATASET RESULT
[k=3]. It needs numpy, h5py and tifffile. See docs/developing/participate.md for the contract.
"""

import json
import sys
from pathlib import Path

import h5py
import numpy as np
import tifffile


def leaving(wall, pinhole, points):
    """Compute the directions (n, 3) in which light paths leave the pinhole.

    They lead to points (n, 3) by Snell's law through all layers; Newton's iteration.
    """
    if wall is None:
        return points - pinhole
    if "normal" not in wall:
        raise SystemExit("it needs one plane wall in front of all cameras")
    normal, outer, layers = np.array(wall["normal"]), np.array(wall["point_mm"]), wall["layers"]
    n = np.array([wall["air_index"], *(layer["index"] for layer in layers), wall["fluid_index"]])
    solid = [layer["thickness_mm"] for layer in layers]
    depths = [(outer - pinhole) @ normal, *solid, (points - outer) @ normal - sum(solid)]
    lateral = (points - pinhole) - ((points - pinhole) @ normal)[:, None] * normal
    radius, ratios = np.linalg.norm(lateral, axis=1), n / n.min()
    t = radius / sum(d / r for d, r in zip(depths, ratios, strict=True))
    for _ in range(8):  # t is the tangent of the path in the rarest medium
        roots = [np.sqrt(r**2 + (r**2 - 1) * t**2) for r in ratios]
        reach = sum(d * t / s for d, s in zip(depths, roots, strict=True))
        t = t + (radius - reach) / sum(
            d * r**2 / s**3 for d, r, s in zip(depths, ratios, roots, strict=True)
        )
    tangent = t / np.sqrt(ratios[0] ** 2 + (ratios[0] ** 2 - 1) * t**2)
    return normal + (tangent / np.maximum(radius, 1e-300))[:, None] * lateral


def project(camera, wall, points):
    """Project points (n, 3), mm, to pixels (column, row)."""
    local = leaving(wall, np.array(camera["center_mm"]), points) @ np.array(camera["rotation"]).T
    (x, y), d = local[:, :2].T / local[:, 2], camera["distortion"]
    s = x**2 + y**2
    radial = 1 + s * (d["k1"] + s * (d["k2"] + s * d["k3"]))
    u = x * radial + 2 * d["p1"] * x * y + d["p2"] * (s + 2 * x**2)
    v = y * radial + d["p1"] * (s + 2 * y**2) + 2 * d["p2"] * x * y
    u, v = tilt(u, v, *np.deg2rad(camera.get("tilt_deg", [0.0, 0.0])))
    return (
        axis * camera["principal_distance_mm"] / camera["pixel_mm"] + p
        for axis, p in zip((u, v), camera["principal_point_px"], strict=True)
    )


def tilt(u, v, a, b):
    """Take light to a sensor that is turned by a about X, then by b about its own Y axis."""
    cos, sin = np.cos, np.sin
    depth = (u * sin(b) - v * sin(a) * cos(b)) / (cos(a) * cos(b)) + 1
    right = (u * cos(b) + v * sin(a) * sin(b) - cos(a) * sin(b)) / depth + cos(a) * sin(b)
    return right, (v * cos(a) + sin(a)) / depth - sin(a)


def sample(image, column, row):
    """Interpolate bilinearly; 0 outside the image."""
    inside = (column >= 0) & (row >= 0) & (column < image.shape[1] - 1) & (row < image.shape[0] - 1)
    c, r = np.where(inside, column, 0), np.where(inside, row, 0)
    i, j = r.astype(int), c.astype(int)
    a, b = r - i, c - j
    value = (1 - a) * ((1 - b) * image[i, j] + b * image[i, j + 1]) + a * (
        (1 - b) * image[i + 1, j] + b * image[i + 1, j + 1]
    )
    return np.where(inside, value, 0.0)


def refocus(rig, images, k):
    """Refocus: the product of all cameras to the power 3 / N, thresholded.

    The threshold of each plane is k standard deviations above its mean. Returns (z, y, x).
    """
    grid = rig["grid"]
    x, y, z = (
        low + step * np.arange(n)
        for low, step, n in zip(grid["low_mm"], grid["voxel_mm"], grid["shape"][::-1], strict=True)
    )
    volume = np.empty(grid["shape"], np.float32)
    for number, depth in enumerate(z):
        points = np.stack(
            [*(axis.ravel() for axis in np.meshgrid(x, y)), np.full(len(x) * len(y), depth)], axis=1
        )
        plane = np.ones(len(points))
        for camera, image in zip(rig["cameras"], images, strict=True):
            plane *= np.maximum(sample(image, *project(camera, rig["wall"], points)), 0.01)
        plane **= min(1.0, 3.0 / len(images))
        threshold = plane.mean() + k * plane.std()
        volume[number] = np.maximum(plane - threshold, 0.0).reshape(len(y), len(x))
    return volume


def normalised(path, black):
    """Normalise grey values by a bright particle's, after subtracting black.

    That is the 95th percentile of the pixels that exceed a tenth of the brightest.
    """
    image = np.maximum(tifffile.imread(path).astype(np.float64) - black, 0.0)
    bright = np.sort(image[image > 0.1 * image.max()])
    return image / max(bright[int(0.95 * (len(bright) - 1))], 1.0) if len(bright) else image


def main(dataset, result, *parameters):
    """Solve every frame of a data set; write one result file."""
    root, k = Path(dataset), float(dict(pair.split("=") for pair in parameters).get("k", 3.0))
    rig = json.loads((root / "cameras.json").read_text(encoding="utf-8"))
    if rig.get("preprocessing"):
        sys.exit("preprocessing: this program takes raw images only")
    with h5py.File(result, "w") as file:
        content = json.loads((root / "manifest.json").read_text(encoding="utf-8"))["content_hash"]
        file.attrs.update(
            {
                "format": "sabench-result",
                "version": 2,
                "dataset": content,
                "solver": "python example",
            }
        )
        for frame in range(rig["frames"]):
            paths = [
                root / f"images/frame_{frame:04d}/{camera['name']}.tif" for camera in rig["cameras"]
            ]
            volume = refocus(
                rig, [normalised(path, rig["sensor"]["black_dn"]) for path in paths], k
            )
            file.create_dataset(
                f"frames/{frame:04d}/volume", data=volume, compression="gzip", compression_opts=1
            )


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit("expected DATASET RESULT [k=3]: a folder that sabench made, and a file to write")
    main(*sys.argv[1:])
