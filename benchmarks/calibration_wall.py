"""Walls as unknowns: errors of calibrations over the Cramer-Rao bound.

`OPENBLAS_NUM_THREADS=1 python benchmarks/calibration_wall.py SEEDS [record.json]` prints JSON, or
writes it. The tanks are those of `benchmarks/calibration_reality.py` without errors that the model
does not have; their nominal walls are off in what is unknown. `tables record.json` prints a table.
"""

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from benchmarks.calibration_reality import NOISE_PX, WALL, Errors, guess, make_tank  # noqa: E402
from sabench.algorithms.calibration.bundle_adjustment import BoardImages  # noqa: E402
from sabench.algorithms.calibration.cramer_rao import compute_bound  # noqa: E402
from sabench.algorithms.calibration.parameters import FreeParameters, WallFrame  # noqa: E402
from sabench.algorithms.calibration.problem import make_anchors  # noqa: E402
from sabench.api import CalibrationCase  # noqa: E402
from sabench.api.make import make_algorithm  # noqa: E402
from sabench.apps.own_calibration.report import WallUnknown, wall_unknowns  # noqa: E402
from sabench.geometry.camera import Camera  # noqa: E402
from sabench.geometry.lens import Distortion  # noqa: E402
from sabench.geometry.refraction import Wall  # noqa: E402
from sabench.scenes.calibration import Calibration as Nominal  # noqa: E402
from sabench.scenes.focusing import draw_nominal_wall  # noqa: E402
from sabench.utils.arrays import F64  # noqa: E402
from sabench.utils.files import canonical_json  # noqa: E402
from sabench.utils.progress import progress_bar  # noqa: E402
from sabench.utils.validation import Unknown  # noqa: E402

_UNKNOWNS: tuple[tuple[Unknown, ...], ...] = (
    ("wall",),
    ("thickness",),
    ("layer_index",),
    ("fluid_index",),
    ("wall", "thickness"),
    ("wall", "thickness", "layer_index", "fluid_index"),
)
_WALL_MM, _WALL_DEG, _THICKNESS_PERCENT = 2.0, 0.3, 5.0  # standard deviations of nominal values
_LAYER_INDEX, _FLUID_INDEX = 0.01, 0.003
_LENSES: tuple[Unknown, ...] = ("principal_point", "k1")
_PLAIN = Distortion(k1=-0.2)
_SETUPS = {
    "cameras known, places unknown": (True, False),
    "cameras known, places known": (True, True),
    "with the lenses, places known": (False, True),
}


def off_wall(unknown: tuple[Unknown, ...], seed: int) -> Wall:
    """Draw a nominal wall that is off in what is unknown."""
    errors = Nominal(
        wall_mm=_WALL_MM * ("wall" in unknown),
        wall_deg=_WALL_DEG * ("wall" in unknown),
        thickness_percent=_THICKNESS_PERCENT * ("thickness" in unknown),
        layer_index=_LAYER_INDEX * ("layer_index" in unknown),
        fluid_index=_FLUID_INDEX * ("fluid_index" in unknown),
    )
    return draw_nominal_wall(WALL, errors, seed)


def wall_errors(
    known_cameras: bool, places: bool, unknown: tuple[Unknown, ...], seed: int
) -> tuple[WallUnknown, ...]:
    """Calibrate a tank; returns the unknowns of the wall against the true ones."""
    tank = make_tank(Errors(places=True), seed)
    cameras = tuple(replace(camera, distortion=_PLAIN) for camera in tank.cameras)
    rng = np.random.default_rng([seed, 3])
    exact = np.stack([camera.project(tank.points_mm.reshape(-1, 3))[0] for camera in cameras])
    pixels = (exact + NOISE_PX * rng.standard_normal(exact.shape)).reshape(tank.case.pixels.shape)
    pixels = np.where(tank.case.found[..., None], pixels, np.nan)
    case = replace(tank.case, pixels=pixels, known_cameras=known_cameras)
    wall = off_wall(unknown, seed)
    if known_cameras:
        case = replace(case, cameras=tuple(replace(camera, wall=wall) for camera in cameras))
        case = replace(case, initial_mm=tank.points_mm + rng.uniform(-3.0, 3.0, 3), unknown=unknown)
    else:
        case = guess(case, seed)
        nominal = tuple(replace(camera, wall=wall) for camera in case.cameras)
        case = replace(case, cameras=nominal, unknown=(*_LENSES, *unknown))
    if not places:
        nothing = np.full(tank.points_mm.shape, np.nan)
        case = replace(case, known_mm=nothing, known_sigma_mm=nothing)
    solver: Any = make_algorithm("refractive_autocal", {})
    found = solver.solve(case).cameras[0].wall
    return wall_unknowns(WALL, found, *_wall_bound(cameras, tank.points_mm, case))


def _wall_bound(
    cameras: tuple[Camera, ...], points: F64, case: CalibrationCase
) -> tuple[FreeParameters, F64]:
    """Compute the unknowns and their bound at the truth."""
    frame, free = WallFrame.from_cameras(cameras, points), FreeParameters.from_case(case)
    state, board = frame.state(case.target.points_mm, points), case.target.points_mm
    anchors = make_anchors(case, frame, NOISE_PX)
    pixels, weights = np.nan_to_num(case.pixels), case.found.astype(np.float64)
    seen = BoardImages(board, pixels, weights, anchors)
    return free, compute_bound(state, seen, free, NOISE_PX).shared_std


def measure_wall(seeds: int) -> list[dict[str, Any]]:
    """Measure root mean square errors of every unknown and their ratio to the bound."""
    low, high = np.sqrt(chi2.ppf([0.025, 0.975], seeds) / seeds).tolist()
    rows: list[dict[str, Any]] = []
    pairs = [(name, unknown) for name in _SETUPS for unknown in _UNKNOWNS]
    for name, unknown in progress_bar(pairs, "walls"):
        drawn = [wall_errors(*_SETUPS[name], unknown, seed) for seed in range(1, seeds + 1)]
        for several in zip(*drawn, strict=True):
            errors = np.array([one.found - one.nominal for one in several])
            stds = np.array([np.inf if one.std is None else one.std for one in several])
            ratio = float(np.sqrt(np.mean((errors / stds) ** 2)))
            rows.append(
                {
                    "setup": name,
                    "unknown": list(unknown),
                    "quantity": several[0].name,
                    "unit": several[0].unit,
                    "seeds": seeds,
                    "bound": float(f"{np.median(stds):.3g}") if np.isfinite(stds).all() else None,
                    "rms_error": float(f"{np.sqrt(np.mean(errors**2)):.3g}"),
                    "error_over_bound": round(ratio, 3),
                    "interval_95": [round(ratio / high, 3), round(ratio / low, 3)],
                    "shown": sum(one.shown for one in several),
                }
            )
    return rows


def wall_table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Format a record of walls as a table."""
    yield f"| unknown | quantity | {' | '.join(_SETUPS)} |"
    yield "|---|---|" + "---|" * len(_SETUPS)
    lines: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        names = ", ".join(f"`{name}`" for name in row["unknown"])
        lines.setdefault((names, row["quantity"]), []).append(_wall_cell(row))
    for (names, quantity), cells in lines.items():
        yield f"| {names} | {quantity} | {' | '.join(cells)} |"


def _wall_cell(row: dict[str, Any]) -> str:
    """Format bound and error over bound, or the error where the data show nothing."""
    low, high = row["interval_95"]
    unit = f" {row['unit']}" if row["unit"] else ""
    bound = "none" if row["bound"] is None else f"{row['bound']:g}{unit}"
    if 2 * row["shown"] < row["seeds"]:
        return f"not shown: {bound}"
    return f"{bound}; {row['error_over_bound']:.2f} ({low:.2f} to {high:.2f})"


if __name__ == "__main__" and sys.argv[1:2] == ["tables"]:
    print("\n".join(wall_table(json.loads(Path(sys.argv[2]).read_text(encoding="utf-8")))))
elif __name__ == "__main__":
    text = canonical_json(measure_wall(int(sys.argv[1])))
    if len(sys.argv) > 2:
        Path(sys.argv[2]).write_text(text, encoding="utf-8")
    else:
        print(text)
