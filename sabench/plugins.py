"""Discovery of generators and solvers: plug-ins of one file each.

They lie outside the package.

Importing this module mounts `sabench.plugins.generators` and `sabench.plugins.solvers`. They are
searched for in this order: the folders next to the package (a checkout) or inside it
(`sabench/_plugins/<kind>`, a wheel), then `<folder>/<kind>` for every folder in the environment
variable SABENCH_PLUGINS (separated as in PATH). The name of a plug-in is the stem of its file.

`load` imports one plug-in. `describe` reads its name, task and summary from its source instead, so
that listing plug-ins is fast and one broken plug-in does not affect the others.
"""

import difflib
import functools
import importlib
import os
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

from sabench.utils.class_source import constant, find_class, import_fault, parse_file
from sabench.utils.code_hash import PACKAGE
from sabench.utils.errors import InputError
from sabench.utils.installed import lacking

PLUGIN_FOLDERS = ("generators", "solvers")
# Class attribute that groups the entries of a kind.
_GROUP = {"solvers": "task", "generators": "makes"}

_Kind = Literal["generator", "solver", "scene", "suite"]


@dataclass(frozen=True)
class ListEntry:
    """One line of `sabench list`.

    Attributes
    ----------
    group : task of a solver, product of a generator; empty for scenes and suites.
    summary : first line of the docstring of a plug-in, title of a scene or suite.
    """

    kind: _Kind
    name: str
    group: str
    summary: str
    file: Path


@functools.cache
def bundled_folder(kind: str) -> Path:
    """Find a bundled folder, such as solvers, scenes or reproduction."""
    beside = PACKAGE.parent / kind
    checkout = (PACKAGE.parent / "pyproject.toml").is_file() and beside.is_dir()
    return beside if checkout else PACKAGE / "_plugins" / kind


def folders(kind: str) -> list[Path]:
    """List all folders that are searched for plug-ins of a kind, each once."""
    variable = os.environ.get("SABENCH_PLUGINS", "")
    extra = [(Path(entry) / kind).absolute() for entry in variable.split(os.pathsep) if entry]
    by_path: dict[Path, Path] = {}  # one folder by two names is one
    for folder in (bundled_folder(kind), *extra):
        if folder.is_dir():
            by_path.setdefault(folder.resolve(), folder)
    return list(by_path.values())


def names(kind: str) -> list[str]:
    """List the names of all plug-ins of a kind, sorted."""
    return sorted(_files(kind))


def file_of(kind: str, name: str) -> Path:
    """Find the file of a plug-in.

    Raises
    ------
    InputError
        No plug-in has this name, or two have it.
    """
    files = _files(kind)
    if name not in files:
        raise InputError(f"no {kind[:-1]} is named {name!r}: {_hint(kind, name, sorted(files))}")
    if len(files[name]) > 1:
        first, second = files[name][:2]
        raise InputError(
            f"two {kind} are named {name}: {first} and {second}; rename or remove one of them"
        )
    return files[name][0]


def _hint(kind: str, name: str, names: list[str]) -> str:
    """Suggest names in place of an unknown one, and where to put a plug-in."""
    if not names:  # a folder `sabench` in the current one hides the installed package's
        return f"none are in {bundled_folder(kind)}; is another copy of sabench in {Path.cwd()}?"
    near = difflib.get_close_matches(name, names, 1)
    what = f"did you mean {near[0]}?" if near else f"there are {', '.join(names)}"
    if os.sep in name:
        return "a program's path is for `solve` and suites alone"
    hint = f"for one of your own, SABENCH_PLUGINS is the folder that holds {kind}/{name}.py"
    entries = filter(None, os.environ.get("SABENCH_PLUGINS", "").split(os.pathsep))
    missing = [entry for entry in entries if not (Path(entry) / kind).is_dir()]
    return f"{what}; {hint}" + "".join(f"; there is no folder {entry}/{kind}" for entry in missing)


def is_bundled(kind: str, name: str) -> bool:
    """Check whether a plug-in is one of sabench's own; raises as `file_of` does."""
    return file_of(kind, name).parent == bundled_folder(kind)


def _files(kind: str) -> dict[str, list[Path]]:
    files: dict[str, list[Path]] = {}
    for folder in folders(kind):
        for file in sorted(folder.glob("[a-z]*.py")):
            files.setdefault(file.stem, []).append(file)
    return files


def load(kind: str, name: str) -> type[Any]:
    """Import a plug-in.

    It is the one class of its file with the stem of the file as its `name`.

    Raises
    ------
    InputError
        No plug-in or two have this name, or the file cannot be imported or has no such class.
    """
    return _load(kind, name, tuple(folders(kind)))


@functools.cache
def _load(kind: str, name: str, searched: tuple[Path, ...]) -> type[Any]:
    file = file_of(kind, name)
    sys.modules[f"{__name__}.{kind}"].__path__ = [str(folder) for folder in searched]
    try:
        module = importlib.import_module(f"{__name__}.{kind}.{name}")
    except Exception as error:
        fault = lacking(error) or f"{type(error).__name__}: {error}"
        raise InputError(f"{kind[:-1]} {name}: cannot import {file}: {fault}") from error
    classes = [
        value
        for value in vars(module).values()
        if isinstance(value, type) and value.__module__ == module.__name__
        if getattr(value, "name", None) == name
    ]
    if len(classes) != 1:
        raise InputError(f"{file}: expected one class with name = {name!r}, got {len(classes)}")
    return classes[0]


def summary(plugin: type[Any]) -> str:
    """Read the first line of a plug-in's docstring."""
    return (plugin.__doc__ or "").strip().split("\n")[0]


def summarise(kind: str, name: str) -> ListEntry:
    """Summarise a plug-in from its source.

    It is imported only if its source is not sufficient.

    Raises
    ------
    InputError
        The file cannot be parsed, has an import that fails, or has no class of this name.
    """
    file = file_of(kind, name)
    source = parse_file(file)
    fault = import_fault(source)
    if fault:
        raise InputError(f"{kind[:-1]} {name}: {file}: {fault}")
    singular: _Kind = "solver" if kind == "solvers" else "generator"
    definition = find_class(source, name)
    group = constant(source, definition, _GROUP[kind]) if definition else None
    if definition and group is not None:
        return ListEntry(singular, name, group, definition.summary, file)
    plugin = load(kind, name)
    return ListEntry(singular, name, getattr(plugin, _GROUP[kind], ""), summary(plugin), file)


def list_solvers(task: str | None = None) -> list[str]:
    """List the names of all solvers, or of those of one task."""
    return _select_names("solvers", task)


def list_generators(makes: str | None = None) -> list[str]:
    """List the names of all generators, or of those of one product.

    Products are "particles", "flow", ...
    """
    return _select_names("generators", makes)


def _select_names(kind: str, group: str | None) -> list[str]:
    if group is None:
        return names(kind)
    entries, faults = readable(kind)
    for fault in faults:
        warnings.warn(fault, stacklevel=3)
    return [entry.name for entry in entries if entry.group == group]


def list_tasks() -> list[str]:
    """List the tasks that have a solver."""
    return sorted({entry.group for entry in readable("solvers")[0]})


def readable(kind: str) -> tuple[list[ListEntry], list[str]]:
    """Describe all plug-ins of a kind.

    Returns entries, and one sentence for each plug-in that is broken.
    """
    entries, faults = [], []
    for name in names(kind):
        try:
            entries.append(summarise(kind, name))
        except InputError as error:
            faults.append(str(error))
    return entries, faults


def list_scenes() -> list[str]:
    """List the names of the bundled scenes."""
    return [file.stem for file in _tables("scene")]


def list_suites() -> list[str]:
    """List the names of the bundled suites."""
    return [file.stem for file in _tables("suite")]


def tables(kind: Literal["scene", "suite"]) -> list[ListEntry]:
    """Describe the bundled scenes or suites by their titles."""
    import tomllib

    titles = {
        file: tomllib.loads(file.read_text(encoding="utf-8"))["title"] for file in _tables(kind)
    }
    return [ListEntry(kind, file.stem, "", title, file) for file, title in titles.items()]


def _tables(kind: Literal["scene", "suite"]) -> list[Path]:
    folders = [bundled_folder("scenes")] if kind == "scene" else suite_folders()
    files = [file for folder in folders for file in folder.glob("*.toml")]
    return sorted(files, key=lambda file: file.name)


def suite_folders() -> list[Path]:
    """List the folders of bundled suites: those of sabench, and those of the thesis."""
    return [bundled_folder(kind) / "suites" for kind in ("scenes", "reproduction")]


def mount() -> None:
    """Create the packages that hold the plug-ins."""
    for kind in PLUGIN_FOLDERS:
        module = ModuleType(f"{__name__}.{kind}", f"Plug-ins: {kind}.")
        module.__path__ = [str(folder) for folder in folders(kind)]
        sys.modules[module.__name__] = module


mount()
