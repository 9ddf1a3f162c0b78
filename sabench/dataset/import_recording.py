"""Import of recordings: images and cameras become a data set without truth."""

import dataclasses
import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sabench.dataset.cameras import MOST_DN, read_cameras
from sabench.dataset.recorded import RecordedWriter, ReferenceList, extended, recorded_writer
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.common_view import grid_of_box, pixel_size_mm, propose_box, share_in_view
from sabench.geometry.grid import Grid
from sabench.images.image_files import Files, find_image_files
from sabench.images.image_reading import RawLayout, read_images
from sabench.images.levels import GreyLevels, GreyValues
from sabench.images.preprocessing import Step, step_faults
from sabench.plotting.card import Card
from sabench.utils.arrays import U16, Bool
from sabench.utils.errors import InputError
from sabench.utils.progress import progress_bar

_CameraFiles = tuple[CameraModel, tuple[Path, ...]]  # a camera and its files


def pair_images(
    folder: Path,
    files: Files,
    cameras: Sequence[CameraModel],
    pairs: Mapping[str, str] | None,
    notes: list[str],
) -> list[_CameraFiles]:
    """Find the files of each calibrated camera: as paired, by its name, or in order.

    Parameters
    ----------
    folder : of the recording, for errors.
    files : of each camera of the recording, by its name.
    pairs : calibrated camera of each camera of the recording; the others are left out.
    notes : list that gets a sentence where cameras are taken in order.

    Raises InputError for cameras without images, images without a calibration, or an unknown name
    in a pair.
    """
    named = {camera.name: camera for camera in cameras}
    if pairs is not None:
        return [
            (_known(named, own, "camera"), _known(files, of, "images")) for of, own in pairs.items()
        ]
    alike = {_plain(name): name for name in files}
    if any(_plain(name) in alike for name in named):
        _check_pairs(folder, list(files), list(named))
        return [(camera, files[alike[_plain(camera.name)]]) for camera in cameras]
    if len(files) != len(named):
        raise InputError(
            f"{folder}: expected images of {len(named)} cameras ({', '.join(named)}), got "
            f"{len(files)} ({', '.join(files)}); name the pairs, or the pattern of the files"
        )
    pairs_in_order = ", ".join(f"{of} = {own}" for of, own in zip(files, named, strict=True))
    notes.append(
        f"no images have a camera's name: taken in order, {pairs_in_order} (or name --pair)"
    )
    return list(zip(cameras, files.values(), strict=True))


def _check_pairs(folder: Path, images: Sequence[str], cameras: Sequence[str]) -> None:
    missing, spare = _without(cameras, images), _without(images, cameras)
    if missing:
        raise InputError(
            f"{folder}: expected images of all {len(cameras)} cameras, found none of "
            f"{', '.join(missing)}; name the pairs to leave cameras out"
        )
    if spare:
        raise InputError(
            f"{folder}: expected a calibration of each camera, found none of {', '.join(spare)}; "
            "name the pairs to leave images out"
        )


def _without(names: Sequence[str], others: Sequence[str]) -> list[str]:
    known = {_plain(one) for one in others}
    return [one for one in names if _plain(one) not in known]


def _known(known: Mapping[str, Any], name: str, kind: str) -> Any:
    if name not in known:
        raise InputError(f"{kind}: expected one of {', '.join(known)}, got {name!r}")
    return known[name]


def _plain(name: str) -> str:
    return "".join(mark for mark in name.lower() if mark.isalnum())


def check_numbers(files: Files, chosen: slice, notes: list[str]) -> None:
    """Check by numbers of files that no camera lacks a frame of the others.

    Frames are paired in order, so that all after a gap would be paired with other cameras' earlier
    ones. Not checked are files without numbers, numbers with different least steps between cameras
    (such as times), and cameras of a single file.

    Parameters
    ----------
    files : of each camera, by its name.
    chosen : range of each camera's files to take.
    notes : list that gets a sentence where cameras begin with different numbers.

    Raises InputError for a camera that lacks a number, counted from its first one, which another
    one has.
    """
    counters = {name: _counters_of(paths) for name, paths in files.items()}
    least_steps = {int(np.diff(own).min()) for own in counters.values() if len(own) > 1}
    if len(least_steps) > 1:
        return  # times, say, and no numbers of frames
    known = {name: own[chosen] for name, own in counters.items() if len(own[chosen]) > 1}
    every = {number - own[0] for own in known.values() for number in own}
    for name, own in known.items():
        gaps = {own[0] + step for step in every if step < own[-1] - own[0]} - set(own)
        if gaps:
            raise InputError(
                f"{name}: expected an image of number {min(gaps)}, as other cameras have, got "
                "none; frames are paired in order: remove it from all cameras, or add it"
            )
    first = {name: own[0] for name, own in known.items()}
    if len(set(first.values())) > 1:
        begin = ", ".join(f"{number} of {name}" for name, number in first.items())
        notes.append(f"frames are paired in order, and images begin with numbers {begin}")


def _counters_of(paths: Sequence[Path]) -> list[int]:
    """Read the last number in files' names that differs in all, if any."""
    found = [[int(one) for one in re.findall(r"\d+", path.stem)] for path in paths]
    for place in reversed(range(min((len(one) for one in found), default=0))):
        numbers = [one[place] for one in found]
        if len(set(numbers)) == len(paths):
            return numbers
    return []


Box = tuple[float, float, float, float, float, float]
_ENOUGH = 0.5  # share of the grid that a camera should see


@dataclass(frozen=True)
class ImportOptions:
    """Properties of a recording that its images and calibration do not contain.

    Attributes
    ----------
    pattern : path of an image below the folder, see `find_image_files`.
    pairs : calibrated camera of each camera of the images, by their names; cameras without a pair
        are left out. None: by name, or else in order.
    frames : range of the images of each camera to take.
    raw : layout of raw files.
    masks : folder with an image for each camera, by its name; 0 marks pixels that do not count.
    volume_mm : x0, x1, y0, y1, z0, z1 of the box that is lit; None: the calibration's grid, or else
        one that is proposed.
    voxel_mm : size of voxels; None: the calibration's, or else that of a pixel in the box's middle.
    interval_s : time between frames.
    pulses, period_s : number of frames in a group, 2 for double frames, and the time from group to
        group.
    black_dn, white_dn : grey values of no light and of saturation; None: estimated for each camera.
    preprocessing : steps that solvers' images pass.
    backlit : whether the images show bubbles or bodies in front of a bright background.
    referenced : whether the data set names the image files in place of holding copies.
    """

    pattern: str | None = None
    pairs: Mapping[str, str] | None = None
    frames: slice = field(default_factory=lambda: slice(None))
    raw: RawLayout | None = None
    masks: Path | None = None
    volume_mm: Box | None = None
    voxel_mm: float | None = None
    interval_s: float = 1.0
    pulses: int = 1
    period_s: float | None = None
    black_dn: float | None = None
    white_dn: float | None = None
    preprocessing: tuple[Step, ...] = ()
    backlit: bool = False
    referenced: bool = False


@dataclass(frozen=True, repr=False)
class ImportedRecording(Card):
    """Levels and grid of an imported recording, and notes for the user.

    Attributes
    ----------
    frames : number of images of each camera.
    grid : of the data set.
    levels : of each camera, by its name.
    notes : one sentence each.
    """

    frames: int
    grid: Grid
    levels: dict[str, GreyLevels]
    notes: tuple[str, ...]

    def _rows(self) -> Iterator[tuple[str, ...]]:
        yield (f"{self.frames} frame(s) of {len(self.levels)} camera(s), recorded, without truth",)
        yield "camera", "black", "white", "bits", "saturated %"
        for name, one in self.levels.items():
            numbers = f"{one.black_dn:.1f}", f"{one.white_dn:g}", str(one.bit_depth)
            yield name, *numbers, f"{100.0 * one.saturated:.3f}"
        ends = zip("xyz", *self.grid.box_mm, strict=True)
        box = ", ".join(f"{axis} {low:.4g} to {high:.4g}" for axis, low, high in ends)
        yield (f"volume: {box} mm; {self.grid}",)
        yield from ((f"note: {note}",) for note in self.notes)


def import_recording(
    folder: Path,
    calibration: Sequence[CameraModel],
    out: Path,
    options: ImportOptions,
    grid: Grid | None = None,
    *,
    overwrite: bool = False,
) -> ImportedRecording:
    """Make a data set without truth of a folder of images and calibrated cameras.

    Images are copied as 16-bit TIFF, or stay where they are. Those of cameras with smaller sensors
    are extended to one size, and what is added is masked.

    Parameters
    ----------
    calibration : cameras of any model.
    grid : of the calibration, if it has one.

    Raises InputError for images or cameras that are missing, of another size, or of different
    numbers; a camera that sees nothing of the volume; and anything that an option, a file or a
    camera is not.
    """
    notes: list[str] = []
    files = find_image_files(folder, [one.name for one in calibration], options.pattern)
    chosen = pair_images(folder, files, calibration, options.pairs, notes)
    check_numbers({camera.name: paths for camera, paths in chosen}, options.frames, notes)
    cameras: list[Any] = [camera for camera, _ in chosen]  # all are dataclasses
    voxels = _grid(cameras, options, grid, notes)
    _check_views(cameras, voxels, notes)
    with recorded_writer(out, folder.resolve().name, overwrite=overwrite) as writer:
        counts, values = _store_all(writer, folder, chosen, options)
        if missing := next((name for name, count in counts.items() if not count), None):
            raise InputError(f"{missing}: expected images in the range of frames, got none")
        if len(set(counts.values())) > 1:
            got = ", ".join(f"{count} of {name}" for name, count in counts.items())
            raise InputError(
                f"{folder}: expected as many images of each camera, got {got}; give a range, "
                "counted from 0, in which all have as many"
            )
        made = ImportedRecording(
            next(iter(counts.values())), voxels, _levels(values, options), tuple(notes)
        )
        rows, columns = _largest(cameras)
        writer.set_cameras(
            [dataclasses.replace(one, rows=rows, columns=columns) for one in cameras],
            **_keys(made, options),
        )
        try:
            read_cameras(writer.root)
        except InputError as error:
            raise InputError(str(error).replace(str(writer.root), str(out))) from None
    return made


def _largest(cameras: Sequence[CameraModel]) -> tuple[int, int]:
    return max(one.rows for one in cameras), max(one.columns for one in cameras)


def _grid(
    cameras: Sequence[CameraModel],
    options: ImportOptions,
    calibrated: Grid | None,
    notes: list[str],
) -> Grid:
    """Choose the grid: of the options, the calibration, or one that all cameras see."""
    if options.volume_mm is None and options.voxel_mm is None and calibrated is not None:
        return calibrated
    if options.volume_mm is not None:
        low, high = np.array(options.volume_mm[::2]), np.array(options.volume_mm[1::2])
    elif calibrated is not None:
        low = np.asarray(calibrated.low_mm) - 0.5 * np.asarray(calibrated.voxel_mm)
        high = low + np.asarray(calibrated.voxel_mm) * calibrated.shape[::-1]
    else:
        low, high = propose_box(cameras)
        notes.append("the volume is what all cameras see; set --volume to the part that is lit")
    voxel_mm = options.voxel_mm or pixel_size_mm(cameras, 0.5 * (low + high))
    return grid_of_box(low, high, voxel_mm)


def _check_views(cameras: Sequence[CameraModel], grid: Grid, notes: list[str]) -> None:
    for camera in cameras:
        lit, seen = share_in_view(camera, grid)
        if not seen:
            raise InputError(
                f"{camera.name}: expected it to see some of the volume, but it sees nothing of it; "
                "check the volume, and units and axes of the calibration"
            )
        if lit < 1.0:
            notes.append(
                f"{camera.name}: {1.0 - lit:.0%} of the volume has no light path to it, which "
                "particle solvers refuse: is part of it in or before the wall?"
            )
        if seen < _ENOUGH:
            notes.append(f"{camera.name}: it sees {seen:.0%} of the volume only")


def _store_all(
    writer: RecordedWriter, folder: Path, chosen: Sequence[_CameraFiles], options: ImportOptions
) -> tuple[dict[str, int], dict[str, GreyValues]]:
    """Store the images and masks of all cameras.

    Returns the number of images and the grey values of each, by its name.
    """
    largest = _largest([camera for camera, _ in chosen])
    masks = _find_masks(options.masks, [camera.name for camera, _ in chosen])
    references = ReferenceList(folder, options.raw) if options.referenced else None
    counts, values = dict[str, int](), dict[str, GreyValues]()
    for camera, paths in chosen:
        mask = _mask(camera, masks.get(camera.name, ()), largest)
        if mask is not None:
            writer.add_mask(camera.name, mask)
        values[camera.name], counts[camera.name] = GreyValues(), 0
        every = _numbered(read_images(paths, (camera.rows, camera.columns), options.raw))
        wanted = options.frames
        images = progress_bar(
            itertools.islice(every, wanted.start, wanted.stop, wanted.step), f"import {camera.name}"
        )
        for frame, (path, page, image) in enumerate(images):
            values[camera.name].add(
                image, None if mask is None else mask[: image.shape[0], : image.shape[1]]
            )
            counts[camera.name] += 1
            if references is None:
                writer.add_image(camera.name, frame, extended(image, largest))
            else:
                references.add(camera.name, path, page, image)
    if references is not None:
        writer.set_references(references)
    return counts, values


def _numbered(images: Iterator[tuple[Path, U16]]) -> Iterator[tuple[Path, int, U16]]:
    for path, pages in itertools.groupby(images, key=lambda pair: pair[0]):
        yield from ((path, page, image) for page, (_, image) in enumerate(pages))


def _find_masks(folder: Path | None, cameras: Sequence[str]) -> Files:
    if folder is None:
        return {}
    found = find_image_files(folder, cameras, "{camera}.*")
    if unknown := [name for name in found if name not in cameras]:
        raise InputError(
            f"{folder}: expected masks by the names of cameras ({', '.join(cameras)}), got "
            f"{', '.join(unknown)}"
        )
    return found


def _mask(camera: CameraModel, files: Sequence[Path], shape: tuple[int, int]) -> Bool | None:
    """Read which pixels (row, column) of the extended image count; None: all."""
    own = np.ones((camera.rows, camera.columns), dtype=np.bool_)
    if files:
        own = next(read_images(files, (camera.rows, camera.columns)))[1] > 0
    counts = extended(own, shape)
    return None if counts.all() else counts


def _levels(values: Mapping[str, GreyValues], options: ImportOptions) -> dict[str, GreyLevels]:
    """Choose each camera's levels: those of the options, or else estimates."""
    bit_depth = max(one.bit_depth for one in values.values())
    given = {"black_dn": options.black_dn, "white_dn": options.white_dn}
    known: dict[str, Any] = {key: value for key, value in given.items() if value is not None}
    levels = {
        name: dataclasses.replace(one.levels(bit_depth, backlit=options.backlit), **known)
        for name, one in values.items()
    }
    for name, one in levels.items():
        if not 0.0 <= one.black_dn < one.white_dn <= MOST_DN:
            raise InputError(
                f"{name}: expected black below white, of 0 to {MOST_DN}, got {one.black_dn:g} and "
                f"{one.white_dn:g}"
            )
    return levels


def _keys(made: ImportedRecording, options: ImportOptions) -> dict[str, Any]:
    """List the keys of cameras.json besides the cameras and their walls."""
    levels = list(made.levels.values())
    both = [(one.black_dn, one.white_dn) for one in levels]
    sensor: dict[str, Any] = {
        "black_dn": both[0][0],
        "white_dn": both[0][1],
        "bit_depth": max(one.bit_depth for one in levels),
    }
    if len(set(both)) > 1:
        sensor["by_camera"] = both
    keys: dict[str, Any] = {
        "frames": made.frames,
        "interval_s": options.interval_s,
        "sensor": sensor,
        "grid": made.grid,
        "shows": ["bubbles" if options.backlit else "particles"],
    }
    if options.pulses > 1:
        keys["pulses"] = options.pulses
        keys["times_s"] = _times(made.frames, options)
    if faults := list(step_faults(options.preprocessing, made.frames)):
        raise InputError(f"preprocessing: {faults[0]}")
    if options.preprocessing:
        keys["preprocessing"] = [step.model_dump() for step in options.preprocessing]
    return keys


def _times(frames: int, options: ImportOptions) -> list[float]:
    shortest = (options.pulses - 1) * options.interval_s
    period = options.period_s or options.pulses * options.interval_s
    if period <= shortest or frames % options.pulses:
        raise InputError(
            f"pulses: expected a whole number of groups of {options.pulses} frames, and more than "
            f"{shortest:g} s from group to group, got {frames} frames and {period:g} s"
        )
    return [
        frame // options.pulses * period + frame % options.pulses * options.interval_s
        for frame in range(frames)
    ]
