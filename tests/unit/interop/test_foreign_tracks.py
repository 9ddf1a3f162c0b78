"""Particles and tracks read from and written to the files of other programs."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import netcdf_file, savemat

from sabench.geometry.rigid_motion import rotation_matrices
from sabench.interop.foreign import (
    ForeignFormatWarning,
    ForeignWorld,
    Recording,
    TrackTable,
    read_world,
)
from sabench.interop.tracks import TrackFormat, read_tracks, write_tracks
from sabench.utils.arrays import triple
from tests.helpers.refusals import check_sentence, refused
from tests.unit.interop.test_cameras import rig

pytestmark = pytest.mark.filterwarnings("ignore::sabench.interop.foreign.ForeignFormatWarning")
CAMERAS, GRID, _ = rig("particle-tracking")
TIMES = (0.0, 0.25, 0.5)
RECORDING = Recording(CAMERAS, TIMES)
FORMATS: tuple[TrackFormat, ...] = (
    *("openptv", "myptv", "openlpt", "lpt-challenge", "netcdf", "mat", "npy", "csv"),
)


def particles() -> TrackTable:
    rng = np.random.default_rng(4)
    frame, trajectory = np.repeat([0, 1], [4, 3]), np.array([3, 1, 7, 5, 7, 2**40, 3])
    size = np.asarray(GRID.voxel_mm) * (np.asarray(GRID.shape[::-1]) - 1)
    place, value = np.asarray(GRID.low_mm) + size * rng.random((7, 3)), rng.random(7)
    velocity, acceleration = rng.normal(size=(2, 7, 3))
    return TrackTable(frame, place, trajectory, value, velocity, acceleration)


def read(path: Path, form: TrackFormat, unit: str | None = None) -> TrackTable:
    return read_tracks(path, form, unit=unit, interval_s=RECORDING.interval_s)


def write(folder: Path, table: TrackTable, form: TrackFormat) -> None:
    folder.mkdir()
    write_tracks(folder, table, form, RECORDING)


def links(table: TrackTable) -> set[frozenset[int]]:
    assert table.trajectory is not None
    numbers = np.unique(table.trajectory)
    return {frozenset(np.flatnonzero(table.trajectory == one).tolist()) for one in numbers}


@pytest.mark.parametrize("form", FORMATS)
def test_particles_come_back(form: TrackFormat, tmp_path: Path) -> None:
    true = particles()
    write(tmp_path / "out", true, form)
    found = read(tmp_path / "out", form)
    np.testing.assert_array_equal(found.frame - found.frame[0], true.frame)
    np.testing.assert_array_equal(found.position_mm, true.position_mm)
    assert links(found) == links(true)
    if form in ("myptv", "netcdf", "mat", "npy", "csv"):  # these hold velocities
        for name in ("velocity_mm_s", "acceleration_mm_s2"):
            np.testing.assert_allclose(getattr(found, name), getattr(true, name), rtol=1e-14)


@pytest.mark.parametrize("form", FORMATS)
def test_losses_are_said(form: TrackFormat, tmp_path: Path) -> None:
    with pytest.warns(ForeignFormatWarning) as said:
        write_tracks(tmp_path, particles(), form, RECORDING)
    check_sentence(str(said[0].message), form)


@pytest.mark.parametrize("form", FORMATS)
def test_particles_without_trajectories(form: TrackFormat, tmp_path: Path) -> None:
    lone = TrackTable(particles().frame, particles().position_mm)
    write(tmp_path / "out", lone, form)
    found = read(tmp_path / "out", form)
    np.testing.assert_array_equal(found.position_mm, lone.position_mm)
    if found.trajectory is not None:  # formats that have nothing but tracks
        assert len(np.unique(found.trajectory)) == len(lone)


def test_targets_are_projections(tmp_path: Path) -> None:
    true = particles().of_frame(0)
    write(tmp_path / "out", true, "openptv")
    text = (tmp_path / "out/img/cam2.10001_targets").read_text(encoding="utf-8")
    rows = np.array([line.split() for line in text.splitlines()[1:]], dtype=float)
    assert (np.diff(rows[:, 2]) >= 0.0).all()
    pixels = CAMERAS[1].project(true.position_mm)[0]
    np.testing.assert_allclose(rows[:, 1:3] - 0.5, pixels[rows[:, -1].astype(int)], atol=1e-4)
    matches = (tmp_path / "out/res/rt_is.10001").read_text(encoding="utf-8").splitlines()[1:]
    assert [int(line.split()[5]) for line in matches] == np.argsort(rows[:, -1]).tolist()


def test_another_world_and_back(tmp_path: Path) -> None:
    true = particles()
    world = ForeignWorld((1.0, -2.0, 3.0), ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    world.write(tmp_path)
    (tmp_path / "res").mkdir()
    found = true.into(world).back(read_world(tmp_path / "res"))
    np.testing.assert_allclose(found.position_mm, true.position_mm, atol=1e-13)
    assert found.velocity_mm_s is not None
    np.testing.assert_allclose(found.velocity_mm_s, np.asarray(true.velocity_mm_s), atol=1e-13)
    (tmp_path / "sabench-world.json").write_text(json.dumps({"origin_mm": [1]}), encoding="utf-8")
    with refused():
        read_world(tmp_path)


HEAD = "frame,particle,x,y,z\n"
ROWS = "0,1,1.5,2,3\n1,1,1.6,2,3\n"
LATIN = "frame;particle;x [µm];y [µm];z [µm];größe\n0;1;1500;2000;3000;7\n1;1;1600;2000;3000;7\n"
METRES = b"Frame\tParticle\tX (m)\tY (m)\tZ (m)\n"
TRACKMATE = b"LABEL;FRAME;TRACK_ID;X;Y;Z\nLabel;Frame;Track ID;X;Y;Z\n;(frame);;(mm);(mm);(mm)\n"
STRANGE = {
    "windows": (HEAD + ROWS).replace("\n", "\r\n").encode(),
    "mark": (HEAD + ROWS).encode("utf-8-sig"),
    "latin": LATIN.encode("latin-1"),
    "comma": b"frame;particle;x;y;z\n0;1;1,5;2,0;3,0\n1;1;1,6;2,0;3,0\n",
    "utf-16": (HEAD + ROWS).encode("utf-16"),
    "metres": METRES + b"0\t1\t.0015\t.002\t.003\n1\t1\t.0016\t.002\t.003\n",
    "comment": b"# made by hand\n# frame particle x y z\n0 1 1.5 2 3\n1 1 1.6 2 3\n",
    "text": TRACKMATE + b"spot a;0;1;1.5;2;3\nspot b;1;1;1.6;2;3\n",
    "order": b"z,particle,frame,x,extra,y\n3,1,1,1.6,9,2\n3,1,0,1.5,9,2\n",
}


@pytest.mark.parametrize("kind", STRANGE)
def test_strange_tables_are_read(kind: str, tmp_path: Path) -> None:
    (tmp_path / "found.csv").write_bytes(STRANGE[kind])
    found = read(tmp_path / "found.csv", "csv")
    assert found.frame.tolist() == [0, 1]
    assert found.trajectory is not None
    assert found.trajectory.tolist() == [1, 1]
    np.testing.assert_allclose(found.position_mm, [[1.5, 2.0, 3.0], [1.6, 2.0, 3.0]], rtol=1e-12)


def test_columns_that_are_left_out_are_said(tmp_path: Path) -> None:
    (tmp_path / "found.csv").write_bytes(STRANGE["order"])
    with pytest.warns(ForeignFormatWarning) as said:
        read_tracks(tmp_path / "found.csv", "csv")
    check_sentence(" ".join(str(one.message) for one in said), "extra")


def bubbles() -> TrackTable:
    """Bubbles of two frames, in rising order."""
    rng, base = np.random.default_rng(8), particles()
    turn = rotation_matrices(rng.normal(size=(7, 3)))
    axes = rng.uniform(0.3, 2.0, (7, 3))
    return TrackTable(base.frame, base.position_mm, semi_axes_mm=axes, turn=turn)


def write_bubbles(file: Path, columns: dict[str, Any]) -> None:
    """Write the frames and positions of `bubbles` and other columns, as text or records."""
    true = bubbles()
    table = {"Frame": true.frame, **dict(zip("XYZ", true.position_mm.T, strict=True)), **columns}
    rows = np.column_stack(list(table.values()))
    if file.suffix == ".npy":
        np.save(file, np.array([*map(tuple, rows)], dtype=[(name, float) for name in table]))
    else:
        np.savetxt(file, rows, fmt="%.17g", delimiter=";", header=";".join(table), comments="")


@pytest.mark.parametrize("form", ["csv", "npy"])
def test_bubbles_are_read_by_the_names_of_their_sizes(form: TrackFormat, tmp_path: Path) -> None:
    true, file = bubbles(), tmp_path / f"found.{form}"
    axes, turn = np.asarray(true.semi_axes_mm), np.asarray(true.turn)
    radius = axes[:, 0]
    nine = {f"turn_{i + 1}{j + 1}": turn[:, i, j] for i in range(3) for j in range(3)}
    for columns, expected, rotations in (
        ({"Radius": radius}, np.tile(radius, (3, 1)).T, None),
        ({"d_m": 2e-3 * radius}, np.tile(radius, (3, 1)).T, None),
        (dict(zip("abc", axes.T, strict=True)), axes, None),
        (dict(zip(("a_mm", "b_mm", "c_mm"), axes.T, strict=True)) | nine, axes, turn),
    ):
        write_bubbles(file, columns)
        found = read_tracks(file, form, bubbles=True)
        assert found.semi_axes_mm is not None
        np.testing.assert_allclose(found.semi_axes_mm, expected, rtol=1e-14)
        np.testing.assert_array_equal(found.position_mm, true.position_mm)
        assert (found.turn is None) == (rotations is None)
        if rotations is not None:
            np.testing.assert_allclose(np.asarray(found.turn), rotations, atol=1e-14)


def test_columns_that_a_kind_does_not_have_are_said(tmp_path: Path) -> None:
    sizes = np.asarray(bubbles().semi_axes_mm)[:, 0]
    write_bubbles(tmp_path / "found.csv", {"radius": sizes, "vx": sizes, "mass": sizes, "b": sizes})
    for kind, lost in ((True, "vx, mass, b"), (False, "radius, vx, b")):
        with pytest.warns(ForeignFormatWarning) as said:
            read_tracks(tmp_path / "found.csv", "csv", bubbles=kind)
        check_sentence(str(said[-1].message), lost)


def test_names_replace_those_of_a_table(tmp_path: Path) -> None:
    rows = np.array([[1.0, 2.0, 3.0, 0.5], [4.0, 5.0, 6.0, 0.25]])
    np.save(tmp_path / "found", rows)
    np.savetxt(tmp_path / "found.csv", rows, header="some;other;names;here", delimiter=";")
    names = ("x", "y", "z", "radius")
    for form in ("npy", "csv"):
        more = {"names": names, "bubbles": True, "single": True}
        found = read_tracks(tmp_path / f"found.{form}", form, **more)  # type: ignore[arg-type]
        assert found.frame.tolist() == [0, 0]
        np.testing.assert_array_equal(np.asarray(found.semi_axes_mm)[:, 2], rows[:, 3])
    with refused("4 columns", "x, y, z"):
        read_tracks(tmp_path / "found.npy", "npy", names=names[:3])
    with refused("columns", "openptv"):
        read_tracks(tmp_path, "openptv", names=names)


def test_bubbles_turn_with_the_world() -> None:
    """The matrix of an ellipsoid in another world is that of its turned points."""
    rows = tuple(triple(row) for row in rotation_matrices(np.array([0.3, -0.8, 0.5])))
    true, world = bubbles(), ForeignWorld((1.0, -2.0, 3.0), rows)
    there, back = true.into(world), true.into(world).back(world)
    np.testing.assert_allclose(np.asarray(back.turn), np.asarray(true.turn), atol=1e-14)
    for row in range(len(true)):
        axes = np.diag(np.asarray(true.semi_axes_mm)[row])
        tip = axes @ np.asarray(true.turn)[row] + true.position_mm[row]
        turned = axes @ np.asarray(there.turn)[row] + there.position_mm[row]
        np.testing.assert_allclose(world.into(tip), turned, atol=1e-13)


AXES = "frame,x,y,z,a,b,c," + ",".join(f"turn_{i}{j}" for i in "123" for j in "123") + "\n"


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("frame,x,y,z,radius\n0,1,2,3,1\n0,1,2,3,-1\n", "radius: expected positive"),
        ("frame,x,y,z,d\n0,1,2,3,0\n", "in row 1"),
        ("frame,x,y,z,radius\n0,1,2,3,nan\n", "line 2, column 5"),
        ("frame,x,y,z,radius\n0,1,5,2,0,3,0,0,5\n", "decimal commas"),
        ("frame,x,y,z,x,radius\n0,1,2,3,4,1\n", "different names"),
        (AXES + "0,1,2,3,1,1,1,1,0,0,0,1,0,0,0,1\n0,1,2,3,1,1,1,1,0,0,0,1,0,0,1,1\n", "row 2"),
    ],
)
def test_broken_bubbles(text: str, key: str, tmp_path: Path) -> None:
    (tmp_path / "found.csv").write_text(text, encoding="utf-8")
    with refused("found.csv", key):
        read_tracks(tmp_path / "found.csv", "csv", bubbles=True)


BROKEN = [
    ("npy", "x,y,z\n1,2,3\n", ".npy"),
    ("csv", "0,1,2,3,4\n", ""),
    ("csv", HEAD + "0,1,2,3\n", ""),
    ("csv", HEAD + "0,1,2,3,4\n0,1,2,3\n", "line 3"),
    ("csv", HEAD + "0,1,2,x,4\n0,1,2,3,4\n", "line 2, column 4"),
    ("csv", HEAD + "0,1,2,nan,4\n", "line 2, column 4"),
    ("csv", HEAD + "0,1.5,2,3,4\n", "particle"),
    ("csv", "frame,a,b,c\n0,1,2,3\n", "frame, a, b, c"),
    ("csv", "x,y,z,w\n0,1,2,3\n", "x, y, z, w"),
    ("csv", HEAD.replace("x", "x [parsec]") + "0,1,2,3,4\n", "parsec"),
    ("myptv", "1 2 3\n", "line 1"),
    ("myptv", "1 2.5 3.5 4.5 0.5\n", "last column"),
    ("openlpt", "A,B,C,D,E\n1,2,3,4,5\n", "TrackID"),
    ("lpt-challenge", "1 2 3 4\n1 2 3\n", "line 2"),
    ("lpt-challenge", "1 2 three\n", "line 1, column 3"),
    ("netcdf", "CDF nothing", "NetCDF"),
    ("netcdf", "nothing", "HDF5"),
    ("mat", "nothing", "MATLAB"),
]


@pytest.mark.parametrize(("form", "text", "key"), BROKEN)
def test_broken_files(form: TrackFormat, text: str, key: str, tmp_path: Path) -> None:
    (tmp_path / "found").write_text(text, encoding="utf-8")
    with refused("found", key) as error:
        read(tmp_path / "found", form)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("form", FORMATS)
def test_nothing_there_is_one_sentence(form: TrackFormat, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for name in ("empty", "nowhere"):
        with refused(name):
            read(tmp_path / name, form)


def test_openptvs_counts_are_checked(tmp_path: Path) -> None:
    write(tmp_path / "out", particles(), "openptv")
    file = tmp_path / "out/res/ptv_is.10002"
    lines = file.read_text(encoding="utf-8").splitlines()
    file.write_text("\n".join(lines[:-1]), encoding="utf-8")
    with refused("ptv_is.10002: line 1"):
        read(tmp_path / "out", "openptv")
    file.write_text("\n".join([lines[0], *(line + " 9 9" for line in lines[1:])]), encoding="utf-8")
    assert len(read(tmp_path / "out", "openptv")) == len(particles())


def test_units_scale_positions(tmp_path: Path) -> None:
    for form in FORMATS:
        write(tmp_path / form, particles(), form)
        if form not in ("netcdf", "mat", "npy", "csv"):  # these name their unit
            found = read(tmp_path / form, form, "um")
            np.testing.assert_allclose(1e3 * found.position_mm, particles().position_mm)
    with refused("unit"):
        read(tmp_path / "openptv", "openptv", "ell")


def test_padded_arrays_of_trajectories_are_read(tmp_path: Path) -> None:
    gap = np.nan
    with netcdf_file(tmp_path / "tracks.nc", "w") as file:
        file.createDimension("trajectory", 2)
        file.createDimension("obs", 3)
        frames, x = [[0.0, 1.0, 2.0], [1.0, 2.0, gap]], [[1.0, 2.0, 3.0], [7.0, 8.0, gap]]
        y, z = [[0.0] * 3, [1.0, 1.0, gap]], [[5.0] * 3, [6.0, 6.0, gap]]
        for name, table in {"frame": frames, "x": x, "y": y, "z": z}.items():
            file.createVariable(name, "f8", ("trajectory", "obs"))[:] = np.array(table)
    found = read(tmp_path / "tracks.nc", "netcdf")
    assert found.frame.tolist() == [0, 1, 1, 2, 2]
    assert found.position_mm[:, 0].tolist() == [1.0, 2.0, 7.0, 3.0, 8.0]
    assert links(found) == {frozenset({0, 1, 3}), frozenset({2, 4})}


def test_older_matlab_files_are_read(tmp_path: Path) -> None:
    true = particles()
    columns = dict(zip("xyz", true.position_mm.T[:, :, None], strict=True))
    savemat(tmp_path / "old.mat", {"frame": true.frame[:, None], "note": "hello", **columns})
    np.testing.assert_array_equal(read(tmp_path / "old.mat", "mat").position_mm, true.position_mm)


def test_myptvs_hdf5_is_read(tmp_path: Path) -> None:
    rows = np.array([[4.0, 1.5, 2.5, 3.5, 0.0, 1.0, 0.1, 0.0], [-1.0, 2.5, 3.5, 4.5, 0, 1, 0.2, 1]])
    with h5py.File(tmp_path / "trajectories.hdf5", "w") as file:
        file["dataset"] = rows.astype(np.float32)
    found = read(tmp_path, "myptv")
    assert found.trajectory is not None
    assert found.trajectory.tolist() == [4, 5]
    np.testing.assert_array_equal(found.position_mm, rows[:, 1:4])


def test_five_cameras_blobs_are_no_velocities(tmp_path: Path) -> None:
    true = dataclasses.replace(particles(), velocity_mm_s=None, acceleration_mm_s2=None)
    (tmp_path / "out").mkdir()
    with pytest.warns(ForeignFormatWarning):
        write_tracks(tmp_path / "out", true, "myptv", Recording([*CAMERAS, CAMERAS[0]], TIMES))
    found = read(tmp_path / "out", "myptv")
    assert found.velocity_mm_s is None
    np.testing.assert_array_equal(found.position_mm, true.position_mm)


def test_netcdf4_reads_our_tracks(tmp_path: Path) -> None:
    netcdf = pytest.importorskip("netCDF4", reason="needs the package netCDF4")
    write(tmp_path / "out", particles(), "netcdf")
    with netcdf.Dataset(tmp_path / "out/tracks.nc") as file:
        assert file["x_mm"].units == "mm"
        np.testing.assert_array_equal(file["x_mm"][:], particles().position_mm[:, 0])
    with netcdf.Dataset(tmp_path / "four.nc", "w") as file:
        file.createDimension("obs", 2)
        for name, values in {"frame": [0, 1], "x": [1.0, 2.0], "y": [3, 4], "z": [5, 6]}.items():
            file.createVariable(name, "f8", ("obs",))[:] = np.array(values, dtype=float)
        file["x"].units = "m"
    assert read(tmp_path / "four.nc", "netcdf").position_mm[:, 0].tolist() == [1000.0, 2000.0]


@pytest.mark.parametrize(
    ("package", "form", "load"),
    [
        ("xarray", "netcdf", lambda xarray, path: xarray.load_dataset(path, decode_times=False)),
        ("mat73", "mat", lambda mat73, path: mat73.loadmat(path)),
    ],
)
def test_other_packages_read_our_tracks(
    package: str, form: TrackFormat, load: Callable[..., Any], tmp_path: Path
) -> None:
    reader = pytest.importorskip(package, reason=f"needs the package {package}")
    write(tmp_path / "out", particles(), form)
    (file,) = (tmp_path / "out").glob("tracks.*")
    found = load(reader, file)
    np.testing.assert_array_equal(np.asarray(found["y_mm"]), particles().position_mm[:, 1])


def test_flowtracks_reads_our_links(tmp_path: Path) -> None:
    flowtracks = pytest.importorskip("flowtracks.io", reason="needs the package flowtracks")
    true = dataclasses.replace(particles(), frame=np.repeat([0, 1], [4, 3]))
    write(tmp_path / "out", true, "openptv")
    (tmp_path / "out/res/ptv_is.10003").unlink()  # it takes no empty frame
    tracks = flowtracks.trajectories(str(tmp_path / "out/res/ptv_is.%d"), fmt="ptvis")
    long = [one for one in tracks if len(one) > 1]
    ends = {tuple(np.round(1e3 * one.pos()[:, 0], 9).tolist()) for one in long}
    x = np.round(true.position_mm[:, 0], 9)
    assert ends == {(x[0], x[6]), (x[2], x[4])}
