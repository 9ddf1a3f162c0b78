"""Finds generators and solvers: one file each, in folders that are not part of the package.

Importing this module mounts `sabench.plugins.generators` and `sabench.plugins.solvers`, whose
search paths are, in this order, the folders beside the package (a checkout) or inside it
(`sabench/_plugins/<kind>`, a wheel), and `<folder>/<kind>` for every folder in the variable
SABENCH_PLUGINS (separated as in PATH). A plug-in's name is its file's stem.
"""

from __future__ import annotations

import difflib
import importlib
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from sabench.utils.errors import InputError

_PACKAGE = Path(__file__).resolve().parent
KINDS = ("generators", "solvers")


def bundled(kind: str) -> Path:
    """The folder of that kind (generators, solvers, scenes, leaderboard) that came with this installation."""
    beside = _PACKAGE.parent / kind
    return (
        beside
        if (_PACKAGE.parent / "pyproject.toml").is_file() and beside.is_dir()
        else _PACKAGE / "_plugins" / kind
    )


def folders(kind: str) -> list[Path]:
    """All folders that are searched for that kind."""
    extra = [
        Path(entry) / kind
        for entry in os.environ.get("SABENCH_PLUGINS", "").split(os.pathsep)
        if entry
    ]
    return [folder for folder in (bundled(kind), *extra) if folder.is_dir()]


def names(kind: str) -> list[str]:
    """Names of all plug-ins of a kind, sorted; two of one name are an InputError."""
    return sorted(_files(kind))


def file_of(kind: str, name: str) -> Path:
    """The file of a plug-in that there is."""
    return _files(kind)[name]


def _files(kind: str) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for folder in folders(kind):
        for file in sorted(folder.glob("[a-z]*.py")):
            if file.stem in found:
                raise InputError(f"two {kind} are named {file.stem}: {found[file.stem]} and {file}")
            found[file.stem] = file
    return found


def load(kind: str, name: str) -> type[Any]:
    """The plug-in class of that name: the one class of its file that carries the file's name as its `name`."""
    known = names(kind)
    if name not in known:
        near = difflib.get_close_matches(name, known, 1)
        hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(known)}"
        raise InputError(f"no {kind[:-1]} is named {name!r}: {hint}")
    try:
        module = importlib.import_module(f"{__name__}.{kind}.{name}")
    except Exception as error:
        raise InputError(
            f"{kind[:-1]} {name}: its file cannot be imported, {type(error).__name__}: {error}"
        ) from error
    found = [
        value
        for value in vars(module).values()
        if isinstance(value, type) and value.__module__ == module.__name__
    ]
    classes = [value for value in found if getattr(value, "name", None) == name]
    if len(classes) != 1:
        raise InputError(
            f"{module.__file__}: expected one class with name = {name!r}, got {len(classes)}"
        )
    return classes[0]


def summary(plugin: type[Any]) -> str:
    """First line of a plug-in's docstring."""
    return (plugin.__doc__ or "").strip().split("\n")[0]


def mount() -> None:
    """Make the packages whose modules the plug-ins are; again after SABENCH_PLUGINS has changed."""
    for kind in KINDS:
        module = ModuleType(f"{__name__}.{kind}", f"Plug-ins: {kind}.")
        module.__path__ = [str(folder) for folder in folders(kind)]
        sys.modules[module.__name__] = module


mount()
