"""The participant's part of a challenge: data sets solved, results packed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sabench.apps.challenge.contents import Challenge, opened_challenge, read_challenge
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import open_result
from sabench.evaluation.leaderboard.archives import Submitted, check_name, pack_results
from sabench.evaluation.solver_card import check_solvers, read_cards
from sabench.tasks.external_programs import is_program, solver_name
from sabench.tasks.solve_and_score import check_result_task, solve
from sabench.utils.errors import InputError
from sabench.utils.files import digest, refuse_existing
from sabench.utils.processes.program import Limits
from sabench.utils.progress import console


def participate(
    path: Path,
    solver: str,
    out: Path,
    *,
    results: Path,
    cards: Sequence[Path] = (),
    parameters: dict[str, Any] | None = None,
    limits: Limits | None = None,
    overwrite: bool = False,
) -> int:
    """Solve all data sets of a challenge, pack the results, and return their number.

    Results that are there are used again, so that an interrupted call is resumed.

    Parameters
    ----------
    path : archive or folder of the challenge.
    solver : its name, or the path of a program.
    out : archive to create, by the name .zip.
    results : folder in which the results are kept.
    cards : of the solver.
    parameters, limits : as `solve` takes them.

    Raises
    ------
    InputError
        As `solve` and `pack_results`, or a solver of another task.
    """
    check_name(out)
    refuse_existing(out, overwrite=overwrite)
    shown = solver_name(solver) if is_program(solver) else solver
    check_solvers(read_cards([], cards), [shown])  # before hours of solving
    with opened_challenge(path) as folder:
        challenge = read_challenge(folder)
        tag = digest([solver, parameters or {}])[:8]
        made = []
        for number, name in enumerate(challenge.data_sets, 1):
            text = f"data set {number} of {len(challenge.data_sets)}: {name}"
            console.print(text, markup=False, highlight=False)
            data = open_dataset(folder / name)
            place = results / f"{name}-{data.content_hash[:8]}-{shown}-{tag}.h5"
            if not _is_there(place, data):
                solve(solver, data, place, parameters=parameters, limits=limits)
            _check_task(place, data, challenge, shown)
            made.append((f"{name}.h5", place))
    pack_results(Submitted(made, []), out, cards, overwrite=overwrite)
    return len(made)


def _is_there(place: Path, data: Dataset) -> bool:
    """Check for an earlier result; one of another data set is refused."""
    if not place.exists():
        place.parent.mkdir(parents=True, exist_ok=True)
        return False
    open_result(place, data)
    return True


def _check_task(place: Path, data: Dataset, challenge: Challenge, solver: str) -> None:
    try:
        check_result_task(open_result(place, data).task, challenge.task, f"solver {solver}")
    except InputError:
        place.unlink()
        raise
