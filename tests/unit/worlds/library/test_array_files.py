"""Files of other programs. Read in every format, in any unit, and refused with a sentence."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import netcdf_file

from sabench.api import Flow, Generator
from sabench.dataset.verification import verify
from sabench.geometry.rigid_motion import Domain
from sabench.plugins import load
from sabench.scenes import Scene, load_scene, parse_scene
from sabench.simulation.pipeline import generate
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.worlds.library.array_files import UnitArray, read_arrays, speed_mm_s
from sabench.worlds.tracers import Motion, require_flow
from tests.conftest import ROOT
from tests.helpers.refusals import refused
from tests.unit.worlds.test_tracers import moving_scene

SIDE = 0.06  # m
DOMAIN = Domain((0.0, 0.0, 0.0), (40.0, 40.0, 40.0), 100)
Arrays = dict[str, tuple[F64, str | None]]


def cellular(points: F64) -> F64:
    x, y, z = 2.0 * np.pi / SIDE * points.T
    return np.stack([np.sin(x) * np.cos(y), -np.cos(x) * np.sin(y), 0.5 * np.cos(z)], axis=1)


def lattice(count: int = 40) -> Arrays:
    """The field as (z, y, x) over more than its period, with a spacing of each axis."""
    axes = [np.linspace(-0.6 * SIDE, 0.6 * SIDE, count + extra) for extra in (0, 3, 6)]
    z, y, x = np.meshgrid(axes[2], axes[1], axes[0], indexing="ij")
    values = cellular(np.stack([x, y, z], axis=-1).reshape(-1, 3)).reshape(*x.shape, 3)
    arrays: Arrays = {name: (axis, "m") for name, axis in zip("xyz", axes, strict=True)}
    return arrays | {name: (values[..., number], "m s-1") for number, name in enumerate("uvw")}


def as_hdf5(path: Path, arrays: Arrays) -> Path:
    with h5py.File(path, "w") as file:
        for name, (values, unit) in arrays.items():
            file[name] = values
            if unit is not None:
                file[name].attrs["units"] = unit
    return path


def as_netcdf(path: Path, arrays: Arrays) -> Path:
    with netcdf_file(path, "w") as file:
        for name, (values, unit) in arrays.items():
            sides = tuple(f"{name}_{number}" for number in range(values.ndim))
            for side, count in zip(sides, values.shape, strict=True):
                file.createDimension(side, count)
            variable = file.createVariable(name, "f8", sides)
            variable[:] = values
            variable.units = unit
    return path


def as_vtk(path: Path, arrays: Arrays) -> Path:
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkRectilinearGrid
    from vtkmodules.vtkIOXML import vtkXMLRectilinearGridWriter

    grid: Any = vtkRectilinearGrid()
    grid.SetDimensions(*(len(arrays[name][0]) for name in "xyz"))
    for name in "xyz":
        getattr(grid, f"Set{name.upper()}Coordinates")(numpy_to_vtk(arrays[name][0], deep=1))
    values = np.stack([arrays[name][0] for name in "uvw"], axis=-1).reshape(-1, 3)
    velocity = numpy_to_vtk(values, deep=1)
    velocity.SetName("velocity")
    grid.GetPointData().AddArray(velocity)
    writer: Any = vtkXMLRectilinearGridWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(grid)
    assert writer.Write()
    return path


def field_of(path: Path, **parameters: Any) -> Flow:
    plugin = load("generators", "from_field")
    made: Flow = plugin(plugin.Parameters(file=str(path), **parameters))
    return made


def points(count: int = 500) -> F64:
    return np.random.default_rng(2).uniform(-20.0, 20.0, (count, 3))


WRITERS: list[tuple[str, Callable[[Path, Arrays], Path], dict[str, Any]]] = [
    ("field.h5", as_hdf5, {}),
    ("field.nc", as_hdf5, {}),  # NetCDF 4 is HDF5
    ("field.nc", as_netcdf, {}),
    ("field.vtr", as_vtk, {"velocity": ["velocity"], "length": "m", "speed": "m/s"}),
]


@pytest.mark.parametrize(("name", "write", "parameters"), WRITERS)
def test_a_field_is_the_same_from_every_format(
    name: str, write: Callable[[Path, Arrays], Path], parameters: dict[str, Any], tmp_path: Path
) -> None:
    field = field_of(write(tmp_path / name, lattice()), **parameters)
    field.check(DOMAIN)
    assert_allclose(field.velocity(points(), 0.0), 1e3 * cellular(points() / 1e3), atol=0.3)
    slopes, step = field.gradient(points(), 0.0), 1e-4
    for axis in range(3):
        move = step * np.eye(3)[axis]
        ends = [field.velocity(points() + by, 0.0) for by in (move, -move)]
        assert_allclose(slopes[..., axis], (ends[0] - ends[1]) / (2.0 * step), atol=1e-3)


@pytest.mark.parametrize(
    "word", ["m s-1", "m.s^-1", "m*s**-1", " m / s ", "metres per second", "mm/ms"]
)
def test_speeds_are_written_in_many_ways_but_as_no_number(word: str) -> None:
    assert speed_mm_s(None, UnitArray(np.zeros(1), word), "u", "flow.speed") == pytest.approx(1e3)
    with refused("u"):
        speed_mm_s(None, UnitArray(np.zeros(1), f"1000 {word}"), "u", "flow.speed")


def test_axes_may_stand_in_any_order_and_units_be_given(tmp_path: Path) -> None:
    arrays = lattice()
    turned = arrays | {name: (np.transpose(arrays[name][0], (2, 1, 0)), None) for name in "uvw"}
    units: dict[str, Any] = {"speed": 500.0, "length": "cm", "center_mm": [1.0, 2.0, 3.0]}
    field = field_of(as_hdf5(tmp_path / "field.h5", turned), order="xyz", **units)
    there = 10.0 * points() / 1e3 + np.array([1.0, 2.0, 3.0])  # a metre is taken for a centimetre
    assert_allclose(field.velocity(there, 0.0), 500.0 * cellular(points() / 1e3), atol=0.3)


@pytest.mark.slow
def test_a_box_repeats_and_time_goes_on(tmp_path: Path) -> None:
    count, times = 24, np.linspace(0.0, 1.0, 5)
    axis = np.arange(count) * SIDE / count
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    values = cellular(np.stack([x, y, z], axis=-1).reshape(-1, 3)).reshape(*x.shape, 3)
    arrays: Arrays = {"x": (axis, "m"), "y": (axis, "m"), "z": (axis, "m"), "t": (times, "s")}
    arrays |= {
        name: (times[:, None, None, None] ** 2 * values[..., number], "m/s")
        for number, name in enumerate("uvw")
    }
    field = field_of(as_hdf5(tmp_path / "field.h5", arrays), periodic="xyz", time="t")
    far = points() + np.array([600.0, -1200.0, 60.0])
    assert_allclose(field.velocity(far, 0.7), 0.49 * 1e3 * cellular(far / 1e3), atol=0.3)
    expected = -0.49e3 * np.pi / SIDE / 1e3 * np.sin(far[:, 2] / 30.0 * np.pi)
    assert_allclose(np.trace(field.gradient(far, 0.7), axis1=1, axis2=2), expected, atol=0.1)


def broken(change: Callable[[Arrays], Arrays], **parameters: Any) -> Callable[[Path], Flow]:
    return lambda folder: field_of(as_hdf5(folder / "field.h5", change(lattice())), **parameters)


def changed_x(
    change: Callable[[F64], F64], unit: str = "m", **parameters: Any
) -> Callable[[Path], Flow]:
    return broken(lambda arrays: arrays | {"x": (change(arrays["x"][0]), unit)}, **parameters)


def no_field(name: str) -> Callable[[Path], Flow]:
    return lambda folder: field_of(Path(shutil.copy(__file__, folder / name)))


def without_unit(arrays: Arrays, name: str) -> Arrays:
    return arrays | {name: (arrays[name][0], None)}


def with_nan(arrays: Arrays) -> Arrays:
    arrays["v"][0][3, 4, 5] = np.nan
    return arrays


def swapped(arrays: Arrays) -> Arrays:
    return arrays | {name: (np.transpose(arrays[name][0], (1, 0, 2)), "m/s") for name in "uvw"}


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (broken(lambda arrays: without_unit(arrays, "y")), "field.h5: y: "),
        (broken(lambda arrays: without_unit(arrays, "w")), "field.h5: w: "),
        (changed_x(lambda x: x, "furlong"), "furlong"),
        (broken(with_nan), "field.h5: v: "),
        (broken(swapped), "u: "),
        (broken(lambda _: lattice(3) | {"x": (np.arange(3.0), "m")}), "x: "),
        (changed_x(lambda x: x[::-1]), "x: "),
        (broken(lambda arrays: arrays, axes=("x", "y", "depth")), "'depth'"),
        (changed_x(lambda x: x**3, periodic="x"), "x: "),
        (lambda folder: field_of(folder / "none.h5"), "none.h5"),
        (no_field("field.h5"), "field.h5"),
        (no_field("field.vti"), "field.vti"),
        (no_field("field.py"), "field.py"),
    ],
)
def test_bad_fields_are_named(make: Callable[[Path], Flow], key: str, tmp_path: Path) -> None:
    with refused(key):
        make(tmp_path).velocity(points(), 0.0)


def test_broken_netcdf_and_fields_that_do_not_cover_the_volume_are_refused(tmp_path: Path) -> None:
    field = field_of(as_hdf5(tmp_path / "field.h5", lattice()))
    with refused("field.h5"):
        field.check(Domain((0.0, 0.0, 0.0), (100.0, 10.0, 10.0), 100))
    (tmp_path / "field.nc").write_bytes(b"CDF\x01" + b"\xff" * 40)
    with refused("field.nc"):
        read_arrays(tmp_path / "field.nc", ["x"])


XYZ, UNITS = "particle,frame,x,y,z", {"length": 1.0, "seconds": 1.0}


def path_of(number: float, time: F64) -> F64:
    return np.stack([number + 10.0 * time, 2.0 * number - 5.0 * time**2, 3.0 + 0.0 * time], axis=-1)


def as_csv(path: Path, header: str, rows: Any) -> Path:
    lines = (",".join(f"{value:.17g}" for value in row) for row in rows)
    path.write_text("\n".join([header, *lines]), encoding="utf-8")
    return path


def tracks_file(folder: Path, unit: str = " [mm]") -> Path:
    """Three trajectories at 20 frames a second, in no order; the last is the shortest."""
    rows = [
        (number, frame, *path_of(number, np.array(frame / 20.0)))
        for number in range(3)
        for frame in range(2 * (number == 2), 9 - 3 * (number == 2))
    ]
    np.random.default_rng(0).shuffle(rows)
    return as_csv(folder / "tracks.csv", f"particle,frame,x{unit},y{unit},z{unit}", rows)


def tracks_of(path: Path, **parameters: Any) -> Generator:
    plugin = load("generators", "from_tracks")
    made: Generator = plugin(plugin.Parameters(file=str(path), **parameters))
    return made


@pytest.mark.parametrize("time", [0.0, 0.13, 0.25, 0.4])
def test_particles_stay_on_their_tracks(time: float, tmp_path: Path) -> None:
    tracks = tracks_of(tracks_file(tmp_path), seconds=0.05)
    seen = tracks.particles(DOMAIN, 0, 0, time)
    assert_array_equal(np.sort(seen.id), [0, 1, 2] if 0.1 < time < 0.3 else [0, 1])
    for number, place, speed in zip(seen.id, seen.position_mm, seen.velocity_mm_s, strict=True):
        assert_allclose(place, path_of(float(number), np.array(time)), atol=1e-12)
        assert_allclose(speed, [10.0, -10.0 * time, 0.0], atol=1e-10)
    with refused("frame 7"):
        tracks.particles(DOMAIN, 0, 7, 0.5)


def test_tracks_with_velocities_and_diameters(tmp_path: Path) -> None:
    rows = [
        (5, time, *path_of(1.0, np.array(time)) / 1e3, 0.01, -0.01 * time, 0.0, 2e-5)
        for time in (0.0, 0.3)
    ]
    header = "id,t [s],x (m),y (m),z (m),u [m/s],v [m/s],w [m/s],d [m]"
    columns = {"id": "id", "time": "t", "velocity": ("u", "v", "w"), "diameter": "d"}
    tracks = tracks_of(as_csv(tmp_path / "tracks.csv", header, rows), start_s=0.1, **columns)
    seen = tracks.particles(DOMAIN, 0, 0, 0.1)
    assert_allclose(seen.position_mm, path_of(1.0, np.array([0.2])), atol=1e-12)
    assert_allclose(seen.diameter_mm, 0.02)


@pytest.mark.parametrize(
    ("header", "rows", "units", "key"),
    [
        (XYZ, [(1, 0, 0, 0, 0)], {"seconds": 1.0}, "tracks.csv: x: "),
        (XYZ, [(1, 0, 0, 0, 0)], {"length": "mm"}, "frame: "),
        ("particle,frame,x,y", [(1, 0, 0, 0)], {}, "tracks.csv"),
        (XYZ, [(1, 0, 0, 0, np.nan)], {}, "z: "),
        (XYZ, [(1.5, 0, 0, 0, 0)], UNITS, "particle: "),
        (XYZ, [(1, 0, 0, 0, 0)] * 2, UNITS, "trajectory 1 at 0 s"),
        (XYZ, [], UNITS, "tracks.csv"),
    ],
)
def test_bad_tracks_are_named(header: str, rows: Any, units: Any, key: str, tmp_path: Path) -> None:
    tracks = tracks_of(as_csv(tmp_path / "tracks.csv", header, rows), **units)
    with refused(key):
        tracks.particles(DOMAIN, 0, 0, 0.0)


def field_scene(path: Path) -> Scene:
    table = {"generator": "from_field", "file": str(path)}
    return moving_scene(frames=2, interval_s=0.001, flow=table)


@pytest.mark.slow
def test_a_data_set_keeps_its_field(tmp_path: Path) -> None:
    original = as_hdf5(tmp_path / "field.h5", lattice())
    scene = field_scene(original)
    data = generate(scene, tmp_path / "data", seed=1, backend="splat")
    assert field_scene(Path(shutil.copy(original, tmp_path / "copy.h5"))).hash == scene.hash
    original.unlink()
    flow, particles = require_flow(data.scene), data.particles(1)
    assert_allclose(flow.velocity(particles.position_mm, 0.0), particles.velocity_mm_s)
    assert not verify(data.root)
    own, name = data.root / "scene.toml", data.manifest.scene
    again = generate(own, tmp_path / "again", seed=1, backend="splat", name=name)
    assert again.content_hash == data.content_hash


def test_a_changed_file_is_named(tmp_path: Path) -> None:
    path = as_hdf5(tmp_path / "field.h5", lattice())
    table = field_scene(path).to_dict()
    as_hdf5(path, lattice(30))
    with pytest.raises(InputError, match=r"flow\.sha256"):
        parse_scene(table, "moving")


def tracks_scene(frames: int, **given: Any) -> Scene:
    values = moving_scene(frames=frames, interval_s=0.05, flow=None).to_dict()
    own = {"generator": "from_tracks", "seconds": 0.05, "center_mm": [0.0, 0.0, 30.0]}
    return parse_scene(values | {"particles": own | given}, "tracks")


def test_tracks_become_frames(tmp_path: Path) -> None:
    motion = Motion(tracks_scene(3, file=str(tracks_file(tmp_path))), 0)
    first, second, third = (motion.at(frame) for frame in range(3))
    assert (len(first), len(second), len(third)) == (2, 2, 3)
    assert_allclose(second.position_mm[0] - first.position_mm[0], [0.5, -0.0125, 0.0], atol=1e-12)


def test_what_trackpy_linked_is_read() -> None:
    """25 particles that move by 0.2 mm along X, and increasingly fast along Y, by trackpy 0.7."""
    tracks = tracks_of(ROOT / "tests/data/trackpy-0.7.csv", length="mm", seconds=0.1)
    domain = Domain((0.0, 0.0, 30.0), (30.0, 30.0, 10.0), 100)
    frames = [tracks.particles(domain, 0, frame, 0.1 * frame) for frame in range(5)]
    for frame, particles in enumerate(frames):
        order, first = np.argsort(particles.id), np.argsort(frames[0].id)
        moved = particles.position_mm[order] - frames[0].position_mm[first]
        expected = np.tile([0.2 * frame, 0.05 * frame * (frame - 1), 0.0], (25, 1))
        assert_allclose(moved, expected, atol=2e-5)
        speeds = np.tile([2.0, frame - 0.5, 0.0], (25, 1))
        assert_allclose(particles.velocity_mm_s, speeds, atol=1e-3)


def series_of(folder: Path, head: str = "") -> Path:
    """Write a file of X Y Z and number for each of 11 frames, as the LPT challenge does."""
    folder.mkdir()
    for frame in range(11):
        rows = [(*path_of(number, np.array(frame / 20.0)), number) for number in range(3)]
        text = head + "\n".join([" ".join(f"{value:.17g}" for value in row) for row in rows]) + "\n"
        (folder / f"part_{frame}.dat").write_text(text, encoding="latin-1", newline="\r\n")
    return folder / "part_*.dat"


COLUMNS = {"id": "4", "time": "file_number", "axes": ("1", "2", "3"), "length": "mm"}


@pytest.mark.parametrize(
    "head", ["", 'Title = "größe 1"\n"X" "Y" "Z" "PartID"\nZone I=3, F=POINT\n']
)
def test_a_series_of_files_is_one(head: str, tmp_path: Path) -> None:
    one = tracks_of(tracks_file(tmp_path), seconds=0.05)
    skip = head.count("\n")
    path = series_of(tmp_path / "series", head)
    many = tracks_of(path, seconds=0.05, skip_lines=skip, **COLUMNS)
    for time in (0.1, 0.17):
        seen, expected = many.particles(DOMAIN, 0, 0, time), one.particles(DOMAIN, 0, 0, time)
        order, other = np.argsort(seen.id), np.argsort(expected.id)
        assert_array_equal(seen.id[order], expected.id[other])
        assert_allclose(seen.position_mm[order], expected.position_mm[other], atol=1e-9)
    (tmp_path / "series" / "part_10.dat").write_text(head + "1 2\n", encoding="utf-8")
    with refused("part_10.dat", "'4'", "'1', '2'"):
        tracks_of(path, seconds=0.05, skip_lines=skip, **COLUMNS).particles(DOMAIN, 0, 0, 0.1)


def test_a_share_of_the_tracks_is_kept_in_all_frames(tmp_path: Path) -> None:
    rows = [(n, frame, n / 100.0, 0.0, frame) for n in range(1000) for frame in (0, 1)]
    path = as_csv(tmp_path / "tracks.csv", XYZ, rows)
    tracks = tracks_of(path, length="mm", seconds=1.0, share=0.3)
    first, later = (tracks.particles(DOMAIN, 5, frame, float(frame)) for frame in (0, 1))
    assert_array_equal(first.id, later.id)
    assert 240 < len(first) < 360
    assert set(first.id) != set(tracks.particles(DOMAIN, 6, 0, 0.0).id)


def test_a_data_set_keeps_a_series(tmp_path: Path) -> None:
    scene = tracks_scene(2, file=str(series_of(tmp_path / "series")), **COLUMNS)
    first = generate(scene, tmp_path / "one", seed=1, backend="splat")
    assert verify(first.root) == []
    assert len(list((first.root / "given/particles").iterdir())) == 11
    shutil.rmtree(tmp_path / "series")
    own = load_scene(first.root / "scene.toml")
    again = generate(own, tmp_path / "two", seed=1, backend="splat")
    assert again.content_hash == first.content_hash
    (first.root / "given/particles/part_3.dat").unlink()
    with pytest.raises(InputError, match="sha256"):
        load_scene(first.root / "scene.toml")
