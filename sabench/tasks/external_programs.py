"""External programs as solvers; docs/developing/participate.md is their contract.

A program in any language takes part by this command line:

    program DATASET RESULT [name=value ...]

DATASET is a folder with copies of the files that a solver may see, RESULT the file that the program
must write.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

from sabench import plugins, tasks
from sabench.dataset import schema
from sabench.dataset.hdf5_probe import probe
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import Result, open_result, result_writer
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, clear_abandoned, inside, is_file
from sabench.utils.processes.isolated import call_isolated
from sabench.utils.processes.limited import Limits, run_limited
from sabench.utils.progress import console
from sabench.utils.validation import printable

_CHECK_S = 1800.0  # for reading all of a result


def is_program(solver: str) -> bool:
    """Decide whether a solver's name is the path of a program.

    It is if it has a path separator, or if an executable file and no plug-in has this name.
    """
    if os.sep in solver or (os.altsep is not None and os.altsep in solver):
        return True
    return (
        is_file(Path(solver))
        and os.access(solver, os.X_OK)
        and solver not in plugins.names("solvers")
    )


def solver_name(solver: str) -> str:
    """Return the name of a solver in tables: for a program the stem of its file."""
    return printable(Path(solver).stem) if is_program(solver) else solver


def find_program(name: str, folder: Path = Path()) -> Path:
    """Find the absolute path of an executable file.

    A relative name is looked for in `folder`.
    """
    path = (folder / name).absolute()
    if not is_file(path):
        raise InputError(f"program {name}: expected an executable file, found none at {path}")
    if not os.access(path, os.X_OK):
        raise InputError(
            f"program {name}: expected an executable file, but it may not be executed: chmod +x "
            f"{name}"
        )
    return path


def run_program(
    program: str,
    dataset: Dataset,
    out: Path,
    *,
    parameters: dict[str, Any] | None = None,
    limits: Limits | None = None,
    overwrite: bool = False,
) -> Result:
    """Run a program on a data set, check its result, and move it into place.

    sabench measures the cost here: wall seconds over the number of frames, or of pairs for
    velocities, and memory.

    Raises
    ------
    InputError
        No such program, a program that fails or breaks a limit, or a result that breaks
        docs/formats/result.md.
    """
    path, limits = find_program(program), limits or Limits()
    if out.exists() and not overwrite:
        raise InputError(f"{out} exists already: choose another name, or say --overwrite")
    with tempfile.TemporaryDirectory(prefix="sabench-", ignore_cleanup_errors=True) as name:
        view, scratch = Path(name) / "dataset", Path(name) / "work"
        show(dataset, view)
        scratch.mkdir()
        result = scratch / "result.h5"
        console.print(f"{path.name}: at most {limits.time_s:g} s", markup=False, highlight=False)
        cost = run_limited(
            [str(path), str(view), str(result), *_words(parameters or {})],
            scratch,
            limits,
            path.name,
        )
        _check_file(result, path.name)
        account = (solver_name(program), parameters or {}, cost.seconds, cost.peak_mb)
        try:
            probe(result)
            call_isolated(
                adopt,
                result,
                dataset.root,
                out,
                account,
                overwrite,
                doing=f"result of {path.name}",
                time_s=_CHECK_S,
            )
        finally:
            clear_abandoned(out.absolute())
    return open_result(out, dataset)


def show(dataset: Dataset, view: Path) -> None:
    """Copy the observation side of a data set into a folder.

    A program cannot harm the data set, since it receives the copies.
    """
    names = [
        name
        for name in dataset.manifest.files
        if name in (schema.CAMERAS, schema.TARGET, schema.POINTS) or _is_image(name)
    ]
    for name in names:
        copy = inside(view, name)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(inside(dataset.root, name), copy)
    head = {
        "format": schema.FORMAT,
        "version": schema.VERSION,
        "content_hash": dataset.content_hash,
    }
    (view / schema.MANIFEST).write_text(canonical_json(head), encoding="utf-8")


def _is_image(name: str) -> bool:
    return name.startswith("images/") and name.endswith(".tif")


def _words(parameters: dict[str, Any]) -> list[str]:
    """Format parameters as name=value: strings as they are, all else as JSON."""
    return [
        f"{name}={value if isinstance(value, str) else json.dumps(value)}"
        for name, value in parameters.items()
    ]


def _check_file(result: Path, name: str) -> None:
    if result.is_symlink() or not result.is_file():
        raise InputError(
            f"program {name}: expected the result at the path in its second argument, found "
            f"{'no file' if not result.exists() else 'none'} there"
        )


def adopt(
    path: Path,
    root: Path,
    out: Path,
    account: tuple[str, dict[str, Any], float, float | None] | None,
    overwrite: bool,
) -> None:
    """Read every value of a foreign result under all checks, and write it anew.

    Nothing else of the foreign file is kept.

    Parameters
    ----------
    account : solver, parameters, seconds (wall time of all frames) and peak memory in MB. None:
        solver and parameters come from the file, and there are no costs.
    """
    data = open_dataset(root)
    result = open_result(path, data)
    solver, parameters, seconds, peak_mb = account or (result.solver, result.parameters, None, None)
    task = tasks.of(result.task)
    with result_writer(out, data, solver, task.name, parameters, overwrite=overwrite) as writer:
        task.copy(data, result, writer)
        if seconds is not None:
            writer.set_cost(seconds / max(1, len(task.frames(data))), peak_mb)
