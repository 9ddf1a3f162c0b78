"""Files that fill the memory, crash their library or never end are refused with a sentence."""

from __future__ import annotations

import os
import resource
import shutil
import time
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile

from sabench.api import Calibration, Camera
from sabench.api.make import generator_of
from sabench.apps.own_calibration.calibrate import check_finite
from sabench.apps.own_calibration.folder import read_case
from sabench.dataset.hdf5 import open_hdf5, read_array
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.verification import probe, verify
from sabench.images.tiff_exr import read_tiff, write_exr
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, read_json
from sabench.utils.processes import call
from sabench.utils.processes.call import read_isolated
from sabench.worlds.library.mesh_files import read_mesh
from tests.helpers.untrusted import reseal
from tests.helpers.untrusted_files import png

SHAPE = (24, 32)
MB = 1_000_000


def largest_mb() -> float:
    """The largest memory that this process has had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6


def deflated_zeros(size: int) -> bytes:
    """As `zlib.compress(bytes(size))`: packs one megabyte, and takes it again for each of them."""
    packer = zlib.compressobj(9, wbits=-zlib.MAX_WBITS)
    block = packer.compress(bytes(MB)) + packer.flush(zlib.Z_FULL_FLUSH)
    rest = packer.compress(bytes(size % MB)) + packer.flush()
    checksum = size % 65521 << 16 | 1  # Adler-32 of zeros
    return b"\x78\xda" + size // MB * block + rest + checksum.to_bytes(4, "big")


def with_stream(path: Path, size: int) -> Path:
    """A chunk of 2.4 MB whose deflate stream holds `size` bytes."""
    with h5py.File(path, "w") as file:
        node = file.create_dataset("x", (100_000, 3), "f8", chunks=(100_000, 3), compression="gzip")
        node.id.write_direct_chunk((0, 0), deflated_zeros(size))
    return path


@pytest.mark.parametrize("size", [2_399_999, 2_400_001, 2000 * MB])
def test_a_deflate_stream_holds_one_chunk(size: int, tmp_path: Path) -> None:
    path = with_stream(tmp_path / "a.h5", size)
    before = largest_mb()
    with (
        pytest.raises(InputError, match="x: expected a deflate stream of 2400000 bytes"),
        open_hdf5(path) as file,
    ):
        read_array(file, "x", (None, 3), "f")
    assert largest_mb() - before < 100


def test_a_stream_that_no_chunk_justifies_is_found_by_the_probe(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        node = file.create_dataset("x", (1000,), "f8", chunks=(1000,), compression="gzip")
        node.id.write_direct_chunk((0,), os.urandom(1_000_000))
    with pytest.raises(InputError, match="expected chunks of 8000 bytes in this file, got one of"):
        probe(path)


@pytest.mark.parametrize("filters", [{"compression": "lzf"}, {"fletcher32": True}])
def test_another_filter_is_named(filters: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("x", data=np.zeros(1000), chunks=(100,), **filters)
    with pytest.raises(InputError, match="x: expected no filter but deflate, got "):
        probe(path)


@pytest.mark.parametrize("shuffle", [False, True])
def test_chunks_that_do_not_compress_are_read(shuffle: bool, tmp_path: Path) -> None:
    """A writer leaves the filter out of such a chunk."""
    path, values = tmp_path / "a.h5", np.random.default_rng(1).random((1001, 3))
    with h5py.File(path, "w") as file:
        file.create_dataset("x", data=values, chunks=(100, 2), compression="gzip", shuffle=shuffle)
    probe(path)
    with open_hdf5(path) as file:
        np.testing.assert_array_equal(read_array(file, "x", (None, 3), "f"), values)


def spin(_: Path) -> None:
    while True:
        pass


def sleep(_: Path) -> None:
    time.sleep(60.0)


def abort(_: Path) -> None:
    os.abort()


def take(_: Path, size: int) -> None:
    np.ones(size, dtype=np.uint8)


def stumble(_: Path) -> None:
    raise IndexError("17")


def test_every_end_of_a_reader_is_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.vti"
    path.write_bytes(b"x")
    monkeypatch.setattr(call, "_CPU_S", 0.5)
    for read, arguments, words in (
        (spin, (), "could not be checked, because reading it takes more than 1 s of CPU time"),
        (abort, (), "reading it: its process ended with signal SIGABRT"),
        (take, (4000 * MB,), "expected a file that can be read with 1000 MB of memory"),
        (stumble, (), "expected an intact file, got IndexError: 17"),
    ):
        with pytest.raises(InputError, match=f"a.vti: {words}"):
            read_isolated(read, path, *arguments)
    monkeypatch.setattr(call, "_PATIENCE", 0.5)
    with pytest.raises(InputError, match=r"because reading it takes more than 0\.5 s"):
        read_isolated(sleep, path)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"compression": "zlib"}, "compression 1, got 8"),
        ({"compression": "zlib", "predictor": True}, "compression 1, got 8"),
        ({"tile": (16, 16)}, "tiles 0, got 1"),
        ({"photometric": "miniswhite"}, "photometric interpretation 1, got 0"),
    ],
)
def test_a_tiff_of_another_kind_is_not_decoded(
    options: dict[str, Any], words: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.tif"
    image = np.full(SHAPE, 7, np.uint16)
    tifffile.imwrite(path, image, **({"photometric": "minisblack"} | options))
    with pytest.raises(InputError, match=f"an uncompressed 16-bit TIFF.*{words}"):
        read_tiff(path, SHAPE)


@pytest.mark.parametrize("value", [np.nan, -np.inf, np.inf, -1.0])
def test_radiance_that_cannot_be_is_a_fault(value: float, quick: Dataset, tmp_path: Path) -> None:
    root = Path(shutil.copytree(quick.root, tmp_path / "set"))
    radiance = quick.radiance(0)[1].copy()
    radiance[3, 4] = value
    write_exr(root / "images" / "frame_0000" / "camera_01.exr", radiance)
    reseal(root)
    (fault,) = verify(root)
    assert "camera_01.exr: expected finite radiance, 0 or more, got 1 pixels" in fault


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 9\n", "expected a mesh as STL"),
        (
            "a.obj",
            "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n",
            "expected",
        ),
        ("a.stl", "solid x", "expected a mesh with faces, got none"),
        ("a.3mf", "x", "a name that ends in .stl, .ply, .obj, .glb, got .3mf"),
    ],
)
def test_a_damaged_mesh_is_a_sentence(name: str, text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=f"{name}: .*{words}"):
        read_mesh(tmp_path / name)


CALIBRATION = """
target_mm = [0.0, 0.0, 30.0]
target = { pattern = "checkerboard", columns = 5, rows = 4, pitch_mm = 0.4 }
array = { rows = 24, columns = 32, pixel_mm = 0.02, focal_length_mm = 85.0 }
cameras = [
    { name = "a", center_mm = [-100.0, 0.0, -400.0], aim_mm = [0.0, 0.0, 30.0] },
    { name = "b", center_mm = [100.0, 0.0, -400.0], aim_mm = [0.0, 0.0, 30.0] },
]
"""
HEADER = b"camera,frame,point,column,row\n"


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (b"a,0,0,1.5," + b"1" * 140_000, "points.csv: line 2: row: expected a number of -1e"),
        (b"\xff,0,0,1.5,2.5", "points.csv: line 2: expected one of the cameras a, b, got ÿ"),
        (b"a,1000000000000000000,0,1.5,2.5", "points.csv: expected frames counted from 0 and at"),
        (b"a,100000,0,1.5,2.5", "at most 1, for 1 points found, got frame 100000"),
        (
            b"a,0,0,1e300,2.5",
            "points.csv: line 2: column: expected a number of -1e\\+06 to 1e\\+06",
        ),
    ],
)
def test_damaged_points_are_a_sentence(points: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "calibration.toml").write_text(CALIBRATION)
    (tmp_path / "points.csv").write_bytes(HEADER + points + b"\n")
    with pytest.raises(InputError, match=words):
        read_case(tmp_path)


def test_a_huge_photograph_is_not_decoded(tmp_path: Path) -> None:
    (tmp_path / "calibration.toml").write_text(CALIBRATION)
    folder = tmp_path / "images" / "0"
    folder.mkdir(parents=True)
    (folder / "a.png").write_bytes(png(24, 32))
    before = largest_mb()
    for rows, columns in ((40_000, 40_000), (32_000, 32_000)):
        (folder / "b.png").write_bytes(png(rows, columns, empty=True))
        with pytest.raises(InputError, match=r"b\.png: expected (an image|24 x 32)"):
            read_case(tmp_path)
    assert largest_mb() - before < 200


def test_a_calibration_that_its_data_do_not_determine(quick: Dataset) -> None:
    first, *others = quick.setup.cameras
    assert isinstance(first, Camera)
    lost = replace(first, center_mm=(0.0, np.nan, 0.0))
    with pytest.raises(InputError, match="solver mine: expected finite cameras, got"):
        check_finite(Calibration((lost, *others)), "mine")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"frames": 1 << 31}, "frames: expected a number less than or equal to 1000000"),
        ({"shows": []}, "shows: expected particles, bubbles or both"),
        ({"shows": ["code"]}, r"code after bubbles only, got \['code'\]"),
        ({"shows": ["particles", "code"]}, "code after bubbles only"),
        ({"grid": {"low_mm": [1e308, 0.0, 0.0]}}, r"grid: expected at most 1e\+09 mm, got 1e\+308"),
        ({"grid": {"voxel_mm": [1e308, 1e308, 1e308]}}, r"grid: expected at most 1e\+09 mm"),
        ({"grid": {"shape": [10**400, 2, 2]}}, "voxels or pixels along a side"),
        ({"wall": {"layers": 4000}}, "wall: expected at most 20 layers, got 4000"),
    ],
)
def test_cameras_that_cannot_be(
    change: dict[str, Any], words: str, quick: Dataset, tmp_path: Path
) -> None:
    root = Path(shutil.copytree(quick.root, tmp_path / "set"))
    values = read_json(root / "cameras.json")
    for key, value in change.items():
        values[key] = values[key] | value if isinstance(value, dict) else value
    if values["wall"]["layers"] == 4000:
        values["wall"]["layers"] = read_json(root / "cameras.json")["wall"]["layers"][:1] * 4000
    (root / "cameras.json").write_text(canonical_json(values))
    reseal(root)
    with pytest.raises(InputError, match=words):
        _ = open_dataset(root).setup
    (fault,) = verify(root)
    assert "cameras.json" in fault


def test_a_scene_of_a_data_set_is_checked(tmp_path: Path) -> None:
    for given, words in (
        ({}, "generator: expected the name of a generator, got None"),
        ({"generator": "uniform", "count": "x"}, "generator uniform: count: expected"),
    ):
        with pytest.raises(InputError, match=words):
            generator_of(given)
