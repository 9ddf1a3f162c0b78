"""Access to the reproduction of J. Belden's thesis in the folder reproduction/.

The folder lies next to the package in a checkout, and inside it in a wheel.
"""

import functools
import importlib
import importlib.util
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from sabench import plugins
from sabench.plotting.drawing import Figure
from sabench.utils.errors import InputError

_NAME = "sabench.plugins.reproduction"


@dataclass(frozen=True)
class Row:
    """Row of a table: a value of the thesis and the measured one.

    Attributes
    ----------
    thesis : its value, or its claim in words; None without one.
    measured : mean over the seeds; None where there is no such value.
    verdict : in words.
    ci95 : half width of the 95 % confidence interval of `measured`; None for a single seed.
    seeds : number of values.
    note : further observation.
    item : name of the measurement.
    pixels : side of small images of a quick trial; None at full size.
    """

    name: str
    thesis: float | str | None
    measured: float | None
    verdict: str
    ci95: float | None = None
    seeds: int = 0
    note: str = ""
    item: str = ""
    pixels: int | None = None


Item = Row | Figure  # what a measurement yields


def reproduce(
    tables: Sequence[str], seeds: int | None = None, pixels: int | None = None
) -> Iterator[Item]:
    """Measure tables and figures of the thesis.

    Yields each row or figure when it is ready. Frames that several of them use are simulated once.

    Parameters
    ----------
    tables : names that `sabench reproduce --list` shows, such as "table-2-1", or "all".
    seeds : number of seeds; by default that of each table.
    pixels : side of the images; by default the scene's. Use small images for a quick trial; the
        results are not comparable.

    Raises InputError: an unknown table, or the folder reproduction/ is missing.
    """
    measured: Iterator[Item] = load_reproduction().reproduce(tables, seeds, pixels)
    return measured


def load_reproduction(module: str = "") -> ModuleType:
    """Import reproduction/ or a module of it; InputError if the folder is missing."""
    package = _load(plugins.bundled_folder("reproduction"))
    return importlib.import_module(f"{_NAME}.{module}") if module else package


@functools.cache
def _load(folder: Path) -> ModuleType:
    """Import a folder as the package `sabench.plugins.reproduction`, once."""
    file = folder / "__init__.py"
    spec = importlib.util.spec_from_file_location(
        _NAME, file, submodule_search_locations=[str(folder)]
    )
    if not file.is_file() or spec is None or spec.loader is None:
        raise InputError(
            f"{folder}: expected the reproduction of the thesis, got no such folder; "
            "copy the folder reproduction/ of sabench's source repository there"
        )
    package = importlib.util.module_from_spec(spec)
    sys.modules[_NAME] = package
    spec.loader.exec_module(package)
    return package
