"""Draw F1 over particles per pixel for each number of cameras, from a record.

Run python docs/images/density.py benchmarks/records/particle-density.json docs/images/NAME.png.
The record is that of `benchmarks/particle_density.py`; cases in which each particle is equally
bright in all cameras count.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from benchmarks.particle_density import CASES, EQUAL, Case
from sabench.plotting.drawing import Curve, Figure, Panel, draw

_CAMERAS = (4, 9, 13, 25)
Points = dict[str, list[tuple[float, float]]]  # solver: particles per pixel and F1


def cameras_of(case: Case) -> int:
    """Number of cameras of a case of `standard-particles`."""
    places = case.layout.get("places")
    return len(places) if places else case.layout.get("columns", 3) * case.layout.get("rows", 3)


def points_of(record: dict[str, Any], cameras: int) -> Points:
    """Points of every solver for one number of cameras, means over the seeds."""
    points: Points = {}
    for name, case in CASES.items():
        plain = Case(case.per_pixel, EQUAL, case.layout)
        if case != plain or cameras_of(case) != cameras:
            continue
        for solver, rows in record.get(name, {}).items():
            scores = [row["f1"] for row in rows if "f1" in row]
            if scores:
                points.setdefault(solver, []).append((case.per_pixel, float(np.mean(scores))))
    return {solver: sorted(own) for solver, own in points.items()}


def figure_of(record: dict[str, Any]) -> Figure:
    """One panel for each number of cameras, one curve for each solver."""
    every = {cameras: points_of(record, cameras) for cameras in _CAMERAS}
    solvers = list(dict.fromkeys(solver for points in every.values() for solver in points))
    panels = tuple(
        Panel(
            f"{cameras} cameras",
            "particles per pixel",
            "F1",
            tuple(
                Curve(
                    solver,
                    [x for x, _ in points.get(solver, [])],
                    [y for _, y in points.get(solver, [])],
                )
                for solver in solvers  # those without points, too: a solver keeps its colour
            ),
        )
        for cameras, points in every.items()
        if points
    )
    return Figure("particle-density", "F1 over the particle density", panels, across=2)


def main(record: Path, out: Path) -> None:
    """Read the record and write the figure."""
    out.write_bytes(draw(figure_of(json.loads(record.read_text(encoding="utf-8")))))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
