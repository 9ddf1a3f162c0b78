"""Comparison of two copies of one data set, made on different processors.

Processors round differently, so the bytes of two honest copies differ. Tolerances are ten times
and more what `benchmarks/instruction_sets.py` measures: see docs/developing/decisions.md.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.dataset import schema
from sabench.dataset.hdf5 import open_hdf5, read_array
from sabench.dataset.reader import Dataset
from sabench.images.tiff_exr import read_exr, read_tiff
from sabench.scenes.sensor import Sensor
from sabench.utils.arrays import F32, F64, U16, Bool
from sabench.utils.files import inside, read_json
from sabench.utils.progress import progress_bar

_MOST_FAULTS = 100
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

    One sentence for each difference, the first hundred; none if the copies agree. Both must be
    intact: see `verify`.

    Raises
    ------
    InputError
        One of them is an observation side alone.
    """
    return list(itertools.islice(_differences(one, other), _MOST_FAULTS))


def _differences(one: Dataset, other: Dataset) -> Iterator[str]:
    if one.manifest.identity is None or one.identity != other.manifest.identity:
        yield (
            f"{other.root / schema.MANIFEST}: identity: expected {_short(one.identity)} as in "
            f"{one.root}, got {_short(other.identity)}"
        )
        return
    if one.content_hash == other.content_hash:
        return
    names, others = set(one.manifest.files), set(other.manifest.files)
    for name in sorted(names ^ others):
        yield f"{(one if name in others else other).root / name}: a file that only one copy has"
    for name in progress_bar(sorted(names & others), "compare"):
        if one.manifest.files[name] != other.manifest.files[name]:
            yield from _compare_files(one, other, name)


def _short(identity: str | None) -> str:
    return identity[:12] if identity else "none"


def _compare_files(one: Dataset, other: Dataset, name: str) -> Iterator[str]:
    first, second, kind = inside(one.root, name), inside(other.root, name), Path(name).suffix
    if kind == ".tif" or kind == ".exr":
        yield from _compare_images(one, first, second)
    elif name in (schema.TRUTH, schema.POINTS):
        yield from _compare_hdf5(first, second, detected=_has_images(one))
    elif kind == ".json":
        if not _same_values(read_json(first), read_json(second)):
            yield f"{second}: expected the values of {first} up to rounding, got others"
    else:
        yield f"{second}: expected the bytes of {first}, got others"


def _has_images(data: Dataset) -> bool:
    return any(name.startswith("images/") for name in data.manifest.files)


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
        read = read_tiff(first, shape), read_tiff(second, shape)
        names = [own.name for own in one.setup.cameras]
        number = names.index(first.stem) if first.stem in names else 0
        different = _other_grey(*read, one.scene.sensor.of_camera(number))
    else:
        different = _other_radiance(read_exr(first, shape), read_exr(second, shape))
    yield from _too_many(different, first, second)


def _other_radiance(one: F32, other: F32) -> Bool:
    scale = max(float(one.max(initial=0.0)), float(other.max(initial=0.0)))
    return np.asarray(np.abs(one.astype(float) - other) > _RADIANCE * scale)


def _other_grey(one: U16, other: U16, sensor: Sensor) -> Bool:
    """Find pixels whose grey values are no two draws of one mean.

    The rejections in a Poisson generator let a change of the last digit shift all later draws, so
    that equal radiance may have other noise.
    """
    electrons = np.maximum((one + other.astype(float)) / 2.0 - sensor.black_level_dn, 0.0)
    electrons /= sensor.gain_dn_e
    variance = sensor.read_noise_e**2 + (electrons if sensor.shot_noise else 0.0)
    noise = sensor.gain_dn_e * np.sqrt(2.0 * variance)
    allowed = 1.0 + _RADIANCE * (sensor.white_dn - sensor.black_level_dn) + _NOISE * noise
    return np.asarray(np.abs(one - other.astype(float)) > allowed)


def _too_many(different: npt.NDArray[Any], first: Path, second: Path) -> Iterator[str]:
    count, most = int(different.sum()), max(_FEW[0], int(_FEW[1] * different.size))
    if count > most:
        yield f"{second}: expected at most {most} pixels other than in {first}, got {count}"


def _compare_hdf5(first: Path, second: Path, *, detected: bool) -> Iterator[str]:
    with open_hdf5(first) as one, open_hdf5(second) as other:
        names, others = _arrays_in(one), _arrays_in(other)
        for name in sorted(names ^ others):
            yield f"{second}: {name}: expected the arrays of {first}, got others"
        for name in sorted(names & others):
            values = [
                read_array(file, name, file[name].shape, file[name].dtype.kind)
                for file in (one, other)
            ]
            if not _agree(name, values[0], values[1], detected=detected):
                yield f"{second}: {name}: expected the values of {first} up to rounding, got others"


def _arrays_in(file: Any) -> set[str]:
    names: set[str] = set()
    file.visititems(lambda name, node: names.add(name) if hasattr(node, "dtype") else None)
    return names


def _agree(name: str, one: npt.NDArray[Any], other: npt.NDArray[Any], *, detected: bool) -> bool:
    """Compare two arrays of a truth or of detected points."""
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
    near: Bool = np.abs(_difference(first, second)) <= allowed
    return float(np.mean(~(same | near))) if one.size else 0.0


def _difference(one: F64, other: F64) -> F64:
    with np.errstate(invalid="ignore"):
        return np.asarray(one - other)
