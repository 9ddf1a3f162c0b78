"""Tables and figures of the thesis, measured again and compared with its values."""

from __future__ import annotations

import difflib
import importlib
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from sabench.evaluation.thesis.common import Item, Row
from sabench.utils.errors import InputError

TABLES = {
    "table-2-1": "largest density with Q = 0.75, and plane spacing: eleven arrays of 25 cameras",
    "table-2-1-best": "Q of the best tomographic solver at 1.5 times these densities",
    "fig-2-4": "grey values of single and refocused images (figures 2-3 to 2-5, 2-14, 2-15)",
    "fig-2-6": "Q against density for every baseline",
    "fig-2-7": "Q against the number of cameras, and against the mapping error",
    "table-2-2": "precision of the velocity in two vortex rings",
    "fig-2-17": "planar PIV of a light sheet beside the 3-D result (figures 2-17 to 2-19)",
    "fig-2-18": "vortex ring and eight cameras: profiles, core, circulation (figures 2-16 to 2-19)",
    "section-2-3-2": "yield of particles with and without self-calibration",
    "section-2-4": "velocity error against baseline and plane spacing",
    "table-2-3": "particles per pixel of all cameras together",
    "table-3-1": "operations and seconds of the algorithms",
    "section-3-2-1": "cost of triggers that are up to 125 us off",
    "fig-3-6": "true and ghost particles against the number of cameras",
    "fig-3-8": "true and ghost particles against the number of particles",
    "fig-2-7-cameras": "Q with the cameras of every calibration; same images through a wall",
    "fig-1-3": "code behind bubbles, read in single views and in refocused planes",
    "table-5-1": "speed, diameter and dimensionless numbers of the jets (equations 5.1 to 5.4)",
    "fig-5-7": "feature potential E and minimum images of bubbles (figures 5-5 to 5-11)",
    "section-2-2-2": "code on a cylinder behind bubbles, on the refocused cylinder and in planes",
    "table-5-2": "three plunging jets from detected bubbles (table 5.2, figures 5-18 to 5-20)",
    "fig-6-3": "sharpness of the calibration grid, in single images and refocused",
    "fig-5-15": "size distributions with intervals, and their scores (figures 5-15 to 5-17)",
    "fig-5-21": "concentration over depth and radius, five points (5-21, 5-26 to 5-30)",
    "fig-5-22": "penetration depth against the jet's height",
    "fig-5-24": "sizes above and below the penetration depth (figures 5-23 to 5-25)",
    "fig-5-28": "tilt of a jet found and removed",
    "fig-6-5": "refocused liquid jet in a cross-flow, and detected drops (figures 6-4 and 6-5)",
    "flow-behind-bodies": "chapter 6: flow through a reef and behind a propeller",
    "drops-over-time": "chapter 6: drops of a liquid jet, counted over time",
    "three-phases": "chapter 6: bubbles, a body and tracers in one picture, score per phase",
    "fig-6-6": "edges of the jet in refocused planes, and errors of their depths",
    "fig-4-6": "error of camera models without refraction",
    "fig-4-9": "Newton's iteration for the path through a wall",
    "table-4-1": "variables of the simulated calibrations, as drawn",
    "appendix-c": "simulated calibrations of 3, 7 and 13 cameras in full (figures C-1 to C-21)",
    "fig-4-12": "auto-calibration error against noise and initial guess (figures 4-11 to 4-15)",
    "fig-4-16": "auto-calibration on random subsets of the cameras",
    "fig-4-18": "held-out points by estimated, exact and linear cameras (figures 4-18 to 4-21)",
    "fig-4-23": "reprojection error by camera in three tests of a traversed grid (figure 4-24)",
    "fig-4-25": "plane spacing of a grid from poor initial guesses (figures 4-25 and 4-26)",
    "fig-4-27": "cameras refitted to moved points",
    "fig-4-28": "differences between the three tests, before and after alignment (to figure 4-31)",
}


def resolve(names: Sequence[str]) -> list[str]:
    """Resolve names of items; `all` are all of them.

    Raises
    ------
    InputError
        An unknown name.
    """
    for name in names:
        if name not in TABLES and name != "all":
            near = difflib.get_close_matches(name, [*TABLES, "all"], 1)
            raise InputError(
                f"{name}: expected one of all, {', '.join(TABLES)}"
                + (f"; did you mean {near[0]}?" if near else "")
            )
    return list(TABLES) if "all" in names else list(names)


def reproduce(
    tables: Sequence[str], seeds: int | None = None, pixels: int | None = None
) -> Iterator[Item]:
    """Measure tables and figures; yield each row or figure when it is ready.

    Frames that several of them use are simulated once.

    Parameters
    ----------
    tables : some of `TABLES`, or `all`.
    seeds : number of seeds; by default that of each table.
    pixels : side of the images; by default the scene's. Use small images for a quick trial; the
        results are not comparable.

    Raises
    ------
    InputError
        An unknown table.
    """
    chosen = resolve(tables)
    return itertools.chain.from_iterable(_measure(table, seeds, pixels) for table in chosen)


def _measure(table: str, seeds: int | None, pixels: int | None) -> Iterator[Item]:
    module: Any = importlib.import_module(f"{__name__}.{table.replace('-', '_')}")
    for item in module.rows(range(1, (seeds or module.SEEDS) + 1), pixels):
        yield replace(item, item=table, pixels=pixels) if isinstance(item, Row) else item
