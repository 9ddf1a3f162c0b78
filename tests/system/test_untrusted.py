"""Damaged files: refused with one sentence, within limits of time and memory."""

import json
import os
import re
import resource
import shutil
import subprocess
import sys
import time
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile

import sabench
from sabench.api import Calibration, Camera
from sabench.api.make import generator_of
from sabench.apps.own_calibration.calibrate import check_finite
from sabench.apps.own_calibration.folder import read_case
from sabench.dataset import hdf5
from sabench.dataset.hdf5 import open_hdf5, read_array
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.schema import read_target
from sabench.dataset.verification import probe, verify
from sabench.evaluation.suite_loading import load_suite
from sabench.images.tiff_exr import read_tiff, write_exr
from sabench.scenes import load_scene, parse_scene
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, read_json
from sabench.utils.processes import call
from sabench.utils.processes.call import read_isolated
from sabench.worlds.library.mesh_files import read_mesh
from tests.conftest import ROOT
from tests.helpers.untrusted import KINDS, LARGEST_STEPS, SCENE, check_sentence, reseal, steps_of
from tests.helpers.untrusted_files import png


@pytest.mark.slow
def test_damaged_input_is_refused_by_one_sentence_or_taken(tmp_path: Path) -> None:
    """Without submissions, each of which starts processes."""
    kinds = [word for kind in sorted({*KINDS} - {"submission"}) for word in ("--kind", kind)]
    words = [
        sys.executable,
        str(ROOT / "benchmarks" / "fuzz.py"),
        "--count",
        "72",
        "--seed",
        "7",
        "--limit",
        "60",
        "--keep",
        str(tmp_path / "kept"),
        *kinds,
    ]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"^all +72 +\d+ +\d+ +0 +0 +0 +0 +\d+$", done.stdout, re.MULTILINE), (
        done.stdout
    )


@pytest.mark.parametrize(
    "large",
    [
        {"frames": 160},
        {"cameras": SCENE["cameras"] | {"rows": 2000, "columns": 1500}},
        {"cameras": SCENE["cameras"] | {"layout": SCENE["cameras"]["layout"] | {"rows": 255}}},
        {"particles": SCENE["particles"] | {"count": 3000}},
    ],
    ids=["frames", "pixels", "cameras", "particles"],
)
def test_fuzzing_generates_no_scene_that_is_valid_but_large(large: dict[str, object]) -> None:
    """Two rows of 255 cameras took 25 s, which looked like a hang."""
    assert steps_of(parse_scene(SCENE, "small")) < 0.1 * LARGEST_STEPS
    assert steps_of(parse_scene(SCENE | large, "large")) > LARGEST_STEPS


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "a.h5"


def test_what_a_file_only_says_that_it_holds_is_not_read(file: Path) -> None:
    with h5py.File(file, "w") as made:
        made.create_dataset("empty", (10**8, 3), "f8", chunks=(1000, 3))
        made.create_dataset("huge", (10**10, 3), "f8", chunks=(1000, 3))
        made.create_dataset("chunk", (3, 3), "f8", chunks=(10**7, 3), maxshape=(None, 3))
        made.create_dataset("null", data=h5py.Empty("f8"))
        made.create_dataset("wide", (3, 3), np.longdouble)
        made.create_dataset("fine", data=np.arange(6.0).reshape(2, 3), compression="gzip")
    with open_hdf5(file) as again:
        for name in ("empty", "huge"):
            with pytest.raises(InputError, match=r"at most 2000 MB|fit into memory"):
                read_array(again, name, (None, 3), "f")
        with pytest.raises(InputError, match="chunks no larger than the data set"):
            read_array(again, "chunk", (None, 3), "f")
        for name in ("null", "wide"):
            with pytest.raises(InputError, match="expected shape"):
                read_array(again, name, (None, 3), "f")
        np.testing.assert_array_equal(
            read_array(again, "fine", (None, 3), "f"), np.arange(6.0).reshape(2, 3)
        )


def test_a_deflated_bomb(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hdf5, "_SMALL", 1000)
    with h5py.File(file, "w") as made:
        made.create_dataset(
            "zeros", (10**6, 3), "f8", chunks=(10**5, 3), compression="gzip", compression_opts=9
        )
        del made["zeros"]
        made.create_dataset("unwritten", (10**6, 3), "f8", chunks=(10**5, 3), compression="gzip")
    with (
        open_hdf5(file) as again,
        pytest.raises(InputError, match="expected values that the file stores"),
    ):
        read_array(again, "unwritten", (None, 3), "f")


def test_a_picture_that_says_that_it_is_huge(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(
        path, np.zeros((2, 24, 32), np.uint16), photometric="minisblack", metadata=None
    )
    with pytest.raises(InputError, match="and 1 more"):
        read_tiff(path, (24, 32))
    tifffile.imwrite(path, np.zeros((4000, 4000), np.uint16), compression="zlib")
    with pytest.raises(InputError, match=r"got uint16 of shape \(4000, 4000\)"):
        read_tiff(path, (24, 32))


def test_errors_are_one_line_whatever_they_quote() -> None:
    assert str(InputError("a\nb\x1b[2J")) == "a b?[2J"
    long = str(InputError("x" * 10_000 + "end"))
    assert len(long) < 1300
    assert long.endswith("end")


def test_deep_and_broken_text(tmp_path: Path) -> None:
    deep = tmp_path / "deep.json"
    deep.write_text("[" * 100_000)
    with pytest.raises(InputError, match="expected a JSON file"):
        read_json(deep)
    for name, load in (("scene.toml", load_scene), ("suite.toml", load_suite)):
        (tmp_path / name).write_text("x = " + "[" * 100_000)
        with pytest.raises(InputError, match="expected a TOML file"):
            load(tmp_path / name)
    assert canonical_json({"a": json.loads('"\\ud800"')}) == '{\n "a": "?"\n}\n'


def test_scenes_and_suites_that_ask_for_too_much(tmp_path: Path, quick_toml: str) -> None:
    for old, new, words in (
        ("columns = 2,", "columns = 1000000,", "at most 1000 cameras, got 2000000"),
        ("count = 300", "count = 1000000000", "particles.count"),
        ("count = 300", "per_mm3 = 1e12", "at most 50000000 of them"),
        ("rows = 240\ncolumns = 320", "rows = 1000000\ncolumns = 1000000", "cameras.rows"),
        ("frames = 1", "frames = 1000000000", "fits on the disk"),
        ("direction = [1.0", 'scattering = "isotropic"\ndirection = [1.0', ""),
    ):
        assert old in quick_toml
        (tmp_path / "s.toml").write_text(quick_toml.replace(old, new))
        if words:
            with pytest.raises(InputError, match=re.escape(words)):
                sabench.generate(tmp_path / "s.toml", tmp_path / "out", backend="splat")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["s.toml"]
    values = ", ".join(map(str, range(2000)))
    (tmp_path / "suite.toml").write_text(
        f'title = "t"\nscenes = ["quick"]\nvary = {{ "particles.count" = [{values}] }}\n'
        f'solvers = [{{ name = "asa" }}]\n'
    )
    with pytest.raises(InputError, match="at most 1000 cases, got 2000"):
        load_suite(tmp_path / "suite.toml")


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [
        ("cameras", "pixel_mm", 1e300),
        ("illumination", "pulse_energy_mj", 1e300),
        ("cameras", "focus_mm", 1e300),
    ],
)
def test_extreme_numbers_end_well(tmp_path: Path, table: str, key: str, value: float) -> None:
    try:
        scene = parse_scene({**SCENE, table: {**SCENE[table], key: 1e300}}, "extreme")
        made = sabench.generate(scene, tmp_path / "set", backend="splat")
    except InputError as error:
        check_sentence(str(error))
    else:
        assert verify(made.root) == []


@pytest.mark.parametrize(
    ("columns", "pitch_mm", "expected"),
    [
        (4_000_000_000_001, 1.0, "expected 2 to 1000000 points"),
        (5, 1.7e308, r"pitch_mm of at most 1e\+06"),
    ],
)
def test_a_huge_target_is_refused(
    tmp_path: Path, columns: int, pitch_mm: float, expected: str
) -> None:
    target = {
        "pattern": "circles",
        "columns": columns,
        "rows": 1,
        "pitch_mm": pitch_mm,
        "mark_mm": 0.5,
    }
    (tmp_path / "target.json").write_text(
        canonical_json({"format": "sabench-dataset", "version": 1, "target": target})
    )
    with pytest.raises(InputError, match=expected):
        read_target(tmp_path)


def test_particle_images_wider_than_any_sensor_are_refused(quick: Dataset, tmp_path: Path) -> None:
    root = Path(shutil.copytree(quick.root, tmp_path / "set"))
    camera = quick.setup.cameras[0].name
    name = f"frames/0000/cameras/{camera}/sigma_px"
    with h5py.File(root / "truth.h5", "r+") as file:
        file[name][0] = 1e18
    with pytest.raises(InputError, match=f"{name}: expected values of at most 1000, got 1e"):
        open_dataset(root).views(0)


def test_more_frames_than_tasks_list_are_one_fault(quick: Dataset, tmp_path: Path) -> None:
    root = Path(shutil.copytree(quick.root, tmp_path / "set"))
    cameras = read_json(root / "cameras.json")
    (root / "cameras.json").write_text(canonical_json({**cameras, "frames": 10**15}))
    reseal(root)
    (fault,) = verify(root)
    assert "less than or equal to 1000000" in fault


SHAPE = (24, 32)
MB = 1_000_000


def largest_mb() -> float:
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


@pytest.mark.slow
def test_ends_of_a_reader_are_sentences(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
def test_other_tiffs_are_not_decoded(options: dict[str, Any], words: str, tmp_path: Path) -> None:
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
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "expected"),
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
        (b"a,0,0,1e300,2.5", "points.csv: line 2: column: expected a number of -1e\\+06 to"),
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
def test_bad_cameras(change: dict[str, Any], words: str, quick: Dataset, tmp_path: Path) -> None:
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
