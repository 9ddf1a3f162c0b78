"""Gates: comparison of figures with a baseline, and the planted bugs that they shall find."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from xml.etree import ElementTree

import numpy as np
import pytest

from benchmarks.gate import ROOT
from benchmarks.planted_bugs import BUGS, Bug
from sabench import tasks
from sabench.evaluation.gates import comparison
from sabench.evaluation.gates.baseline import (
    DATA,
    Baseline,
    CaseEntry,
    Entry,
    Tolerance,
    default_path,
    default_tolerance,
    read_baseline,
    write_baseline,
)
from sabench.evaluation.gates.comparison import GateReport, names_of, score_known_wrong, write_junit
from sabench.evaluation.gates.dataset_statistics import fingerprint
from sabench.evaluation.gates.findings import Finding, compare, loss
from sabench.evaluation.gates.independent_projection import retrace
from sabench.evaluation.suite_loading import load_suite
from sabench.evaluation.suites import SolverEntry
from sabench.scenes import Scene, build_rig, load_scene, parse_scene
from sabench.scenes.loading import find
from sabench.simulation.pipeline import generate
from sabench.tasks.task import Better
from tests.helpers.refusals import refused

TOLERANCES = {"reconstruction": {"q": Tolerance(relative=0.01, absolute=0.0)}}


def case(data: dict[str, float | None] | None = None, **solvers: Entry) -> CaseEntry:
    return CaseEntry(
        case="a", seed=1, renderer="splat", scene_hash="0", data=data or {}, solvers=solvers
    )


def entry(reference_s: float | None = 0.01, **figures: float | None) -> Entry:
    return Entry(figures=figures, reference_s=reference_s)


def found(
    before: CaseEntry, now: CaseEntry, tolerances: Any = TOLERANCES
) -> list[tuple[str, bool]]:
    tracks = dict.fromkeys(now.solvers, "reconstruction")
    return [(one.figure or one.text, one.worse) for one in compare(before, now, tracks, tolerances)]


@pytest.mark.parametrize(
    ("task", "figure", "before", "now", "change"),
    [
        ("reconstruction", "q", 0.8, 0.7, 0.1),
        ("reconstruction", "peak_recall", 0.5, 0.75, -0.25),
        ("velocimetry", "bias_voxel", 0.1, 0.05, -0.05),
        ("calibration", "z_mean_mm", -0.3, 0.2, -0.1),
        ("velocimetry", "response", 0.9, 1.2, 0.1),
        ("velocimetry", "response", 1.3, 0.9, -0.2),
        ("calibration", "bound_px", 0.3, 0.2, 0.1),
        ("see_through", "single_percent", 70.0, 75.0, 5.0),
        ("bubbles", "seconds", 1.0, 3.0, 2.0),
    ],
)
def test_what_is_worse_depends_on_the_score(
    task: str, figure: str, before: float, now: float, change: float
) -> None:
    better: Better = tasks.of(task).score_of(figure).better
    assert loss(better, before, now) == pytest.approx(change)


def test_scores_that_describe_the_data_are_the_only_steady_ones() -> None:
    every = [score for task in tasks.every() for score in task.columns]
    data = {"single_percent", "best_single_percent", "single_separation"}
    steady = {"bound_px", "held_out_exact_mm"} | data
    assert {score.key for score in every if score.better == "steady"} == steady


def test_only_what_is_beyond_its_tolerance_is_told() -> None:
    before = case(msa=entry(q=0.800, rms_px=0.2))
    assert found(before, case(msa=entry(q=0.7921, rms_px=0.2))) == []
    assert found(before, case(msa=entry(q=0.7919, rms_px=0.2))) == [("q", True)]
    assert found(before, case(msa=entry(q=0.8081, rms_px=0.2))) == [("q", False)]
    both = found(before, case(msa=entry(peak_rms_px=0.1, q=0.1, rms_px=0.3)))
    assert [figure for figure, _ in both] == ["q", "rms_px", "peak_rms_px"]  # the first score first
    # no tolerance of its own: the rule's
    assert found(before, case(msa=entry(q=0.8, rms_px=0.3))) == [("rms_px", True)]


def test_an_absolute_tolerance_holds_where_the_relative_one_is_smaller() -> None:
    both = {"reconstruction": {"q": Tolerance(relative=0.01, absolute=0.05)}}
    for before, now, worse in ((0.8, 0.76, []), (0.8, 0.74, [("q", True)]), (8.0, 7.93, [])):
        assert found(case(msa=entry(q=before)), case(msa=entry(q=now)), both) == worse


def test_a_lost_figure_is_worse_and_a_new_one_is_news() -> None:
    with_it, without = case(msa=entry(q=0.8, rms_px=0.2)), case(msa=entry(q=0.8, rms_px=None))
    assert found(with_it, without) == [("rms_px", True)]
    assert found(without, with_it) == [("rms_px", False)]
    assert found(without, without) == []


def test_missing_and_failed_solvers_are_worse_and_new_ones_news() -> None:
    good, bad = entry(q=0.8), Entry(error="it fell")
    text = "it is in the baseline but did not run: is its name another, or a parameter?"
    assert found(case(msa=good), case()) == [(text, True)]
    assert found(case(), case(msa=good)) == [("not in the baseline", False)]
    assert found(case(msa=good), case(msa=bad)) == [("failed: it fell", True)]
    assert found(case(msa=bad), case(msa=good)) == [("it failed before and does not now", False)]
    assert found(case(msa=bad), case(msa=bad)) == []


def test_times_are_over_the_reference_kernels() -> None:
    """Ten times slower is no change on a machine that is ten times slower."""
    before = case(msa=entry(0.01, seconds=2.0))
    assert found(before, case(msa=entry(0.1, seconds=20.0))) == []
    assert found(before, case(msa=entry(0.01, seconds=20.0))) == [("seconds", True)]
    (finding,) = compare(before, case(msa=entry(0.1, seconds=400.0)), {"msa": "reconstruction"}, {})
    assert finding.before == 2.0
    assert finding.now == pytest.approx(40.0)


def test_a_data_set_s_figures_may_move_neither_way() -> None:
    probe = "probe.reconstruction.q"
    keys = ("camera_00.column_mean", "camera_00.retraced_px", probe)
    before, same, moved = (
        dict(zip(keys, values, strict=True))
        for values in ((100.0, 1e-9, 0.8), (100.0000001, 2e-8, 0.80001), (99.9, 1e-4, 0.81))
    )
    assert found(case({**before}), case({**same})) == []
    assert [one.solver for one in compare(case({**before}), case({**moved}), {}, {})] == [DATA] * 3
    assert all(worse for _, worse in found(case({**before}), case({**moved})))
    assert found(case({**before}), case({**same, probe: None})) == [(probe, True)]


def test_rounding_is_allowed_and_lost_pixels_are_not() -> None:
    for task in tasks.every():
        for score in task.columns:
            assert default_tolerance(task.name, score.key).allowed(1.0) > 1e-4
    assert default_tolerance(DATA, "column_mean").allowed(500.0) < 0.01
    assert default_tolerance(DATA, "retraced_px").allowed(0.0) < 1e-5


def baseline() -> Baseline:
    cases = (case({"camera_00.column_mean": 1.5}, msa=entry(q=0.8, rms_px=None)),)
    about = {"suite": "tiny", "sabench": "0", "machine": {"cores": 2}, "versions": {}}
    return Baseline.model_validate(about | {"tolerances": TOLERANCES, "cases": cases})


def test_a_baseline_comes_back_from_its_file_and_equal_ones_are_equal_bytes(tmp_path: Path) -> None:
    for name in ("one.json", "other.json"):
        write_baseline(tmp_path / name, baseline())
    assert read_baseline(tmp_path / "one.json", "tiny") == baseline()
    assert (tmp_path / "one.json").read_bytes() == (tmp_path / "other.json").read_bytes()


def without_cases(text: str) -> str:
    return json.dumps({key: one for key, one in json.loads(text).items() if key != "cases"})


FAULTS: dict[str, tuple[Any, str]] = {
    "no JSON": (lambda text: text[:-20], ""),
    "another format": (lambda text: text.replace("sabench-baseline", "sabench-dataset"), ""),
    "a list": (lambda text: "[]", ""),
    "another version": (lambda text: text.replace('"version": 1', '"version": 2'), "version 1"),
    "another suite": (lambda text: text.replace('"tiny"', '"large"'), "tiny"),
    "no cases": (without_cases, "cases"),
    "no figures": (lambda text: text.replace('"data"', '"date"'), "cases.0.dat"),
    "a word for a number": (lambda text: text.replace("0.8", '"good"'), "figures.q"),
    "a negative tolerance": (
        lambda text: text.replace('"relative": ', '"relative": -'),
        "relative",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_bad_baselines_are_refused_in_one_sentence(name: str, tmp_path: Path) -> None:
    change, key = FAULTS[name]
    path = tmp_path / "baseline.json"
    write_baseline(path, baseline())
    path.write_text(change(path.read_text()))
    with refused(str(path), key):
        read_baseline(path, "tiny")


def test_the_bundled_baseline_is_of_the_bundled_suite() -> None:
    kept = read_baseline(default_path(find("ci", "scenes/suites")), "ci")
    cases = load_suite("ci")[1]
    assert [one.key for one in kept.cases] == [(one.name, one.seed) for one in cases]
    for entry_, case_ in zip(kept.cases, cases, strict=True):
        assert entry_.scene_hash == case_.data_hash
        assert set(entry_.solvers) == set(names_of(case_.solvers, case_.name))
        assert not any(one.error for one in entry_.solvers.values())
        assert len(entry_.data) > 20
        retraced = [value for key, value in entry_.data.items() if key.endswith("retraced_px")]
        assert all(value is not None and value < 1e-8 for value in retraced)


def test_the_bundled_suite_has_every_track_and_both_renderers() -> None:
    from sabench.plugins import load

    _, cases = load_suite("ci")
    served = {load("solvers", one.name).task for case_ in cases for one in case_.solvers}
    assert served >= set(tasks.NAMES)
    assert {one.renderer for one in cases} == {"splat", "mitsuba"}


@pytest.mark.parametrize("share", [None, 0.25])
def test_seconds_of_a_gate_are_cpu_seconds_without_compilation(
    share: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A solver that had a quarter of a core took a quarter of its time."""
    monkeypatch.setattr(comparison, "solve_timed", lambda *_, **__: 0.01)
    scores = {"q": 0.5, "seconds": 2.0, "reconstruction_s": 1.0, "compile_s": 20.0}
    monkeypatch.setattr(comparison, "score", lambda *_: scores)
    monkeypatch.setattr(comparison, "open_result", lambda *_: SimpleNamespace(cpu_share=share))
    unused = cast(Any, None)
    entry_ = comparison._solve(unused, unused, SolverEntry(name="msa"), Path("unused.h5"))
    part = share or 1.0
    assert entry_.figures == {"q": 0.5, "seconds": 2.0 * part, "reconstruction_s": part}


def test_solvers_of_one_name_need_labels() -> None:
    two = [SolverEntry(name="msa", parameters={"k": value}) for value in (1.0, 2.0)]
    assert list(names_of(two, "s")) == ["msa k=1.0", "msa k=2.0"]
    with refused("case a: solvers"):
        names_of([two[0], two[0]], "case a")


def report(*worse: Finding, news: tuple[Finding, ...] = ()) -> GateReport:
    return GateReport("tiny", worse, news, baseline())


def test_junit_has_a_case_for_the_data_and_each_solver(tmp_path: Path) -> None:
    bad = Finding("a", 1, "msa", "q", 0.8, 0.6, 0.008, worse=True)
    text = "a \x00 case <gone> & more"
    gone = Finding("b", 1, "asa", "", None, None, None, worse=True, text=text)
    better_ = Finding("a", 1, DATA, "", None, None, None, worse=False, text="new")
    write_junit(tmp_path / "out.xml", report(bad, gone, news=(better_,)))
    root = ElementTree.fromstring((tmp_path / "out.xml").read_bytes())
    (suite,) = root
    assert (root.tag, suite.tag) == ("testsuites", "testsuite")
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("3", "2", "0")
    names = [(one.get("classname"), one.get("name")) for one in suite]
    assert names[:2] == [("tiny.a.seed1", DATA), ("tiny.a.seed1", "msa")]
    assert names[2:] == [("tiny.b.seed1", "asa")]
    assert suite[1].findtext("failure") == bad.sentence
    assert "0.8 before, 0.6 now, -0.2 where 0.008 is allowed" in bad.sentence
    assert "case <gone> & more" in (suite[2].findtext("failure") or "")
    assert suite[0].find("failure") is None
    assert suite[0].findtext("system-out") == better_.sentence


def slanted(**changes: Any) -> Scene:
    values = load_scene("quick").to_dict()
    layers = [{"index": 1.52, "thickness_mm": 7.0}, {"index": 1.34, "thickness_mm": 3.0}]
    values["wall"] |= {"normal": [0.1, -0.06, 1.0], "layers": layers}
    values["cameras"]["distortion"] = {"k1": -0.4, "k2": 3.0, "k3": 20.0, "p1": 0.02, "p2": -0.03}
    values["volume"]["size_mm"], values["particles"]["count"] = [9.0, 6.0, 3.0], 40
    return parse_scene(values | changes, "slanted")


@pytest.mark.slow_but_first
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (14.0, -8.0)])
@pytest.mark.parametrize("wall", [True, False])
def test_two_implementations_of_a_camera_agree(wall: bool, tilt: tuple[float, float]) -> None:
    scene = slanted()
    scene = scene if wall else scene.model_copy(update={"wall": None})
    points = np.random.default_rng(1).uniform([-4.5, -3.0, 28.0], [4.5, 3.0, 32.0], (50, 3))
    for upright in build_rig(scene).cameras:
        camera = replace(upright, tilt_deg=tilt)
        found, expected = retrace(scene, camera, points), camera.project(points)[0]
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9)


@pytest.mark.slow
def test_a_fingerprint_is_the_same_twice_and_another_for_another_seed(tmp_path: Path) -> None:
    made = [
        fingerprint(generate(slanted(), tmp_path / str(n), seed=seed, backend="splat"))
        for n, seed in enumerate((1, 1, 2))
    ]
    assert made[0] == made[1]
    assert set(made[0]) == set(made[2])
    moved = [one for one in compare(case({**made[0]}), case({**made[2]}), {}, {}) if one.worse]
    assert len(moved) > 0.4 * len(made[0])
    assert max(value for key, value in made[0].items() if key.endswith("retraced_px")) < 1e-9


@pytest.mark.slow
def test_a_probe_finds_some_particles_and_some_ghosts(tmp_path: Path) -> None:
    data = generate(slanted(), tmp_path / "data", seed=1, backend="splat")
    figures = score_known_wrong(data, tmp_path / "probe.h5")
    assert 0.5 < figures["probe.reconstruction.q"] < 0.95
    assert 0.1 < figures["probe.reconstruction.precision"] < 0.9
    assert figures["probe.reconstruction.ghost_percent"] > 20.0
    assert figures == score_known_wrong(data, tmp_path / "probe.h5")


@pytest.mark.parametrize("bug", BUGS, ids=lambda bug: bug.title)
def test_the_line_to_replace_is_in_the_file_once(bug: Bug) -> None:
    text = (ROOT / bug.file).read_text(encoding="utf-8")
    assert text.count(bug.old) == 1
    assert bug.old != bug.new
