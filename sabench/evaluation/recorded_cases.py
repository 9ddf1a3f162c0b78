"""Recorded data sets as cases of suites, scored without truth."""

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import open_result
from sabench.dataset.schema import MANIFEST
from sabench.dataset.verification import verify
from sabench.evaluation.suites import RecordedCase, RecordingSpec
from sabench.tasks.quality import FIGURES_OF, quality, residual_picture
from sabench.tasks.solve_and_score import costs_of
from sabench.utils.errors import InputError
from sabench.utils.files import is_file, is_folder
from sabench.utils.progress import console

_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")


def recording_name(spec: RecordingSpec, suite: Path) -> str:
    """Name the case of a recording: by default as its folder."""
    return spec.name or _UNSAFE.sub("_", _place(spec, suite).name)


def open_recording(spec: RecordingSpec, suite: Path) -> RecordedCase:
    """Open the recorded data set of a suite.

    Raises
    ------
    InputError
        No folder, one that is no data set, or a data set that is not recorded.
    """
    data = _open(_place(spec, suite), f"{suite}: recordings: {spec.folder}")
    name = recording_name(spec, suite)
    return RecordedCase(name=name, base=name, data=data, quality=spec.quality, solvers=spec.solvers)


def _place(spec: RecordingSpec, suite: Path) -> Path:
    return Path(os.path.normpath(suite.parent.absolute() / Path(spec.folder).expanduser()))


def _open(root: Path, source: str) -> Dataset:
    if not is_file(root / MANIFEST):
        got = f"found one without {MANIFEST}" if is_folder(root) else "found none"
        raise InputError(
            f"{source}: expected the folder of a recorded data set, {got}; `sabench import` makes "
            "one of images and cameras"
        )
    data = open_dataset(root)
    if data.has_truth:
        raise InputError(
            f"{source}: expected a recorded data set, got one with truth; name its scene in "
            f"`scenes` and its seed, {data.manifest.seed}, in `seeds`"
        )
    if not data.recorded:
        raise InputError(
            f"{source}: expected a recorded data set, got the observation side of one alone"
        )
    return data


def check_intact(case: RecordedCase) -> Dataset:
    """Return the data set of a recorded case, with the bytes that its case is about.

    Raises
    ------
    InputError
        Files are missing or damaged, or the data set has changed since the suite was read.
    """
    root = case.data.root
    if faults := verify(root):
        raise InputError(
            f"recording {case.name}: expected the files that were imported, but {faults[0]}"
        )
    if open_dataset(root).content_hash != case.data_hash:
        raise InputError(f"{root}: expected no change of the recording during the run")
    return case.data


@dataclass(frozen=True)
class Judged:
    """Scores of a result, or its figures without truth.

    Attributes
    ----------
    scores : scores as in its record.
    residuals : a PNG of the residuals of recorded images; None for other results.
    """

    scores: dict[str, Any]
    residuals: bytes | None = None


def judge(case: RecordedCase, out: Path) -> Judged:
    """Score a result of a recorded case by its images; its costs come with it.

    Results of tasks that have no figures without truth have their costs alone.
    """
    result = open_result(out, case.data)
    scores = {"task": result.task, "quality": None, **costs_of(result)}
    if result.task not in FIGURES_OF:
        return Judged(scores)
    options = case.quality
    judged = quality(case.data, out, frames=options.frames, solve_again=options.again)
    for note in judged.notes:
        console.print(f"note: {note}", markup=False, highlight=False)
    scores["quality"] = {**options.model_dump(), "figures": judged.figures}
    left = judged.left
    return Judged(scores, None if left is None else residual_picture(case.data, left))
