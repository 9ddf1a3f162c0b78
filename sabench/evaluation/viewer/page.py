"""Page of a view: data, script and library in one HTML file."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from markupsafe import Markup

from sabench.evaluation.viewer.contents import Contents
from sabench.evaluation.viewer.page_content import content_of
from sabench.evaluation.viewer.static_drawing import draw_surroundings
from sabench.plotting.outlines import STYLE
from sabench.plotting.page import escape_code, inline_code, inline_json, render_page
from sabench.utils.version import __version__

_FOLDER = Path(__file__).with_name("page")
_SCRIPTS = ("base", "colours", "raster", "space", "rig", "objects", "planes", "images", "main")


def render(contents: Contents) -> tuple[str, list[str]]:
    """Render contents as a self-contained page; say also what is left out."""
    values, arrays, notes = content_of(contents)
    content = {
        "title": contents.title,
        "facts": contents.facts,
        "notes": notes,
        "counts": _count_rows(contents),
        "frames": [f"{one.time_s:.6g}" for one in contents.frames],
        "cameras": _camera_rows(contents),
        "drawings": [Markup(one) for one in draw_surroundings(contents.surroundings)],
        "version": __version__,
        "data": inline_json(values),
        "arrays": arrays,
    }
    code = inline_code(_FOLDER, _SCRIPTS, _library(), STYLE)
    template = (_FOLDER / "page.html.j2").read_text(encoding="utf-8")
    return render_page(template, content | code), notes


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
