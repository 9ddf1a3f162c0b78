"""A key that would change nothing is refused, not ignored."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from sabench.scenes.loading import find, parse_scene
from sabench.utils.errors import InputError

MIRROR = {"wall.depth_mm": 200.0, "wall.mirrors": True}


def changed(name: str, changes: dict[str, Any]) -> dict[str, Any]:
    """Read a bundled scene and set values by their dotted keys."""
    values = tomllib.loads(find(name, "scenes").read_text(encoding="utf-8"))
    for dotted, value in changes.items():
        table, key = dotted.split(".")
        values.setdefault(table, {})[key] = value
    return values


@pytest.mark.parametrize(
    ("name", "changes", "fault"),
    [
        ("standard-bubbles", MIRROR, "wall.mirrors: expected a scene of particles alone"),
        ("calibration", {"cameras.airy_rings": True}, "cameras.airy_rings: expected a scene of"),
        (
            "quick",
            {"cameras.airy_rings": True, "cameras.particle_sigma_px": 0.7},
            "cameras.airy_rings: expected none beside particle_sigma_px",
        ),
        (
            "quick",
            {"illumination.scattering": "isotropic", "illumination.polarisation": [0.0, 1.0, 0.0]},
            "illumination.polarisation: expected none",
        ),
    ],
)
def test_a_key_that_would_change_nothing_is_refused(
    name: str, changes: dict[str, Any], fault: str
) -> None:
    with pytest.raises(InputError, match=fault):
        parse_scene(changed(name, changes), name, Path("scenes"))


@pytest.mark.parametrize(
    "changes",
    [
        {"cameras.airy_rings": True, **MIRROR},
        {"illumination.polarisation": [0.0, 1.0, 0.0]},
    ],
)
def test_the_same_keys_serve_particles(changes: dict[str, Any]) -> None:
    made = parse_scene(changed("quick", changes), "quick", Path("scenes")).to_dict()
    assert {
        dotted: made[dotted.split(".")[0]][dotted.split(".")[1]] for dotted in changes
    } == changes
