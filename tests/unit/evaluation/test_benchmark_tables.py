"""Tables of benchmarks."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

import sabench.evaluation.timed_solving  # noqa: F401 - names what the server loads
from benchmarks import false_alarms, quality_without_truth, realism, standard_tables
from benchmarks.particle_density import CASES, scene_of
from benchmarks.particle_scores import Recording, find_particles, score_particles
from sabench import tasks
from sabench.api import FoundParticles
from sabench.api.make import make_algorithm
from sabench.scenes import Scene, build_rig, load_scene, parse_scene
from sabench.simulation.in_memory import simulate
from sabench.simulation.pipeline import generate
from sabench.tasks.particles import score_particle_frame
from sabench.utils.processes.call import call_isolated


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Four cameras in water behind glass; the sides are unequal everywhere."""
    values = load_scene("quick").to_dict()
    values["volume"]["size_mm"] = [9.0, 6.0, 3.0]
    values["particles"]["count"] = 120
    return parse_scene(values, "small")


def test_scores_are_those_of_the_task(scene: Scene, tmp_path: Path) -> None:
    data = generate(scene, tmp_path / "data", seed=4, backend="splat")
    shot = simulate(scene, seed=4)
    rng = np.random.default_rng(5)
    root = 0.003 * rng.normal(size=(3, 3)) + 0.01 * np.eye(3)
    true = shot.particles.position_mm[10:]
    found = FoundParticles(
        np.concatenate([true + rng.normal(size=true.shape) @ root.T, true[:7] + 0.7]),
        covariance_mm2=np.broadcast_to(root @ root.T, (len(true) + 7, 3, 3)),
    )
    recording = Recording(shot.observation.images, scene.sensor)
    own = score_particles(found, shot, build_rig(scene).cameras, recording)
    task = score_particle_frame(data, found, shot.particles, 0)
    assert own["recall"] == pytest.approx(100.0 * float(task["recall"] or 0.0), abs=0.01)
    for key, digits in (("f1", 4), ("rms_px", 4), ("coverage_68", 3), ("coverage_95", 3)):
        assert own[key] == round(float(task[key] or 0.0), digits), key
    assert own["rms_over_bound"] == pytest.approx(task["rms_over_bound"], rel=1e-3)


def test_particles_of_a_volume_are_its_maxima(scene: Scene) -> None:
    shot = simulate(scene, seed=4)
    found = find_particles(make_algorithm("msa", {}), shot.observation)
    scores = score_particles(found, shot, build_rig(scene).cameras, None)
    assert scores["recall"] > 80.0
    assert scores["rms_px"] < 0.5
    assert "rms_over_bound" not in scores


@pytest.mark.parametrize(
    ("case", "cameras"),
    [("equal 0.125", 4), ("nine 0.10", 9), ("thirteen 0.30", 13), ("twentyfive 0.50", 25)],
)
def test_cases_have_their_cameras_and_densities(case: str, cameras: int) -> None:
    assert len(build_rig(scene_of(case)).cameras) == cameras
    assert CASES[case].per_pixel == pytest.approx(float(case.split()[-1]))


def test_light_scatters_between_cameras_as_the_case_says() -> None:
    """By the logarithm of the ratio of two cameras' light."""
    values = scene_of("scatter 0.05").to_dict()
    values["particles"]["per_pixel"] = 0.01
    photons = [np.log(view.photons) for view in simulate(parse_scene(values, "s"), seed=7).views]
    scatter = np.mean([np.std(photons[i] - photons[j]) for i in range(4) for j in range(i)])
    assert scatter == pytest.approx(0.3, abs=0.03)


ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs/using/quality.md"


def cases(sign: float) -> list[dict[str, Any]]:
    made = []
    for n in range(5):
        pairs = quality_without_truth.PAIRS
        figures = {key: float(n) if key != "followed" else None for key, _ in pairs}
        true = {true: sign * float(np.exp(n)) for _, true in pairs}
        made.append({"solver": "bayesian_ipr", "figures": figures, "true": true})
    return made


def test_ranks_are_compared_where_both_are_known() -> None:
    for sign in (1.0, -1.0):
        for key, _, value, count in quality_without_truth.correlations(cases(sign)):
            known = key != "followed"
            assert count == (5 if known else 0)
            assert value == pytest.approx(sign) if known else np.isnan(value)


def test_the_page_shows_the_record() -> None:
    record = json.loads(quality_without_truth.RECORD.read_text(encoding="utf-8"))["cases"]
    page = PAGE.read_text(encoding="utf-8").splitlines()
    assert [line for line in quality_without_truth.table(record) if line not in page] == []


def test_scenes_of_cases() -> None:
    scene = quality_without_truth.make_scene(0.03, "dim", "cameras off")
    assert scene.frames == 4
    assert scene.calibration is not None
    assert scene.calibration.shift_px == 0.4
    assert quality_without_truth.make_scene(0.03, "bright", "true cameras").calibration is None


RECORDS: list[dict[str, Any]] = [
    {"case": "tracking-easy", "solver": "own", "label": None, "f1": 0.99},
    {"case": "tracking-easy", "solver": "optv", "label": "second", "f1": None},
    {"case": "tracking-hard", "solver": "own", "label": None, "f1": 0.7},
    {"case": "bubbles-hard", "solver": "own", "label": None, "f1": 0.1},
]


def test_a_table_has_a_row_for_each_case_and_a_column_for_each_solver() -> None:
    """Several seeds have a mean and an interval."""
    text = standard_tables.table(standard_tables.collect(RECORDS, "tracking-", "f1", 3))
    rows = ["| easy | 0.990 | - |", "| hard | 0.700 | - |"]
    assert text.splitlines() == ["| case | own | second |", "|---|---|---|", *rows]
    records = [{**RECORDS[0], "f1": 0.9 + 0.1 * seed} for seed in (0, 1)]
    row = standard_tables.collect(records, "tracking-", "f1", 2)["easy"]
    assert row == {"own": "0.95 ± 0.64"}  # t = 12.7 times the standard error


SCORES: realism.Scores = {
    ("clean", "good"): {1: 0.9, 2: 0.8, 3: 0.95},
    ("mie", "good"): {1: 0.7, 2: 0.7, 9: 0.1},
    ("clean", "bad"): {1: 0.5},
}


def test_a_cost_is_the_mean_over_the_seeds_of_both_cases() -> None:
    """The best solver in clean images comes first."""
    width = stats.t.interval(0.95, 1, scale=stats.sem([-0.2, -0.1]))[1]
    assert realism.cost(SCORES, "mie", "good") == f"-0.150 ± {width:.3f}"
    assert realism.cost(SCORES, "clean", "good").startswith(f"{np.mean([0.9, 0.8, 0.95]):.3f} ± ")
    assert realism.cost(SCORES, "mie", "bad") == "-"
    lines = realism.table(SCORES, ["clean", "mie"]).splitlines()
    assert lines[0] == "| effect | `good` | `bad` |"
    assert [line.split(" | ")[0] for line in lines[2:]] == ["| clean: the score", "| mie"]


def test_the_bundled_records_are_of_the_present_version_and_have_every_sensor() -> None:
    found = standard_tables.read_tables([ROOT / "leaderboard" / "records"])
    assert all(found.values())
    assert set(found["reconstruction"]) >= {"easy", "standard", "hard"}
    record = json.loads(false_alarms.RECORD.read_text(encoding="utf-8"))
    assert set(record["sensors"]) == set(false_alarms.SENSORS)
    assert false_alarms.tables(record)


def loaded() -> list[str]:
    return [name for name in sys.modules if name.startswith(("sabench.tasks.", "numba.np."))]


def test_a_solver_s_process_has_all_tasks_and_the_compiler_from_its_server() -> None:
    names = call_isolated(loaded, doing="look")
    assert {f"sabench.tasks.{name}" for name in tasks.NAMES} <= set(names)
    assert "numba.np.npyimpl" in names
