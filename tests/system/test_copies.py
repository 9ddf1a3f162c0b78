"""Copies of data sets: of other processors, and of the observation side alone."""

import json
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile

import sabench
from benchmarks.instruction_sets import SMALL
from sabench import plugins, tasks
from sabench.dataset import schema
from sabench.dataset.copies import disagreements, pack
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.verification import verify
from sabench.evaluation.leaderboard.submissions import submit
from sabench.images.tiff_exr import write_exr, write_tiff
from sabench.simulation.pipeline import generate
from sabench.tasks.conformance import example
from sabench.tasks.solve_and_score import score, solve
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json
from tests.conftest import Command
from tests.helpers.commands import refuse, run_python, succeed
from tests.helpers.refusals import refused
from tests.helpers.untrusted import reseal
from tests.system.test_conformance import ONE_OF_EACH

_LIMITS = {key: value for part in SMALL.values() for key, value in part.items()}
Change = Callable[[Path], None]


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return generate("quick", tmp_path_factory.mktemp("here") / "a", seed=1, backend="splat")


@pytest.fixture(scope="module")
def there(here: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the copy of the other processor, and its result by `msa`."""
    folder = tmp_path_factory.mktemp("there")
    _generate_there(folder / "b", folder / "numba")
    if open_dataset(folder / "b").content_hash == here.content_hash:
        pytest.skip("this processor rounds as one without AVX does")
    sabench.solve("msa", folder / "b", folder / "msa.h5")
    return folder


def _generate_there(out: Path, cache: Path) -> None:
    words = ["-m", "sabench", "generate", "quick", "-o", out, "--seed", 1, "--backend", "splat"]
    succeed(run_python(*words, env={**_LIMITS, "NUMBA_CACHE_DIR": str(cache)}))


@pytest.mark.slow
def test_copies_of_two_processors_have_one_identity(here: Dataset, there: Path) -> None:
    other = open_dataset(there / "b")
    assert other.content_hash != here.content_hash
    assert other.identity == here.identity is not None
    assert disagreements(here, other) == disagreements(other, here) == []


@pytest.mark.slow
def test_results_of_other_copies_and_records_meet(
    here: Dataset, there: Path, tmp_path: Path
) -> None:
    board, own = tmp_path / "board", tmp_path / "own.h5"
    sabench.solve("msa", here.root, own)
    (theirs,) = submit(there / "msa.h5", "Ann", [here.root], board)
    (ours,) = submit(own, "Ben", [there], board)  # scored on the copy of the other processor
    assert theirs.record["dataset"] != ours.record["dataset"]
    assert theirs.record["identity"] == ours.record["identity"] == here.identity
    assert theirs.record["run_hash"] == ours.record["run_hash"]
    assert (theirs.of, ours.of) == (1, 1)  # one result, sent twice
    assert theirs.record["q"] == pytest.approx(ours.record["q"], abs=1e-3)
    (both,) = submit(there / "msa.h5", "Cleo", [here.root, there], board)
    assert both.of == 1
    assert both.record["dataset"] == ours.record["dataset"]  # the copy that was solved
    other = tmp_path / "other.h5"
    sabench.solve("msa", here.root, other, parameters={"k": 2.0})
    (another,) = submit(other, "Dan", [there], board)
    assert another.of == 2
    (tmp_path / "sent").mkdir()
    for result in (own, there / "msa.h5"):
        shutil.copy(result, tmp_path / "sent" / f"{result.parent.name}.h5")
    with pytest.raises(InputError):  # two results of copies of one data set
        submit(tmp_path / "sent", "Ann", [here.root, there], board)


def _move_a_particle(root: Path) -> None:
    with h5py.File(root / "truth.h5", "r+") as file:
        file["frames/0000/position_mm"][7, 2] += 1e-6


def _exchange_particles(root: Path) -> None:
    with h5py.File(root / "truth.h5", "r+") as file:
        file["frames/0000/id"][...] = file["frames/0000/id"][...][::-1]


def _darken(root: Path) -> None:
    path = root / "images" / "frame_0000" / "camera_01.tif"
    grey = tifffile.imread(path)
    write_tiff(path, np.minimum(grey, np.uint16(np.quantile(grey, 0.99))))


def _scale_light(root: Path) -> None:
    path = root / "images" / "frame_0000" / "camera_02.exr"
    write_exr(path, open_dataset(root).radiance(0)[2] * np.float32(1.01))


def _turn_a_camera(root: Path) -> None:
    path = root / "cameras.json"
    values: dict[str, Any] = json.loads(path.read_text())
    values["cameras"][0]["center_mm"][0] += 1e-6
    path.write_text(canonical_json(values), encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "file"),
    [
        (_move_a_particle, "truth.h5: frames/0000/position_mm"),
        (_exchange_particles, "truth.h5: frames/0000/id"),
        (_darken, "camera_01.tif"),
        (_scale_light, "camera_02.exr"),
        (_turn_a_camera, "cameras.json"),
    ],
)
def test_a_changed_copy_does_not_pass_as_the_original(
    here: Dataset, tmp_path: Path, command: Command, change: Change, file: str
) -> None:
    copy = Path(shutil.copytree(here.root, tmp_path / "copy"))
    change(copy)
    reseal(copy)
    assert open_dataset(copy).identity == here.identity  # it claims to be one
    done = command("verify", str(copy), "--against", str(here.root))
    assert done.returncode == 1
    assert file in done.stdout
    result = tmp_path / "msa.h5"
    sabench.solve("msa", here.root, result)
    with refused("copy"):
        submit(result, "Ann", [here.root, copy], tmp_path / "board")


def test_an_identity_follows_from_what_defines_the_data(here: Dataset, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(here.root, tmp_path / "copy"))
    manifest = json.loads((copy / schema.MANIFEST).read_text())
    (copy / schema.MANIFEST).write_text(schema.seal(manifest | {"seed": 2}), encoding="utf-8")
    assert "identity" in verify(copy)[0]
    (copy / schema.MANIFEST).write_text(schema.seal(manifest), encoding="utf-8")
    assert verify(copy) == []


@pytest.mark.slow
def test_the_observation_side_does_not_disclose_the_identity(here: Dataset, tmp_path: Path) -> None:
    """Seeds are often small, and the identity would tell whether a guess is right."""
    blind = pack(here, tmp_path / "blind", blind=True)
    assert open_dataset(blind).identity is None
    assert str(here.identity) not in (blind / schema.MANIFEST).read_text()
    sabench.solve("msa", blind, tmp_path / "msa.h5")
    (standing,) = submit(tmp_path / "msa.h5", "Ann", [here.root], tmp_path / "board")
    assert standing.record["dataset"] == here.content_hash


@pytest.mark.slow
@pytest.mark.parametrize("solver", ONE_OF_EACH)
def test_a_solver_on_the_observation_side_scores_the_same(solver: str, tmp_path: Path) -> None:
    task = tasks.of(ONE_OF_EACH[solver])
    data = example(task, plugins.load("solvers", solver).sees, tmp_path / "data")
    seen = open_dataset(pack(data, tmp_path / "seen", blind=True))
    assert not seen.has_truth
    assert sabench.verify(seen.root) == []
    solve(solver, data, tmp_path / "whole.h5")
    solve(solver, seen, tmp_path / "seen.h5")
    one, other = score(data, tmp_path / "whole.h5"), score(data, tmp_path / "seen.h5")
    for cost in ("seconds", "peak_mb", "compile_s", "reconstruction_s"):
        assert (cost in one) == (cost in other)
        one.pop(cost, None), other.pop(cost, None)
    assert one == other


def test_the_observation_side_has_nothing_of_the_truth(
    quick: Dataset, command: Command, tmp_path: Path
) -> None:
    succeed(command("pack", quick.root, "--blind", "-o", "blind.zip"))
    with zipfile.ZipFile(tmp_path / "blind.zip") as archive:
        names = archive.namelist()
        archive.extractall(tmp_path / "blind")
    images = [f"images/frame_0000/camera_0{number}.tif" for number in range(4)]
    assert sorted(names) == ["cameras.json", *images, "manifest.json"]
    manifest = json.loads((tmp_path / "blind/manifest.json").read_text())
    assert sorted(manifest.pop("files")) == ["cameras.json", *images]
    assert len(manifest.pop("manifest_hash")) == 64
    head = {"format": "sabench-dataset", "version": 1, "side": "observation"}
    assert manifest == head | {"content_hash": quick.content_hash}
    for name in ("cameras.json", *images):
        assert (tmp_path / "blind" / name).read_bytes() == (quick.root / name).read_bytes()
    assert command("verify", "blind").stdout == "blind: intact\n"
    assert command("solve", "asa", "blind", "-o", "r.h5").returncode == 0
    refuse(command("score", "blind", "r.h5"), "blind")
    assert command("score", quick.root, "r.h5").returncode == 0


def test_the_whole_is_packed_and_is_there_once(quick: Dataset, tmp_path: Path) -> None:
    whole = pack(quick, tmp_path / "whole", blind=False)
    assert sabench.verify(whole) == []
    with refused("whole"):
        pack(quick, whole, blind=True)
    seen = open_dataset(pack(quick, tmp_path / "seen", blind=True))
    for name in seen.contents.files:  # a program that writes there spoils its own copy
        assert not (seen.root / name).samefile(quick.root / name)
    with refused("seen"):
        pack(seen, tmp_path / "again", blind=False)
    assert not (tmp_path / "again").exists()
