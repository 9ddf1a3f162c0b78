"""Child process of OpenPTV: python -m sabench.interop.openptv_process FOLDER.

`openptv.write_project` makes the folder.

The steps are those of its graphical program, pyptv: particle images, correspondences, positions,
then tracking out of the files of these.
"""

import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from sabench.utils.files import read_json

_SIMILAR = 0.01  # least ratio of sizes and brightnesses of a particle's images: overlaps must pass
_LEAST = 3  # cameras that must see a particle, of three or more


def parameters(folder: Path, project: dict[str, Any]) -> tuple[list[Any], Any, Any]:
    """Make OpenPTV's cameras, and its parameters of control and of the volume."""
    from optv.calibration import Calibration
    from optv.parameters import ControlParams, VolumeParams

    media, size = project["media"], project["pixel_mm"]
    control = ControlParams(
        project["cameras"],
        flags=[],
        image_size=project["image_size"],
        pixel_size=(size, size),
        cam_side_n=media["n1"],
        wall_ns=media["n2"],
        wall_thicks=media["d"],
        object_side_n=media["n3"],
    )
    volume = VolumeParams(
        x_span=np.array(project["x_mm"]),
        z_spans=np.array([project["z_mm"], project["z_mm"]]),
        pixels_tot=_SIMILAR,
        pixels_x=_SIMILAR,
        pixels_y=_SIMILAR,
        ref_gray=_SIMILAR,
        epipolar_band=project["tolerance_px"] * size,
        min_correlation=0.0,
    )
    cameras = []
    for number in range(project["cameras"]):
        camera = Calibration()
        camera.from_file(f"{folder}/cam{number}.ori", f"{folder}/cam{number}.addpar")
        cameras.append(camera)
    return cameras, control, volume


def main(folder: Path) -> None:
    """Detect, match and track particles."""
    os.chdir(folder)
    project = read_json(folder / "project.json")
    cameras, control, volume = parameters(folder, project)
    for number in range(project["cameras"]):
        control.set_img_base_name(number, f"img/cam{number}.")
    (folder / "img").mkdir(exist_ok=True)
    (folder / "res").mkdir(exist_ok=True)
    counts = [
        _frame(folder, frame, project, cameras, control, volume)
        for frame in range(project["frames"])
    ]
    links = (
        _track(folder, project, cameras, control, volume)
        if project["frames"] > 1 and min(counts)
        else []
    )
    (folder / "links.json").write_text(json.dumps(links), encoding="utf-8")


def _frame(
    folder: Path, frame: int, project: dict[str, Any], cameras: list[Any], control: Any, volume: Any
) -> int:
    """Detect, match and locate the particles of a frame.

    Writes the files that tracking reads. Returns the number of particles.
    """
    from optv.correspondences import MatchedCoords, correspondences
    from optv.orientation import point_positions
    from optv.parameters import TargetParams
    from optv.segmentation import target_recognition

    images = tifffile.imread(folder / f"frame_{frame:05d}.tif").reshape(
        project["cameras"], *project["image_size"][::-1]
    )
    chosen = TargetParams(
        discont=project["discontinuity"],
        gvthresh=[project["threshold"]] * 4,
        pixel_count_bounds=(2, 400),
        xsize_bounds=(1, 40),
        ysize_bounds=(1, 40),
        min_sum_grey=project["threshold"],
        cross_size=2,
    )
    targets, flat = [], []
    for number, image in enumerate(images):
        blobs = target_recognition(np.ascontiguousarray(image), chosen, number, control)
        blobs.sort_y()
        targets.append(blobs)
        flat.append(MatchedCoords(blobs, control, cameras[number]))
    pixels, rows, _ = correspondences(targets, flat, cameras, volume, control)
    row = (
        np.concatenate([part.reshape(len(cameras), -1) for part in rows], axis=1).astype(int)
        if len(pixels)
        else np.zeros((len(cameras), 0), int)
    )
    row = row[:, (row >= 0).sum(axis=0) >= min(_LEAST, len(cameras))]
    positions = np.zeros((0, 3))
    if row.shape[1]:
        matched = np.array([points.get_by_pnrs(ids) for points, ids in zip(flat, row, strict=True)])
        positions, _ = point_positions(
            np.ascontiguousarray(matched.transpose(1, 0, 2)), control, cameras, volume
        )
    for number, blobs in enumerate(targets):
        blobs.write(f"img/cam{number}.".encode(), frame + 1)
    _write_positions(folder, frame, positions, row)
    print(f"sabench frame {frame}", flush=True)
    return len(positions)


def _write_positions(folder: Path, frame: int, positions: Any, row: Any) -> None:
    text = json.dumps(positions.tolist())
    (folder / f"found_{frame:05d}.json").write_text(text, encoding="utf-8")
    four = np.full((4, len(positions)), -1)
    four[: len(row)] = row
    both = enumerate(zip(positions, four.T, strict=True), 1)
    lines = [
        f"{n:4d} {x:9.3f} {y:9.3f} {z:9.3f} {a:4d} {b:4d} {c:4d} {d:4d}"
        for n, ((x, y, z), (a, b, c, d)) in both
    ]
    (folder / "res" / f"rt_is.{frame + 1}").write_text(
        "\n".join([str(len(positions)), *lines]) + "\n", encoding="utf-8"
    )


def _track(
    folder: Path, project: dict[str, Any], cameras: list[Any], control: Any, volume: Any
) -> list[list[int]]:
    """Track particles; returns the row that each had in the frame before."""
    from optv.parameters import SequenceParams, TrackingParams
    from optv.tracker import Tracker

    most = project["move_mm"]
    limits = np.array([[-most, most]] * 3)
    chosen = TrackingParams(
        accel_lim=project["change_mm"],
        angle_lim=project["angle_gon"],
        velocity_lims=limits,
        add_particle=0,
    )
    frames = SequenceParams(
        image_base=[f"img/cam{number}." for number in range(project["cameras"])],
        frame_range=(1, project["frames"]),
    )
    names = {"corres": "res/rt_is", "linkage": "res/ptv_is", "prio": "res/added"}
    Tracker(control, volume, chosen, frames, cameras, names).full_forward()
    return [_before(folder / "res" / f"ptv_is.{frame + 1}") for frame in range(project["frames"])]


def _before(path: Path) -> list[int]:
    if not path.is_file():
        return []
    return [int(line.split()[0]) for line in path.read_text(encoding="utf-8").splitlines()[1:]]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
