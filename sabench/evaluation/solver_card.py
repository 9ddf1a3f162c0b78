"""Solver card: what a reader needs to know about a submitted solver."""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from sabench.utils.errors import InputError
from sabench.utils.validation import printable, validate

CARD = "card.toml"  # names of cards in a submission end so
LONGEST_TEXT = 100_000  # bytes of a card, and of a record
MOST_CASES = 1000  # of a suite, and so files of a submission


def _check_text(text: str) -> str:
    if not text.strip() or not text.isprintable():
        raise ValueError(f"expected one line of printable text, got {printable(text)!r}")
    return text


_Text = Annotated[str, AfterValidator(_check_text)]


class SolverCard(BaseModel):
    """Content of the file: one line of text for each key.

    All keys are needed, so that "none" is an answer and not an omission.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    solver: _Text = Field(description="name of the solver in its results")
    paper: _Text = Field(description='reference of the method, or "unpublished"')
    code: _Text = Field(description='address of the source and its version, or "closed"')
    licence: _Text = Field(description='licence of the code, or "none"')
    hardware: _Text = Field(description="machine that solved the data sets, with its seconds")
    parameters: _Text = Field(description="how the parameters were selected, and on which data")
    training_data: _Text = Field(description='data that the solver was trained on, or "none"')


def read_card(path: Path, name: str | None = None) -> SolverCard:
    """Read a solver card from a TOML file.

    Parameters
    ----------
    name : of the file in errors; by default its path.

    Raises InputError: no such file, no TOML, more than 100 kB, a key that is missing or unknown, or
    a value that is not one line of text.
    """
    shown = printable(name or str(path), 200)
    try:
        with path.open("rb") as file:
            content = file.read(LONGEST_TEXT + 1)
        if len(content) > LONGEST_TEXT:
            raise ValueError(f"more than {LONGEST_TEXT} bytes")
        values = tomllib.loads(content.decode("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        reason = error.strerror if isinstance(error, OSError) else printable(str(error))
        raise InputError(f"{shown}: expected a solver card in TOML, got {reason}") from error
    return validate(SolverCard, values, shown)


def read_cards(inside: Sequence[tuple[str, Path]], given: Sequence[Path]) -> dict[str, SolverCard]:
    """Read the cards inside a submission (names and paths), and those given with it.

    Returns them by their solvers.

    Raises InputError: as `read_card`, and two cards of one solver.
    """
    by_solver: dict[str, tuple[str, SolverCard]] = {}
    for name, path in [*inside, *((str(path), path) for path in given)]:
        card = read_card(path, name)
        if card.solver in by_solver:
            raise InputError(
                f"{printable(name)}: solver: expected one card of {card.solver!r}, but "
                f"{printable(by_solver[card.solver][0])} is one, too"
            )
        by_solver[card.solver] = name, card
    return {solver: card for solver, (_, card) in by_solver.items()}


def check_solvers(cards: dict[str, SolverCard], solvers: Sequence[str]) -> None:
    """Refuse a card that belongs to no result."""
    for solver in cards:
        if solver not in solvers:
            names = printable(", ".join(sorted(set(solvers))), 200)
            raise InputError(
                f"solver card: solver: expected the solver of a result ({names}), got {solver!r}"
            )
