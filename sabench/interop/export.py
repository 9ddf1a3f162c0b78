"""Export of data sets and results to other programs.

Formats of data (vtk and tables) take the truth or a result. Those of tracking programs take what a
program needs to solve the data set, without the truth; with a result, cameras and particles.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import tifffile

from sabench import tasks
from sabench.api import FoundParticles, Reconstruction
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import Result, open_result
from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.images.tiff_exr import write_tiff
from sabench.interop import coco, openlpt, openptv, openptv_files, vtkhdf
from sabench.interop.cameras import check_writable, read_cameras, write_into
from sabench.interop.foreign import ForeignWorld, Recording, note, of_estimates, to_8_bits
from sabench.interop.image_statistics import measure_frame
from sabench.interop.openptv_files import FIRST
from sabench.interop.tracks import TrackFormat, write_tracks
from sabench.plotting.kinds import COLOURS, rgb
from sabench.utils.errors import InputError
from sabench.utils.files import complete_or_nothing
from sabench.utils.progress import progress_bar

NAME = "state.py"
_TEMPLATE = Path(__file__).with_name("paraview_state.py.j2")


def write_state(root: Path, home: Path) -> None:
    """Write a ParaView state into an export's folder that loads the folder's files.

    `home` is the folder's final path, for a ParaView that does not give it to the state.
    """
    text = _TEMPLATE.read_text(encoding="utf-8").replace("{{ folder }}", repr(str(home)))
    text = text.replace("{{ colors }}", repr({kind: rgb(kind) for kind in COLOURS}))
    (root / NAME).write_text(text, encoding="utf-8")


Format = Literal["vtk", TrackFormat, "coco"]
ProgramFormat = Literal["openptv", "myptv", "openlpt", "lpt-challenge"]
_PROGRAMS: dict[str, ProgramFormat] = {name: name for name in get_args(ProgramFormat)}
_GREY = "grey values are scaled to 8 bits, so that the peak of a bright particle has 160"


def export(
    dataset: Dataset | str | Path,
    out: str | Path,
    result: str | Path | None = None,
    *,
    to: Format = "vtk",
    overwrite: bool = False,
) -> Path:
    """Write a data set or a result of it into a folder for another program.

    A `ForeignFormatWarning` lists what the format cannot store. Raises InputError for a missing
    data set or result, one without particles, an unknown format, cameras that the format cannot
    describe, or an existing folder.

    Parameters
    ----------
    to : vtk: one file for each frame and kind (see `vtkhdf`), of the truth or of the result, and a
        state that shows them in ParaView.
        netcdf, mat, npy, csv: one table of particles, true or found. openptv, myptv, openlpt,
        lpt-challenge: cameras and images; with a result, cameras and particles. coco: images, and
        boxes and masks of true bubbles.
    """
    if to not in get_args(Format):
        raise InputError(f"to: expected one of {', '.join(get_args(Format))}, got {to!r}")
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    if data.shows_target:
        raise InputError(
            f"{data.root}: expected a data set with particles or bubbles, "
            "got one with a calibration target"
        )
    opened = open_result(result, data) if result is not None else None
    program = _PROGRAMS.get(to)
    if program:
        check_writable(data.setup.cameras, program)
    with complete_or_nothing(Path(out), overwrite=overwrite) as root:
        root.mkdir()
        if to == "vtk":
            vtkhdf.write(root, data, opened)
            write_state(root, Path(out).absolute())
        elif to == "coco":
            if opened is not None:
                raise InputError(
                    f"{opened.path}: expected no result for coco, which has true bubbles"
                )
            coco.write(root, data)
        elif program and opened is None:
            write_into(root, data.setup.cameras, program, data.setup.grid)
            _OBSERVATIONS[program](root, data, Path(out).absolute())
        else:
            _write_particles(root, data, opened, to)
    return Path(out)


def _write_particles(
    root: Path, data: Dataset, result: Result | None, to: TrackFormat | ProgramFormat
) -> None:
    setup, world = data.setup, ForeignWorld()
    table = of_estimates(_particles(data, result))
    cameras: Sequence[CameraModel] = setup.cameras
    program = _PROGRAMS.get(to)
    if program:
        world = write_into(root, cameras, program, setup.grid)
    if program and world != ForeignWorld():
        cameras = read_cameras(root, program)  # the same cameras in its world
    recording = Recording(cameras, tuple(setup.time_s(i) for i in range(setup.frames)))
    write_tracks(root, table.into(world), to, recording)


def _particles(data: Dataset, result: Result | None) -> list[FoundParticles]:
    frames = progress_bar(range(data.setup.frames), "export")
    if result is None:
        if "particles" not in data.shows:
            raise InputError(f"{data.root}: expected a data set with particles, or a result")
        true = (data.particles(frame) for frame in frames)
        return [
            FoundParticles(
                particles.position_mm,
                trajectory=particles.id.astype(np.int64),
                velocity_mm_s=np.asarray(particles.velocity_mm_s, dtype=np.float64),
            )
            for particles in true
        ]
    task = tasks.of(result.task)
    if task.estimate not in (FoundParticles, Reconstruction):
        raise InputError(
            f"{result.path}: expected a result with particles, got one of {task.estimate.__name__}"
        )
    return [_particles_of(result, task.read(data, result, frame)) for frame in frames]


def _particles_of(result: Result, estimate: FoundParticles | Reconstruction) -> FoundParticles:
    if isinstance(estimate, FoundParticles):
        return estimate
    if estimate.particles_mm is None:
        raise InputError(f"{result.path}: expected a result with particles_mm, got a volume alone")
    return FoundParticles(estimate.particles_mm)


def _write_for_openptv(root: Path, data: Dataset, home: Path) -> None:
    note(f"openptv: {_GREY}")
    (root / "img").mkdir()
    frames = progress_bar(range(data.setup.frames), "images")
    for frame in frames:
        images = to_8_bits(data.observation(frame).normalised_images())
        for number, image in enumerate(images, 1):
            path = root / "img" / f"cam{number}.{FIRST + frame}"
            tifffile.imwrite(path, image, photometric="minisblack")
    settings = openptv.derive_settings(measure_frame(data.observation(0)))
    setup = data.setup
    span = (FIRST, FIRST + setup.frames - 1)
    cameras = tuple(camera for camera in setup.cameras if isinstance(camera, Camera))
    openptv_files.write_parameters(root, setup.grid, cameras, span, settings)


def _write_for_openlpt(root: Path, data: Dataset, home: Path) -> None:
    note(f"openlpt: {_GREY}; config.txt names files below {home}")
    setup = data.setup
    for frame in progress_bar(range(setup.frames), "images"):
        openlpt.write_frame(root, frame, data.observation(frame).normalised_images())
    settings = openlpt.derive_settings(measure_frame(data.observation(0)))
    cameras = tuple(camera for camera in setup.cameras if isinstance(camera, Camera))
    openlpt.write_project(root, cameras, setup.grid, setup.frames, settings, home)


def _write_raw_images(root: Path, data: Dataset, home: Path) -> None:
    for number, camera in enumerate(data.setup.cameras):
        (root / f"images_{camera.name}").mkdir()
        for frame in range(data.setup.frames):
            image = data.raw_image(number, frame)
            write_tiff(root / f"images_{camera.name}" / f"{frame:04d}.tif", image)


_OBSERVATIONS: dict[str, Callable[[Path, Dataset, Path], None]] = {
    "openptv": _write_for_openptv,
    "openlpt": _write_for_openlpt,
    "myptv": _write_raw_images,
    "lpt-challenge": _write_raw_images,
}
