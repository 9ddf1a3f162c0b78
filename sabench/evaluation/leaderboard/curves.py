"""Curves of scores over one property of the scenes: density, cameras, noise, ..."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sabench import plugins
from sabench.evaluation.leaderboard.page_content import details_of, table_of
from sabench.evaluation.record_schema import Record
from sabench.evaluation.records import key_of
from sabench.evaluation.suite_loading import scenes_of
from sabench.scenes import Scene
from sabench.scenes.calibration import Calibration

_GROUP = ("task", "suite", "scene", "renderer", "split")
# words for keys of scenes; others are shown as they are
_QUANTITIES = {
    "particles.per_pixel": "particles per pixel",
    "particles.count": "particles",
    "bubbles.void_fraction": "void fraction",
    "cameras": "cameras",
    "illumination.pulse_energy_mj": "pulse energy, mJ (less light: more noise)",
    "sensor.read_noise_e": "read noise, electrons",
    "detection.noise_px": "noise of detected points, px",
    "calibration.shift_px": "calibration error, px",
    "calibration.center_mm": "calibration error, mm",
}
_LOGARITHMIC = {"illumination.pulse_energy_mj"}
Facts = dict[str, Any]


@dataclass(frozen=True)
class Curve:
    """Cases that differ in one property alone.

    Attributes
    ----------
    quantity : words for the property.
    logarithmic : whether its axis is.
    points : pairs of its value and the case's place on the page, rising.
    """

    task: str
    quantity: str
    logarithmic: bool
    points: tuple[tuple[float, int], ...]


def curves_of(cases: Sequence[Sequence[Record]]) -> list[Curve]:
    """Find all curves among cases, as the page has them.

    Scenes of bundled suites are compared as a whole; of other cases the varied values are known.
    """
    groups: dict[str, dict[int, Facts]] = {}
    bundled = {one.file.stem: one.file for one in plugins.tables("suite")}
    for place, rows in enumerate(cases):
        head = rows[0] | details_of(rows)
        if not table_of(head).recorded and (facts := _facts(head, bundled)):
            groups.setdefault(key_of(head, _GROUP), {})[place] = facts
    return [
        Curve(
            cases[points[0][1]][0]["task"], _QUANTITIES.get(key, key), key in _LOGARITHMIC, points
        )
        for group in groups.values()
        for key, points in _varied(group)
    ]


def _varied(group: Mapping[int, Facts]) -> Iterator[tuple[str, tuple[tuple[float, int], ...]]]:
    """Yield each property with the cases that differ in it alone, usual ones first."""
    known = list(_QUANTITIES)
    keys = {key for facts in group.values() for key in facts}
    for key in sorted(keys, key=lambda one: (known.index(one) if one in known else 99, one)):
        alike: dict[str, list[tuple[float, int]]] = {}
        for place, facts in group.items():
            value = facts.get(key)
            if isinstance(value, int | float) and not isinstance(value, bool):
                rest = {name: one for name, one in facts.items() if name != key}
                alike.setdefault(key_of({"rest": rest}, ("rest",)), []).append((value, place))
        for points in alike.values():
            if len({value for value, _ in points}) > 1:
                yield key, tuple(sorted(points))


def _facts(row: Record, bundled: Mapping[str, Path]) -> Facts:
    """List the properties of a case by dotted keys; bundled suites are by name."""
    file = bundled.get(row.get("suite") or "")
    scene = scenes_of(file).get(row["scene_hash"]) if file else None
    return _flatten(_comparable(scene)) if scene else dict(row.get("axes") or {})


def _comparable(scene: Scene) -> Facts:
    """Make a scene's table with the number of cameras in place of their layout.

    Nominal cameras without errors have errors of zero.
    """
    table = scene.to_dict()
    exact = Calibration().model_dump(mode="json", exclude_none=True)
    array = {key: value for key, value in table["cameras"].items() if key != "layout"}
    calibration = exact | table.get("calibration", {})
    return {
        **table,
        "title": "",
        "calibration": calibration,
        "cameras": scene.cameras.count,
        "camera": array,
    }


def _flatten(table: Mapping[str, Any], head: str = "") -> Facts:
    """Flatten tables within tables to dotted keys; without None."""
    flat: Facts = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            flat |= _flatten(value, f"{head}{key}.")
        elif value is not None:
            flat[f"{head}{key}"] = value
    return flat
