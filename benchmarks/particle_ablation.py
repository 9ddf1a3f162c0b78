"""Effect of each part of `bayesian_ipr`: runs with one part taken out at a time.

    python benchmarks/particle_ablation.py [--cases "equal 0.10" ...] [--seeds 101 ...]
        [--parts NAME ...] [--output benchmarks/records/particle-ablation.json]

The cases are those of `benchmarks/particle_density.py`, the seed is the one on which the solver's
settings were chosen. Parts:

    widening        while candidates share the light, their images are as wide as measured
    levels          the darkest candidates go at once, not in six steps
    settling        all particles are fitted once at each step, not until they are settled
    refits          neighbours of a particle that is tried as a ghost are not fitted again
    splits          no particle is tried as two
    light free      any light in any camera is as probable as any other
    one light       all cameras see the same light
    alignment       cameras stay where their calibration says
    widths          images are as wide everywhere as statistics of pixels say
    background      no background is taken away, no bright spot covered, no area hidden
    best camera     what a particle gains in its best camera counts

Prints one line a measurement, and writes one JSON value: case, part, and for each seed recall and
ghosts in percent of the true particles, F1, the RMS distance in the images, and CPU seconds. What
the file holds of other cases and parts stays.
"""

import argparse
import json
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from benchmarks.particle_density import (  # noqa: E402
    CASES,
    exact_cameras,
    measure,
    scene_of,
    warm_up,
    write_record,
)
from sabench.algorithms.particles import (  # noqa: E402
    bayesian_ipr,
    learned_model,
    obstacles,
    particle_search,
)
from sabench.algorithms.particles.joint_fit import even_covariance  # noqa: E402
from sabench.algorithms.particles.learned_model import learn_light  # noqa: E402
from sabench.algorithms.particles.particle_search import ParticleSearch  # noqa: E402
from sabench.simulation.in_memory import simulate  # noqa: E402
from sabench.utils.arrays import F32, Bool  # noqa: E402

SOLVER = "bayesian_ipr"
_CASES = ["equal 0.05", "equal 0.10", "equal 0.15", "own 0.05", "off 0.10"]
_FREE, _SAME = 3.0, 0.02  # scatter of light's logarithm between cameras
_COMMON = 0.4  # of particles

Patches = list[tuple[Any, str, Any]]  # object, name of its attribute, and what takes its place


def _nothing(*_: Any, **__: Any) -> None:
    """Do nothing."""


def _set_even(between: float) -> Callable[..., None]:
    """Make a method that sets a scatter of light between cameras."""

    def set_covariance(search: ParticleSearch, *_: float) -> None:
        search.covariance = even_covariance(len(search.typical), between, _COMMON)

    return set_covariance


def _learn_light_only(between: float) -> Callable[[ParticleSearch], None]:
    """Make a function that learns typical light, with a scatter that stays."""

    def learn_typical(search: ParticleSearch) -> None:
        learn_light(search)
        search.covariance = even_covariance(len(search.typical), between, _COMMON)

    return learn_typical


def _fixed_light(between: float) -> Patches:
    return [
        (learned_model, "learn_light", _learn_light_only(between)),
        (ParticleSearch, "reset_covariance", _set_even(between)),
    ]


def _remove_with_best_camera(search: ParticleSearch, lone: bool) -> None:
    _REMOVE(search, False)
    search.sure &= lone


def _not_cleared(images: F32, flaws: Any) -> tuple[F32, Any]:
    return images, flaws


def _none_hidden(images: F32, *_: Any) -> Bool:
    return np.zeros(images.shape, dtype=np.bool_)


_REMOVE = ParticleSearch.remove
PARTS: dict[str, tuple[dict[str, Any], Patches]] = {
    "all parts": ({}, []),
    "widening": ({"widening": 1.0}, []),
    "levels": ({}, [(bayesian_ipr, "_DARKEST", bayesian_ipr._DARKEST[-1:])]),
    "settling": ({"fits": 1}, []),
    "refits": ({}, [(particle_search, "_TRIAL_FITS", 0)]),
    "splits": ({}, [(ParticleSearch, "split", _nothing)]),
    "light free": ({}, _fixed_light(_FREE)),
    "one light": ({}, _fixed_light(_SAME)),
    "alignment": ({}, [(learned_model, "align_cameras", _nothing)]),
    "widths": ({}, [(learned_model, "learn_widths", _nothing)]),
    "background": (
        {},
        [
            (bayesian_ipr, "clear_images", _not_cleared),
            (obstacles, "find_dark_areas", _none_hidden),
        ],
    ),
    "best camera": ({}, [(ParticleSearch, "remove", _remove_with_best_camera)]),
}


def main() -> None:
    """Measure, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", nargs="+", default=_CASES, choices=list(CASES))
    parser.add_argument("--seeds", type=int, nargs="+", default=[101])
    parser.add_argument("--parts", nargs="+", default=list(PARTS), choices=list(PARTS))
    parser.add_argument("--output", type=Path)
    chosen = parser.parse_args()
    warm_up([SOLVER])
    for case in chosen.cases:
        for seed in chosen.seeds:
            shot = simulate(scene_of(case), seed=seed, backend=CASES[case].renderer)
            cameras = exact_cameras(case, shot)
            for part in chosen.parts:
                parameters, patches = PARTS[part]
                with ExitStack() as stack:
                    for owner, name, value in patches:
                        stack.enter_context(patch.object(owner, name, value))
                    row = {"seed": seed} | measure(SOLVER, shot, cameras, parameters)
                print(case, part, json.dumps(row), file=sys.stderr, flush=True)
                if chosen.output:
                    write_row(chosen.output, case, part, row)


def write_row(path: Path, case: str, part: str, row: dict[str, Any]) -> None:
    """Write one measurement, in place of an earlier one of the same seed."""
    record = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    rows = record.get(case, {}).get(part, [])
    kept = [old for old in rows if old["seed"] != row["seed"]]
    write_record(path, {case: {part: [*kept, row]}})


if __name__ == "__main__":
    main()
