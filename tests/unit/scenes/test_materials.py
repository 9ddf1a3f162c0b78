"""Materials of a scene: their names become indices at the wavelength of its light."""

import tomllib
from typing import Any

import pytest

from sabench.scenes import Scene, build_rig, find, parse_scene
from sabench.scenes.materials import fill_indices, refractive_index
from sabench.scenes.wall import CylinderSpec, WallSpec
from sabench.utils.validation import validate
from tests.helpers.refusals import refused


def quick(wall: dict[str, Any], layer: dict[str, Any], **light: Any) -> Scene:
    values = tomllib.loads(find("quick", "scenes").read_text(encoding="utf-8"))
    values["wall"] = {"layers": [{"thickness_mm": 5.0, **layer}], "depth_mm": 100.0, **wall}
    values["illumination"] |= light
    return parse_scene(values, "test")


@pytest.mark.parametrize(("nm", "glass"), [(532.0, 1.51947), (632.8, 1.51509)])
def test_the_wall_has_the_indices_at_the_laser_s_wavelength(nm: float, glass: float) -> None:
    scene = quick({"fluid": "water", "temperature_c": 25.0}, {"material": "BK7"}, wavelength_nm=nm)
    wall: Any = build_rig(scene).cameras[0].wall
    assert wall.fluid_index == refractive_index("water", nm, 25.0)
    assert wall.layers[0].index == pytest.approx(glass, abs=1e-5)


def test_a_scene_with_materials_survives_being_written() -> None:
    scene = quick({"fluid": "water"}, {"material": "acrylic"})
    written = tomllib.loads(scene.to_toml())
    assert "index" not in written["wall"]["layers"][0]
    assert "fluid_index" not in written["wall"]
    again = parse_scene(written, "again")
    assert again == scene
    assert again.hash == scene.hash
    assert scene.with_frames(3).wall == scene.wall
    red = {**written, "illumination": {**written["illumination"], "wavelength_nm": 650.0}}
    wall: Any = parse_scene(red, "red").plane
    assert wall.fluid_index == refractive_index("water", 650.0)


def test_round_tanks_and_tanks_of_several_faces_have_materials() -> None:
    values = tomllib.loads(find("quick", "scenes").read_text(encoding="utf-8"))
    layers = [{"material": "acrylic", "thickness_mm": 5.0}]
    face = {"fluid": "water", "temperature_c": 30.0, "layers": layers}
    round_tank = {"shape": "cylinder", "outer_radius_mm": 80.0, **face}
    for wall in ([face, face], round_tank):
        filled, faults = fill_indices({**values, "wall": wall})
        assert not faults
        for one in filled["wall"] if isinstance(wall, list) else [filled["wall"]]:
            kind: type[WallSpec | CylinderSpec] = CylinderSpec if "shape" in one else WallSpec
            made: WallSpec | CylinderSpec = validate(kind, one, "test")
            assert made.fluid_index == refractive_index("water", 532.0, 30.0)
            assert made.layers[0].index == refractive_index("acrylic", 532.0)
            assert "fluid_index" not in made.model_dump()


def test_the_window_of_the_laser_has_materials_too() -> None:
    entry: dict[str, Any] = {"point_mm": [-60.0, 0.0, 0.0], "normal": [1.0, 0.0, 0.0]}
    entry["layers"] = [{"material": "fused silica", "thickness_mm": 3.0}]
    light: Any = quick({"fluid": "water"}, {"material": "BK7"}, entry=entry).illumination
    assert light.entry.layers[0].index == refractive_index("fused silica", 532.0)


@pytest.mark.parametrize(
    ("wall", "layer", "key"),
    [
        ({}, {"material": "BK8"}, "layers.0.material"),
        ({}, {"material": "BK7", "index": 1.5}, "layers.0.material"),
        ({"fluid": "water"}, {"index": 1.5}, "fluid"),
        ({"temperature_c": 20.0}, {"index": 1.5}, "temperature_c"),
        ({}, {}, "layers.0.index"),
    ],
)
def test_what_cannot_be_is_named(wall: dict[str, Any], layer: dict[str, Any], key: str) -> None:
    with refused(f"test: wall.{key}"):
        quick({"fluid_index": 1.333, **wall}, layer)


def test_a_wall_outside_a_scene_needs_numbers() -> None:
    layers = [{"material": "BK7", "thickness_mm": 1.0}]
    with refused("test: layers.0", "index"):
        validate(WallSpec, {"fluid_index": 1.333, "layers": layers}, "test")
    with refused("test", "fluid_index"):
        validate(WallSpec, {"fluid": "water"}, "test")
