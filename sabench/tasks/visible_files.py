"""Files that a solver sees: the observation side, and what it needs to run.

Where the system can confine a process, a solver sees nothing else: no truth, no other data set, no
secret, no file of the user's home.
"""

import contextlib
import os
import re
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sabench import plugins
from sabench.dataset import schema
from sabench.dataset.copies import copy_observation
from sabench.dataset.reader import Dataset
from sabench.utils.code_hash import PACKAGE
from sabench.utils.errors import InputError
from sabench.utils.kernel_folder import kernel_folder
from sabench.utils.processes.confinement import VisiblePaths, can_confine

_UNFINISHED = re.compile(r"[^\s']*\.result\.h5\.partial-\d+")  # what a killed writer leaves
_DEEPEST = 6  # largest depth of the search for data sets below a visible folder
_BESIDE_COMMANDS = ("lib", "lib64", "libexec", "pyvenv.cfg")  # what commands in a bin folder need
_SKIPPED = {".git", ".venv", "__pycache__", "node_modules", "site-packages"}

_SECRET: ContextVar[Path | None] = ContextVar("secret", default=None)


@contextlib.contextmanager
def hide_from_solvers(secret: Path | None) -> Iterator[None]:
    """Hide a file, for a while, from all solvers that are confined."""
    token = _SECRET.set(secret)
    try:
        yield
    finally:
        _SECRET.reset(token)


@dataclass(frozen=True)
class Sandbox:
    """Folders of one run of a solver on one data set.

    Attributes
    ----------
    observation : data set of the observation side alone.
    scratch : empty folder for the result.
    confined : whether the solver can be confined to them.
    """

    observation: Path
    scratch: Path
    confined: bool

    @property
    def result(self) -> Path:
        """The result file that the solver must write."""
        return self.scratch / "result.h5"

    @contextlib.contextmanager
    def naming(self, root: Path, out: Path) -> Iterator[None]:
        """Name the data set and the result in errors, not the files in the sandbox."""
        try:
            yield
        except InputError as error:
            raise type(error)(
                *(self._rename(part, root, out) for part in error.arguments)
            ) from None

    def _rename(self, words: Any, root: Path, out: Path) -> Any:
        if not isinstance(words, str):
            return [self._rename(word, root, out) for word in words]
        named = words.replace(str(self.observation), str(root)).replace(str(self.result), str(out))
        return _UNFINISHED.sub(lambda _: str(out), named)


@contextlib.contextmanager
def open_sandbox(data: Dataset) -> Iterator[Sandbox]:
    """Lay out the observation side of a data set for a solver, for a while."""
    confined = can_confine()
    with tempfile.TemporaryDirectory(
        prefix=".sabench-", dir=_parent(data) if confined else None, ignore_cleanup_errors=True
    ) as name:
        folder = Path(name).resolve()
        sandbox = Sandbox(folder / "dataset", folder / "work", confined)
        copy_observation(data, sandbox.observation, linked=confined)
        sandbox.scratch.mkdir()
        yield sandbox


def _parent(data: Dataset) -> Path | None:
    """Return the folder where images can be linked, if not the usual one."""
    parent, usual = data.root.absolute().parent, Path(tempfile.gettempdir())
    other = usual.stat().st_dev != data.root.stat().st_dev
    return parent if other and os.access(parent, os.W_OK) else None


def view_of_plugin(sandbox: Sandbox, data: Dataset, solver: str) -> VisiblePaths | None:
    """List the files that a Python plug-in sees; None where it cannot be confined."""
    if not sandbox.confined:
        return None
    view = view_of_import(solver)
    hidden = _find_data_sets([Path(folder) for folder in (*view.changeable, *view.writable)], data)
    return replace(
        view,
        readable=(*view.readable, *_words([sandbox.observation])),
        writable=(*view.writable, *_words([sandbox.scratch])),
        hidden=(*view.hidden, *_words(hidden)),
    )


def view_of_import(solver: str) -> VisiblePaths:
    """List the files that the import of a Python plug-in needs.

    sabench's own solvers may write compiled kernels; what another solver writes there is discarded,
    so that it cannot change later runs.
    """
    python = [Path(sys.prefix), Path(sys.base_prefix), PACKAGE.parent / "pyproject.toml"]
    folders = [folder for kind in plugins.PLUGIN_FOLDERS for folder in plugins.folders(kind)]
    # list the folders of compiled kernels, of numba and Dr.Jit
    kernels = [PACKAGE, *folders, *_import_paths(), *[kernel_folder(), Path.home() / ".drjit"]]
    view = VisiblePaths(readable=_words(python), hidden=_words(_find_secret([*python, *kernels])))
    if plugins.is_bundled("solvers", solver):
        return replace(view, writable=_words(kernels), home=str(Path.home()))
    return replace(view, changeable=_words(kernels))


def view_of_program(sandbox: Sandbox, data: Dataset, program: Path) -> VisiblePaths | None:
    """List the files that a program sees; None where it cannot be confined.

    They are those of its folder, of SABENCH_VISIBLE (separated as in PATH) and of the commands on
    PATH.
    """
    if not sandbox.confined:
        return None
    commands = _listed("PATH")
    beside = [command.parent / name for command in commands for name in _BESIDE_COMMANDS]
    python = [Path(sys.prefix), Path(sys.base_prefix)]
    folders = [program.parent, *_listed("SABENCH_VISIBLE")]
    shown = [*folders, *python, *commands, *beside]
    return VisiblePaths(
        readable=_words([*shown, sandbox.observation]),
        writable=_words([sandbox.scratch]),
        hidden=_words([*_find_data_sets(folders, data), *_find_secret(shown)]),
    )


def _import_paths() -> list[Path]:
    """List the folders of importable modules that are not Python's own.

    They are those of PYTHONPATH and of packages that were installed elsewhere, but neither the
    script's nor the checkout's: the package is shown itself.
    """
    python = [Path(sys.prefix), Path(sys.base_prefix)]
    paths = [*_listed("PYTHONPATH"), *(Path(entry).absolute() for entry in sys.path[1:] if entry)]
    return [
        path
        for path in dict.fromkeys(paths)
        if path not in PACKAGE.parents and not any(map(path.is_relative_to, python))
    ]


def _listed(variable: str) -> list[Path]:
    words = os.environ.get(variable, "").split(os.pathsep)
    return [Path(word).absolute() for word in words if word]


def _find_data_sets(shown: Iterable[Path], data: Dataset) -> Iterator[Path]:
    """Find the data sets within folders that are shown: they have truth in them."""
    yield data.root.absolute()
    for folder in shown:
        depth = len(folder.parts)
        for place, below, files in os.walk(folder):
            if schema.TRUTH in files:
                yield Path(place)
            deep = len(Path(place).parts) - depth >= _DEEPEST
            below[:] = [] if deep else [name for name in below if name not in _SKIPPED]


def _find_secret(shown: Iterable[Path]) -> Iterator[Path]:
    """Find the paths of the secret that a solver could read, also in linked folders."""
    secret = _SECRET.get()
    if secret is None:
        return
    yield from (secret.absolute(), secret.resolve())
    for folder in shown:
        if secret.resolve().is_relative_to(folder.resolve()):
            yield folder / secret.resolve().relative_to(folder.resolve())


def _words(paths: Iterable[Path]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(str(path) for path in paths if path.exists()))
