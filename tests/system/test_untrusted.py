"""Some hundred damaged files of every kind.

They are a part of what benchmarks/fuzz.py tries, and the faults that it once found.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

import sabench
from sabench.dataset import hdf5
from sabench.dataset.hdf5 import open_hdf5, read_array
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.schema import read_target
from sabench.dataset.verification import verify
from sabench.evaluation.suite_loading import load_suite
from sabench.images.tiff_exr import read_tiff
from sabench.scenes import load_scene, parse_scene
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, read_json
from tests.conftest import ROOT
from tests.helpers.untrusted import (
    KINDS,
    LARGEST_STEPS,
    SCENE,
    check_sentence,
    reseal,
    steps_of,
)


def test_damaged_input_is_refused_by_one_sentence_or_taken(tmp_path: Path) -> None:
    """Without submissions, each of which starts processes."""
    kinds = [word for kind in sorted({*KINDS} - {"submission"}) for word in ("--kind", kind)]
    words = [
        sys.executable,
        str(ROOT / "benchmarks" / "fuzz.py"),
        "--count",
        "144",
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
    assert re.search(r"^all +144 +\d+ +\d+ +0 +0 +0 +0 +\d+$", done.stdout, re.MULTILINE), (
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


def test_attributes_of_other_kinds(quick: Dataset, quick_result: Path, file: Path) -> None:
    for name, value in {
        "parameters": "[1]",
        "seconds": np.zeros(3),
        "solver": h5py.Empty("f4"),
        "task": "x" * 60_000,
        "peak_mb": float("inf"),
    }.items():
        shutil.copy(quick_result, file)
        with h5py.File(file, "r+") as made:
            made.attrs[name] = value
        with pytest.raises(InputError, match=f"attribute {name}"):
            sabench.score(quick, file)
    shutil.copy(quick_result, file)
    with h5py.File(file, "r+") as made:
        made.attrs["version"], made.attrs["seconds"], made.attrs["solver"] = (
            np.array([2]),
            np.array([2.5]),
            np.bytes_("\x1b[2Jmine"),
        )
    scores = sabench.score(quick, file)
    assert (scores["seconds"], scores["solver"]) == (2.5, "?[2Jmine")


def test_parameters_that_json_cannot_hold(quick: Dataset, quick_result: Path, file: Path) -> None:
    for text in ('{"a": NaN}', '{"a": 1e999}', "[" * 5000):
        shutil.copy(quick_result, file)
        with h5py.File(file, "r+") as made:
            made.attrs["parameters"] = text
        with pytest.raises(InputError, match="attribute parameters: expected a JSON object"):
            sabench.score(quick, file)


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
def test_extreme_numbers_end_well_or_in_a_sentence(
    tmp_path: Path, table: str, key: str, value: float
) -> None:
    try:
        scene = parse_scene({**SCENE, table: {**SCENE[table], key: 1e300}}, "extreme")
        made = sabench.generate(scene, tmp_path / "set", backend="splat")
    except InputError as error:
        check_sentence(str(error))
    else:
        assert verify(made.root) == []


def test_names_that_no_disk_can_hold_are_refused_in_suites(tmp_path: Path) -> None:
    text = 'title = "t"\nscenes = ["quick"]\nbackend = "splat"\nsolvers = [{ name = "asa" }]\n'
    for old, words in (
        ('"quick"', "expected a name of at most 200"),
        ('"asa"', "no solver is named"),
    ):
        (tmp_path / "s.toml").write_text(text.replace(old, f'"{"x" * 5000}"'))
        with pytest.raises(InputError, match=words):
            load_suite(tmp_path / "s.toml")


def test_a_suite_of_too_many_scenes_is_refused_before_any_is_read(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(
        f'title = "t"\nscenes = {["quick"] * 1001}\nsolvers = [{{ name = "asa" }}]\n'.replace(
            "'", '"'
        )
    )
    with pytest.raises(InputError, match="expected at most 1000, got 1001"):
        load_suite(tmp_path / "s.toml")


@pytest.mark.parametrize(
    ("columns", "pitch_mm", "expected"),
    [
        (4_000_000_000_001, 1.0, "expected 2 to 1000000 points"),
        (5, 1.7e308, r"pitch_mm of at most 1e\+06"),
    ],
)
def test_a_target_beyond_all_measure_is_refused(
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


def test_frames_beyond_counting_end_in_a_hundred_faults(quick: Dataset, tmp_path: Path) -> None:
    root = Path(shutil.copytree(quick.root, tmp_path / "set"))
    cameras = read_json(root / "cameras.json")
    (root / "cameras.json").write_text(canonical_json({**cameras, "frames": 10**6}))
    reseal(root)
    faults = verify(root)
    assert len(faults) == 100
    assert "frame_0001" in faults[0]


def test_more_frames_than_tasks_list_are_one_fault(quick: Dataset, tmp_path: Path) -> None:
    root = Path(shutil.copytree(quick.root, tmp_path / "set"))
    cameras = read_json(root / "cameras.json")
    (root / "cameras.json").write_text(canonical_json({**cameras, "frames": 10**15}))
    reseal(root)
    (fault,) = verify(root)
    assert "less than or equal to 1000000" in fault
