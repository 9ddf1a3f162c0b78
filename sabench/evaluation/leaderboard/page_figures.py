"""Figures of the leaderboard page, as many as it may hold."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from pathlib import Path

from sabench import tasks
from sabench.evaluation.record_schema import Record
from sabench.utils.errors import InputError
from sabench.utils.files import inside

_SMALL = Path("records", "pictures")  # of bundled records, beside the folder of pictures
# of the figures on the page; the best of every case come first, and those beyond are left out
_PICTURES_BYTES = 80_000_000


def stem_of(record: Record) -> str:
    """Return the name with which the figures of a result begin."""
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
    seen: dict[int, int] = {}
    rows = [(place, row) for place, case in enumerate(cases) for row in case]
    for number, (place, row) in enumerate(rows):
        run = next((run for run in row["runs"] if run.get("pictures")), None)
        if run is None:
            continue
        rank = seen[place] = seen.get(place, 0) + 1
        stem = stem_of(run)
        wanted = [(0, "images", "images")] + ([(0, "truth", "truth")] if _shows_truth(row) else [])
        # a failed run may have left a figure of an earlier success, which is not this record's
        if not run.get("error"):
            wanted += [
                (rank, f"row{number}", stem),
                (rank, f"error{number}", f"{stem}.error"),
                (rank, f"left{number}", f"{stem}.left"),
            ]
        for order, name, file in wanted:
            own = f"{run['pictures']}/{file}"
            path = _there(pictures, f"{own}.png") or _there(small, f"{own}.webp")
            if path:
                yield order, place, name, path


def _shows_truth(row: Record) -> bool:
    return not row["recorded"] and tasks.of(row["task"]).captions.truth


def _there(pictures: Path, name: str) -> Path | None:
    """Find the figure of this name.

    None where there is none, or where the name leads outside the folder: then one record does not
    stop the page.
    """
    try:
        path = inside(pictures, name)
    except InputError:
        return None
    return path if path.is_file() else None
