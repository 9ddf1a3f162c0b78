"""Result files from outside: matched to data sets, checked and scored."""

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from sabench.dataset.copies import disagreements
from sabench.dataset.reader import Dataset, datasets_in
from sabench.dataset.results import estimate_hash, read_dataset_names
from sabench.dataset.verification import probe, verify
from sabench.tasks.external_programs import write_anew
from sabench.tasks.solve_and_score import score
from sabench.utils.errors import InputError
from sabench.utils.processes.call import call_isolated
from sabench.utils.processes.program import ProgramLimits
from sabench.utils.validation import printable


def match_data_sets(files: list[tuple[str, Path]], folders: Sequence[Path]) -> dict[str, Dataset]:
    """Find the data set of every result; verify each once.

    It is the copy that was solved, or else another one.
    """
    there = list(data_sets_in(folders))
    intact: dict[Path, Dataset] = {}
    found = {}
    for label, file in files:
        probe(file)
        wanted = read_dataset_names(file)
        copies = sorted(
            (one for one in there if wanted.fits(one)),
            key=lambda one: one.content_hash != wanted.content_hash,
        )
        if not copies:
            where = ", ".join(str(folder) for folder in folders)
            raise InputError(
                f"{printable(label)}: expected a result of a data set in {where}, but none there "
                f"has the hash {printable(wanted.content_hash, 12)!r}"
            )
        if not all(one.root in intact for one in copies):
            _check_copies(label, copies)
            intact |= {one.root: one for one in copies}
        found[label] = copies[0]
    return found


def _check_copies(label: str, copies: list[Dataset]) -> None:
    """Refuse damaged data sets, and copies that differ by more than rounding."""
    for one in copies:
        if faults := verify(one.root):
            raise InputError(
                f"{printable(label)}: expected an intact data set at {one.root}, but {faults[0]}"
            )
    for one in copies[1:]:
        if faults := disagreements(copies[0], one):
            raise InputError(
                f"{printable(label)}: expected equal copies of its data set at {copies[0].root} "
                f"and {one.root}, but {faults[0]}; give the one that counts with --data"
            )


def data_sets_in(folders: Sequence[Path]) -> Iterator[Dataset]:
    """List every data set in the folders that can be read and has its truth.

    Data sets lie at a folder or directly below it; anything else is skipped.
    """
    for folder in folders:
        if not folder.is_dir():
            raise InputError(f"{folder}: expected a folder of data sets, found none")
        yield from (data for data in datasets_in(folder) if data.has_truth)


def score_safely(label: str, file: Path, data: Dataset) -> dict[str, Any]:
    """Score a result in a child process, and hash its estimates.

    Returns what `score` does, and `estimate_hash`.

    Raises InputError: a result that `score` refuses, or one that takes more than an hour.
    """
    doing, time_s = f"result {printable(label)}", ProgramLimits.time_s
    return dict(call_isolated(_score, file, data.root, doing=doing, time_s=time_s))


def _score(file: Path, root: Path) -> dict[str, Any]:
    """Score a copy of a submitted file.

    The values of the file are read once, under all checks, and written to the copy.
    """
    with tempfile.TemporaryDirectory(prefix="sabench-") as folder:
        copy = Path(folder) / "result.h5"
        write_anew(file, root, copy, None, False)
        return score(root, copy) | {"estimate_hash": estimate_hash(copy)}
