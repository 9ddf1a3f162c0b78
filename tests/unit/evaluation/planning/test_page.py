"""Drawings of rigs and the page of a plan."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from sabench.apps.planning.page import draw_rig, render
from sabench.apps.planning.plan import plan
from sabench.plotting.outlines import Outline, draw_outlines
from tests.conftest import Command


def shapes(svg: str, kind: str) -> list[str]:
    """Return the points of all shapes of a kind."""
    root = ElementTree.fromstring(svg)
    return [one.attrib["points"] for one in root.iter() if one.attrib.get("class") == kind]


@pytest.mark.parametrize(
    ("scene", "cameras", "walls"),
    [("quick", 4, 3), ("cylinder-tank", 4, 2), ("thesis-50x50x10", 25, 0)],
)
def test_a_rig_is_drawn_with_all_its_parts(scene: str, cameras: int, walls: int) -> None:
    made = plan(scene)
    drawings = dict(draw_rig(made.scene, made.viewing))
    assert list(drawings) == ["Rig, z and x", "Volume, z and x", "Rig, z and y", "Volume, z and y"]
    svg = drawings["Rig, z and x"]
    assert len(shapes(svg, "camera")) == cameras
    assert len(shapes(svg, "ray")) == 3 * cameras
    assert len(shapes(svg, "volume")) == 1
    assert len(shapes(svg, "wall")) == min(walls, 2)  # the back wall is outside the window
    assert shapes(svg, "sheet")


def test_outlines_are_to_scale() -> None:
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    low, high = np.array([-10.0, -10.0]), np.array([30.0, 30.0])
    svg = draw_outlines("a < b", [Outline("volume", square, closed=True)], low, high, ("z", "x"))
    (points,) = shapes(svg, "volume")
    assert points == "100.0,100.0 200.0,100.0 200.0,200.0 100.0,200.0"  # 400 px for 40 mm
    assert "10 mm; z to the right, x down" in svg
    assert 'd="M0 416.0 h100.0"' in svg


def test_the_page_escapes_what_a_scene_says() -> None:
    made = plan("quick")
    scene = made.scene.model_copy(update={"title": "<script>alert(1)</script>"})
    page = render(type(made)(scene, made.rig, made.viewing, made.sections))
    assert "<script" not in page


def test_the_command_prints_a_table_json_and_a_page(command: Command, tmp_path: Path) -> None:
    file = tmp_path / "plan.html"
    done = command("plan", "quick", "--html", str(file))
    assert done.stdout.endswith(f"{file}: the plan with drawings\n")
    assert done.returncode == 0, done.stderr
    assert re.search(r"plane_spacing_mm +│ 0\.157", done.stdout)
    assert "warning: illumination.pulse_energy_mj: " in done.stdout
    assert file.read_text(encoding="utf-8").startswith("<!doctype html>")
    assert command("plan", "quick", "--html", str(file)).returncode == 2  # it is there already
    found = json.loads(command("plan", "quick", "--json").stdout)
    assert found["figures"]["cameras"]["value"] == 4
    assert found["warnings"][0]["key"]
