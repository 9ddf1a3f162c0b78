"""Small recordings: images of a generated data set in files as recorders write them."""

from pathlib import Path
from typing import Any

import numpy as np

from sabench.dataset.import_recording import ImportOptions, import_recording
from sabench.dataset.reader import Dataset
from sabench.scenes import Scene, find, parse_scene
from sabench.utils.arrays import U16


def make_scene_in_motion(frames: int = 4, **changes: Any) -> Scene:
    """Eighty particles in air, before four cameras of 96 x 112 pixels."""
    import tomllib

    values = tomllib.loads(find("particle-tracking-air", "scenes").read_text(encoding="utf-8"))
    values["volume"]["size_mm"] = [6.0, 5.0, 3.0]
    values["cameras"] |= {"rows": 96, "columns": 112}
    values["particles"] |= {"per_pixel": 0.01}
    values["grid"]["crop_mm"] = [0.4, 0.4, 0.0]
    values |= {"frames": frames}
    for table, update in changes.items():
        values[table] = values[table] | update
    return parse_scene(values, "small")


def stack_of(data: Dataset, camera: int) -> U16:
    return np.stack([data.raw_image(camera, frame) for frame in range(data.setup.frames)])


def write_pngs(data: Dataset, folder: Path) -> Path:
    import cv2

    for number, camera in enumerate(data.setup.cameras):
        (folder / camera.name).mkdir(parents=True)
        for frame, image in enumerate(stack_of(data, number)):
            cv2.imwrite(str(folder / camera.name / f"img_{frame}.png"), image)
    return folder


def write_stacks(data: Dataset, folder: Path, **options: Any) -> Path:
    import tifffile

    folder.mkdir()
    for number, camera in enumerate(data.setup.cameras):
        values = stack_of(data, number)
        tifffile.imwrite(folder / f"{camera.name}.tif", values, photometric="minisblack", **options)
    return folder


def exact_options(data: Dataset, **changes: Any) -> ImportOptions:
    """Give the facts that the original's scene states, so that both are solved alike."""
    setup = data.setup
    known: dict[str, Any] = {
        "black_dn": setup.sensor.black_dn,
        "white_dn": setup.sensor.white_dn,
        "interval_s": setup.time_s(1) - setup.time_s(0),
    }
    return ImportOptions(**(known | changes))


def import_exactly(data: Dataset, images: Path, out: Path, **changes: Any) -> None:
    """Import images of a data set with its own cameras, grid, levels and times."""
    options = exact_options(data, **changes)
    import_recording(images, data.setup.cameras, out, options, data.setup.grid)
