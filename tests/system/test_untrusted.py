"""Damaged files: refused with one sentence, within limits of time and memory."""

import json
import os
import re
import resource
import shutil
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
from sabench.utils.processes.call import read_isolated
from sabench.worlds.library.mesh_files import read_mesh
from tests.conftest import ROOT
from tests.helpers.commands import run_python
from tests.helpers.refusals import check_sentence as check, refused
from tests.helpers.untrusted import KINDS, LARGEST_STEPS, SCENE, check_sentence, reseal, steps_of
from tests.helpers.untrusted_files import png


@pytest.mark.slow
def test_damaged_input_is_refused_by_one_sentence_or_taken(tmp_path: Path) -> None:
    """Without submissions, each of which starts processes."""
    kinds = [word for kind in sorted({*KINDS} - {"submission"}) for word in ("--kind", kind)]
    options = f"--count 72 --seed 7 --limit 60 --keep {tmp_path / 'kept'}".split()
    done = run_python(ROOT / "benchmarks" / "fuzz.py", *options, *kinds, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"^all +72 +\d+ +\d+ +0 +0 +0 +0 +\d+$", done.stdout, re.M), done.stdout


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
            with pytest.raises(InputError, match=name):  # memory decides which sentence it is
                read_array(again, name, (None, 3), "f")
        for name in ("chunk", "null", "wide"):
            with refused(name):
                read_array(again, name, (None, 3), "f")
        np.testing.assert_array_equal(
            read_array(again, "fine", (None, 3), "f"), np.arange(6.0).reshape(2, 3)
        )


def test_a_deflated_bomb(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hdf5, "LARGEST_TEXT", 1000)
    with h5py.File(file, "w") as made:
        made.create_dataset(
            "zeros", (10**6, 3), "f8", chunks=(10**5, 3), compression="gzip", compression_opts=9
        )
        del made["zeros"]
        made.create_dataset("unwritten", (10**6, 3), "f8", chunks=(10**5, 3), compression="gzip")
    with open_hdf5(file) as again, refused("unwritten"):
        read_array(again, "unwritten", (None, 3), "f")


def test_a_picture_that_says_that_it_is_huge(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(
        path, np.zeros((2, 24, 32), np.uint16), photometric="minisblack", metadata=None
    )
    with refused("a.tif"):
        read_tiff(path, (24, 32))
    tifffile.imwrite(path, np.zeros((4000, 4000), np.uint16), compression="zlib")
    with refused("a.tif"):
        read_tiff(path, (24, 32))


def test_errors_are_one_line_whatever_they_quote() -> None:
    assert str(InputError("a\nb\x1b[2J")) == "a b?[2J"
    long = str(InputError("x" * 10_000 + "end"))
    assert len(long) < 1300
    assert long.endswith("end")


def test_deep_and_broken_text(tmp_path: Path) -> None:
    deep = tmp_path / "deep.json"
    deep.write_text("[" * 100_000)
    with pytest.raises(InputError, match=r"deep\.json"):  # the parser's words are Python's
        read_json(deep)
    for name, load in (("scene.toml", load_scene), ("suite.toml", load_suite)):
        (tmp_path / name).write_text("x = " + "[" * 100_000)
        with pytest.raises(InputError, match=name):
            load(tmp_path / name)
    assert canonical_json({"a": json.loads('"\\ud800"')}) == '{\n "a": "?"\n}\n'


def test_scenes_and_suites_that_ask_for_too_much(tmp_path: Path, quick_toml: str) -> None:
    for old, new, key in (
        ("columns = 2,", "columns = 1000000,", "cameras"),
        ("count = 300", "count = 1000000000", "particles.count"),
        ("count = 300", "per_mm3 = 1e12", "particles"),
        ("rows = 240\ncolumns = 320", "rows = 1000000\ncolumns = 1000000", "cameras.rows"),
        ("frames = 1", "frames = 1000000000", "disk"),
    ):
        assert old in quick_toml
        (tmp_path / "s.toml").write_text(quick_toml.replace(old, new))
        with refused(key):
            sabench.generate(tmp_path / "s.toml", tmp_path / "out", backend="splat")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["s.toml"]
    values = ", ".join(map(str, range(2000)))
    (tmp_path / "suite.toml").write_text(
        f'title = "t"\nscenes = ["quick"]\nvary = {{ "particles.count" = [{values}] }}\n'
        f'solvers = [{{ name = "asa" }}]\n'
    )
    with refused("suite.toml"):
        load_suite(tmp_path / "suite.toml")


@pytest.mark.parametrize(
    ("table", "key"),
    [("cameras", "pixel_mm"), ("illumination", "pulse_energy_mj"), ("cameras", "focus_mm")],
)
def test_extreme_numbers_end_well(tmp_path: Path, table: str, key: str) -> None:
    try:
        scene = parse_scene({**SCENE, table: {**SCENE[table], key: 1e300}}, "extreme")
        made = sabench.generate(scene, tmp_path / "set", backend="splat")
    except InputError as error:
        check_sentence(str(error))
    else:
        assert verify(made.root) == []


@pytest.mark.parametrize(
    "large", [{"columns": 4_000_000_000_001}, {"pitch_mm": 1.7e308}], ids=["points", "pitch"]
)
def test_a_huge_target_is_refused(tmp_path: Path, large: dict[str, Any]) -> None:
    board = {"pattern": "circles", "columns": 5, "rows": 1, "pitch_mm": 1.0, "mark_mm": 0.5}
    head = {"format": "sabench-dataset", "version": 1, "target": board | large}
    (tmp_path / "target.json").write_text(canonical_json(head))
    with refused("target.json"):
        read_target(tmp_path)


@pytest.fixture
def root(quick: Dataset, tmp_path: Path) -> Path:
    return Path(shutil.copytree(quick.root, tmp_path / "set"))


def test_particle_images_wider_than_any_sensor_are_refused(quick: Dataset, root: Path) -> None:
    camera = quick.setup.cameras[0].name
    name = f"frames/0000/cameras/{camera}/sigma_px"
    with h5py.File(root / "truth.h5", "r+") as file:
        file[name][0] = 1e18
    with refused(name):
        open_dataset(root).views(0)


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


@pytest.mark.parametrize("size", [2_399_999, 2_400_001, 2000 * MB])
def test_a_deflate_stream_holds_one_chunk(size: int, tmp_path: Path) -> None:
    path = tmp_path / "a.h5"  # a chunk of 2.4 MB
    with h5py.File(path, "w") as file:
        node = file.create_dataset("x", (100_000, 3), "f8", chunks=(100_000, 3), compression="gzip")
        node.id.write_direct_chunk((0, 0), deflated_zeros(size))
    before = largest_mb()
    with refused("x"), open_hdf5(path) as file:
        read_array(file, "x", (None, 3), "f")
    assert largest_mb() - before < 100


def test_a_stream_that_no_chunk_justifies_is_found_by_the_probe(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        node = file.create_dataset("x", (1000,), "f8", chunks=(1000,), compression="gzip")
        node.id.write_direct_chunk((0,), os.urandom(1_000_000))
    with refused("a.h5"):
        probe(path)


@pytest.mark.parametrize("filters", [{"compression": "lzf"}, {"fletcher32": True}])
def test_another_filter_is_named(filters: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("x", data=np.zeros(1000), chunks=(100,), **filters)
    with refused("x"):
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


def take(_: Path, size: int) -> None:
    np.ones(size, dtype=np.uint8)


@pytest.mark.slow
def test_a_file_that_takes_gigabytes_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.vti").write_bytes(b"x")
    with refused("a.vti"):
        read_isolated(take, tmp_path / "a.vti", 4000 * MB)


@pytest.mark.parametrize(
    "options",
    [
        {"compression": "zlib"},
        {"compression": "zlib", "predictor": True},
        {"tile": (16, 16)},
        {"photometric": "miniswhite"},
    ],
)
def test_other_tiffs_are_not_decoded(options: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    image = np.full(SHAPE, 7, np.uint16)
    tifffile.imwrite(path, image, **({"photometric": "minisblack"} | options))
    with refused("a.tif"):
        read_tiff(path, SHAPE)


@pytest.mark.parametrize("value", [np.nan, -np.inf, np.inf, -1.0])
def test_radiance_that_cannot_be_is_a_fault(value: float, quick: Dataset, root: Path) -> None:
    radiance = quick.radiance(0)[1].copy()
    radiance[3, 4] = value
    write_exr(root / "images" / "frame_0000" / "camera_01.exr", radiance)
    reseal(root)
    (fault,) = verify(root)
    check(fault, "camera_01.exr")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 9\n"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n"),
        ("a.stl", "solid x"),
        ("a.3mf", "x"),
    ],
    ids=["no such vertex", "NaN", "no faces", "another kind"],
)
def test_a_damaged_mesh_is_a_sentence(name: str, text: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with refused(name):
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
    "points",
    [
        b"a,0,0,1.5," + b"1" * 140_000,
        b"\xff,0,0,1.5,2.5",
        b"a,1000000000000000000,0,1.5,2.5",
        b"a,100000,0,1.5,2.5",
        b"a,0,0,1e300,2.5",
    ],
    ids=["long row", "camera", "huge frame", "large frame", "column"],
)
def test_damaged_points_are_a_sentence(points: bytes, tmp_path: Path) -> None:
    (tmp_path / "calibration.toml").write_text(CALIBRATION)
    (tmp_path / "points.csv").write_bytes(HEADER + points + b"\n")
    with refused("points.csv"):
        read_case(tmp_path)


def test_a_huge_photograph_is_not_decoded(tmp_path: Path) -> None:
    (tmp_path / "calibration.toml").write_text(CALIBRATION)
    folder = tmp_path / "images" / "0"
    folder.mkdir(parents=True)
    (folder / "a.png").write_bytes(png(24, 32))
    before = largest_mb()
    for rows, columns in ((40_000, 40_000), (32_000, 32_000)):
        (folder / "b.png").write_bytes(png(rows, columns, empty=True))
        with refused("b.png"):
            read_case(tmp_path)
    assert largest_mb() - before < 200


def test_a_calibration_that_its_data_do_not_determine(quick: Dataset) -> None:
    first, *others = quick.setup.cameras
    assert isinstance(first, Camera)
    lost = replace(first, center_mm=(0.0, np.nan, 0.0))
    with refused("mine"):
        check_finite(Calibration((lost, *others)), "mine")


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"frames": 10**15}, "frames"),
        ({"shows": []}, "shows"),
        ({"shows": ["code"]}, "code"),
        ({"shows": ["particles", "code"]}, "code"),
        ({"grid": {"low_mm": [1e308, 0.0, 0.0]}}, "grid"),
        ({"grid": {"voxel_mm": [1e308, 1e308, 1e308]}}, "grid"),
        ({"grid": {"shape": [10**400, 2, 2]}}, "grid"),
        ({"wall": {"layers": 4000}}, "wall"),
    ],
)
def test_bad_cameras(change: dict[str, Any], key: str, root: Path) -> None:
    values = read_json(root / "cameras.json")
    for key, value in change.items():
        values[key] = values[key] | value if isinstance(value, dict) else value
    if values["wall"]["layers"] == 4000:
        values["wall"]["layers"] = read_json(root / "cameras.json")["wall"]["layers"][:1] * 4000
    (root / "cameras.json").write_text(canonical_json(values))
    reseal(root)
    with refused(key):
        _ = open_dataset(root).setup
    (fault,) = verify(root)
    assert "cameras.json" in fault


def test_a_scene_of_a_data_set_is_checked(tmp_path: Path) -> None:
    for given, key in (({}, "generator"), ({"generator": "uniform", "count": "x"}, "count")):
        with refused(key):
            generator_of(given)
