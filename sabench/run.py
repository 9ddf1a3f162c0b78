"""Run a suite: every case and seed, every solver on it, every score into a record, then the page."""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import platform
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sabench import __version__, backend, board, tracks
from sabench.apart import apart
from sabench.columns import COLUMNS
from sabench.dataset.read import Dataset, open_dataset
from sabench.dataset.result import open_result
from sabench.dataset.verify import verify
from sabench.errors import DeclinedError, InputError
from sabench.files import canonical_json, clear_abandoned, complete_or_nothing
from sabench.generation import Renderer, generate
from sabench.progress import console
from sabench.records import append, latest, read_records
from sabench.reference_kernel import reference_s
from sabench.solving import OWN_TRACK, score, solve
from sabench.suite import Case, Entrant, Suite, load_suite


def run_suite(path: str | Path, work: Path, leaderboard: Path, *, fresh: bool = False) -> list[dict[str, Any]]:
    """Generate, solve, score and record a whole suite, then rebuild the page; returns the new records.

    A record is written as soon as its score is known, so an interrupted run keeps what it has finished. A solver that fails gets a record
    that says why, and the run goes on.
    """
    suite, cases = load_suite(path)
    records = []
    for number, case in enumerate(cases, 1):
        console.print(f"data set {number} of {len(cases)}: {case.name}, seed {case.seed}", markup=False, highlight=False)
        dataset = dataset_of(case, work, fresh)
        for record in _rank(case, dataset, suite, work, leaderboard):
            append(leaderboard / "records" / "local.jsonl", record)
            records.append(record)
        if not suite.keep_data:
            shutil.rmtree(dataset.root)
    build_board(leaderboard)
    return records


def build_board(leaderboard: Path) -> Path:
    """Records to page; returns the page's path."""
    page, records = leaderboard / "index.html", latest(read_records(leaderboard / "records"))
    console.print(f"page of {len(records)} records", markup=False, highlight=False)
    board.build_page(records, leaderboard / "pictures", page)
    return page


def dataset_of(case: Case, work: Path, fresh: bool) -> Dataset:
    """The case's data set: an earlier one if it is whole and was made by this version, else a new one."""
    folder = case.folder(work)
    if folder.is_dir() and not fresh and not verify(folder):
        dataset = open_dataset(folder)
        if dataset.manifest.versions.get("sabench") == __version__ and dataset.manifest.versions.get("mitsuba") == _version("mitsuba"):
            console.print(f"data set {folder} is whole: used again")
            return dataset
    renderer: Renderer = "mitsuba" if case.renderer == "mitsuba" else "splat"
    return generate(case.scene, folder, seed=case.seed, backend=renderer, name=case.name, overwrite=True)


def _rank(case: Case, dataset: Dataset, suite: Suite, work: Path, leaderboard: Path) -> Iterator[dict[str, Any]]:
    """Records of all the suite's solvers on one data set; the first seed of a case is pictured."""
    folder = leaderboard / "pictures" / case.folder(work).name if case.seed == suite.seeds[0] else None
    if folder:
        _picture_case(folder, dataset)
    for entrant in case.solvers:
        head = _describe(case, dataset, entrant) | {"pictures": folder.name if folder else None}
        record = head | _blank(head["track"])
        name = f"{head['solver']}-{head['run_hash'][:8]}"
        out = work / "results" / f"{case.folder(work).name}-{name}.h5"
        try:
            record["reference_s"] = solve_apart(entrant, dataset, out)
            record |= {key: value for key, value in score(dataset, out).items() if key not in head}
            if folder:
                _picture_result(folder / name, record["track"], dataset, out)
        except InputError as error:
            console.print(f"error: {error}", style="red", markup=False, highlight=False)
            record["error"], record["declined"] = str(error), isinstance(error, DeclinedError)
        if not suite.keep_data:
            out.unlink(missing_ok=True)
        yield record


def _picture_case(folder: Path, dataset: Dataset) -> None:
    """What the cameras saw, and what was there."""
    track = tracks.of(OWN_TRACK[dataset.shows[-1]])
    _draw(folder / "images.png", track.images(dataset))
    _draw(folder / "truth.png", track.picture(dataset, "truth"))


def _picture_result(stem: Path, track: str, dataset: Dataset, out: Path) -> None:
    """What a solver made of it and, of tracks whose pictures do not show it yet, where that is wrong."""
    module, result = tracks.of(track), open_result(out, dataset)
    _draw(stem.with_name(f"{stem.name}.png"), module.picture(dataset, result))
    if hasattr(module, "error_picture"):
        _draw(stem.with_name(f"{stem.name}.error.png"), module.error_picture(dataset, result))


def _describe(case: Case, dataset: Dataset, entrant: Entrant) -> dict[str, Any]:
    """All of a record but its scores and pictures."""
    solver, track, parameters = entrant.describe()
    head = {
        "scene": case.base, "case": case.name, "axes": dict(case.axes), "scene_hash": case.scene.hash, "dataset": dataset.content_hash,
        "seed": case.seed, "renderer": case.renderer, "track": track, "solver": solver, "label": entrant.label, "parameters": parameters,
    }  # fmt: skip
    run_hash = hashlib.sha256(canonical_json([head["dataset"], solver, parameters]).encode()).hexdigest()
    return {**head, "versions": versions(), "machine": machine(), "run_hash": run_hash}


def versions() -> dict[str, str]:
    """Of what shapes the figures."""
    libraries = {name: _version(name) for name in ("mitsuba", "drjit", "numpy", "scipy")}
    return libraries | {"sabench": __version__, "python": platform.python_version()}


def _blank(track: str) -> dict[str, Any]:
    """A record's scores before any is known."""
    return dict.fromkeys((*(column.key for column in COLUMNS[track]), "error", "reference_s")) | {"declined": False}


def machine() -> dict[str, Any]:
    """What this run computes on."""
    info = Path("/proc/cpuinfo")
    models = [line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")] if info.exists() else []
    try:
        kind = backend.choose().kind
    except InputError:
        kind = "none"
    cpu = models[0] if models else platform.processor() or platform.machine()
    return {"cpu": cpu, "cores": os.cpu_count(), "system": f"{platform.system()} {platform.machine()}", "backend": kind}


def solve_apart(entrant: Entrant, dataset: Dataset, out: Path) -> float:
    """Solve in a process of its own, so that its memory is its own and its crash is only its own; its fault is an InputError here.

    Returns
    -------
    Seconds of the reference kernel, the mean of before and after.
    """
    try:
        if not entrant.is_program:
            return float(apart(_solve, entrant.name, entrant.parameters, str(dataset.root), str(out), doing=f"solver {entrant.name}"))
        before = reference_s()
        solve(entrant.name, dataset, out, parameters=entrant.parameters, limits=entrant.limits, overwrite=True)
        return (before + reference_s()) / 2.0
    finally:
        clear_abandoned(out)


def _solve(name: str, parameters: dict[str, Any], dataset: str, out: str) -> float:
    before = reference_s()
    solve(name, dataset, out, parameters=parameters, overwrite=True)
    return (before + reference_s()) / 2.0


def _draw(path: Path, picture: bytes) -> None:
    with complete_or_nothing(path, overwrite=True) as partial:
        partial.write_bytes(picture)


def _version(package: str) -> str:
    return importlib.metadata.version(package)
