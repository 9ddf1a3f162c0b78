"""Findings: figures that moved by more than their tolerance since a baseline."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from sabench import tasks
from sabench.evaluation.gates.baseline import (
    DATA,
    TIMES,
    CaseEntry,
    Entry,
    Tolerances,
    score_of,
    tolerance_of,
)
from sabench.tasks.task import Better, Figures


@dataclass(frozen=True)
class Finding:
    """Figure that moved beyond its tolerance, or case or solver that changed.

    Attributes
    ----------
    worse : whether it fails the gate; else it is news.
    before, now : the figure; None where there is none. Times are scaled to the baseline's machine.
    tolerance : how far it may move, None where that does not apply.
    text : description, where there is no figure.
    """

    case: str
    seed: int
    solver: str
    figure: str = ""
    before: float | None = None
    now: float | None = None
    tolerance: float | None = None
    worse: bool = field(kw_only=True)
    text: str = ""

    @property
    def change(self) -> float | None:
        """Change of the figure."""
        return None if self.before is None or self.now is None else self.now - self.before

    @property
    def sentence(self) -> str:
        """The finding in one line."""
        where = f"{self.case}, seed {self.seed}: {self.solver}"
        if self.text:
            return f"{where}: {self.text}"
        was, is_ = (
            "none" if value is None else f"{value:.6g}" for value in (self.before, self.now)
        )
        moved = "" if self.change is None else f", {self.change:+.3g}"
        beyond = "" if self.tolerance is None else f" where {self.tolerance:.3g} is allowed"
        return f"{where}: {self.figure}: {was} before, {is_} now{moved}{beyond}"


def loss(better: Better, before: float, now: float) -> float:
    """Compute by how much a figure got worse; negative: better.

    Signed errors count by their absolute values.
    """
    if better == "steady":
        return abs(now - before)
    if better == "larger":
        return before - now
    if better == "unity":
        return abs(now - 1.0) - abs(before - 1.0)
    return abs(now) - abs(before)


def compare(
    before: CaseEntry, now: CaseEntry, served: Mapping[str, str], tolerances: Tolerances
) -> Iterator[Finding]:
    """Compare the figures of one case with the baseline's.

    `served` has each solver's task. A solver of the baseline that did not run counts as worse; a
    new solver is news.
    """
    yield from _moved(now.key, DATA, DATA, before.data, now.data, tolerances)
    for solver in {**before.solvers, **now.solvers}:
        old, new = before.solvers.get(solver), now.solvers.get(solver)
        said = _standing(old, new)
        if said is not None:
            worse, text = said
            yield Finding(*now.key, solver, worse=worse, text=text)
        elif old is not None and new is not None:
            scaled = scale_times(new, old).figures
            yield from _moved(now.key, solver, served[solver], old.figures, scaled, tolerances)


def _standing(old: Entry | None, new: Entry | None) -> tuple[bool, str] | None:
    """Compare whether a solver ran and failed before and now.

    Returns whether the gate fails, and the text, for a solver that is missing, new, failed or
    mended; else None.
    """
    if new is None:
        return True, "it is in the baseline but did not run: is its name another, or a parameter?"
    if old is None:
        return False, f"not in the baseline{': ' + new.error if new.error else ''}"
    if new.error and not old.error:
        return True, f"failed: {new.error}"
    if old.error and not new.error:
        return False, "it failed before and does not now"
    return None


def scale_times(new: Entry, old: Entry) -> Entry:
    """Scale the times of a new entry to the machine and load of the old one.

    The factor is the ratio of the reference kernel's times.
    """
    if not new.reference_s or not old.reference_s:
        return new
    times = {
        key: value * old.reference_s / new.reference_s
        for key in TIMES
        if (value := new.figures.get(key)) is not None
    }
    return new.model_copy(update={"figures": new.figures | times, "reference_s": old.reference_s})


def _moved(
    case: tuple[str, int],
    solver: str,
    task: str,
    before: Figures,
    now: Figures,
    tolerances: Tolerances,
) -> Iterator[Finding]:
    """List the figures beyond tolerance, the missing and the new ones.

    A figure that is missing now is worse, a new one is news. The scores of a task come in its
    order, the most important one first.
    """
    scores = [] if task == DATA else [score.key for score in tasks.of(task).all_scores]
    places = {key: place for place, key in enumerate(scores)}
    for figure in sorted({**before, **now}, key=lambda key: (places.get(key, len(places)), key)):
        old, new = before.get(figure), now.get(figure)
        if old is None or new is None:
            if old is not new:
                yield Finding(*case, solver, figure, old, new, worse=new is None)
            continue
        allowed = tolerance_of(tolerances, task, figure).allowed(old)
        better: Better = "steady" if task == DATA else score_of(task, figure).better
        change = loss(better, old, new)
        if abs(change) > allowed:
            yield Finding(*case, solver, figure, old, new, allowed, worse=change > 0.0)
