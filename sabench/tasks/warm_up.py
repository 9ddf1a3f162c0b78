"""Kernels compiled in advance, so that no later command has to.

Each solver is called on the small data set of its task, and its result scored: that makes, compiles
and stores all that `generate`, `solve` and `score` call. Images of containers and nodes of clusters
begin with their kernels then.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from sabench import plugins
from sabench.tasks.conformance import Verdict, beat_nothing, check_solver


@dataclass(frozen=True)
class Warmed:
    """A solver that was called.

    Attributes
    ----------
    compile_s : seconds of compilation and of loading kernels: few if all were there.
    verdict, text : as `conform` gives for a result that is worth something.
    """

    solver: str
    compile_s: float
    verdict: Verdict
    text: str


def warm_up(solvers: Sequence[str] = ()) -> Iterator[Warmed]:
    """Compile the kernels of some solvers, or of all.

    Raises
    ------
    InputError
        An unknown solver.
    """
    from sabench.utils.compiled import compile_s  # numba takes half a second to import

    names = solvers or plugins.names("solvers")
    for name in names:
        plugins.load("solvers", name)
    with tempfile.TemporaryDirectory(prefix="sabench-warmup-") as scratch:
        for name in names:
            before = compile_s()
            found = next(check_solver(name, folder=Path(scratch), laws=(beat_nothing,)))
            yield Warmed(name, compile_s() - before, found.verdict, found.text)
