"""Copies of a data set: observation side, archives, comparison.

Processors round differently, so the bytes of two correct copies differ. Tolerances are ten times
and more what `benchmarks/instruction_sets.py` measures: see docs/developing/decisions.md.
"""

import contextlib
import itertools
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.dataset import schema
from sabench.dataset.hdf5 import open_hdf5, read_array
from sabench.dataset.reader import Dataset
from sabench.images.tiff_exr import read_exr, read_tiff, write_tiff
from sabench.scenes.sensor import Sensor
from sabench.utils.arrays import U16, Bool
from sabench.utils.errors import MOST, InputError
from sabench.utils.files import complete_or_nothing, inside, read_json, zip_folder
from sabench.utils.progress import progress_bar


def copy_observation(dataset: Dataset, folder: Path, *, linked: bool = False) -> None:
    """Make a data set of the observation side alone in a folder.

    Its manifest has the content hash of the complete data set, so that results apply to both.

    Parameters
    ----------
    folder : empty, or not there yet.
    linked : whether images may be links to those of the data set (on one file system), in place of
        copies: for readers that cannot write to them.
    """
    files = {name: one for name, one in dataset.contents.files.items() if schema.is_observed(name)}
    for name in files:
        place = inside(folder, name)
        if not inside(dataset.root, name).is_file():
            continue  # whoever reads it finds the fault, and names the file
        place.parent.mkdir(parents=True, exist_ok=True)
        source = inside(dataset.root, name)
        if linked:
            try:
                os.link(source, place)
            except OSError:  # another file system, or one without links
                linked = False
        if not linked:
            shutil.copyfile(source, place)
    if dataset.references is not None:
        for frame in range(dataset.setup.frames):
            for number, camera in enumerate(dataset.setup.cameras):
                name = schema.image_name(camera.name, frame, "tif")
                place = inside(folder, name)
                place.parent.mkdir(parents=True, exist_ok=True)
                write_tiff(place, dataset.raw_image(number, frame))
                files[name] = schema.FileEntry.of(place)
    whole = dataset.content_hash
    schema.write_manifest(folder, files, side="observation", content_hash=whole)


def pack(dataset: Dataset, out: Path, *, blind: bool, overwrite: bool = False) -> Path:
    """Copy a data set into a new folder, or into an archive by the name .zip.

    It appears when it is complete.

    Parameters
    ----------
    blind : pack the observation side alone: what a participant of a private test set receives.

    Raises InputError if the folder or archive is there already, and `overwrite` is not set; or the
    data set is the observation side alone, and the whole is asked for.
    """
    with _folder_of(out, overwrite) as folder:
        if blind:
            copy_observation(dataset, folder)
            return out
        if dataset.references is not None:
            raise InputError(
                f"{dataset.root}: expected a data set that holds its images, got one that "
                "references them; pack it with --blind, which copies them"
            )
        whole = dataset.contents if dataset.recorded else dataset.manifest
        for name in [*whole.files, schema.MANIFEST]:
            _copy_file(dataset.root, folder, name)
    return out


def pack_samples(root: Path, out: Path, *, blind: bool, overwrite: bool = False) -> Path:
    """Copy a data set of samples as `pack` does one of frames."""
    contents = schema.read_manifest(root)
    if not isinstance(contents, schema.ShardedContents):
        raise InputError(f"{root}: expected a data set of samples, got one of frames")
    files = [name for name in contents.all_files if not blind or schema.is_observed(name)]
    with _folder_of(out, overwrite) as folder:
        for name in progress_bar(files, "copy"):
            _copy_file(root, folder, name)
        text = (root / schema.MANIFEST).read_text(encoding="utf-8")
        if blind:
            keys = set(schema.ShardedContents.model_fields)
            head = contents.model_dump(mode="json", include=keys) | {"side": "observation"}
            for listed in (head["files"], *(entry["files"] for entry in head["shards"])):
                for name in [name for name in listed if not schema.is_observed(name)]:
                    del listed[name]
            text = schema.seal(head)
        (folder / schema.MANIFEST).write_text(text, encoding="utf-8")
    return out


@contextlib.contextmanager
def _folder_of(out: Path, overwrite: bool) -> Iterator[Path]:
    """Give a folder to fill, which becomes `out`, as an archive by the name .zip."""
    with complete_or_nothing(out, overwrite=overwrite) as partial:
        folder = partial.with_name(f"{partial.name}.files") if out.suffix == ".zip" else partial
        folder.mkdir()
        try:
            yield folder
            if folder is not partial:
                zip_folder(folder, partial)
        finally:
            if folder is not partial:
                shutil.rmtree(folder, ignore_errors=True)


def _copy_file(root: Path, folder: Path, name: str) -> None:
    place = inside(folder, name)
    place.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(inside(root, name), place)


_ROUNDING = {"float64": 1e-9, "float32": 1e-6}  # relative to the largest value of an array
_FEW = (5, 1e-3)  # pixels, or share of all, whose rays may take another path
_RADIANCE = 1e-3  # of the brightest pixel
_NOISE = 8.0  # standard deviations of the difference of two grey values
# arrays of truth that single rays or samples of noise change, with the allowed difference
_SAMPLED = {"number": 0.0, "depth_mm": 1e-3, "path_mm": 1e-3}
_ESTIMATED = {"error": 0.05, "visible": 0.02}
_DETECTED_PX, _OTHERWISE_DETECTED = 0.2, 0.02  # of points found in images: distance, share


def disagreements(one: Dataset, other: Dataset) -> list[str]:
    """Find where two copies of a data set differ by more than rounding and noise.

    One sentence for each difference, the first twenty; none if the copies agree. Both must be
    intact: see `verify`.

    Raises InputError if one of them is an observation side alone.
    """
    return list(itertools.islice(_differences(one, other), MOST))


def _differences(one: Dataset, other: Dataset) -> Iterator[str]:
    if one.manifest.identity is None or one.identity != other.manifest.identity:
        expected, got = ((each or "none")[:12] for each in (one.identity, other.identity))
        path = other.root / schema.MANIFEST
        yield f"{path}: identity: expected {expected} as in {one.root}, got {got}"
        return
    if one.content_hash == other.content_hash:
        return
    names, others = set(one.manifest.files), set(other.manifest.files)
    for name in sorted(names ^ others):
        yield f"{(one if name in others else other).root / name}: a file that only one copy has"
    for name in progress_bar(sorted(names & others), "compare"):
        if one.manifest.files[name] != other.manifest.files[name]:
            yield from _compare_files(one, other, name)


def _compare_files(one: Dataset, other: Dataset, name: str) -> Iterator[str]:
    first, second, kind = inside(one.root, name), inside(other.root, name), Path(name).suffix
    if kind == ".tif" or kind == ".exr":
        yield from _compare_images(one, first, second)
    elif name in (schema.TRUTH, schema.POINTS):
        yield from _compare_hdf5(
            first, second, detected=any(name.startswith("images/") for name in one.manifest.files)
        )
    elif kind == ".json":
        if not _same_values(read_json(first), read_json(second)):
            yield f"{second}: expected the values of {first} up to rounding, got others"
    else:
        yield f"{second}: expected the bytes of {first}, got others"


def _same_values(one: Any, other: Any) -> bool:
    """Compare values of JSON; numbers may differ by rounding."""
    if isinstance(one, float) and isinstance(other, float | int):
        return bool(np.isclose(one, other, rtol=_ROUNDING["float64"], atol=_ROUNDING["float64"]))
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        return all(map(_same_values, one, other))
    if isinstance(one, dict) and isinstance(other, dict) and one.keys() == other.keys():
        return all(_same_values(value, other[key]) for key, value in one.items())
    return type(one) is type(other) and one == other


def _compare_images(one: Dataset, first: Path, second: Path) -> Iterator[str]:
    camera = one.setup.cameras[0]
    shape = (camera.rows, camera.columns)
    if first.suffix == ".tif":
        names = [each.name for each in one.setup.cameras]
        sensor = one.scene.sensor.of_camera(names.index(first.stem) if first.stem in names else 0)
        different = _other_grey(read_tiff(first, shape), read_tiff(second, shape), sensor)
    else:
        light = np.stack([read_exr(path, shape).astype(float) for path in (first, second)])
        different = np.abs(light[0] - light[1]) > _RADIANCE * light.max(initial=0.0)
    count, most = int(different.sum()), max(_FEW[0], int(_FEW[1] * different.size))
    if count > most:
        yield f"{second}: expected at most {most} pixels other than in {first}, got {count}"


def _other_grey(one: U16, other: U16, sensor: Sensor) -> Bool:
    """Find pixels with grey values that are not two draws of one mean.

    The rejections in a Poisson generator let a change of the last digit shift all later draws, so
    that equal radiance may have other noise.
    """
    electrons = np.maximum((one + other.astype(float)) / 2.0 - sensor.black_level_dn, 0.0)
    electrons /= sensor.gain_dn_e
    variance = sensor.read_noise_e**2 + (electrons if sensor.shot_noise else 0.0)
    noise = sensor.gain_dn_e * np.sqrt(2.0 * variance)
    allowed = 1.0 + _RADIANCE * (sensor.white_dn - sensor.black_level_dn) + _NOISE * noise
    return np.asarray(np.abs(one - other.astype(float)) > allowed)


def _compare_hdf5(first: Path, second: Path, *, detected: bool) -> Iterator[str]:
    with open_hdf5(first) as one, open_hdf5(second) as other:
        names, others = _arrays_in(one), _arrays_in(other)
        for name in sorted(names ^ others):
            yield f"{second}: {name}: expected the arrays of {first}, got others"
        for name in sorted(names & others):
            first_values, second_values = (
                read_array(file, name, file[name].shape, file[name].dtype.kind)
                for file in (one, other)
            )
            if not _agree(name, first_values, second_values, detected=detected):
                yield f"{second}: {name}: expected the values of {first} up to rounding, got others"


def _arrays_in(file: Any) -> set[str]:
    names: set[str] = set()
    file.visititems(lambda name, node: names.add(name) if hasattr(node, "dtype") else None)
    return names


def _agree(name: str, one: npt.NDArray[Any], other: npt.NDArray[Any], *, detected: bool) -> bool:
    if one.shape != other.shape or one.dtype.kind != other.dtype.kind:
        return False
    label = name.rpartition("/")[2]
    if label == "pixels" and detected:
        return _share_beyond(one, other, _DETECTED_PX) <= _OTHERWISE_DETECTED
    if label in _SAMPLED:
        return _share_beyond(one, other, _SAMPLED[label]) <= _FEW[1]
    if one.dtype.kind != "f":
        return bool(np.array_equal(one, other))
    scale = np.abs(one[np.isfinite(one)]).max(initial=0.0)
    rounding = _ROUNDING["float32" if one.dtype.itemsize < 8 else "float64"]
    allowed = float(scale) * _ESTIMATED.get(label, rounding)
    return _share_beyond(one, other, allowed) == 0.0


def _share_beyond(one: npt.NDArray[Any], other: npt.NDArray[Any], allowed: float) -> float:
    """Compute the share of values that differ by more; NaN agrees with NaN alone."""
    first, second = one.astype(np.float64), other.astype(np.float64)
    same: Bool = (first == second) | (np.isnan(first) & np.isnan(second))
    with np.errstate(invalid="ignore"):
        near: Bool = np.abs(first - second) <= allowed
    return float(np.mean(~(same | near))) if one.size else 0.0
