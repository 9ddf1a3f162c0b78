"""Suites of recorded data sets: run, resumed, gated and shown without truth. The recording is of a
generated data set whose truth stays behind. It is never changed or deleted."""

import json
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

import sabench
from sabench.dataset.copies import pack
from sabench.dataset.reader import open_dataset
from sabench.dataset.verification import verify
from sabench.evaluation.record_schema import parse
from sabench.evaluation.runner import dataset_of
from sabench.evaluation.suite_loading import Secret, load_suite
from sabench.tasks.quality import FIGURES
from sabench.utils.errors import InputError
from tests.conftest import Command
from tests.helpers.commands import local_page, local_records, refuse, succeed
from tests.helpers.recordings import import_exactly, make_scene_in_motion, write_pngs
from tests.helpers.refusals import refused
from tests.system.test_board import block
from tests.system.test_programs import WHOLE, write

SUITE = """title = "t"
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
    (tmp_path / "s.toml").write_text(SUITE)
    return tmp_path


def damage(folder: Path) -> Path:
    image = folder / "tank/images/frame_0001/camera_02.tif"
    image.write_bytes(image.read_bytes()[:-1] + b"\x01")
    return image


def import_again(made: Path, folder: Path) -> None:
    shutil.rmtree(folder / "tank")
    data = open_dataset(made / "data")
    import_exactly(data, made / "images", folder / "tank", black_dn=50.0)


@pytest.mark.slow
def test_a_recording_beside_a_scene(folder: Path, command: Command) -> None:
    (folder / "s.toml").write_text(SUITE + QUICK)
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
    (folder / "s.toml").write_text(SUITE.replace('{ name = "ray_triangulation" }', both) + QUICK)
    done = succeed(command("run", "s.toml"))
    page = block(local_page(folder))
    names = ("reconstruction", "particles")
    assert list(page["tasks"]) == [one for name in names for one in (name, f"{name}, recorded")]
    own = page["tasks"]["particles, recorded"]
    assert [one["key"] for one in own["columns"]] == [*FIGURES, "seconds", "peak_mb"]
    assert own["columns"][0]["meaning"].endswith("; smaller is better")
    assert own["larger"] is None
    volumes = page["tasks"]["reconstruction, recorded"]["columns"]
    assert volumes[0]["key"] == "explained"
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
    (folder / "s.toml").write_text(SUITE.replace('["tank"]', asked))
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
    suite = SUITE.replace('["tank"]', asked).replace('{ name = "ray_triangulation" }', solvers)
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
        SUITE.replace('"tank"', '{ folder = "elsewhere", quality = { again = true } }').replace(
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
    image = damage(folder)
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
    file.write_text(f'frozen = "{"0" * 64}"\n' + SUITE)
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
    (folder / "s.toml").write_text(SUITE + QUICK)
    assert [case.name for case in load_suite(folder / "s.toml", secret)[1]] == ["few", "few"]


@pytest.mark.slow
def test_one_case_whatever_the_seeds_are(folder: Path, command: Command) -> None:
    (folder / "s.toml").write_text("seeds = [1, 2]\n" + SUITE + QUICK)
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
    (tmp_path / "s.toml").write_text(SUITE.replace('"tank"', json.dumps(place)))
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
    assert parse(json.dumps(record).encode())["recorded"] is True
    judged = record["quality"] | change.pop("quality", {})
    with refused(key, kind=ValueError):
        parse(json.dumps(record | {"quality": judged} | change).encode())
