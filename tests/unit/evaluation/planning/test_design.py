"""Scenes that are designed for a wanted depth, density and resolution."""

from __future__ import annotations

from pathlib import Path

import pytest

from sabench.apps.planning.design import Wanted, design_scene
from sabench.apps.planning.plan import plan
from sabench.scenes import load_scene
from sabench.utils.errors import InputError
from tests.conftest import Command


@pytest.mark.slow
@pytest.mark.parametrize(
    ("base", "wanted"),
    [
        ("standard-particles", Wanted(20.0, 0.2, 0.08)),
        ("standard-particles", Wanted(4.0, 5.0, 0.03)),
        ("quick", Wanted(60.0, 0.01, 0.1)),
        ("thesis-50x50x10", Wanted(30.0, 0.5, 0.06)),
    ],
)
def test_a_design_has_what_was_wanted(base: str, wanted: Wanted) -> None:
    start, made = plan(base), plan(design_scene(load_scene(base), wanted))
    figures, before = made.to_dict()["figures"], start.to_dict()["figures"]
    assert figures["depth_mm"]["value"] == wanted.depth_mm
    assert figures["per_mm3"]["value"] == pytest.approx(wanted.per_mm3, rel=0.01)
    assert figures["pixel_center_mm"]["value"] == pytest.approx(wanted.pixel_mm, rel=1e-3)
    assert figures["scored_share"]["value"] > 0.99
    assert figures["cameras"] == before["cameras"]
    assert figures["peak_e"]["value"] == pytest.approx(before["peak_e"]["value"], rel=0.05)
    fields = [one["depth_of_field_mm"]["value"] for one in (figures, before)]
    assert fields[0] >= 0.999 * wanted.depth_mm


def test_the_base_s_own_figures_give_the_base() -> None:
    base = load_scene("standard-particles")
    figures = plan(base).to_dict()["figures"]
    wanted = Wanted(*(figures[key]["value"] for key in ("depth_mm", "per_mm3", "pixel_center_mm")))
    made = design_scene(base, wanted)
    assert made.cameras.center_mm == pytest.approx(base.cameras.center_mm, rel=1e-3)
    assert made.volume.size_mm == pytest.approx(base.volume.size_mm, rel=1e-3)
    assert made.light.pulse_energy_mj == pytest.approx(base.light.pulse_energy_mj, rel=0.01)


@pytest.mark.parametrize(
    ("base", "sentence"),
    [
        ("vortex-ring-experiment", "cameras.layout.kind: expected grid, ring, line or cross"),
        ("cylinder-tank", "wall: expected one plane wall or none"),
        ("plunging-jet-7", "particles: expected a scene with particles"),
    ],
)
def test_bases_that_cannot_be_scaled_are_refused(base: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        design_scene(load_scene(base), Wanted(10.0, 0.1, 0.05))


@pytest.mark.slow
def test_the_command_writes_a_scene_that_can_be_planned(command: Command, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    words = ("--depth", "8", "--density", "0.5", "--resolution", "0.05")
    done = command("plan", *words, "-o", str(file))
    assert done.returncode == 0, done.stderr
    assert load_scene(file).volume.size_mm[2] == 8.0
    again = command("plan", *words, "-o", str(file))
    assert again.returncode == 2
    missing = command("plan", "--depth", "8", "-o", str(tmp_path / "other.toml"))
    assert "--density, --resolution: expected" in missing.stderr
    assert "SCENE: expected a scene file" in command("plan").stderr
    assert not (tmp_path / "other.toml").exists()
