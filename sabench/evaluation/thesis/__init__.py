"""The thesis's tables and figures measured again, its values beside ours."""

from __future__ import annotations

import difflib
import importlib
import itertools
from collections.abc import Iterator, Sequence
from typing import Any

from sabench.evaluation.thesis.common import Item
from sabench.utils.errors import InputError

TABLES = {
    "table-2-1": "largest density with Q = 0.75, and the plane spacing, of eleven arrays of 25 cameras",
    "table-2-1-best": "Q of the best tomographic solver at 1.5 times these densities",
    "fig-2-6": "Q against density for every baseline",
    "fig-2-7": "Q against the number of cameras, and against the mapping error",
    "table-2-2": "precision of the velocity in two vortex rings",
    "fig-2-18": "a vortex ring before eight cameras: profiles, core distance and circulation (figures 2-16 to 2-19)",
    "table-2-3": "particles per pixel of all cameras together",
    "table-3-1": "operations and seconds of the algorithms",
    "fig-3-6": "true and ghost particles against the number of cameras",
    "fig-3-8": "true and ghost particles against the number of particles",
    "fig-2-7-cameras": "Q with the cameras of every calibration, from the same images through a wall",
    "fig-1-3": "a code behind bubbles, in single views and in refocused planes",
    "table-5-2": "three plunging jets out of the bubbles that are found (table 5.2, figures 5-18 to 5-20)",
    "fig-6-5": "a liquid jet in a cross-flow, refocused, and the drops that are found (figures 6-4 and 6-5)",
    "fig-4-6": "error of camera models without refraction",
    "fig-4-9": "Newton's iteration for the path through a wall",
    "fig-4-12": "errors of the auto-calibration against noise and start (figures 4-11 to 4-15)",
    "fig-4-16": "auto-calibration on random subsets of the cameras",
    "fig-4-18": "points in the volume by estimated and exact cameras, and by linear auto-calibration (figures 4-18 to 4-21)",
    "fig-4-25": "spacing of a traversed grid's planes from poor starts (figures 4-25 and 4-26)",
    "fig-4-27": "cameras refitted to moved points",
}


def reproduce(
    tables: Sequence[str], seeds: int | None = None, pixels: int | None = None
) -> Iterator[Item]:
    """The rows of tables and figures, and pictures of curves, each as soon as it is measured; frames that several of them look at are taken once.

    Parameters
    ----------
    tables : some of `TABLES`.
    seeds : how many; by default as many as each table's module says.
    pixels : side of the images; by default the scene's. Fewer make a coarse copy of each array, for
        a quick look.

    Raises
    ------
    InputError
        An unknown table.
    """
    for table in tables:
        if table not in TABLES:
            near = difflib.get_close_matches(table, TABLES, 1)
            raise InputError(
                f"{table}: expected one of {', '.join(TABLES)}"
                + (f"; did you mean {near[0]}?" if near else "")
            )
    modules: list[Any] = [
        importlib.import_module(f"{__name__}.{table.replace('-', '_')}") for table in tables
    ]
    return itertools.chain.from_iterable(
        module.rows(range(1, (seeds or module.SEEDS) + 1), pixels) for module in modules
    )
