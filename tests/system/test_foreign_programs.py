"""Data sets exported, solved by other programs outside, imported and scored here."""

import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import open_result, result_writer
from sabench.interop.export import Format, export
from sabench.interop.foreign import ForeignFormatWarning, read_world
from sabench.interop.tracks import TrackFormat, import_result
from sabench.scenes import load_scene
from sabench.simulation.pipeline import generate
from sabench.tasks import of
from sabench.tasks.solve_and_score import score
from tests.conftest import Command
from tests.helpers.commands import succeed
from tests.helpers.refusals import check_sentence, refused

PROGRAMS: tuple[Any, ...] = ("openptv", "openlpt", "myptv", "lpt-challenge")


@pytest.fixture(scope="module")
def tank(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    scene = load_scene("particle-tracking").with_frames(6)
    return generate(scene, tmp_path_factory.mktemp("tank") / "data", seed=1, backend="splat")


@pytest.fixture(scope="module")
def truth(tank: Dataset) -> Path:
    path, task = tank.root.parent / "truth.h5", of("particles")
    with result_writer(path, tank, "truth", "particles", {}) as writer:
        for frame in range(tank.setup.frames):
            writer.add(task.truth(tank, frame), frame)
    return path


def export_quietly(tank: Dataset, out: Path, result: Path | None, to: Format) -> Path:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ForeignFormatWarning)
        return export(tank, out, result, to=to)


@pytest.mark.slow_but_first
@pytest.mark.parametrize("form", [*PROGRAMS, "netcdf", "mat", "npy", "csv"])
def test_a_result_comes_back(form: TrackFormat, tank: Dataset, truth: Path, tmp_path: Path) -> None:
    folder = export_quietly(tank, tmp_path / "out", truth, form)
    import_result(tank, folder, tmp_path / "back.h5", form, solver="someone")
    result = open_result(tmp_path / "back.h5", tank)
    assert result.solver == "someone"
    task = of("particles")
    for frame in range(tank.setup.frames):
        found, true = task.read(tank, result, frame), task.truth(tank, frame)
        np.testing.assert_allclose(found.position_mm, true.position_mm, atol=1e-12)
    figures = score(tank, tmp_path / "back.h5")
    assert [figures[key] for key in ("f1", "link_recall", "link_precision")] == [1.0, 1.0, 1.0]


OUTSIDE = Path(__file__).parents[1] / "helpers" / "outside_optv.py"
LEAST = {"openptv": (0.99, 0.85, 0.99), "openlpt": (0.9, 0.6, 0.9)}


@pytest.mark.slow
@pytest.mark.parametrize(("form", "package"), [("openptv", "optv"), ("openlpt", "pyopenlpt")])
def test_a_program_solves_an_exported_project(
    form: Any, package: str, tank: Dataset, tmp_path: Path
) -> None:
    pytest.importorskip(package, reason=f"needs the package {package}")
    folder = export_quietly(tank, tmp_path / "out", None, form)
    code = f"import pyopenlpt; pyopenlpt.run({str(folder / 'config.txt')!r})"
    words = [OUTSIDE, folder] if form == "openptv" else ["-c", code]
    subprocess.run([sys.executable, *words], check=True, capture_output=True, timeout=60)
    solver = package.removeprefix("py")
    import_result(tank, folder, tmp_path / "found.h5", form, solver=solver)
    figures = score(tank, tmp_path / "found.h5")
    for key, least in zip(("precision", "recall", "link_precision"), LEAST[form], strict=True):
        assert figures[key] > least
    assert form == "openlpt" or figures["rms_mm"] < 0.02


@pytest.mark.parametrize("form", PROGRAMS)
def test_what_a_program_gets_has_no_truth(form: Format, tank: Dataset, tmp_path: Path) -> None:
    folder = export_quietly(tank, tmp_path / "out", None, form)
    names = {path.name for path in folder.rglob("*") if path.is_file()}
    images = len(tank.setup.cameras) * tank.setup.frames
    assert len(names) >= tank.setup.frames
    assert sum(path.stat().st_size > 50_000 for path in folder.rglob("*")) >= images
    banned = ("ptv_is", "rt_is", "particles", "trajectories", "tracks", "ConvergeTrack", "truth")
    assert not [name for name in names if name.startswith(banned)]


@pytest.mark.slow
def test_export_and_import(tank: Dataset, truth: Path, tmp_path: Path, command: Command) -> None:
    done = succeed(command("export", tank.root, truth, "--to", "openptv", "-o", tmp_path / "out"))
    assert "note: openptv" in done.stderr
    found = tmp_path / "found.h5"
    done = succeed(
        command("import-result", tank.root, tmp_path / "out", "--from", "openptv", "-o", found)
    )
    assert f"{found}: " in done.stdout
    assert "particles in 6 frames" in done.stdout
    succeed(command("score", tank.root, found, "--json"))


CSV = "frame,particle,x,y,z\n"


@pytest.mark.filterwarnings("ignore::sabench.interop.foreign.ForeignFormatWarning")
@pytest.mark.parametrize(
    ("rows", "more", "key"),
    [
        ("0,0,0.001,0.002,0.030\n1,1,0.001,0.002,0.030\n", {}, "unit"),
        ("3,1,1,2,30\n9,1,1,2,30\n", {}, "frames 3 to 9"),
        ("3,1,1,2,30\n", {"first": 4}, "from 4 on"),
        ("0,1,1,2,30\n0,1,1,1,30\n", {}, "frame 0: trajectory"),
        ("", {}, "found.csv"),
        ("".join(f"{frame},1,1,-2,-30\n" for frame in range(6)), {}, "volume"),
        ("0,1,1,2,30\n", {"task": "bubbles"}, "task: expected particles"),
    ],
    ids=["metres", "frames", "first", "twice", "none", "axes", "task"],
)
def test_wrong_results_are_one_sentence(
    tank: Dataset, tmp_path: Path, rows: str, more: dict[str, Any], key: str
) -> None:
    (tmp_path / "found.csv").write_text(CSV + rows, encoding="utf-8")
    with refused(key):
        import_result(tank, tmp_path / "found.csv", tmp_path / "out.h5", "csv", **more)
    assert not (tmp_path / "out.h5").exists()


def test_missing_frames_and_few_inside_are_said(tank: Dataset, tmp_path: Path) -> None:
    missing = "0,1,1,2,30\n1,1,1,2,30\n3,1,1,2,30\n"
    outside = "".join(f"{frame},{n},1,{9 * n},30\n" for frame in range(6) for n in range(11))
    for name, rows, key in (
        ("missing", missing, "frames 2, 4, 5"),
        ("outside", outside, "volume"),
    ):
        (tmp_path / "found.csv").write_text(CSV + rows, encoding="utf-8")
        with pytest.warns(ForeignFormatWarning, match=key) as caught:
            import_result(tank, tmp_path / "found.csv", tmp_path / f"{name}.h5", "csv")
        check_sentence(str(caught[0].message))


@pytest.mark.filterwarnings("ignore::sabench.interop.foreign.ForeignFormatWarning")
@pytest.mark.parametrize(
    ("shows", "row", "task", "key"),
    [
        (("bubbles",), "0,1,1,2,30,1e-5", None, "radii"),
        (("bubbles",), "0,1,1,2,30,50", None, "radii"),
        (("particles", "bubbles"), "0,1,1,2,30,1", None, "--task bubbles"),
        (("target",), "0,1,1,2,30,1", None, "target"),
        (("bubbles",), "0,1,1,2,30", None, "radius or diameter"),
        (("particles", "bubbles"), "0,1,1,2,30", "bubbles", "radius or diameter"),
    ],
)
def test_wrong_bubbles_are_one_sentence(
    tank: Dataset,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    shows: tuple[str, ...],
    row: str,
    task: str | None,
    key: str,
) -> None:
    monkeypatch.setattr(Dataset, "shows", shows)
    head = ["frame", "particle", "x", "y", "z", "radius"][: len(row.split(","))]
    (tmp_path / "found.csv").write_text(f"{','.join(head)}\n{row}\n", encoding="utf-8")
    with refused(key):
        import_result(tank, tmp_path / "found.csv", tmp_path / "out.h5", "csv", task=task)
    assert not (tmp_path / "out.h5").exists()


@pytest.mark.slow_but_first
@pytest.mark.parametrize("program", PROGRAMS)
def test_a_project_of_another_program_is_imported(
    tank: Dataset, tmp_path: Path, command: Command, program: Format
) -> None:
    """Images and calibration of one folder become a data set whose cameras see the same."""
    project = export_quietly(tank, tmp_path / "project", None, program)
    box = ("--volume=-6,6,-6,6,24,36",) if program == "myptv" else ()
    succeed(command("import", project, "--from", program, "-o", tmp_path / "back", *box))
    back = open_dataset(tmp_path / "back")
    assert back.setup.frames == tank.setup.frames
    middle = np.array([(axis[0] + axis[-1]) / 2.0 for axis in tank.setup.grid.axes_mm])
    points = np.random.default_rng(1).uniform(-2.0, 2.0, (20, 3)) + middle
    world = read_world(project)
    for number, (own, other) in enumerate(zip(tank.setup.cameras, back.setup.cameras, strict=True)):
        there = other.project(world.into(points))[0]
        np.testing.assert_allclose(there, own.project(points)[0], atol=1e-3)
        first, again = (one.raw_image(number, 2).astype(float).ravel() for one in (tank, back))
        assert np.corrcoef(first, again)[0, 1] > 0.98
