"""Page of the leaderboard: its rows as one self-contained HTML file.

Users sort, filter, plot and compare the rows in their browser.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

from sabench import plugins
from sabench.evaluation.leaderboard.page_content import cases_of, content_of
from sabench.evaluation.leaderboard.page_figures import albums_of
from sabench.evaluation.leaderboard.page_standings import front_of
from sabench.evaluation.record_schema import Record
from sabench.plotting.page import escape_code, inline_code, inline_json, render_page
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
    folder = plugins.bundled_folder("leaderboard")
    content = {
        "version": __version__,
        "date": max(dates, default=""),
        "static": static,
        "data": inline_json(content_of(cases) | front | {"leftOut": left_out}),
        "albums": {number: inline_json(album) for number, album in albums.items()},
    }
    code = inline_code(folder / "page", _SCRIPTS, library())
    template = (folder / "page.html.j2").read_text(encoding="utf-8")
    return render_page(template, content | code)


@cache
def library() -> str:
    """Load the plotting library as a script: Vega-Embed with all that it needs."""
    import vl_convert  # it loads 90 MB, which no other command needs

    return escape_code(vl_convert.javascript_bundle("window.vegaEmbed = vegaEmbed;"))
