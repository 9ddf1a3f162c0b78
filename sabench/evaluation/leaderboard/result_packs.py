"""Archives of results with the cards of their solvers, for `sabench submit`."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

import tomli_w

from sabench.dataset.results import read_solver
from sabench.dataset.verification import probe
from sabench.evaluation.leaderboard.archives import Submitted
from sabench.evaluation.solver_card import (
    CARD,
    SolverCard,
    check_solvers,
    read_cards,
)
from sabench.utils.errors import InputError
from sabench.utils.files import complete_or_nothing
from sabench.utils.zip_archives import zip_folder


def pack_results(
    files: Submitted, out: Path, cards: Sequence[Path] = (), *, overwrite: bool = False
) -> tuple[int, list[str]]:
    """Copy results and the cards of their solvers into an archive by the name .zip.

    Returns the number of results and the solvers that have a card.

    Parameters
    ----------
    files : results, and cards that lie with them.
    cards : further solver cards.

    Raises
    ------
    InputError
        Another ending of the archive's name, a file that is no result, a bad card, or a card that
        belongs to no result.
    """
    check_name(out)
    known = read_cards(files.cards, cards)
    check_solvers(known, _solvers(files))
    with (
        complete_or_nothing(out, overwrite=overwrite) as partial,
        tempfile.TemporaryDirectory(prefix="sabench-") as folder,
    ):
        _copy(files, list(known.values()), Path(folder))
        zip_folder(Path(folder), partial)
    return len(files.results), list(known)


def check_name(out: Path) -> None:
    """Refuse a name that is not one of a zip archive."""
    if out.suffix != ".zip":
        raise InputError(f"{out}: expected a name that ends in .zip for an archive of results")


def _solvers(files: Submitted) -> list[str]:
    for _, file in files.results:
        probe(file)
    return [read_solver(file) for _, file in files.results]


def _copy(files: Submitted, cards: list[SolverCard], folder: Path) -> None:
    for name, file in files.results:
        place = folder / name
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, place)
    for number, card in enumerate(cards):
        place = folder / (f"{number}.{CARD}" if number else CARD)
        place.write_text(tomli_w.dumps(card.model_dump()), encoding="utf-8")
