"""Selection of a part of a suite."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from sabench.evaluation.suites import Case
from sabench.utils.errors import InputError


@dataclass(frozen=True)
class Only:
    """Selection of cases, seeds and solvers of a suite; an empty tuple selects all.

    Solvers have the names that tables show.
    """

    cases: tuple[str, ...] = ()
    seeds: tuple[int, ...] = ()
    solvers: tuple[str, ...] = ()

    def select(self, cases: list[Case]) -> list[Case]:
        """Select the wanted cases, each with the wanted solvers.

        Raises
        ------
        InputError
            A case, seed or solver that the suite does not have.
        """
        _check_known("case", self.cases, {case.name for case in cases})
        _check_known("seed", self.seeds, {case.shown_seed for case in cases})
        _check_known(
            "solver",
            self.solvers,
            {solver_entry.shown for case in cases for solver_entry in case.solvers},
        )
        wanted = (
            case
            for case in cases
            if _among(case.name, self.cases) and _among(case.shown_seed, self.seeds)
        )
        own = [
            replace(
                case, solvers=tuple(one for one in case.solvers if _among(one.shown, self.solvers))
            )
            for case in wanted
        ]
        return [case for case in own if case.solvers]


def _among(value: Any, wanted: tuple[Any, ...]) -> bool:
    return not wanted or value in wanted


def _check_known(what: str, wanted: tuple[Any, ...], known: set[Any]) -> None:
    for value in wanted:
        if value not in known:
            raise InputError(
                f"--{what} {value}: expected one of {', '.join(str(one) for one in sorted(known))}"
            )


WHOLE = Only()  # the whole suite
