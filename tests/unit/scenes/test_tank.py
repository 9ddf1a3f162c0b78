"""Walls of a scene: which one a camera looks through, and what cannot be."""

import json
import tomllib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.geometry.refraction import Wall
from sabench.scenes import Scene, build_rig, find, load_scene, parse_scene, scene_schema
from tests.helpers.refusals import refused

Change = Callable[[dict[str, Any]], None]
CYLINDER, FACES = "cylinder-tank", "two-faces"
THICK = [{"index": 1.5, "thickness_mm": 50.0}]
WIDE = {"focal_length_mm": 12.0, "rows": 800, "columns": 1000}


def values_of(name: str) -> dict[str, Any]:
    return tomllib.loads(find(name, "scenes").read_text(encoding="utf-8"))


def put(table: str, **keys: Any) -> Change:
    return lambda values: values[table].update(keys)


def place(*centers: list[float], **lens: float) -> Change:
    """Put the cameras elsewhere, with another lens or sensor."""
    places = [{"center_mm": center} for center in centers]
    return put("cameras", layout={"kind": "list", "places": places}, **lens)


def hide(z_mm: float) -> Change:
    disc = {"center_mm": [0.0, 0.0, z_mm], "radius_mm": 3.0}
    return lambda values: values.update({"occluders": [disc]})


def change_face(**keys: Any) -> Change:
    return lambda values: values["wall"][1].update(keys)


def add_backlight(values: dict[str, Any]) -> None:
    del values["particles"], values["illumination"]
    values["bubbles"] = {"generator": "bubble_field", "count": 3, "radius_mm": 0.5}
    values["backlight"] = {"center_mm": [0.0, 0.0, 80.0], "size_mm": [30.0, 30.0]}


FAULTS: list[tuple[str, Change, str]] = [
    (CYLINDER, put("volume", center_mm=[30.0, 0.0, 0.0]), "volume: |35 mm|37.05 mm"),
    (CYLINDER, place([0.0, 0.0, -37.0]), "cameras: camera_00"),
    (CYLINDER, put("wall", layers=THICK), "wall.layers: |outer_radius_mm"),
    (CYLINDER, put("wall", shape="round"), "wall.shape: |'round'"),
    (CYLINDER, put("wall", outer_radius=40.0), "wall.outer_radius: "),
    (CYLINDER, add_backlight, "wall: "),
    (CYLINDER, hide(-39.0), "occluders.0: |1 mm"),
    (FACES, place([-60.0, 0.0, -500.0], **WIDE), "cameras: camera_00|wall.0 and wall.1"),
    (FACES, place([0.0, 0.0, 20.0]), "cameras: camera_00"),
    (FACES, change_face(fluid_index=1.4), "wall.1.fluid_index: |1.333"),
    (FACES, change_face(mirrors=True), "wall.1.mirrors: "),
    (FACES, change_face(shape="cylinder"), "wall.1.shape: |'cylinder'"),
    (FACES, add_backlight, "wall: |2"),
    (FACES, hide(20.0), "occluders.0: |16.26 mm"),
]


@pytest.mark.parametrize(("name", "change", "keys"), FAULTS)
def test_what_cannot_be_is_named(name: str, change: Change, keys: str) -> None:
    values = values_of(name)
    change(values)
    first, *more = keys.split("|")
    with refused(f"scene: {first}", *more):
        build_rig(parse_scene(values, "scene"))


def test_cameras_choose_the_face_that_they_look_through() -> None:
    walls = [camera.wall for camera in build_rig(load_scene("two-faces")).cameras]
    assert all(isinstance(wall, Wall) for wall in walls)
    sides = [float(np.sign(wall.normal[0])) for wall in walls if isinstance(wall, Wall)]
    assert sides == [1.0, 1.0, -1.0, -1.0]


def test_a_face_beside_the_line_of_sight_is_not_chosen() -> None:
    """A camera in front of the planes of three faces of an octagon, but of one face only."""
    values = values_of("two-faces")
    angles = np.deg2rad([-45.0, 0.0, 45.0])
    normals = np.column_stack([np.sin(angles), np.zeros(3), np.cos(angles)])
    values["volume"]["center_mm"] = [0.0, 0.0, 0.0]
    values["wall"] = [
        {"point_mm": (-80.0 * normal).tolist(), "normal": normal.tolist(), "fluid_index": 1.333}
        for normal in normals
    ]
    place([0.0, 0.0, -500.0], [350.0, 0.0, -350.0], [-350.0, 0.0, -350.0])(values)
    rig = build_rig(parse_scene(values, "octagon"))
    found = [camera.wall.normal for camera in rig.cameras if isinstance(camera.wall, Wall)]
    assert_allclose(found, normals[[1, 0, 2]], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["cylinder-tank", "two-faces"])
def test_occluders_hide_nothing_from_the_other_side(name: str) -> None:
    """The straight line of a camera beyond the tank would meet the disc after leaving it again."""
    values = values_of(name)
    disc = {"center_mm": [-60.0, 0.0, -50.0], "normal": [1.0, 0.0, 1.0], "radius_mm": 5.0}
    values["occluders"] = [disc]
    place([-300.0, 0.0, -300.0], [300.0, 0.0, 300.0 if name == CYLINDER else -300.0])(values)
    rig = build_rig(parse_scene(values, "scene"))
    assert [len(rig.occluders_of(camera)) for camera in rig.cameras] == [1, 0]


def test_the_walls_of_a_plane_scene_are_written_as_before() -> None:
    """The hash of a scene, and with it a data set's identity, does not know the new keys."""
    scene = load_scene("quick")
    keys = {"air_index", "depth_mm", "fluid_index", "layers", "normal", "point_mm"}
    assert {*scene.to_dict()["wall"]} == keys
    assert scene.walls == (scene.plane,)
    assert scene.fluid_index == 1.333
    assert Scene.model_validate({**values_of("quick"), "wall": None}).fluid_index == 1.0


def test_the_schema_knows_all_walls() -> None:
    text = json.dumps(scene_schema())
    assert all(f"#/$defs/{name}" in text for name in ("WallSpec", "CylinderSpec"))


def test_the_cylinder_and_the_free_surface_of_a_scene() -> None:
    wall: Any = build_rig(load_scene("cylinder-tank")).cameras[0].wall
    assert wall.radii_mm.tolist() == [40.0, 35.0]
    assert wall.indices.tolist() == [1.0, 1.52, 1.333]
    surface: Any = build_rig(load_scene("free-surface")).cameras[0].wall
    assert surface.indices.tolist() == [1.0, 1.333]
