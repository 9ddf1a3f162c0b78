"""Stamps of compiled kernels, which change with what they may call.

numba compiles a kernel again when its own file has changed, but not when another file has changed
whose kernels it calls. The stamp of every kernel of sabench and of plug-ins therefore contains the
sources of all modules of sabench that its module imports, directly or not. numba compares the stamp
in each index of its cache, and replaces the index if it differs. It reads the whole index first,
which fails where a class has moved to another module since, or where the file is damaged: such an
index counts as empty, too.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.machinery
import pickle
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

_PACKAGE = Path(__file__).resolve().parents[1]
_CACHING = "numba.core.caching"
_IMPORT = re.compile(r"^\s*from (sabench[\w.]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)


def stamp_kernels() -> None:
    """Let numba stamp kernels so, now or when it is imported."""
    if _CACHING in sys.modules:
        _install(sys.modules[_CACHING])
    else:
        sys.meta_path.insert(0, _OnImport())


class _OnImport:
    """Finder that changes numba's module of caches as it is imported."""

    def find_spec(
        self, name: str, path: Any = None, target: Any = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Find that module as Python does, once; leave all others to other finders."""
        if name != _CACHING:
            return None
        sys.meta_path.remove(self)
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        if spec is None or spec.loader is None:
            return spec
        execute = spec.loader.exec_module

        def execute_and_install(module: ModuleType) -> None:
            execute(module)
            _install(module)

        spec.loader.exec_module = execute_and_install  # type: ignore[method-assign]
        return spec


def _install(caching: ModuleType) -> None:
    locators = caching.CacheImpl._locator_classes
    caching.CacheImpl._locator_classes = [_locator_of(tuple(locators)), *locators]
    caching.IndexDataCacheFile._load_index = _or_empty(caching.IndexDataCacheFile._load_index)


def _or_empty(load: Callable[[Any], dict[Any, str]]) -> Callable[[Any], dict[Any, str]]:
    @functools.wraps(load)
    def load_index(index: Any) -> dict[Any, str]:
        try:
            return load(index)
        except (pickle.UnpicklingError, AttributeError, EOFError, ImportError, IndexError):
            return {}

    return load_index


def _locator_of(others: tuple[Any, ...]) -> type:
    class KernelLocator:
        """Place of a kernel of sabench or of a plug-in in the cache: where numba puts it."""

        @staticmethod
        def from_function(function: Any, file: str) -> Any:
            """Locate a kernel and extend its stamp; None for kernels of other packages."""
            if function.__module__.partition(".")[0] != "sabench":
                return None
            found = (other.from_function(function, file) for other in others)
            locator = next((one for one in found if one is not None), None)
            if locator is not None:
                own = locator.get_source_stamp()
                locator.get_source_stamp = lambda: (own, kernel_sources(Path(file)))
            return locator

    return KernelLocator


@functools.cache
def kernel_sources(file: Path) -> str:
    """Compute the SHA-256 of a file and of all files of sabench that it imports."""
    found, open_files = {file}, [file]
    while open_files:
        new = _imported(open_files.pop()) - found
        found |= new
        open_files += new
    whole = hashlib.sha256()
    for one in sorted(found):
        content = one.read_bytes()
        whole.update(f"{one.name}\0{len(content)}\0".encode() + content)
    return whole.hexdigest()


@functools.cache
def _imported(file: Path) -> set[Path]:
    """Find the files of sabench that a file imports, directly."""
    found = set()
    for module, names in _IMPORT.findall(file.read_text(encoding="utf-8")):
        folder = _PACKAGE.joinpath(*module.split(".")[1:])
        places = [folder, *(folder / name for name in re.findall(r"\w+", names))]
        found |= {place.with_suffix(".py") for place in places}
    return {one for one in found if one.is_file()}
