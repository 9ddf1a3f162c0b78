"""Programs in other languages, submissions, and their cards."""

import datetime
import json
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import sabench
from sabench.api import FoundParticles, Reconstruction
from sabench.dataset.reader import Dataset
from sabench.dataset.results import estimate_hash, open_result
from sabench.dataset.schema import identity_of, seal
from sabench.evaluation.leaderboard.submissions import submit
from sabench.evaluation.records import append, latest, read_records
from sabench.evaluation.solver_card import read_card
from sabench.scenes import load_scene, parse_scene
from sabench.tasks.external_programs import run_program
from sabench.tasks.plain_results import write_plain
from sabench.utils.errors import InputError, UncheckedError
from sabench.utils.processes.program import ProgramLimits
from tests.conftest import ROOT, Command
from tests.helpers.commands import refuse, succeed
from tests.helpers.refusals import check_sentence, refused

EXAMPLES = ROOT / "examples"


def write(path: Path, body: str) -> Path:
    """Make a Python program with the arguments `dataset`, `result` and `rest`."""
    head = (
        "import json, os, sys\nfrom pathlib import Path\nimport h5py, numpy as np\n"
        "dataset, result, *rest = sys.argv[1:]\n"
    )
    path.write_text(f"#!{sys.executable}\n{head}{body}\n")
    path.chmod(0o755)
    return path


WHOLE = """
rig = json.loads(Path(dataset, "cameras.json").read_text())
with h5py.File(result, "w") as file:
    file.attrs.update({"format": "sabench-result", "version": 2, "solver": "liar"})
    file.attrs.update({"seconds": 1e-6, "peak_mb": 1e-6})
    file.attrs["dataset"] = json.loads(Path(dataset, "manifest.json").read_text())["content_hash"]
    for frame in range(rig["frames"]):
        file[f"frames/{frame:04d}/volume"] = np.zeros(rig["grid"]["shape"], "f4")
        file[f"frames/{frame:04d}/particles_mm"] = np.array([[0.0, 0.0, 30.0]])
"""


def test_a_result_is_taken_and_its_costs_are_measured(quick: Dataset, tmp_path: Path) -> None:
    program = write(
        tmp_path / "mine.py", WHOLE + "assert rest == ['k=3.5', 'mode=fast', 'on=true'], rest"
    )
    made = run_program(
        str(program), quick, tmp_path / "r.h5", parameters={"k": 3.5, "mode": "fast", "on": True}
    )
    assert (made.solver, made.parameters) == ("mine", {"k": 3.5, "mode": "fast", "on": True})
    assert made.seconds is not None
    assert made.seconds > 0.05  # a Python that imports numpy takes longer; the file says 1e-6
    assert made.peak_mb is not None
    assert made.peak_mb > 10.0
    scores = sabench.score(quick, tmp_path / "r.h5")
    assert scores["q"] == 0.0
    assert scores["recall"] < 0.01
    assert scores["whole_process"] is made.whole_process is True


PLAIN = {
    "reconstruction": "np.save(open(result, 'wb'), np.zeros(shape))",
    "particles": "open(result, 'w').write('frame,x_mm,y_mm,z_mm,track\\n0,0.5,0,30,7\\n')",
}


@pytest.mark.parametrize("task", PLAIN)
def test_a_program_needs_no_hdf5(quick: Dataset, tmp_path: Path, task: str) -> None:
    shape = f"shape = {quick.setup.grid.shape}\n"
    program = write(tmp_path / "plain.py", shape + PLAIN[task])
    made = run_program(str(program), quick, tmp_path / "r.h5")
    assert (made.solver, made.task, made.whole_process) == ("plain", task, True)
    if task == "particles":
        found = made.read(FoundParticles)
        assert found.position_mm.tolist() == [[0.5, 0.0, 30.0]]
        assert found.trajectory is not None
        assert len(found.trajectory) == 1
    else:
        assert sabench.score(quick, tmp_path / "r.h5")["q"] == 0.0


def test_plain_results_of_several_frames(tmp_path: Path) -> None:
    scene = load_scene("quick").with_frames(2)
    data = sabench.generate(scene, tmp_path / "data", backend="splat")
    volumes = np.arange(2.0)[:, None, None, None] * np.ones(data.setup.grid.shape)
    np.save(tmp_path / "result.npy", volumes)
    write_plain(tmp_path / "result.npy", data.root, tmp_path / "volumes.h5", "mine")
    made = open_result(tmp_path / "volumes.h5", data)
    assert [made.read(Reconstruction, frame).volume.mean() for frame in (0, 1)] == [0.0, 1.0]
    table = tmp_path / "result"
    table.write_text("frame;x_mm;y_mm;z_mm\n1;0,5;0;30\n")
    write_plain(table, data.root, tmp_path / "particles.h5", "mine")
    made = open_result(tmp_path / "particles.h5", data)
    assert [len(made.read(FoundParticles, frame).position_mm) for frame in (0, 1)] == [0, 1]
    table.write_text("x_mm;y_mm;z_mm\n0,5;0;30\n")  # of which frame?
    with refused("result", "frame"):
        write_plain(table, data.root, tmp_path / "none.h5", "mine")


BAD = {
    "none": "pass",
    "link": "os.symlink('/etc/passwd', result)",
    "text": "open(result, 'w').write('no HDF5')",
    "empty": "open(result, 'w')",
    "no z": "open(result, 'w').write('x_mm,y_mm,frame\\n0,0,0\\n')",
    "another frame": "open(result, 'w').write('frame x_mm y_mm z_mm\\n3 0 0 0\\n')",
    "half a frame": "open(result, 'w').write('frame x_mm y_mm z_mm\\n0.5 0 0 0\\n')",
    "bubbles": "open(result, 'w').write('x_mm,y_mm,z_mm,radius_mm\\n0,0,30,0.5\\n')",
    "half a track": "open(result, 'w').write('track x_mm y_mm z_mm\\n3.5 0 0 0\\n')",
    "flat volume": "np.save(open(result, 'wb'), np.zeros((4, 5)))",
    "pickle": "np.save(open(result, 'wb'), np.array([{}]), allow_pickle=True)",
    "no number": "rig = json.loads(Path(dataset, 'cameras.json').read_text())\n"
    "np.save(open(result, 'wb'), np.full(rig['grid']['shape'], np.nan))",
    "half an array": "open(result, 'wb').write(b'\\x93NUMPY\\x01')",
    "kind": WHOLE.replace('"f4")', '"i4")'),
    "shape": WHOLE.replace('np.zeros(rig["grid"]["shape"], "f4")', "np.zeros((4, 5, 6), 'f4')"),
    "NaN": WHOLE.replace("[0.0, 0.0, 30.0]", "[0.0, np.nan, 30.0]"),
    "data set": WHOLE.replace('["content_hash"]', '["content_hash"][::-1]'),
    "memory": WHOLE.replace("np.array([[0.0, 0.0, 30.0]])", "0.0").replace(
        'file[f"frames/{frame:04d}/particles_mm"] = 0.0',
        "file.create_dataset('frames/0000/particles_mm', (10**9, 3), 'f8', chunks=(1000, 3))",
    ),
    "exit code": "raise SystemExit('no cameras today')",
}


@pytest.mark.slow_but_first
@pytest.mark.parametrize("what", BAD)
def test_no_result_leaves_nothing(quick: Dataset, tmp_path: Path, what: str) -> None:
    program = write(tmp_path / "bad.py", BAD[what])
    # memory and the reversed hash change from one machine to the next
    unsteady = what in ("memory", "data set")
    with (
        pytest.raises(InputError) if unsteady else refused("bad" if what == "exit code" else "r.h5")
    ):
        run_program(str(program), quick, tmp_path / "r.h5", limits=ProgramLimits(time_s=60.0))
    assert list(tmp_path.iterdir()) == [program]


@pytest.mark.slow
def test_the_command(quick: Dataset, command: Command, tmp_path: Path) -> None:
    write(tmp_path / "mine.py", WHOLE)
    assert "r.h5: mine," in succeed(command("solve", "./mine.py", quick.root, "-o", "r.h5")).stdout
    where = (quick.root, "-o", "s.h5")
    refuse(command("solve", "./mine.py", quick.root, "-o", "r.h5"), "r.h5")
    refuse(command("solve", "./other.py", *where), "other.py")
    refuse(command("solve", "msa", *where, "--time-limit", 5), "msa")
    write(tmp_path / "mine.py", "import time\ntime.sleep(60)")
    refuse(command("solve", "./mine.py", *where, "--time-limit", 0.5), "mine", "0.5 s")
    (tmp_path / "mine.py").chmod(0o644)
    refuse(command("solve", "./mine.py", *where), "mine.py")


SUITE = """
title = "two programs and a solver"
scenes = ["quick"]
backend = "splat"
solvers = [
  { name = "./bin/mine.py", task = "reconstruction", parameters = { k = 2 }, time_limit_s = 60.0 },
  # `track`: the key of earlier suites
  { name = "./bin/slow.py", task = "reconstruction", label = "slow one", \
time_limit_s = 0.5, memory_limit_mb = 500.0 },
  { name = "asa" },
]
"""


@pytest.mark.slow
def test_programs_in_a_suite(command: Command, tmp_path: Path) -> None:
    (tmp_path / "suites" / "bin").mkdir(parents=True)
    write(tmp_path / "suites" / "bin" / "mine.py", WHOLE)
    write(tmp_path / "suites" / "bin" / "slow.py", "import time\ntime.sleep(60)")
    suite = tmp_path / "suites" / "s.toml"
    suite.write_text(SUITE)
    done = command("run", suite, "--json")
    assert done.returncode == 1, done.stderr
    mine, slow, asa = json.loads(done.stdout)
    named = {"solver": "mine", "parameters": {"k": 2}, "error": None, "q": 0.0}
    assert mine.items() >= named.items()
    assert (slow["solver"], slow["label"], slow["declined"]) == ("slow", "slow one", False)
    check_sentence(slow["error"], "slow", "0.5 s")
    assert asa["q"] > 0.4
    assert (mine["whole_process"], asa["whole_process"]) == (True, False)
    assert str(tmp_path) not in json.dumps([mine["solver"], slow["solver"], slow["error"]])
    suite.write_text(SUITE.replace('task = "reconstruction", l', "l"))
    refuse(command("run", suite), "slow.py: task")
    suite.write_text(SUITE.replace("slow.py", "none.py"))
    refuse(command("run", suite), "none.py")
    suite.write_text(SUITE.replace('"asa"', '"asa", time_limit_s = 3.0'))
    refuse(command("run", suite), "asa", "time_limit_s")


@pytest.mark.slow
@pytest.mark.skipif(
    not (shutil.which("g++") and shutil.which("make")), reason="g++ or make is not there"
)
def test_both_examples_score_as_the_bundled_solver_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same algorithm with linear instead of cubic interpolation, on tilted sensors."""
    values = load_scene("quick").to_dict()
    lens = {"k1": -2.0, "p2": 0.05}
    values["cameras"]["each"] = [
        {"camera": f"camera_0{n}", "tilt_deg": [20.0 - 10.0 * n, 9.0 * n], "distortion": lens}
        for n in range(4)
    ]
    values["volume"]["size_mm"], values["particles"]["count"] = [9.0, 7.0, 2.0], 150
    data = sabench.generate(parse_scene(values, "tilted"), tmp_path / "data", backend="splat")
    make = ["make", "-s", "-C", str(EXAMPLES / "cpp"), f"BUILD={tmp_path}"]
    done = subprocess.run(make, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")  # it compiles without warnings
    python, script = tmp_path / "run", EXAMPLES / "python" / "synthetic_aperture.py"
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{script}" "$@"\n')
    python.chmod(0o755)
    monkeypatch.setenv("SABENCH_VISIBLE", str(EXAMPLES))
    volumes, own = [], {"k": 3.0}
    for number, program in enumerate((python, tmp_path / "synthetic_aperture")):
        run_program(str(program), data, tmp_path / f"{number}.h5", parameters=own)
        with h5py.File(tmp_path / f"{number}.h5") as file:
            volumes.append(file["frames/0000/volume"][...])
    assert volumes[0].max() > 0.0
    np.testing.assert_allclose(volumes[1], volumes[0], rtol=0, atol=1e-5 * volumes[0].max())
    sabench.solve("msa", data, tmp_path / "msa.h5", parameters=own)
    bundled, *scores = (sabench.score(data, tmp_path / f"{name}.h5") for name in ("msa", 0, 1))
    for one in scores:
        assert one["q"] == pytest.approx(bundled["q"], abs=0.03)
        assert one["recall"] == pytest.approx(bundled["recall"], abs=0.02)
        assert one["precision"] == pytest.approx(bundled["precision"], abs=0.02)


@pytest.mark.slow
def test_a_submission_is_ranked_beside_what_is_there(
    quick: Dataset, quick_result: Path, command: Command, tmp_path: Path
) -> None:
    sent = shutil.copy(quick_result, tmp_path / "mine.h5")
    done = succeed(
        command("submit", sent, "--name", "Ann <b>", "--data", quick.root.parent, "--json")
    )
    (first,) = json.loads(done.stdout)
    assert (first["rank"], first["of"]) == (1, 1)
    assert first["submission"]["name"] == "Ann <b>"
    assert first["scene"] == "quick"
    assert first["seconds"] is None  # another machine's
    page = (tmp_path / "leaderboard" / "index.html").read_text()
    assert "<b>" not in page.split("<table", 1)[-1].split("</table>")[0]
    write(tmp_path / "zero.py", WHOLE)
    run_program(str(tmp_path / "zero.py"), quick, tmp_path / "zero.h5")
    done = succeed(command("submit", tmp_path / "zero.h5", "--name", "Bob", "--data", quick.root))
    assert "2 of 2" in done.stdout
    assert "msa (Ann <b>)" in done.stdout
    assert len(read_records(tmp_path / "leaderboard" / "records")) == 2


@pytest.mark.slow
def test_all_of_a_submission_or_nothing(quick: Dataset, quick_result: Path, tmp_path: Path) -> None:
    folder = tmp_path / "sent"
    folder.mkdir()
    shutil.copy(quick_result, folder / "a.h5")
    (folder / "b.h5").write_bytes(b"no result")
    with refused("b.h5"):
        submit(folder, "Ann", [quick.root], tmp_path / "board")
    shutil.copy(quick_result, folder / "b.h5")
    with refused("a.h5", "b.h5"):
        submit(folder, "Ann", [quick.root], tmp_path / "board")
    with h5py.File(folder / "b.h5", "r+") as file:
        file.attrs["dataset"] = file.attrs["identity"] = "0" * 64
    with refused("000000000"):
        submit(folder, "Ann", [quick.root], tmp_path / "board")
    assert not (tmp_path / "board").exists()


def test_changed_data_scores_nothing(quick: Dataset, quick_result: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(quick.root, tmp_path / "copy"))
    with h5py.File(copy / "truth.h5", "r+") as file:
        file["frames/0000/position_mm"][...] = np.zeros_like(file["frames/0000/position_mm"])
    with refused("truth.h5"):
        submit(quick_result, "Ann", [copy], tmp_path / "board")


def recorded(data: Dataset, board: Path, **values: Any) -> None:
    known = {"scene_hash": data.manifest.scene_hash, "solver": "asa", "parameters": {}}
    known |= {"run_hash": "ab", "versions": {}, "machine": {}}
    append(board / "records" / "a.jsonl", known | values)


@pytest.mark.slow
def test_the_case_comes_from_a_record(quick: Dataset, quick_result: Path, tmp_path: Path) -> None:
    case = {"case": "dense", "difficulty": "hard", "seed": 0, "split": "hidden"}
    more = {"suite": "tank", "scene": "quick", "axis": "density", "axes": {"a": 1}, "q": 0.99}
    more |= {"dataset": quick.content_hash, "renderer": "mitsuba", "task": "reconstruction"}
    recorded(quick, tmp_path / "board", **case, **more)
    (standing,) = submit(quick_result, "Ann", [quick.root], tmp_path / "board")
    assert standing.record.items() >= case.items()
    assert (standing.rank, standing.of, standing.best) == (2, 2, ("asa", 0.99))


def make_private(root: Path, seed: int) -> Dataset:
    manifest = json.loads((root / "manifest.json").read_text())
    parts = manifest["scene_hash"], seed, manifest["renderer"], manifest["versions"]["simulation"]
    changed = {"seed": seed, "identity": identity_of(*parts)}
    (root / "manifest.json").write_text(seal(manifest | changed))
    return sabench.open_dataset(root)


@pytest.mark.slow
def test_a_private_data_set_is_not_disclosed(
    quick: Dataset, quick_result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    seed = 4611686018427387905
    root = Path(shutil.copytree(quick.root, tmp_path / "finals"))
    data, board = make_private(root, seed), tmp_path / "board"
    (standing,) = submit(quick_result, "Ann", [root], board)
    texts = [path.read_text() for path in board.rglob("*") if path.is_file()]
    assert len(texts) >= 2  # records and page
    secrets = (str(seed), str(data.identity), data.manifest.scene_hash, "finals", str(tmp_path))
    for secret in secrets:
        assert not any(secret in text for text in texts), secret
    assert "quick" not in (board / "records" / "submitted.jsonl").read_text()
    named = {"case": f"private-{data.content_hash[:12]}", "split": "hidden", "seed": 0}
    assert standing.record.items() >= named.items()
    assert str(named["case"]) in " ".join(capsys.readouterr().err.split())
    (again,) = submit(quick_result, "Bob", [root], board)
    assert again.record["case"] == standing.record["case"]
    assert not any(str(seed) in path.read_text() for path in board.rglob("*.jsonl"))


@pytest.mark.slow
def test_a_recorded_seed_is_public(quick: Dataset, quick_result: Path, tmp_path: Path) -> None:
    root, board = Path(shutil.copytree(quick.root, tmp_path / "copy")), tmp_path / "board"
    seed = make_private(root, 77).manifest.seed
    recorded(quick, board, scene="mine", dataset="of another machine", seed=seed, renderer="splat")
    (standing,) = submit(quick_result, "Ann", [root], board)
    assert standing.record.items() >= {"scene": "quick", "seed": 77, "split": "public"}.items()


@pytest.mark.slow
def test_later_submissions_replace_none(quick: Dataset, quick_result: Path, tmp_path: Path) -> None:
    board, day = tmp_path / "board", datetime.date(2026, 1, 2)
    submit(quick_result, "Ann", [quick.root], board, date=day)
    for name in ("Ann", " Ann "):
        with refused("Ann"):
            submit(quick_result, name, [quick.root], board, date=day)
    submit(quick_result, "Bob", [quick.root], board, date=day)
    submit(quick_result, "Ann", [quick.root], board, date=day + datetime.timedelta(1))
    sent = [record["submission"] for record in latest(read_records(board / "records"))]
    assert [tuple(one.values()) for one in sent] == [
        ("Ann", "2026-01-02"),
        ("Bob", "2026-01-02"),
        ("Ann", "2026-01-03"),
    ]


CARD = """solver = "mine"
paper = "Somebody, Some Journal 1 (2026) 2"
code = "closed"
licence = "none"
hardware = "a laptop, 3 s"
parameters = "k = 3, by eye on the scene quick"
training_data = "none"
"""
ONE_SOLVER = """title = "t"
backend = "splat"
scenes = ["quick"]
solvers = [{ name = "asa" }]
"""


@pytest.mark.usefixtures("late_probe")
def test_what_could_not_be_checked_is_not_called_damaged(
    quick: Dataset, quick_result: Path, tmp_path: Path
) -> None:
    with pytest.raises(UncheckedError):
        submit(quick_result, "Ann", [quick.root], tmp_path / "board")


def renamed(result: Path, place: Path, solver: str) -> Path:
    with h5py.File(result, "r") as old, h5py.File(place, "w") as new:
        new.attrs.update({**old.attrs, "solver": solver, "parameters": "{}"})
        for frame in old["frames"]:
            for name, node in old[f"frames/{frame}"].items():
                new.create_dataset(f"frames/{frame}/{name}", data=node[...])
    return place


@pytest.mark.slow
def test_a_card_is_packed_recorded_and_shown(
    quick: Dataset, quick_result: Path, command: Command, tmp_path: Path
) -> None:
    (tmp_path / "c.toml").write_text(CARD, encoding="utf-8")
    renamed(quick_result, tmp_path / "r.h5", "mine")
    done = command("pack", "r.h5", "--card", "c.toml", "-o", "sent.zip")
    assert done.stdout == "sent.zip: 1 result(s), the card of mine\n", done.stderr
    with zipfile.ZipFile(tmp_path / "sent.zip") as archive:
        assert archive.namelist() == ["card.toml", "r.h5"]
    done = succeed(
        command("submit", "sent.zip", "--name", "Ann", "--data", quick.root.parent, "--json")
    )
    (printed,) = json.loads(done.stdout)
    (record,) = read_records(tmp_path / "leaderboard" / "records")
    assert printed["card"] == record["card"] == read_card(tmp_path / "c.toml").model_dump()
    page = (tmp_path / "leaderboard" / "index.html").read_text(encoding="utf-8")
    assert "Somebody, Some Journal" in page


@pytest.mark.parametrize(
    ("text", "key"),
    [
        (CARD.replace("licence", "license"), "license"),
        (CARD.replace('code = "closed"\n', ""), "code"),
        (CARD.replace('"none"', "3", 1), "licence"),
        (CARD.replace("by eye", r"\u0007"), "parameters"),
        (CARD.replace("closed", ""), "code"),
        ("x" * 200_000, "card.toml"),
        (CARD.replace('"mine"', '"other"'), "other"),
        (None, "card.toml"),
    ],
    ids=["typo", "missing", "number", "bell", "empty", "long", "other solver", "none"],
)
def test_a_bad_card_is_one_sentence(
    text: str | None, key: str, quick: Dataset, quick_result: Path, tmp_path: Path
) -> None:
    card = tmp_path / "card.toml"
    if text is not None:
        card.write_text(text, encoding="utf-8")
    result = renamed(quick_result, tmp_path / "r.h5", "mine")
    with refused(key) as fault:
        submit(result, "Ann", [quick.root], tmp_path / "board", cards=[card])
    assert "\n" not in str(fault.value)
    assert not (tmp_path / "board").exists()


@pytest.mark.slow
def test_a_bundled_solvers_result_is_recognised(command: Command, tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(ONE_SOLVER, encoding="utf-8")
    assert command("run", "s.toml").returncode == 0
    (result,) = (tmp_path / "work" / "results").glob("*.h5")
    renamed(result, tmp_path / "mine.h5", "mine")
    done = command("submit", "mine.h5", "--name", "Ann")
    assert "mine.h5: its estimates are those of asa; the record says so" in done.stderr
    assert "its estimates are" not in succeed(command("submit", result, "--name", "Ann")).stderr
    mine, own = read_records(tmp_path / "leaderboard" / "records")[1:]
    assert (mine["solver"], mine["same_estimates_as"]) == ("mine", "asa")
    assert (own["solver"], own["same_estimates_as"]) == ("asa", None)


@pytest.mark.slow
def test_anothers_earlier_result_is_recognised(
    quick: Dataset, quick_result: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    board = tmp_path / "board"
    result = renamed(quick_result, tmp_path / "r.h5", "mine")
    submit(result, "Ann", [quick.root], board)
    (standing,) = submit(result, "Bob", [quick.root], board)
    assert standing.record["same_estimates_as"] == "mine (Ann)"
    assert "r.h5: its estimates are those of mine (Ann)" in capfd.readouterr().err


def test_a_changed_value_changes_the_hash(quick_result: Path, tmp_path: Path) -> None:
    same = renamed(quick_result, tmp_path / "a.h5", "other")
    assert estimate_hash(same) == estimate_hash(quick_result)
    shutil.copyfile(same, tmp_path / "b.h5")
    with h5py.File(tmp_path / "b.h5", "r+") as file:
        volume = file["frames/0000/volume"]
        place = np.unravel_index(volume[...].argmax(), volume.shape)
        volume[place] = np.nextafter(volume[place], np.float32(0.0))
    assert estimate_hash(tmp_path / "b.h5") != estimate_hash(quick_result)
