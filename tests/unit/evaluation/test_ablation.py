"""Rules of the ablation, and how they are changed."""

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks import ablation, ablation_cases
from benchmarks.ablation import verdict, worth
from benchmarks.ablation_rules import OFF, ROOT, STRUCTURE, Rule, rules_of
from sabench.images import widths

ROOMS = ("images", "algorithms/particles", "algorithms/bubbles", "algorithms/calibration")


@pytest.mark.slow
def test_what_is_switched_off_or_left_alone_exists() -> None:
    """A constant or a branch that is gone leaves both lists."""
    rules = {rule.key: rule for room in ROOMS for rule in rules_of(room)}
    assert OFF.keys() <= rules.keys()
    assert all("off" in rules[key].variants for key in OFF)
    for key in STRUCTURE:
        module, _, name = key.rpartition(".")
        assert name in (ROOT / "sabench" / f"{module.replace('.', '/')}.py").read_text()
        assert key not in rules


@pytest.mark.slow
def test_numbers_are_doubled_and_halved_and_shares_as_what_they_miss() -> None:
    rules = {rule.key: rule.variants for rule in rules_of("images")}
    assert rules["images.widths._LEAST_SIGMA"] == {
        "doubled": "(0.6, 5.0)",
        "halved": "(0.15, 1.25)",
    }
    rules = {rule.key: rule.variants for rule in rules_of("algorithms/particles")}
    clip = rules["algorithms.particles.joint_fit._CLIP"]["doubled"]
    assert float(clip) == pytest.approx(0.94)


@pytest.mark.slow
def test_a_kernel_and_its_callers_hold_a_constant() -> None:
    rules = {rule.key: rule for rule in rules_of("algorithms/particles")}
    still = rules["algorithms.particles.joint_fit._LIGHT_STEPS"]
    assert {"find_light", "fit_particle", "remove_ghosts", "split_pairs"} <= still.kernels
    assert "algorithms.particles.particle_search.refine" in still.users
    assert not rules["algorithms.particles.bayesian_ipr._GROWTH"].kernels


def test_a_module_is_imported_with_the_other_value() -> None:
    code = (
        "from benchmarks.ablation_rules import change\n"
        "change('images.widths', 'LOCAL_PX', '0.5')\n"
        "from sabench.images import widths; print(widths.LOCAL_PX)"
    )
    told = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, check=True)
    assert float(told.stdout) == 0.5 != widths.LOCAL_PX


def test_a_case_that_is_worse_keeps_a_rule_and_a_particle_more_or_less_does_not() -> None:
    def table(f1: float, rms_px: float) -> dict[str, object]:
        base = {"case": "a", "seed": 1, "f1": 0.99, "rms_px": 0.1, "true": 200.0}
        changed = base | {"f1": f1, "rms_px": rms_px}
        rule = {"code": "1", "variants": {"off": [changed]}}
        return {"as it is": {"1": [base]}, "rules": {"rule": rule}}

    judged = {(0.98, 0.1): "keep", (1.0, 0.1): "turn", (0.985, 0.1): "go", (0.99, 0.12): "keep"}
    for figures, expected in judged.items():
        assert verdict(table(*figures), "rule") == expected
    assert worth(table(0.98, 0.2), "rule", "off")["a"].rms == pytest.approx(2.0)


def test_a_screening_ends_with_the_first_case_that_is_worse(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The fastest case comes first; a record is not measured again."""
    asked: list[tuple[str, str]] = []
    changed = {"doubled": "2", "halved": "1"}
    rule = Rule("images.a", "_B", "_B = 1", changed, set(), {"images.a.f"})

    def run(
        room: str, rule: Rule | None, variant: str, cases: list[str], seed: int
    ) -> Iterator[dict[str, object]]:
        for case in cases:
            asked.append((variant, case))
            lost = 0.1 if (variant, case) == ("halved", "fast") else 0.0
            seconds = {"fast": 1.0, "slow": 2.0}[case]
            figures = {"f1": 1.0 - lost, "rms_px": 0.1, "true": 200.0, "cpu_s": seconds}
            yield {"case": case, "seed": seed, "entered": ["images.a.f"]} | figures

    monkeypatch.setattr(ablation, "run_variant", run)
    monkeypatch.setattr(ablation, "rules_of", lambda room: [rule])
    monkeypatch.setattr(ablation_cases, "FOLDER", tmp_path)
    record = tmp_path / "record.json"
    options = argparse.Namespace(rules=[], seeds=[1], jobs=1, record=record)
    for _ in range(2):
        ablation.measure(options, "images", ["slow", "fast"])
        assert asked[2:] == [("doubled", "fast"), ("doubled", "slow"), ("halved", "fast")]
    assert verdict(json.loads(record.read_text())["images"], rule.key) == "keep"
    # with other code it stays as it was judged, until its own text changes or it is asked for
    monkeypatch.setattr(ablation, "code_of", lambda room: "other")
    ablation.measure(options, "images", ["slow", "fast"])
    assert asked[5:] == [("", "fast"), ("", "slow")]
    options.rules = ["_B"]
    ablation.measure(options, "images", ["slow", "fast"])
    assert len(asked) == 10
