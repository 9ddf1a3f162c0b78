"""OpenPTV's library run on a project folder as its own users do: python outside_optv.py FOLDER. It
reads the project's files only, by the library's own readers, and writes res/rt_is and ptv_is."""

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import tifffile


def main(folder: Path) -> None:
    from optv.calibration import Calibration
    from optv.parameters import (
        ControlParams,
        SequenceParams,
        TargetParams,
        TrackingParams,
        VolumeParams,
    )
    from optv.tracker import Tracker

    os.chdir(folder)
    count = int(Path("parameters/ptv.par").read_text(encoding="utf-8").split()[0])
    control, volume = ControlParams(count), VolumeParams()
    control.read_control_par("parameters/ptv.par")
    volume.read_volume_par("parameters/criteria.par")
    target, sequence, track = TargetParams(), SequenceParams(num_cams=count), TrackingParams()
    target.read("parameters/targ_rec.par")
    sequence.read_sequence_par("parameters/sequence.par", count)
    track.read_track_par("parameters/track.par")
    cameras = []
    for number in range(1, count + 1):
        camera = Calibration()
        name = f"cal/cam{number}.tif"
        camera.from_file(f"{name}.ori", f"{name}.addpar")
        cameras.append(camera)
    Path("res").mkdir(exist_ok=True)
    for frame in range(sequence.get_first(), sequence.get_last() + 1):
        _frame(frame, target, control, volume, cameras)
    names = {"corres": "res/rt_is", "linkage": "res/ptv_is", "prio": "res/added"}
    Tracker(control, volume, track, sequence, cameras, names).full_forward()


def _frame(frame: int, target: Any, control: Any, volume: Any, cameras: list[Any]) -> None:
    from optv.correspondences import MatchedCoords, correspondences
    from optv.orientation import point_positions
    from optv.segmentation import target_recognition

    targets, flat = [], []
    for number, camera in enumerate(cameras):
        image = tifffile.imread(f"img/cam{number + 1}.{frame}")
        own = target_recognition(np.ascontiguousarray(image), target, number, control)
        own.sort_y()
        targets.append(own)
        flat.append(MatchedCoords(own, control, camera))
    _, rows, _ = correspondences(targets, flat, cameras, volume, control)
    row = np.concatenate([part.reshape(len(cameras), -1) for part in rows], axis=1).astype(int)
    row = row[:, (row >= 0).sum(axis=0) >= min(3, len(cameras))]
    seen = np.array([one.get_by_pnrs(own) for one, own in zip(flat, row, strict=True)])
    stacked = np.ascontiguousarray(seen.transpose(1, 0, 2))
    positions, _ = point_positions(stacked, control, cameras, volume)
    for number, own in enumerate(targets):
        own.write(f"img/cam{number + 1}.".encode(), frame)
    four = np.full((4, len(positions)), -1)
    four[: len(row)] = row
    lines = [
        f"{n:4d} {x:9.3f} {y:9.3f} {z:9.3f} " + " ".join(map(str, own))
        for n, ((x, y, z), own) in enumerate(zip(positions, four.T, strict=True), 1)
    ]
    text = "\n".join([str(len(lines)), *lines]) + "\n"
    Path(f"res/rt_is.{frame}").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
