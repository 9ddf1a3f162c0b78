"""Values that no rig has name the key and the unit that would fit."""

from typing import Any

import pytest

from sabench import plugins
from sabench.apps.planning.plan import plan
from sabench.scenes import find, load_scene, parse_scene
from sabench.scenes.usual import unusual_values
from sabench.utils.files import read_toml


@pytest.mark.parametrize(
    ("table", "key", "value", "hint"),
    [
        ("cameras", "focal_length_mm", 0.085, "is this in metres? Then write 85"),
        ("cameras", "pixel_mm", 10.0, "is this in micrometres? Then write 0.01"),
        ("particles", "diameter_mm", 20.0, "is this in micrometres? Then write 0.02"),
        ("illumination", "wavelength_nm", 0.532, "is this in micrometres? Then write 532"),
        ("particles", "per_pixel", 3.0, "expected 0 to 0.5, as rigs have, got 3"),
    ],
)
def test_a_wrong_unit_is_named_with_its_key(table: str, key: str, value: float, hint: str) -> None:
    values: dict[str, Any] = read_toml(find("quick", "scenes"))
    if key == "per_pixel":
        del values["particles"]["count"]
    values[table][key] = value
    scene = parse_scene(values, "typing error")
    [(name, sentence)] = unusual_values(scene)
    assert name == f"{table}.{key}"
    assert hint in sentence
    if key not in ("wavelength_nm", "diameter_mm"):  # whose light is refused in a plan
        assert [advice.key for advice in plan(scene).advice] == [name]  # and blames no other


def test_one_camera_and_one_edge_are_found_among_usual_ones() -> None:
    values: dict[str, Any] = read_toml(find("quick", "scenes"))
    values["cameras"]["each"] = [
        {"camera": "camera_00", "focal_length_mm": 0.085},
        {"camera": "camera_01", "focal_length_mm": 85.0},
    ]
    values["volume"]["size_mm"] = [14.0e6, 10.0, 4.0]
    found = dict(unusual_values(parse_scene(values, "typing errors")))
    assert list(found) == ["volume.size_mm", "cameras.each.focal_length_mm"]
    assert "Then write 14" in found["volume.size_mm"]


def test_every_bundled_scene_has_usual_values() -> None:
    files = sorted(plugins.bundled_folder("scenes").glob("*.toml"))
    assert len(files) > 20
    for file in files:
        assert unusual_values(load_scene(file)) == []
