"""Damaged files of other programs, and of experimenters, for the functions that read them."""

import contextlib
import copy
import csv
import io
import json
import random
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import h5py
import numpy as np
import tomli_w
from scipy.io import netcdf_file

from sabench.apps.own_calibration.calibrate import calibrate
from sabench.dataset.reader import Dataset
from sabench.evaluation.gates import baseline as baselines
from sabench.evaluation.gates.findings import compare
from sabench.evaluation.suite_loading import read_secret
from sabench.interop.vtkhdf import write_lattice
from sabench.scenes import load_scene, parse_scene
from sabench.simulation.pipeline import generate
from sabench.utils.arrays import triple
from sabench.worlds.bubbles_and_bodies import Phases
from tests.helpers import mutations
from tests.helpers.bubble_scenes import small
from tests.helpers.calibration_cases import write_points

_COUNTS = (5, 6, 7)  # nodes of fields along z, y, x
_HALF_MM = (6.0, 6.0, 45.0)
_LONG = 140_000  # characters: more than a field of Python's csv may have
Feed = Callable[[], object]


def write_fields(folder: Path) -> dict[str, Path]:
    folder.mkdir(parents=True, exist_ok=True)
    axes = {
        name: np.linspace(-half, half, count)
        for name, half, count in zip("xyz", _HALF_MM, _COUNTS[::-1], strict=True)
    }
    axes["z"] = axes["z"] + 30.0
    rng = np.random.default_rng(3)
    parts = {name: rng.normal(0.0, 1.0, _COUNTS) for name in "uvw"}
    files = {}
    for suffix in (".h5", ".nc", ".vtkhdf"):
        files[f"field{suffix}"] = folder / f"field{suffix}"
    with h5py.File(files["field.h5"], "w") as file:
        for name, values in (axes | parts).items():
            file.create_dataset(name, data=values, compression="gzip")
            file[name].attrs["units"] = "mm" if name in axes else "mm/s"
    _write_netcdf(files["field.nc"], axes | parts)
    _write_vtkhdf(files["field.vtkhdf"], axes, parts)
    files |= _write_vtk(folder, axes, parts)
    time = np.tile(np.arange(4) * 0.1, 6)
    places = [np.tile(axis[1:3], 12) + time for axis in axes.values()]
    table = np.column_stack([np.repeat(np.arange(6), 4), time, *places])
    files["tracks.csv"] = folder / "tracks.csv"
    names = "id,t [s],x [mm],y [mm],z [mm]"
    np.savetxt(files["tracks.csv"], table, delimiter=",", header=names, comments="")
    files["tracks.h5"] = folder / "tracks.h5"
    with h5py.File(files["tracks.h5"], "w") as file:
        for name, column, unit in zip(
            ("id", "t", "x", "y", "z"), table.T, ("", "s", *["mm"] * 3), strict=True
        ):
            file[name] = column
            file[name].attrs["units"] = unit
    return files


def _write_netcdf(path: Path, arrays: dict[str, Any]) -> None:
    with netcdf_file(path, "w") as file:
        for name, values in arrays.items():
            sizes = [f"{name}{axis}" for axis in range(values.ndim)]
            for size, count in zip(sizes, values.shape, strict=True):
                file.createDimension(size, count)
            variable = file.createVariable(name, "f8", sizes)
            variable[:] = values
            variable.units = "mm" if values.ndim == 1 else "mm/s"


def _write_vtkhdf(path: Path, axes: dict[str, Any], parts: dict[str, Any]) -> None:
    low, step = (triple([axis[i] for axis in axes.values()]) for i in (0, 1))
    step = triple(np.subtract(step, low))
    write_lattice(path, low, step, {"velocity": np.stack([*parts.values()], axis=-1)})


def _write_vtk(folder: Path, axes: dict[str, Any], parts: dict[str, Any]) -> dict[str, Path]:
    try:
        from vtkmodules.util.numpy_support import numpy_to_vtk
        from vtkmodules.vtkCommonDataModel import vtkImageData
        from vtkmodules.vtkIOLegacy import vtkStructuredPointsWriter
        from vtkmodules.vtkIOXML import vtkXMLImageDataWriter
    except ImportError:
        return {}
    image: Any = vtkImageData()
    image.SetDimensions(*_COUNTS[::-1])
    image.SetOrigin(*(float(axis[0]) for axis in axes.values()))
    image.SetSpacing(*(float(axis[1] - axis[0]) for axis in axes.values()))
    flat = np.ascontiguousarray(np.stack([*parts.values()], axis=-1).reshape(-1, 3))
    velocity = numpy_to_vtk(flat, deep=1)
    velocity.SetName("velocity")
    image.GetPointData().AddArray(velocity)
    made = {}
    kinds = (("field.vti", vtkXMLImageDataWriter), ("field.vtk", vtkStructuredPointsWriter))
    for name, kind in kinds:
        writer: Any = kind()
        writer.SetFileName(str(folder / name))
        writer.SetInputData(image)
        writer.Write()
        made[name] = folder / name
    return made


def write_meshes(folder: Path) -> dict[str, Path]:
    import trimesh

    folder.mkdir(parents=True, exist_ok=True)
    ball = trimesh.creation.icosphere(1, 1.0)
    files = {}
    for suffix in ("stl", "ply", "obj", "glb"):
        files[f"mesh.{suffix}"] = folder / f"mesh.{suffix}"
        ball.export(files[f"mesh.{suffix}"])
    return files


def write_baseline(path: Path) -> Path:
    figures = {"q": 0.5, "seconds": 1.0, "rms_px": None}
    entry = baselines.CaseEntry(
        case="tiny",
        seed=1,
        renderer="splat",
        scene_hash="a" * 64,
        data={"camera_00.grey_mean": 5.0},
        solvers={"asa": baselines.Entry(figures=figures, reference_s=0.1)},
    )
    tolerances = {"reconstruction": {"q": baselines.Tolerance(relative=0.0, absolute=0.1)}}
    head = {"suite": "tiny", "sabench": "1", "machine": {}, "versions": {}}
    baselines.write_baseline(
        path, baselines.Baseline(**head, tolerances=tolerances, cases=(entry,))
    )
    return path


def interrupt(values: dict[str, Any], folder: Path) -> Path:
    """Generate a data set up to its last step; its parts stay in the folder."""

    class Stopped(Exception):  # noqa: N818 (no fault)
        pass

    folder.mkdir()
    with (
        mock.patch("sabench.simulation.pipeline.put_together", side_effect=Stopped),
        contextlib.suppress(Stopped),
    ):
        generate(parse_scene(values, "tiny"), folder / "set", seed=1, backend="splat", name="tiny")
    return folder


def damage_file(source: Path, folder: Path, rng: random.Random) -> Path:
    """Copy a file into a folder and change it there as its kind suggests."""
    path = Path(shutil.copy(source, folder / source.name))
    if path.suffix in (".h5", ".vtkhdf"):
        mutations.hdf5(path, rng)
    elif path.suffix == ".csv" and rng.random() < 0.7:
        _change_table(path, rng)
    elif path.suffix in (".obj", ".ply", ".vti", ".vtk") and rng.random() < 0.5:
        _change_numbers(path, rng)
    else:
        path.write_bytes(mutations.data(path.read_bytes(), rng, head=400))
    return path


def _change_table(path: Path, rng: random.Random) -> None:
    with path.open(newline="", encoding="utf-8") as file:
        rows = [*csv.reader(file)]
    for _ in range(rng.choice((1, 1, 3))):
        row = rng.choice(rows)
        if not row:
            continue
        at = rng.randrange(len(row))
        row[at] = rng.choice(
            ("x" * _LONG, "", "nan", "1e999", "-1e300", "1e18", "-1", "0", "1.5", '"', "\0", "é")
        )
        if rng.random() < 0.1:
            del row[at]
        if rng.random() < 0.1:
            rows.append(copy.copy(row))
    text = io.StringIO()
    csv.writer(text).writerows(rows)
    whole = text.getvalue().encode("utf-8" if rng.random() < 0.8 else "latin-1", "replace")
    path.write_bytes(whole)


def _change_numbers(path: Path, rng: random.Random) -> None:
    """Replace words of a text by numbers that nobody expects."""
    words = path.read_bytes().split(b" ")
    for _ in range(rng.choice((1, 1, 3, 20))):
        at = rng.randrange(len(words))
        words[at] = rng.choice(
            (b"-1", b"0", b"7", b"99999", b"1000000000000", b"nan", b"1e300", b"9" * 400, b"x")
        )
    path.write_bytes(b" ".join(words))


def field(base: Any, inputs: Path, out: Path, rng: random.Random) -> Feed:
    """Run `sabench generate` on a scene whose flow or particles come from a damaged file."""
    from tests.helpers.untrusted import SCENE

    name = rng.choice(sorted(one for one in base.files if one.startswith(("field", "tracks"))))
    path = damage_file(base.files[name], inputs, rng)
    values = copy.deepcopy(SCENE)
    values["timing"] = {"rate_hz": 10.0, "pulses_s": [0.0]}
    if name.startswith("tracks"):
        values["particles"] = {"generator": "from_tracks", "file": path.name, "diameter_mm": 0.02}
    else:
        plain = path.suffix in (".h5", ".nc")
        own = {} if plain else {"velocity": ["velocity"], "length": "mm", "speed": "mm/s"}
        values["flow"] = {"generator": "from_field", "file": path.name, **own}
    (inputs / "scene.toml").write_text(tomli_w.dumps(values))
    return lambda: generate(load_scene(inputs / "scene.toml"), out / "set", seed=1, backend="splat")


def mesh(base: Any, inputs: Path, out: Path, rng: random.Random) -> Feed:
    """Make the bodies of a scene with a damaged mesh, as `sabench generate` does first."""
    name = rng.choice(sorted(one for one in base.files if one.startswith("mesh")))
    path = damage_file(base.files[name], inputs, rng)
    body = {"generator": "mesh_file", "file": str(path), "unit": "mm", "place_mm": [0, 0, 60.0]}
    return lambda: Phases(small(bubbles=None, solids=[body]), 1).bodies(0)


def describe_calibration(data: Dataset, folder: Path) -> dict[str, Any]:
    case, first, place = data.calibration_case(), data.setup.pinholes[0], [0.0, 0.0, 30.0]
    array = ("rows", "columns", "pixel_mm", "focal_length_mm", "principal_distance_mm")
    values = {
        "target_mm": place,
        "target": {
            key: getattr(case.target, key) for key in ("pattern", "columns", "rows", "pitch_mm")
        },
        "array": {key: getattr(first, key) for key in array},
        "wall": {"fluid_index": 1.333, "layers": [{"index": 1.52, "thickness_mm": 5.0}]},
        "cameras": [
            {"name": c.name, "center_mm": list(c.center_mm), "aim_mm": place}
            for c in data.setup.cameras
        ],
        "known": [{"frame": 0, "point": 0, "z_mm": 30.0}],
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "calibration.toml").write_text(tomli_w.dumps(values))
    write_points(folder / "points.csv", case.pixels, data.setup.cameras)
    return values


def calibration(base: Any, inputs: Path, out: Path, rng: random.Random) -> Feed:
    """Run `sabench calibrate` on a folder with a damaged file."""
    from tests.helpers.untrusted import write_toml

    folder = inputs / "mine"
    values = describe_calibration(base.target, folder)
    which = rng.random()
    if which < 0.4:
        write_toml(folder / "calibration.toml", values, rng)
    elif which < 0.75:
        _change_table(folder / "points.csv", rng)
    elif which < 0.85:
        path = folder / "points.csv"
        path.write_bytes(mutations.data(path.read_bytes(), rng))
    else:
        _damaged_images(folder, [c.name for c in base.target.setup.cameras], rng)
    return lambda: calibrate(folder, out / "result", "refractive_autocal", {})


def _damaged_images(folder: Path, names: list[str], rng: random.Random) -> None:
    (folder / "points.csv").unlink()
    frame = folder / "images" / "0"
    frame.mkdir(parents=True)
    for name in names:
        (frame / f"{name}.png").write_bytes(png(24, 32))
    damaged = frame / f"{rng.choice(names)}.png"
    how = rng.random()
    if how < 0.3:
        sizes = (1, 24, 4000, 32_000, 100_000, 2**31 - 1)
        damaged.write_bytes(png(rng.choice(sizes), rng.choice(sizes), empty=True))
    elif how < 0.4:
        damaged.rename(damaged.with_suffix(rng.choice((".tif", ".jpg", ".bmp"))))
    else:
        damaged.write_bytes(mutations.data(damaged.read_bytes(), rng, head=60))


def png(rows: int, columns: int, *, empty: bool = False) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        end = struct.pack(">I", zlib.crc32(kind + data))
        return struct.pack(">I", len(data)) + kind + data + end

    head = struct.pack(">IIBBBBB", columns, rows, 16, 0, 0, 0, 0)
    data = zlib.compress(bytes(10 if empty else rows * (1 + 2 * columns)))
    parts = chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + parts


def baseline(base: Any, inputs: Path, out: Path, rng: random.Random) -> Feed:
    """Read a damaged baseline, as `sabench check` does, and compare it with the intact one."""
    whole = json.loads(base.files["baseline"].read_text())
    path = inputs / "tiny.json"
    if rng.random() < 0.2:
        path.write_bytes(mutations.data(base.files["baseline"].read_bytes(), rng))
    else:
        text = json.dumps(mutations.tree(whole, rng), ensure_ascii=rng.random() < 0.9)
        path.write_text(text, encoding="utf-8", errors="surrogatepass")

    def feed() -> None:
        before = baselines.read_baseline(path, "tiny")
        now = baselines.read_baseline(base.files["baseline"], "tiny")
        for entry in now.cases:
            old = before.case(entry.key)
            if old is not None:
                tasks = dict.fromkeys((*entry.solvers, *old.solvers), "reconstruction")
                list(compare(old, entry, tasks, before.tolerances))

    return feed


def secret(base: Any, inputs: Path, out: Path, rng: random.Random) -> Feed:
    from tests.helpers.untrusted import write_toml

    write_toml(inputs / "secret.toml", {"secret": "0123456789abcdef", "seeds": 3}, rng)

    def feed() -> None:
        drawn = read_secret(inputs / "secret.toml")
        if drawn.seeds < 1000:
            drawn.seeds_of("tiny", 1, "tiny")

    return feed


def interrupted(base: Any, inputs: Path, out: Path, rng: random.Random) -> Feed:
    from tests.helpers.untrusted import SCENE

    scene = parse_scene(SCENE, "tiny")
    folder = next(base.interrupted.iterdir())
    parts = Path(shutil.copytree(folder, out / folder.name))
    path = rng.choice(sorted(one for one in parts.rglob("*") if one.is_file()))
    path.write_bytes(mutations.data(path.read_bytes(), rng))
    return lambda: generate(scene, out / "set", seed=1, backend="splat", name="tiny")


KINDS = {
    "field": field,
    "mesh": mesh,
    "calibration": calibration,
    "baseline": baseline,
    "secret": secret,
    "interrupted": interrupted,
}
