"""Tables and figures of the thesis, measured again and compared with its values."""

import difflib
import importlib
import itertools
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sabench.evaluation.reproduction import Item, Row
from sabench.utils.errors import InputError


@dataclass(frozen=True)
class Measurement:
    """Measurement of a table or figure.

    Attributes
    ----------
    module : module of this package with a function of the measurement's name, such as `fig_2_6`.
    seeds : default number of seeds.
    title : what is measured.
    seconds : CPU time of one seed where the reference kernel takes `REFERENCE_S`; 0 if unknown.
    """

    module: str
    seeds: int
    title: str
    seconds: float = 0.0


REFERENCE_S = 0.02


_FILE = Path(__file__).with_name("measurements.toml")
MEASUREMENTS = {
    name: Measurement(**values)
    for name, values in tomllib.loads(_FILE.read_text(encoding="utf-8")).items()
}


def resolve(names: Sequence[str]) -> list[str]:
    """Resolve names of measurements; `all` stands for all of them.

    Raises InputError: an unknown name.
    """
    for name in names:
        if name not in MEASUREMENTS and name != "all":
            near = difflib.get_close_matches(name, [*MEASUREMENTS, "all"], 1)
            raise InputError(
                f"{name}: expected one of all, {', '.join(MEASUREMENTS)}"
                + (f"; did you mean {near[0]}?" if near else "")
            )
    return list(MEASUREMENTS) if "all" in names else list(names)


def reproduce(
    tables: Sequence[str], seeds: int | None = None, pixels: int | None = None
) -> Iterator[Item]:
    """Measure tables and figures; `sabench.reproduce` describes the parameters."""
    chosen = resolve(tables)
    return itertools.chain.from_iterable(_measure(table, seeds, pixels) for table in chosen)


def _measure(table: str, seeds: int | None, pixels: int | None) -> Iterator[Item]:
    measurement = MEASUREMENTS[table]
    module: Any = importlib.import_module(f"{__name__}.{measurement.module}")
    measure = getattr(module, table.replace("-", "_"))
    for item in measure(range(1, (seeds or measurement.seeds) + 1), pixels):
        yield replace(item, item=table, pixels=pixels) if isinstance(item, Row) else item
