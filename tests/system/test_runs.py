"""Runs of suites. Nothing is computed twice, every record says how to reproduce it, and hidden data
sets stay hidden."""

import base64
import json
import re
import shlex
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from sabench.dataset.results import estimate_hash
from sabench.evaluation import runner
from sabench.evaluation.runner import dataset_of
from sabench.evaluation.suite_loading import load_suite, read_secret
from sabench.evaluation.suites import Only
from sabench.tasks.solve_and_score import score, score_iterations, solve
from sabench.utils.errors import InputError
from tests.conftest import Command
from tests.helpers.commands import local_records, refuse, succeed
from tests.helpers.refusals import check_sentence, refused
from tests.system.test_board import block

SUITE = """title = "t"
seeds = [1, 2]
backend = "splat"
keep_data = false
solvers = [{ name = "asa" }, { name = "msa", label = "sharp one", parameters = { k = 2.0 } }]
[[cases]]
scene = "quick"
name = "few"
difficulty = "easy"
axis = "density"
set = { "particles.count" = 40, "volume.size_mm" = [7.0, 5.0, 2.0] }
"""


@pytest.mark.slow
def test_one_run_of_an_iterative_solver_tells_accuracy_over_seconds(tmp_path: Path) -> None:
    solvers = 'solvers = [{ name = "asa" }, { name = "mlos_smart" }]'
    (tmp_path / "s.toml").write_text(re.sub("solvers = .*", solvers, SUITE))
    asa, smart = runner.run_suite(
        tmp_path / "s.toml", tmp_path / "w", tmp_path / "b", only=Only(seeds=(1,))
    )
    assert asa["iterations"] is None
    numbers, seconds, quality = np.transpose(smart["iterations"])
    assert numbers.tolist() == [1, 2, 3, 5, 8]
    assert np.all(np.diff(seconds) > 0.0)
    assert seconds[-1] < smart["seconds"]
    assert np.all(np.diff(quality) > 0.0)
    assert quality[-1] < smart["q"] < quality[-1] + 0.05
    made = dataset_of(load_suite(tmp_path / "s.toml", None)[1][0], tmp_path / "w", fresh=False)
    solve("mlos_smart", made, tmp_path / "plain.h5")
    assert smart["estimate_hash"] == estimate_hash(tmp_path / "plain.h5")
    solve("mlos_smart", made, tmp_path / "steps.h5", iterations=True)
    with h5py.File(tmp_path / "steps.h5", "r+") as file:
        file["iterations/2/seconds"][0] = -1.0
    with refused("iterations/2/seconds"):
        score_iterations(made, tmp_path / "steps.h5")


@pytest.mark.slow
def test_the_page_has_residual_images_of_particles_and_of_nothing_else(tmp_path: Path) -> None:
    solvers = 'solvers = [{ name = "asa" }, { name = "ray_triangulation" }]'
    (tmp_path / "s.toml").write_text(re.sub("solvers = .*", solvers, SUITE))
    runner.run_suite(tmp_path / "s.toml", tmp_path / "w", tmp_path / "b", only=Only(seeds=(1,)))
    (picture,) = (tmp_path / "b" / "pictures").glob("*/*.left.png")
    assert picture.name.startswith("ray_triangulation-")
    page = (tmp_path / "b" / "index.html").read_text(encoding="utf-8")
    assert base64.b64encode(picture.read_bytes()).decode() in page


@pytest.mark.slow
def test_a_second_run_computes_nothing_and_a_record_is_made_again_by_its_command(
    tmp_path: Path, command: Command
) -> None:
    (tmp_path / "s.toml").write_text(SUITE)
    succeed(command("run", "s.toml", "--case", "few", "--seed", "1"))
    named = {"seed": 1, "difficulty": "easy", "axis": "density", "split": "public"}
    first = local_records(tmp_path)
    assert [one["solver"] for one in first] == ["asa", "msa"]
    assert all(one.items() >= named.items() for one in first)
    again = command("run", "s.toml", "--json")
    assert "few, seed 1, known" in again.stderr
    before = local_records(tmp_path)
    for records in (json.loads(again.stdout), before):
        pairs = [(record["seed"], record["solver"]) for record in records]
        assert pairs == [(1, "asa"), (1, "msa"), (2, "asa"), (2, "msa")]
    words = shlex.split(before[3]["command"])
    assert words == shlex.split("sabench run s.toml --case few --seed 2 --solver 'sharp one'")
    assert command(*words[1:], "--fresh").returncode == 0
    anew = local_records(tmp_path)[4:]
    assert [(record["seed"], record["label"], record["run_hash"]) for record in anew] == [
        (2, "sharp one", before[3]["run_hash"])
    ]
    assert anew[0]["q"] == before[3]["q"]


@pytest.mark.slow
def test_a_data_set_that_could_not_be_checked_stays_as_it_is(
    tmp_path: Path, command: Command, request: pytest.FixtureRequest
) -> None:
    (tmp_path / "s.toml").write_text(SUITE.replace("keep_data = false\n", ""))
    words = ("run", "s.toml", "--seed", "1", "--solver", "asa")
    assert command(*words).returncode == 0
    (manifest,) = (tmp_path / "work" / "datasets").glob("*/manifest.json")
    before = manifest.stat().st_mtime_ns
    (tmp_path / "leaderboard" / "records" / "local.jsonl").unlink()
    request.getfixturevalue("late_probe")
    refuse(command(*words))
    assert manifest.stat().st_mtime_ns == before


@pytest.mark.parametrize(
    ("name", "other"),
    [("__version__", "0"), ("SIMULATION", "0"), ("version_of", lambda package: f"no {package}")],
)
def test_a_data_set_of_other_versions_is_generated_again(
    name: str, other: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "s.toml").write_text(SUITE)
    case = load_suite(tmp_path / "s.toml")[1][0]
    made = runner.dataset_of(case, tmp_path, fresh=False)

    def refuse(*_: object, **__: object) -> None:
        raise InputError("generated again")

    monkeypatch.setattr(runner, "generate", refuse)
    assert runner.dataset_of(case, tmp_path, fresh=False).content_hash == made.content_hash
    monkeypatch.setattr(runner, name, other)
    with pytest.raises(InputError):
        runner.dataset_of(case, tmp_path, fresh=False)


@pytest.mark.slow
def test_a_score_that_no_record_may_have_is_an_error_of_the_solver(
    tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "s.toml").write_text(SUITE)
    wrong = {"q": 1e300}
    monkeypatch.setattr(runner, "score", lambda data, out: score(data, out) | wrong)
    done = command("run", "s.toml", "--seed", "1", "--solver", "asa")
    assert done.returncode == 1, done.stderr
    (found,) = local_records(tmp_path)
    check_sentence(found["error"], "asa: q")
    assert found["q"] is None


def test_scores_of_another_task_than_the_solver_was_listed_with_are_refused() -> None:
    head = {"task": "particles", "solver": "asa"}
    with refused("asa", "particles", "reconstruction"):
        runner._checked({"task": "reconstruction", "q": 0.5}, head)
    assert runner._checked({"task": "particles", "f1": 0.5}, head) == {"f1": 0.5}


@pytest.mark.slow
def test_hidden_runs_tell_no_seed_and_show_no_picture(tmp_path: Path, command: Command) -> None:
    (tmp_path / "s.toml").write_text(SUITE)
    (tmp_path / "secret.toml").write_text('secret = "the organiser\'s own words"\nseeds = 2\n')
    done = succeed(command("run", "s.toml", "--hidden", "secret.toml", "--solver", "asa"))
    found = local_records(tmp_path)
    named = [(record["seed"], record["split"], record["pictures"]) for record in found]
    assert named == [(0, "hidden", None), (1, "hidden", None)]
    cases = load_suite(tmp_path / "s.toml", read_secret(tmp_path / "secret.toml"))[1]
    page = (tmp_path / "leaderboard/index.html").read_text()
    output = page + json.dumps(found) + done.stdout + done.stderr
    assert not any(str(case.seed) in output for case in cases)
    assert "own words" not in output
    assert not (tmp_path / "leaderboard/pictures").exists()
    assert found[0]["dataset"] != found[1]["dataset"]
    assert all(record.get("identity") is None for record in found)  # a hash of the seed


@pytest.mark.slow
def test_a_suite_ends_in_means_and_leaves_no_data(command: Command, tmp_path: Path) -> None:
    (tmp_path / "suite.toml").write_text(
        'title = "t"\nbackend = "splat"\nseeds = [1, 2]\nkeep_data = false\n[[cases]]\n'
        'scene = "quick"\nname = "q"\n[cases.set]\n"volume.size_mm" = [6.0, 4.0, 2.0]\n'
        '[cases.vary]\n"particles.count" = [100, 200]\n[[solvers]]\nname = "msa"\n'
        'label = "product"\n'
    )
    done = succeed(command("run", "suite.toml"))
    assert "data set 4 of 4: q-count_200, seed 2" in done.stderr
    counts = [line.count("±") for line in done.stdout.splitlines() if "product" in line]
    assert min(counts) > 0
    assert sum(counts) > 2 * 4  # of two cases, in as many tables as the terminal's width asks for
    assert len(counts) % 2 == 0
    records = local_records(tmp_path)
    assert [(record["case"], record["axes"], record["seed"]) for record in records] == [
        (f"q-count_{count}", {"particles.count": count}, seed)
        for count in (100, 200)
        for seed in (1, 2)
    ]
    assert [bool(record["pictures"]) for record in records] == [True, False, True, False]
    assert not list((tmp_path / "work" / "datasets").iterdir())
    assert not list((tmp_path / "work" / "results").iterdir())
    page = (tmp_path / "leaderboard" / "index.html").read_text()
    data = block(page)
    axes = [case["axes"] for case in data["cases"]]
    assert axes == ["particles.count 100", "particles.count 200"]
    # a mean and its half width
    assert [len(row["scores"][0]) for row in data["rows"]] == [2] * len(data["rows"])
