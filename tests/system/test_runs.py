"""Runs of suites, of scenes and of recordings: what is known, hidden or kept."""

import base64
import json
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile

import sabench
from sabench.dataset.copies import pack
from sabench.dataset.reader import open_dataset
from sabench.dataset.results import estimate_hash
from sabench.dataset.verification import verify
from sabench.evaluation import runner
from sabench.evaluation.record_schema import parse_record
from sabench.evaluation.runner import dataset_of
from sabench.evaluation.suite_loading import Secret, load_suite, read_secret
from sabench.evaluation.suites import Only
from sabench.tasks.quality import FIGURES
from sabench.tasks.solve_and_score import score, score_iterations, solve
from sabench.utils.errors import InputError
from tests.conftest import Command
from tests.helpers.commands import local_page, local_records, refuse, succeed
from tests.helpers.recordings import import_exactly, make_scene_in_motion, write_pngs
from tests.helpers.refusals import check_sentence, refused
from tests.system.test_board import block
from tests.system.test_programs import WHOLE, write

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


RECORDED = """title = "t"
backend = "splat"
keep_data = false
recordings = ["tank"]
solvers = [{ name = "ray_triangulation" }]
"""
QUICK = """[[cases]]
scene = "quick"
name = "few"
set = { "particles.count" = 40, "volume.size_mm" = [7.0, 5.0, 2.0] }
"""
ALONE = {"residual_px", "explained", "jitter_mm", "followed"}  # figures of one solution


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    data = sabench.generate(make_scene_in_motion(), folder / "data", seed=5, backend="splat")
    import_exactly(data, write_pngs(data, folder / "images"), folder / "tank")
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made / "tank", tmp_path / "tank")
    (tmp_path / "s.toml").write_text(RECORDED)
    return tmp_path


def import_again(made: Path, folder: Path) -> None:
    shutil.rmtree(folder / "tank")
    import_exactly(open_dataset(made / "data"), made / "images", folder / "tank", black_dn=50.0)


@pytest.mark.slow
def test_a_recording_beside_a_scene(folder: Path, command: Command) -> None:
    (folder / "s.toml").write_text(RECORDED + QUICK)
    succeed(command("run", "s.toml"))
    scene, recording = local_records(folder)
    assert (scene["recorded"], scene.get("quality"), scene["case"]) == (False, None, "few")
    tank = open_dataset(folder / "tank")
    head = {"recorded": True, "case": "tank", "dataset": tank.content_hash, "seed": 0}
    assert recording.items() >= (head | {"renderer": "recorded", "split": "public"}).items()
    known = {key for key, value in recording["quality"]["figures"].items() if value is not None}
    assert known == ALONE
    assert recording["quality"]["figures"]["explained"] > 0.5
    assert recording["seconds"] is not None
    assert recording["peak_mb"] > 0.0
    assert recording["f1"] is None
    assert verify(folder / "tank") == []
    assert not list((folder / "work/datasets").iterdir())  # of the scene: keep_data is false

    again = command("run", "s.toml", "--json")
    assert "tank, recorded, known" in again.stderr
    assert len(json.loads(again.stdout)) == len(local_records(folder)) == 2
    words = shlex.split(recording["command"])
    assert "--seed" not in words
    assert command(*words[1:], "--fresh").returncode == 0
    anew = local_records(folder)[2]
    assert anew["run_hash"] == recording["run_hash"]
    assert anew["quality"] == recording["quality"]


@pytest.mark.slow
def test_the_page_has_a_table_of_its_own_without_ranks(folder: Path, command: Command) -> None:
    both = '{ name = "msa" }, { name = "ray_triangulation" }'
    (folder / "s.toml").write_text(RECORDED.replace('{ name = "ray_triangulation" }', both) + QUICK)
    done = succeed(command("run", "s.toml"))
    page = block(local_page(folder))
    names = ("reconstruction", "particles")
    assert list(page["tasks"]) == [one for name in names for one in (name, f"{name}, recorded")]
    own = page["tasks"]["particles, recorded"]
    assert [one["key"] for one in own["columns"]] == [*FIGURES, "seconds", "peak_mb"]
    assert own["columns"][0]["meaning"].endswith("; smaller is better")
    assert own["larger"] is None
    assert page["tasks"]["reconstruction, recorded"]["columns"][0]["key"] == "explained"
    recorded = [row for row in page["rows"] if page["cases"][row["case"]]["recorded"]]
    assert len(recorded) == 2
    assert not any(row["ranked"] for row in recorded)
    assert all(row["ranked"] for row in page["rows"] if row not in recorded)
    assert recorded[1]["scores"][1][0] == pytest.approx(
        local_records(folder)[3]["quality"]["figures"]["explained"]
    )
    pictures = [path.name for path in (folder / "leaderboard/pictures").glob("tank-*/*")]
    assert "truth.png" not in pictures
    assert sum(name.endswith(".error.png") for name in pictures) == 1  # residuals of particles
    assert "residual_px" in done.stdout
    assert "held_out" not in done.stdout


@pytest.mark.slow
def test_all_figures_where_the_suite_asks_for_them(folder: Path, command: Command) -> None:
    """They are other results: a record without them does not stand for one with them."""
    assert command("run", "s.toml").returncode == 0
    asked = '[{ folder = "tank", quality = { frames = 2, again = true } }]'
    (folder / "s.toml").write_text(RECORDED.replace('["tank"]', asked))
    succeed(command("run", "s.toml"))
    first, second = local_records(folder)
    assert first["run_hash"] != second["run_hash"]
    judged = second["quality"]
    assert (judged["frames"], judged["again"]) == (2, True)
    assert all(judged["figures"][key] is not None for key in FIGURES)
    (row,) = block(local_page(folder))["rows"]  # the newest record counts
    assert row["runs"] == [second["run_hash"]]


@pytest.mark.slow
def test_images_without_particles(made: Path, folder: Path, command: Command) -> None:
    data, rng = open_dataset(made / "data"), np.random.default_rng(0)
    stacks = folder / "dark"
    stacks.mkdir()
    for camera in data.setup.cameras:
        shape = (3, camera.rows, camera.columns)
        noise = rng.normal(100.0, 3.0, shape).astype(np.uint16)
        tifffile.imwrite(stacks / f"{camera.name}.tif", noise, photometric="minisblack")
    shutil.rmtree(folder / "tank")
    import_exactly(data, stacks, folder / "tank")
    asked = '[{ folder = "tank", quality = { frames = 9, again = true } }]'
    solvers = '{ name = "bayesian_ipr" }, { name = "ray_triangulation" }'
    suite = RECORDED.replace('["tank"]', asked).replace('{ name = "ray_triangulation" }', solvers)
    (folder / "s.toml").write_text(suite)
    succeed(command("run", "s.toml"))
    first, second = local_records(folder)
    assert (first["error"], second["error"]) == (None, None)
    assert first["quality"]["figures"]["followed"] is None


@pytest.mark.slow
def test_programs_and_images_elsewhere(made: Path, folder: Path, command: Command) -> None:
    data, images = open_dataset(made / "data"), folder / "images"
    shutil.copytree(made / "images", images)
    import_exactly(data, images, folder / "elsewhere", referenced=True)
    write(folder / "mine.py", WHOLE)
    program = '{ name = "./mine.py", task = "reconstruction" }'
    (folder / "s.toml").write_text(
        RECORDED.replace('"tank"', '{ folder = "elsewhere", quality = { again = true } }').replace(
            '{ name = "ray_triangulation" }', program
        )
    )
    done = command("run", "s.toml", "--json")
    (record,) = json.loads(done.stdout)
    assert (record["solver"], record["error"], record["whole_process"]) == ("mine", None, True)
    assert "mine" in done.stderr
    (images / "camera_01/img_2.png").unlink()
    refuse(command("run", "s.toml", "--fresh"), "img_2.png")


@pytest.mark.slow
def test_a_recording_that_has_changed(made: Path, folder: Path, command: Command) -> None:
    """A damaged one is refused, another one of the same name is solved anew."""
    assert command("run", "s.toml").returncode == 0
    image = folder / "tank/images/frame_0001/camera_02.tif"
    image.write_bytes(image.read_bytes()[:-1] + b"\x01")
    refuse(command("run", "s.toml", "--fresh"), "recording tank", str(image))
    assert image.is_file()
    assert len(local_records(folder)) == 1
    import_again(made, folder)
    done = succeed(command("run", "s.toml"))
    assert "recording tank: it has changed" in " ".join(done.stderr.split())
    first, second = local_records(folder)
    assert first["dataset"] != second["dataset"]
    assert len(block(local_page(folder))["cases"]) == 2


def test_a_change_during_a_run_is_found(made: Path, folder: Path) -> None:
    (case,) = load_suite(folder / "s.toml")[1]
    assert dataset_of(case, folder, fresh=True).root == folder / "tank"
    import_again(made, folder)
    with refused("tank"):
        dataset_of(case, folder, fresh=True)


def test_a_frozen_suite_freezes_its_recordings(made: Path, folder: Path) -> None:
    file = folder / "s.toml"
    file.write_text(f'frozen = "{"0" * 64}"\n' + RECORDED)
    with pytest.raises(InputError) as caught:  # of hashes that no machine repeats
        load_suite(file)
    (found,) = re.findall("got others with ([0-9a-f]{64})", str(caught.value))
    file.write_text(file.read_text().replace("0" * 64, found))
    assert len(load_suite(file)[1]) == 1
    import_again(made, folder)
    with pytest.raises(InputError, match=r"s\.toml"):
        load_suite(file)


@pytest.mark.slow
def test_gates_compare_figures_without_truth(folder: Path, command: Command) -> None:
    words = ("check", "s.toml", "--baseline", "base.json")
    done = succeed(command(*words, "--update"))
    assert verify(folder / "tank") == []
    base = json.loads((folder / "base.json").read_text())
    entry = base["cases"][0]
    figures = entry["solvers"]["ray_triangulation"]["figures"]
    assert {f"quality.{key}" for key in ALONE} <= set(figures)
    assert (entry["data"], entry["renderer"]) == ({}, "recorded")
    assert command(*words).returncode == 0

    moved = {"quality.residual_px": -0.05, "quality.explained": 0.2, "quality.followed": -0.2}
    changed = {key: value + moved.get(key, 0.0) for key, value in figures.items() if value}
    entry["solvers"]["ray_triangulation"]["figures"] = changed
    (folder / "base.json").write_text(json.dumps(base))
    done = command(*words, "--json")
    assert done.returncode == 1
    found = json.loads(done.stdout)
    assert {one["figure"] for one in found["worse"]} == {"quality.residual_px", "quality.explained"}
    assert "quality.followed" in {one["figure"] for one in found["news"]}


def test_a_private_test_set_has_scenes_alone(folder: Path) -> None:
    secret = Secret(secret="the organiser's own words", seeds=2)
    with refused("s.toml"):
        load_suite(folder / "s.toml", secret)
    (folder / "s.toml").write_text(RECORDED + QUICK)
    assert [case.name for case in load_suite(folder / "s.toml", secret)[1]] == ["few", "few"]


@pytest.mark.slow
def test_one_case_whatever_the_seeds_are(folder: Path, command: Command) -> None:
    (folder / "s.toml").write_text("seeds = [1, 2]\n" + RECORDED + QUICK)
    cases = load_suite(folder / "s.toml")[1]
    assert [(case.name, case.shown_seed) for case in cases] == [("few", 1), ("few", 2), ("tank", 0)]
    done = command("run", "s.toml", "--case", "tank", "--solver", "ray_triangulation", "--json")
    assert [record["case"] for record in json.loads(done.stdout)] == ["tank"]
    refuse(command("run", "s.toml", "--case", "tunk"), "--case tunk", "tank")


@pytest.mark.parametrize("written", ["nothing", "images", "data", "blind", "x" * 300, "a\0b"])
def test_other_folders_are_refused(written: str, made: Path, tmp_path: Path) -> None:
    if not (made / "blind").is_dir():
        pack(open_dataset(made / "data"), made / "blind", blind=True)
    place = str(made / written) if written in ("images", "data", "blind") else written
    (tmp_path / "s.toml").write_text(RECORDED.replace('"tank"', json.dumps(place)))
    with refused("s.toml") as caught:
        load_suite(tmp_path / "s.toml")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"f1": 0.9}, "f1"),
        ({"recorded": False}, "quality"),
        ({"quality": {"figures": {"followed": 2.0}}}, "followed"),
        ({"quality": {"figures": {"f1": 0.9}}}, "figures"),
        ({"quality": {"figures": {"explained": "much"}}}, "explained"),
    ],
)
def test_records_with_unknown_truth_are_left_out(change: dict[str, Any], key: str) -> None:
    names = ("scene", "scene_hash", "dataset", "renderer", "solver", "run_hash")
    record = dict.fromkeys(names, "tank") | {"seed": 0, "task": "particles", "parameters": {}}
    record |= {"versions": {}, "machine": {}, "version": 2, "recorded": True}
    record |= {"quality": {"frames": 1, "again": False, "figures": {"explained": 0.9}}}
    assert parse_record(json.dumps(record).encode())["recorded"] is True
    judged = record["quality"] | change.pop("quality", {})
    with refused(key, kind=ValueError):
        parse_record(json.dumps(record | {"quality": judged} | change).encode())
