"""Page of the leaderboard: its rows as one self-contained HTML file.

Users sort, filter, plot and compare the rows in their browser.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from sabench import plugins
from sabench.evaluation.leaderboard.page_content import cases_of, content_of
from sabench.evaluation.leaderboard.page_figures import albums_of
from sabench.evaluation.leaderboard.page_standings import front_of
from sabench.evaluation.record_schema import Record
from sabench.utils.inline_code import escape_code, escape_json, hash_code, join_scripts
from sabench.utils.version import __version__

_SCRIPTS = (
    "base",
    "state",
    "rows",
    "download",
    "table",
    "plots",
    "front",
    "viewer",
    "case",
    "main",
)


def render(rows: Sequence[Record], pictures: Path) -> str:
    """Render rows of `over_seeds` as a page.

    `pictures` holds the folders that the records name; figures outside it are left out.
    """
    cases = cases_of(rows)
    albums, left_out = albums_of(cases, pictures)
    front, static = front_of(cases)
    dates = [run["date"][:10] for row in rows for run in row["runs"] if run.get("date")]
    facts = {"version": __version__, "date": max(dates, default=""), "static": static}
    return _assemble(content_of(cases) | front | {"leftOut": left_out}, albums, facts)


def _assemble(
    data: dict[str, Any], albums: dict[int, dict[str, str]], facts: dict[str, Any]
) -> str:
    folder = plugins.bundled_folder("leaderboard")
    style = escape_code((folder / "page" / "page.css").read_text(encoding="utf-8"))
    script = join_scripts(folder / "page", _SCRIPTS)
    texts = {"style": style, "script": script, "library": library()}
    environment = Environment(
        loader=FileSystemLoader(folder),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    blocks = {number: _data(album) for number, album in albums.items()}
    hashes = {name: hash_code(text) for name, text in texts.items()}
    return environment.get_template("page.html.j2").render(
        **texts, **facts, hashes=hashes, data=_data(data), albums=blocks
    )


@cache
def library() -> str:
    """Load the plotting library as a script: Vega-Embed with all that it needs."""
    import vl_convert  # it loads 90 MB, which no other command needs

    return escape_code(vl_convert.javascript_bundle("window.vegaEmbed = vegaEmbed;"))


def _data(value: Any) -> str:
    """Serialise as JSON in which no markup can begin."""
    return escape_json(json.dumps(value, separators=(",", ":"), allow_nan=False))
