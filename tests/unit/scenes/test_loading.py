"""A scene says what it means, or one sentence says what it does not."""

import pickle
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sabench import scenes
from sabench.scenes.loading import find
from sabench.scenes.sensor import Sensor
from sabench.simulation.in_memory import make_particles
from sabench.utils.errors import InputError
from tests.helpers.refusals import check_sentence, refused


def change(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new)


FAULTS = [
    ("thickness_mm = 5.0 }", "thickness_cm = 0.5 }", "wall.layers.0.thickness_cm"),
    ("spacing_mm = [240.0", "spacing_m = [0.24", "cameras.layout.spacing_m"),
    ("count = 300", "count = 300\nper_mm3 = 1.0", "count, per_mm3"),
    ('"uniform"', '"unifrom"', "unifrom"),
    ('kind = "grid"', 'kind = "gird"', "cameras.layout"),
    ("rows = 240", "rows = 2.5", "cameras.rows"),
    ("index = 1.52", "index = 0.5", "wall.layers.0.index"),
    ("pixel_mm = 0.01", "pixel_mm = nan", "cameras.pixel_mm"),
    ("bit_depth = 12", "bit_depth = 17", "sensor.bit_depth"),
    ("normal = [0.0, 0.0, 1.0]\nair", "normal = [0.0, 0.0, 0.0]\nair", "wall.normal"),
    ("center_mm = [0.0, 0.0, -490.0]", "x_axis = [0.0, 0.0, 0.0]", "cameras.x_axis"),
    ("direction = [1.0, 0.0, 0.0]", "direction = [0.0, 0.0, 1.0]", "illumination"),
    ("-490.0]", "10.0]", "camera_00"),
    ("center_mm = [0.0, 0.0, 30.0]", "center_mm = [0.0, 0.0, 104.0]", "volume"),
    ("center_mm = [0.0, 0.0, 30.0]", "center_mm = [0.0, 0.0, 5.0]", "volume"),
    ("= 85.0", "= 85.0\naim_mm = [400.0, 0.0, 30.0]", "4"),
    ("f_number = 18.0", "f_number = 18.0\nfocus_mm = 50.0", "focus_mm"),
    ("crop_mm = [0.5", "crop_mm = [7.0", "crop_mm"),
    ("title =", "title", ": title "),
    ("count = 300", "count = true", "particles.count: expected a number"),
    ("count = 300", 'count = "300"', "particles.count: expected a number"),
    ("black_level_dn = 64.0", "black_level_dn = 5000.0", "sensor.black_level_dn"),
]


@pytest.mark.parametrize(("old", "new", "key"), FAULTS)
def test_a_fault_is_named(tmp_path: Path, quick_toml: str, old: str, new: str, key: str) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(change(quick_toml, old, new))
    with refused(str(file), key):
        scenes.load_scene(file)


def test_all_faults_are_named_together(tmp_path: Path, quick_toml: str) -> None:
    file = tmp_path / "bad.toml"
    text = re.sub(r"(?s)\[illumination\].*?(?=\n\[)", "", quick_toml)
    text = change(text, "focal_length_mm", "focal_lenght_mm")
    text = change(text, "read_noise_e = ", "read_noise_e = -")
    file.write_text(change(text, "count = 300", "per_mm = 3.0"))
    with refused(str(file), "4") as caught:
        scenes.load_scene(file)
    lines = str(caught.value).split("\n")[1:]
    keys = ["cameras.focal_lenght_mm", "illumination", "particles.per_mm", "sensor.read_noise_e"]
    assert sorted(line.strip().split(":")[0] for line in lines) == keys
    again = pickle.loads(pickle.dumps(caught.value))
    assert (str(again), again.faults) == (str(caught.value), caught.value.faults)


def test_faults_of_the_geometry_are_named_together() -> None:
    values = scenes.load_scene("quick").to_dict()
    values["grid"]["crop_mm"] = [7.0, 0.0, 0.0]
    values["cameras"]["focus_mm"] = 50.0
    values["occluders"] = [{"center_mm": [0.0, 0.0, 1.0], "radius_mm": 1.0}]
    scene = scenes.parse_scene(values, "bad")
    with refused("camera_00", "3") as caught:
        scenes.build_rig(scene, "bad")
    keys = [fault.split(":")[0] for fault in caught.value.faults]
    assert keys == ["grid.crop_mm", "cameras.focus_mm"]


def test_long_lists_of_faults_are_cut() -> None:
    error = InputError.from_faults("file", [f"key {number}: bad\nline" for number in range(30)])
    lines = str(error).split("\n")
    assert (len(lines), lines[1]) == (22, "  key 0: bad line")
    check_sentence(str(error), "file", "30", "10")


def test_a_misspelt_table_counts_as_given() -> None:
    values = scenes.load_scene("quick").to_dict()
    values["particels"] = values.pop("particles")
    with refused("s: particels") as caught:
        scenes.parse_scene(values, "s")
    assert len(caught.value.faults) == 1


WORLDS = {
    "quick": scenes.ParticleWorld,
    "vortex-ring-experiment": scenes.ParticleWorld,
    "plunging-jet-7": scenes.BubbleWorld,
    "calibration-boards": scenes.TargetWorld,
}


@pytest.mark.parametrize("name", WORLDS)
def test_a_scene_has_one_world(name: str) -> None:
    scene = scenes.load_scene(name)
    assert isinstance(scene.world, WORLDS[name])
    assert (scene.world.tracers is None) == (scene.particles is None)
    if scene.world.tracers is None:
        with refused("particles"):
            _ = scene.particle_world
    else:
        assert scene.particle_world.illumination == scene.illumination
        assert scene.particle_world.flow == scene.flow


def test_missing_scene_suggests_the_nearest() -> None:
    with refused("quick"):
        scenes.load_scene("quik")
    with refused("quick.toml: expected a scene, got a suite"):
        scenes.load_scene(find("quick", "scenes/suites"))


@pytest.mark.parametrize("name", ["quick", "cylinder-tank", "two-faces", "free-surface"])
def test_resolved_scene_is_the_same_scene(name: str, tmp_path: Path) -> None:
    scene = scenes.load_scene(name)
    (tmp_path / "again.toml").write_text(scene.to_toml())
    again = scenes.load_scene(tmp_path / "again.toml")
    assert again == scene
    assert again.hash == scene.hash


def test_what_a_scene_does_not_have_is_not_in_its_hash() -> None:
    """Data sets of earlier versions hold the hash of scenes without these tables."""
    values = scenes.load_scene("quick").to_dict()
    disc = {"center_mm": [0.0, 0.0, -9.0], "radius_mm": 5.0}
    assert not {"occluders", "calibration"} & set(values)
    both = scenes.parse_scene(values | {"occluders": [disc], "calibration": {}}, "s").to_dict()
    assert both["occluders"] == [disc | {"normal": [0.0, 0.0, 1.0]}]
    assert both["calibration"]["shift_px"] == 0.0
    changed = values | {"sensor": values["sensor"] | {"read_noise_e": 6.5}}
    assert scenes.parse_scene(values, "a").hash != scenes.parse_scene(changed, "b").hash


def test_schema_covers_every_key_of_a_scene() -> None:
    whole = scenes.scene_schema()
    assert set(scenes.load_scene("quick").to_dict()) <= set(whole["properties"])
    assert whole["additionalProperties"] is False
    for table, name in (("particles", "uniform"), ("targets", "boards")):
        known = [
            choice["properties"]["generator"]["const"]
            for choice in whole["properties"][table]["oneOf"]
            if "properties" in choice
        ]
        assert name in known
        assert ("boards" in known) == (table == "targets")
    assert all(part["description"] for part in whole["properties"].values())


def test_particles_of_a_frame_do_not_depend_on_other_frames_or_cameras() -> None:
    values = scenes.load_scene("quick").to_dict()
    values["particles"] |= {"velocity_mm_s": [3000.0, -100.0, 250.0]}
    one = scenes.parse_scene(values | {"frames": 3}, "one")
    values["cameras"]["layout"]["columns"] = 1
    other = scenes.parse_scene(values | {"frames": 9}, "other")
    for frame in (2, 0, 1):
        a, b = make_particles(one, 5, frame), make_particles(other, 5, frame)
        assert_array_equal(a.position_mm, b.position_mm)
        assert_array_equal(a.id, b.id)
    first, other_seed = (make_particles(one, seed, 0).position_mm for seed in (5, 6))
    assert not np.array_equal(first, other_seed)


def test_particles_move_with_their_velocity_and_stay_in_the_volume() -> None:
    values = scenes.load_scene("quick").to_dict()
    values["particles"] |= {"velocity_mm_s": [900.0, -100.0, 250.0]}
    scene = scenes.parse_scene(values | {"frames": 4}, "moving")
    first, last = make_particles(scene, 1, 0), make_particles(scene, 1, 3)
    stayed, at_first, at_last = np.intersect1d(first.id, last.id, return_indices=True)
    assert 100 < len(stayed) < 300
    moved = last.position_mm[at_last] - first.position_mm[at_first]
    assert_allclose(moved, np.tile([2.7, -0.3, 0.75], (len(stayed), 1)), atol=1e-9)
    low = np.asarray(scene.volume.center_mm) - np.asarray(scene.volume.size_mm) / 2
    assert (last.position_mm >= low).all()
    assert (last.position_mm <= low + scene.volume.size_mm).all()


@pytest.mark.parametrize(
    ("density", "count"), [({"per_mm3": 0.5}, 0.5 * 14 * 10 * 4), ({"per_pixel": 0.01}, 768)]
)
def test_density_per_volume_and_per_pixel(density: dict[str, float], count: float) -> None:
    values = scenes.load_scene("quick").to_dict()
    values["particles"] = {"generator": "uniform", **density}
    assert len(make_particles(scenes.parse_scene(values, "a"), 1, 0)) == round(count)


PLACES: list[Any] = [{"center_mm": [9.0, 8.0, -400.0]}, {"center_mm": [0.0, 0.0, -500.0]}]
PLACES[1]["aim_mm"] = [1, 0, 30]


@pytest.mark.parametrize(
    ("layout", "count"),
    [
        ({"kind": "ring", "count": 5, "radius_mm": 150.0, "start_deg": 10.0}, 5),
        ({"kind": "line", "count": 3, "spacing_mm": 120.0, "angle_deg": 90.0}, 3),
        ({"kind": "cross", "arm": 2, "spacing_mm": 80.0}, 9),
        ({"kind": "grid", "x_mm": [-300.0, -100.0, 50.0], "y_mm": [0.0, 90.0]}, 6),
        ({"kind": "list", "places": PLACES}, 2),
    ],
)
def test_every_layout_aims_its_cameras_at_the_volume(layout: dict[str, object], count: int) -> None:
    values = scenes.load_scene("quick").to_dict()
    values["cameras"]["layout"] = layout
    scene = scenes.parse_scene(values, "layout")
    first, *others = scenes.build_rig(scene).cameras
    assert len(others) == count - 1
    pixel, valid = first.project([scene.volume.center_mm])
    assert valid.all()
    assert_allclose(pixel[0], first.principal_point_px, atol=1e-9)


def test_a_gain_beyond_all_numbers_saturates_the_converter() -> None:
    assert Sensor(full_well_e=1e300, gain_dn_e=1e300, bit_depth=12).white_dn == 4095
    assert Sensor(full_well_e=1000.0, gain_dn_e=0.2, black_level_dn=7.4).white_dn == 207


MIRROR = {"wall.depth_mm": 200.0, "wall.mirrors": True}


def changed(name: str, changes: dict[str, Any]) -> dict[str, Any]:
    values = tomllib.loads(find(name, "scenes").read_text(encoding="utf-8"))
    for dotted, value in changes.items():
        table, key = dotted.split(".")
        values.setdefault(table, {})[key] = value
    return values


AIRY, POLARISED = {"cameras.airy_rings": True}, {"illumination.polarisation": [0.0, 1.0, 0.0]}


@pytest.mark.parametrize(
    ("name", "changes", "key"),
    [
        ("standard-bubbles", MIRROR, "wall.mirrors"),
        ("calibration", AIRY, "cameras.airy_rings"),
        ("quick", AIRY | {"cameras.particle_sigma_px": 0.7}, "cameras.airy_rings"),
        ("quick", POLARISED | {"illumination.scattering": "isotropic"}, "polarisation"),
    ],
)
def test_a_key_that_would_change_nothing_is_refused(name: str, changes: Any, key: str) -> None:
    with refused(key):
        scenes.parse_scene(changed(name, changes), name, Path("scenes"))


@pytest.mark.parametrize("changes", [AIRY | MIRROR, POLARISED])
def test_the_same_keys_serve_particles(changes: dict[str, Any]) -> None:
    made = scenes.parse_scene(changed("quick", changes), "quick", Path("scenes")).to_dict()
    for dotted, value in changes.items():
        table, key = dotted.split(".")
        assert made[table][key] == value
