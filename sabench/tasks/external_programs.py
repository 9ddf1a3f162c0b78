"""External programs as solvers; docs/developing/participate.md is their contract.

A program in any language takes part by this command line:

    program DATASET RESULT [name=value ...]

DATASET is a folder with copies of the files that a solver may see, RESULT the file that the program
must write.
"""

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from sabench import plugins, tasks
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import Result, open_result, result_writer
from sabench.dataset.verification import probe
from sabench.tasks.plain_results import is_plain, write_plain
from sabench.tasks.visible_files import open_sandbox, view_of_program
from sabench.utils.errors import InputError
from sabench.utils.files import clear_abandoned, is_file, refuse_existing
from sabench.utils.processes.call import call_isolated
from sabench.utils.processes.program import ProgramLimits, run_limited
from sabench.utils.progress import say
from sabench.utils.validation import printable


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
    """Find the absolute path of an executable file; relative names are in `folder`."""
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
    limits: ProgramLimits | None = None,
    overwrite: bool = False,
) -> Result:
    """Run a program on a data set, check its result, and move it into place.

    sabench measures the cost here: wall seconds over the number of frames, or of pairs for
    velocities, and memory.

    Raises InputError for a missing program, a program that fails or breaks a limit, or a result
    that breaks docs/formats/result.md.
    """
    path, limits = find_program(program), limits or ProgramLimits()
    refuse_existing(out, overwrite=overwrite)
    with open_sandbox(dataset) as sandbox, sandbox.naming(dataset.root, out):
        sees = "; sees its folder and SABENCH_VISIBLE" if sandbox.confined else "; not confined"
        say(f"{path.name}: at most {limits.time_s:g} s{sees}")
        # strings as they are, all else as JSON
        words = [
            f"{name}={value if isinstance(value, str) else json.dumps(value)}"
            for name, value in (parameters or {}).items()
        ]
        cost = run_limited(
            [str(path), str(sandbox.observation), str(sandbox.result), *words],
            sandbox.scratch,
            limits,
            path.name,
            view_of_program(sandbox, dataset, path),
        )
        if is_plain(sandbox.result):
            doing, plain = f"result of {path.name}", sandbox.observation.with_name("plain.h5")
            each = sandbox.result, dataset.root, plain, path.name
            call_isolated(write_plain, *each, doing=doing, time_s=ProgramLimits.time_s)
            plain.replace(sandbox.result)
        result = open_foreign(sandbox.result, dataset, path.name)
        head = replace(
            result,
            solver=solver_name(program),
            parameters=parameters or {},
            seconds=cost.seconds / max(1, len(tasks.of(result.task).frames(dataset))),
            peak_mb=cost.peak_mb,
            reconstruction_s=None,
            compile_s=None,
            cpu_share=None,
            isolated=sandbox.confined,
            whole_process=True,
        )
        copy_isolated(result, dataset, out, head, path.name, overwrite=overwrite)
    return open_result(out, dataset)


def open_foreign(path: Path, data: Dataset, name: str) -> Result:
    """Open the result file of a solver that is not sabench's own, named so in errors."""
    if path.is_symlink() or not path.is_file():
        got = "a link" if path.is_symlink() else "no file"
        raise InputError(f"{name}: expected its result at {path}, found {got} there")
    probe(path)
    return open_result(path, data)


def copy_isolated(
    result: Result, data: Dataset, out: Path, head: Result, name: str, *, overwrite: bool
) -> None:
    """Write a foreign result anew, checked, by `write_anew` in a child process."""
    doing, time_s = f"result of {name}", ProgramLimits.time_s
    try:
        call_isolated(
            write_anew, result.path, data.root, out, head, overwrite, doing=doing, time_s=time_s
        )
    finally:
        clear_abandoned(out.absolute())


def write_anew(path: Path, root: Path, out: Path, head: Result | None, overwrite: bool) -> None:
    """Read every value of a foreign result under all checks, and write it anew.

    Nothing else of the foreign file is copied.

    Parameters
    ----------
    head : solver, parameters and costs to write; None: solver and parameters of the file alone.
    """
    data = open_dataset(root)
    result = open_result(path, data)
    header, task = head or result, tasks.of(result.task)
    with result_writer(
        out, data, header.solver, task.name, header.parameters, overwrite=overwrite
    ) as writer:
        task.copy(data, result, writer)
        if head:
            writer.set(**head.costs)
