"""HTML page of the leaderboard: a row for each case, solver and machine.

It is one file.

Users sort, filter, plot and compare the rows in their browser.
"""

import base64
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

from sabench import plugins, tasks
from sabench.evaluation.leaderboard.page_content import (
    ENTRY,
    cases_of,
    describe_cases,
    table_of,
    with_figures,
)
from sabench.evaluation.leaderboard.standings import front_of
from sabench.evaluation.record_schema import Record
from sabench.evaluation.records import key_of
from sabench.plotting.kinds import COLOURS
from sabench.plotting.page import escape_code, inline_code, inline_json, render_page
from sabench.tasks.task import LARGEST
from sabench.utils.confidence import mean_of
from sabench.utils.errors import InputError
from sabench.utils.files import complete_or_nothing, inside
from sabench.utils.version import __version__

_SMALL = Path("records", "pictures")  # of bundled records, beside the folder of pictures
# of the figures on the page; the best of every case come first, and those beyond are left out
_PICTURES_BYTES = 80_000_000


def stem_of(record: Record) -> str:
    """Return the common start of the names of a result's figures."""
    return f"{record['solver']}-{record['run_hash'][:8]}"


def albums_of(
    cases: Sequence[Sequence[Record]], pictures: Path
) -> tuple[dict[int, dict[str, str]], int]:
    """Encode the figures of every case as data URLs, by their names.

    Returns also the number of figures that did not fit into the page.
    """
    albums: dict[int, dict[str, str]] = {}
    room, left_out = _PICTURES_BYTES, 0
    for _, place, name, path in sorted(_pictures(cases, pictures)):
        if name in albums.get(place, {}):
            continue
        size = path.stat().st_size * 4 // 3
        if size > room:
            left_out += 1
            continue
        room -= size
        text = base64.b64encode(path.read_bytes()).decode()
        albums.setdefault(place, {})[name] = f"data:image/{path.suffix[1:]};base64,{text}"
    return albums, left_out


def _pictures(
    cases: Sequence[Sequence[Record]], pictures: Path
) -> Iterator[tuple[int, int, str, Path]]:
    """List every figure that is there, of the rows of each case.

    It has its rank within the case, the index of the case, its name and its path. Bundled records
    have small figures, which are bundled with them.
    """
    small = pictures.parent / _SMALL
    counts: dict[int, int] = {}
    rows = [(place, row) for place, case in enumerate(cases) for row in case]
    for number, (place, row) in enumerate(rows):
        run = next((run for run in row["runs"] if run.get("pictures")), None)
        if run is None:
            continue
        rank = counts[place] = counts.get(place, 0) + 1
        stem = stem_of(run)
        wanted = [(0, "images", "images")]
        if not row["recorded"] and tasks.of(row["task"]).captions.truth:
            wanted.append((0, "truth", "truth"))
        # the file may be a figure of an earlier successful run, not of this failed one
        if not run.get("error"):
            wanted += [
                (rank, f"row{number}", stem),
                (rank, f"error{number}", f"{stem}.error"),
                (rank, f"left{number}", f"{stem}.left"),
            ]
        for order, name, file in wanted:
            base = f"{run['pictures']}/{file}"
            path = _find_picture(pictures, f"{base}.png") or _find_picture(small, f"{base}.webp")
            if path:
                yield order, place, name, path


def _find_picture(pictures: Path, name: str) -> Path | None:
    """Find the figure of this name.

    None where there is none, or where the name leads outside the folder: then one record does not
    stop the page.
    """
    try:
        path = inside(pictures, name)
    except InputError:
        return None
    return path if path.is_file() else None


_FILES = ("base", "state", "rows", "download", "table", "plots", "front", "viewer", "case", "main")


def _render(rows: Sequence[Record], pictures: Path) -> str:
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
        "data": inline_json(
            describe_cases(cases) | front | {"leftOut": left_out, "kinds": COLOURS}
        ),
        "albums": {number: inline_json(album) for number, album in albums.items()},
    }
    code = inline_code(folder / "page", _FILES, library())
    template = (folder / "page.html.j2").read_text(encoding="utf-8")
    return render_page(template, content | code)


@cache
def library() -> str:
    """Load the plotting library as a script: Vega-Embed with all that it needs."""
    import vl_convert  # it loads 90 MB, which no other command needs

    return escape_code(vl_convert.javascript_bundle("window.vegaEmbed = vegaEmbed;"))


def over_seeds(records: list[Record]) -> list[Record]:
    """Merge the records of all seeds into one row.

    There is a row for every case, solver and machine. It is the first seed's record with `seeds`,
    `runs` and, in place of every score, its `Mean` over the seeds.

    A score that no seed has is None. `ranked` is true if the first score ranks every seed that has
    not failed, so that leaving out a seed improves no rank. `error` counts the seeds that failed
    and gives the first one's reason. `runs` are the records of the seeds. Records of unknown tasks
    make no rows. Those of recorded data sets have figures without truth in place of scores, and no
    rank.
    """
    groups: dict[str, list[Record]] = {}
    for record in sorted(records, key=lambda record: int(record["seed"])):
        task = record.get("task") or "reconstruction"
        if task in tasks.NAMES:
            named = {
                **record,
                "case": record.get("case") or record["scene"],
                "task": task,
                "split": record.get("split") or "public",
                "recorded": bool(record.get("recorded")),
            }
            groups.setdefault(key_of(named, ENTRY), []).append(named)
    return [_merge(group) for group in groups.values()]


def _merge(group: list[Record]) -> Record:
    table = table_of(group[0])
    keys = [score.key for score in table.columns]
    runs = [
        {**record, **{key: _number(with_figures(record).get(key)) for key in keys}}
        for record in group
    ]
    means = {key: mean_of([run[key] for run in runs if run[key] is not None]) for key in keys}
    errors = [record["error"] for record in group if record.get("error")]
    share = f"{len(errors)} of {len(group)} seeds: " if len(group) > 1 and errors else ""
    error = share + errors[0] if errors else None
    return {
        **group[0],
        **means,
        "seeds": [run["seed"] for run in runs],
        "runs": runs,
        "error": error,
        "ranked": not table.recorded
        and not any(table.task.rank(run)[0] for run in runs if not run.get("error")),
    }


def _number(value: object) -> float | None:
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        return None
    # the digits of larger values would fill the page
    return float(value) if -LARGEST < value < LARGEST else None


def build_page(records: list[Record], pictures: Path, out: Path) -> None:
    """Write the records as one self-contained page.

    `pictures` holds the folders that the records name; figures outside it are left out.
    """
    text = _render(over_seeds(records), pictures)
    with complete_or_nothing(out, overwrite=True) as partial:
        partial.write_text(text, encoding="utf-8")
