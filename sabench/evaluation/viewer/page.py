"""Page of a view: data, script and library in one HTML file."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from sabench.evaluation.viewer.contents import Contents
from sabench.evaluation.viewer.page_content import content_of
from sabench.evaluation.viewer.static_drawing import draw_surroundings
from sabench.plotting.outlines import STYLE
from sabench.utils.inline_code import escape_code, escape_json, hash_code, join_scripts
from sabench.utils.version import __version__

_FOLDER = Path(__file__).with_name("page")
_SCRIPTS = ("base", "colours", "raster", "space", "rig", "objects", "planes", "images", "main")


def render(contents: Contents) -> tuple[str, list[str]]:
    """Render contents as a self-contained page; say also what is left out."""
    values, arrays, notes = content_of(contents)
    style = escape_code(STYLE + (_FOLDER / "page.css").read_text(encoding="utf-8"))
    texts = {"style": style, "script": join_scripts(_FOLDER, _SCRIPTS), "library": _library()}
    environment = Environment(
        loader=FileSystemLoader(_FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("page.html.j2").render(
        title=contents.title,
        facts=contents.facts,
        notes=notes,
        counts=_count_rows(contents),
        frames=[f"{one.time_s:.6g}" for one in contents.frames],
        cameras=_camera_rows(contents),
        drawings=[Markup(one) for one in draw_surroundings(contents.surroundings)],
        version=__version__,
        **{name: Markup(text) for name, text in texts.items()},
        hashes={name: Markup(hash_code(text)) for name, text in texts.items()},
        data=Markup(escape_json(json.dumps(values, separators=(",", ":"), allow_nan=False))),
        arrays=arrays,
    )
    return page, notes


@cache
def _library() -> str:
    return escape_code((_FOLDER / "three.min.js").read_text(encoding="utf-8"))


def _count_rows(contents: Contents) -> list[tuple[str, list[int]]]:
    """List the kinds of particles and bubbles with their numbers in every frame."""
    return [
        (f"{sort}: {contents.labels.get(kind, kind)}", numbers)
        for sort, kinds in contents.totals().items()
        for kind, numbers in kinds.items()
    ]


def _camera_rows(contents: Contents) -> list[tuple[str, str, Any]]:
    """List name, position and image size of each camera."""
    return [
        (
            one.name,
            ", ".join(f"{value:.5g}" for value in one.center_mm),
            f"{one.rows} x {one.columns}",
        )
        for one in contents.surroundings.cameras
    ]
