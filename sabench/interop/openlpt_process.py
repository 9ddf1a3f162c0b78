"""Child process of OpenLPT: python -m sabench.interop.openlpt_process FOLDER.

`openlpt.write_project` makes the folder.
"""

import sys
from pathlib import Path
from typing import Any

from sabench.interop.openlpt import LEAST_FRAMES


def main(folder: Path) -> None:
    """Track particles, or only reconstruct them where there are too few frames."""
    import pyopenlpt as lpt

    settings = lpt.BasicSetting()
    settings.readConfig(str(folder / "config.txt"))
    if settings._frame_end + 1 >= LEAST_FRAMES:
        lpt.run(str(folder / "config.txt"))
    else:
        _reconstruct(lpt, folder, settings)


def _reconstruct(lpt: Any, folder: Path, settings: Any) -> None:
    config = lpt.TracerConfig()
    lines, row = config.readCommonConfig(str(folder / "tracer.txt"), settings)
    config._min_obj_int, config._radius_obj = int(lines[row]), float(lines[row + 1])
    cameras = [
        lpt.loadCameraModel(str(folder / f"cam{number}.txt")) for number in range(settings._n_cam)
    ]
    config._otf.loadParam(settings._n_cam, 2, 2, 2, settings._axis_limit, cameras)
    readers = [lpt.ImageIO("", path) for path in settings._image_file_paths]
    sequences = [
        [reader.loadImg(frame) for frame in range(settings._frame_end + 1)] for reader in readers
    ]
    for camera, images in enumerate(sequences):
        config._otf.estimateUniformOTFFromImage(camera, config, images)
    for frame in range(settings._frame_end + 1):
        objects = lpt.IPR(cameras).runIPR(config, [images[frame] for images in sequences])
        rows = [" ".join(repr(value[0]) for value in obj._pt_center.to_list()) for obj in objects]
        (folder / f"found_{frame:05d}.txt").write_text("\n".join(rows) + "\n", encoding="utf-8")
        print(f"Total time for frame {frame}", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
