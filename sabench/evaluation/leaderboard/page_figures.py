"""Figures of the leaderboard page, as many as it may hold."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from pathlib import Path

from sabench import tasks
from sabench.evaluation.record_schema import Record
from sabench.utils.errors import InputError
from sabench.utils.files import inside

# of the figures on the page; the best of every case come first, and those beyond are left out
_PICTURES_BYTES = 80_000_000


def albums_of(
    cases: Sequence[Sequence[Record]], pictures: Path
) -> tuple[dict[int, dict[str, str]], int]:
    """Encode the figures of every case in base 64, by their names.

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
        albums.setdefault(place, {})[name] = base64.b64encode(path.read_bytes()).decode()
    return albums, left_out


def _pictures(
    cases: Sequence[Sequence[Record]], pictures: Path
) -> Iterator[tuple[int, int, str, Path]]:
    """List every figure that is there, of the rows of each case.

    It has its rank within the case, the index of the case, its name and its path.
    """
    seen: dict[int, int] = {}
    rows = [(place, row) for place, case in enumerate(cases) for row in case]
    for number, (place, row) in enumerate(rows):
        run = next((run for run in row["runs"] if run.get("pictures")), None)
        if run is None:
            continue
        rank = seen[place] = seen.get(place, 0) + 1
        stem = f"{run['solver']}-{run['run_hash'][:8]}"
        wanted = [(0, "images", "images.png")] + (
            [(0, "truth", "truth.png")] if _shows_truth(row) else []
        )
        # a failed run may have left a figure of an earlier success, which is not this record's
        if not run.get("error"):
            wanted += [
                (rank, f"row{number}", f"{stem}.png"),
                (rank, f"error{number}", f"{stem}.error.png"),
                (rank, f"left{number}", f"{stem}.left.png"),
            ]
        for order, name, file in wanted:
            path = _there(pictures, f"{run['pictures']}/{file}")
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
