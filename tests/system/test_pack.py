"""The observation side of a data set, for participants of a private test set."""

from __future__ import annotations

import json
import shutil
import zipfile
from pathlib import Path

import pytest

import sabench
from sabench import plugins, tasks
from sabench.dataset.copies import pack
from sabench.dataset.reader import Dataset, open_dataset
from sabench.tasks.conformance import example
from sabench.tasks.solve_and_score import score, solve
from sabench.utils.errors import InputError
from tests.conftest import Command

ONE_OF_EACH = {  # a fast solver of every task
    "asa": "reconstruction",
    "ray_triangulation": "particles",
    "pinhole_linear": "calibration",
    "piv3d_plain": "velocimetry",
    "minimum_image": "bubbles",
    "see_through": "see_through",
}


@pytest.mark.slow
@pytest.mark.parametrize("solver", ONE_OF_EACH)
def test_a_solver_takes_the_observation_side_and_scores_the_same(
    solver: str, tmp_path: Path
) -> None:
    task = tasks.of(ONE_OF_EACH[solver])
    data = example(task, plugins.load("solvers", solver).sees, tmp_path / "data")
    seen = open_dataset(pack(data, tmp_path / "seen", blind=True))
    assert not seen.has_truth
    assert sabench.verify(seen.root) == []
    solve(solver, data, tmp_path / "whole.h5")
    solve(solver, seen, tmp_path / "seen.h5")
    one, other = score(data, tmp_path / "whole.h5"), score(data, tmp_path / "seen.h5")
    costs = ("seconds", "peak_mb", "compile_s", "reconstruction_s")
    assert {k: v for k, v in one.items() if k not in costs} == {
        k: v for k, v in other.items() if k not in costs
    }


def test_nothing_of_the_truth_is_packed(quick: Dataset, command: Command, tmp_path: Path) -> None:
    done = command("pack", quick.root, "--blind", "-o", "blind.zip")
    assert done.returncode == 0, done.stderr
    with zipfile.ZipFile(tmp_path / "blind.zip") as archive:
        names = archive.namelist()
        manifest = json.loads(archive.read("manifest.json"))
        archive.extractall(tmp_path / "blind")
    assert sorted(names) == [
        "cameras.json",
        *(f"images/frame_0000/camera_0{number}.tif" for number in range(4)),
        "manifest.json",
    ]
    assert not {"seed", "scene", "scene_hash", "renderer"} & set(manifest)
    assert command("verify", "blind").stdout == "blind: intact\n"
    assert command("solve", "asa", "blind", "-o", "r.h5").returncode == 0
    done = command("score", "blind", "r.h5")
    assert done.returncode == 2
    assert "expected a data set with its truth, got the observation side alone" in done.stderr
    assert command("score", quick.root, "r.h5").returncode == 0


def test_a_changed_file_is_found(quick: Dataset, tmp_path: Path) -> None:
    seen = pack(quick, tmp_path / "seen", blind=True)
    file = seen / "images/frame_0000/camera_02.tif"
    file.write_bytes(file.read_bytes()[:-1] + b"x")
    (fault,) = sabench.verify(seen)
    assert "camera_02.tif: its bytes do not match the manifest" in fault


def test_the_whole_is_packed_and_is_there_once(quick: Dataset, tmp_path: Path) -> None:
    whole = pack(quick, tmp_path / "whole", blind=False)
    assert sabench.verify(whole) == []
    with pytest.raises(InputError, match="exists already"):
        pack(quick, whole, blind=True)
    seen = open_dataset(pack(quick, tmp_path / "seen", blind=True))
    with pytest.raises(InputError, match="observation side alone"):
        pack(seen, tmp_path / "again", blind=False)
    assert not (tmp_path / "again").exists()
    shutil.rmtree(whole)
