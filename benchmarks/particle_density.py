"""Particles found and ghosts over the particle density, by solvers of particles and of volumes.

    python benchmarks/particle_density.py [--seeds 1 2] [--cases NAME ...] [--solvers NAME ...]
        [--output benchmarks/records/particle-density.json]

The scene is `standard-particles`: 240 x 320 pixels behind glass, particles of the whole volume,
scored where all cameras see. The particles of a volume are its local maxima. Cases:

    equal 0.01 ... 0.15     four cameras, each particle equally bright in all of them
    nine 0.05, 0.10         the same with nine cameras, as are equal 0.20 and 0.25
    thirteen 0.05 ... 0.50  the same with thirteen cameras
    twentyfive 0.05 ...     the same with 25 cameras in the square of the nine
    scatter 0.05, 0.10      four cameras, Mie scattering of particles of 2 um: the logarithm of the
                            ratio of two cameras' light has a standard deviation of 0.3
    scatter nine 0.20       the same with nine cameras
    off 0.10                four cameras, each off by 0.1 px
    mitsuba 0.10            four cameras, Mitsuba's images
    own 0.01                nine cameras, Mie scattering of single particles, noise of the scene
    front 0.05, 0.10        four cameras, the same
    own 0.05                four cameras, the same with light from a direction in which no two
                            cameras see the same angle
    hidden 0.05             nine cameras, equally bright; a disc hides half of the volume from one
    realistic, realistic 0.005, 0.02    the scene `realistic-particles`, nine cameras, with 0.05
                            and with fewer particles per pixel
    narrow                  four cameras with pixels twice as large and a wider aperture: images of
                            0.25 px, 0.05 particles per pixel on a quarter of the sensor, dark
                            elsewhere; Mie scattering as in front
    hard                    the standard suite's hard case of tracking, one frame

But for one case, the splat renderer makes the images. Its model differs from that of
`bayesian_ipr`: widths come from the lens and the particles' size and vary over the field and with
depth, particles differ in size by 10 %, and grey values are noisy and rounded. The seeds are others
than those on which the solver's settings were chosen (101). Prints one line a measurement, and
writes one JSON value: recall and ghosts in percent of the true particles, F1, the RMS distance in
the images, the RMS distance in space over the Cramer-Rao bound, the coverage of claimed 68 and 95 %
ellipsoids over the nominal one, and CPU seconds. What the file holds of other cases and solvers
stays.
"""

import argparse
import json
import resource
import sys
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from benchmarks.particle_scores import (  # noqa: E402
    Recording,
    find_particles,
    score_particles,
    why_skipped,
)
from sabench.api import Camera, Observation  # noqa: E402
from sabench.api.make import make_algorithm  # noqa: E402
from sabench.scenes import Scene, parse_scene  # noqa: E402
from sabench.scenes.loading import find  # noqa: E402
from sabench.simulation.in_memory import Shot, simulate  # noqa: E402
from sabench.utils.backend import Renderer  # noqa: E402

EQUAL = {"scattering": "isotropic", "pulse_energy_mj": 6.5}  # light of the scene's Mie particles
_SMALL = {"diameter_mm": 0.002}  # of 2 um: the lobes of their light are wide
_BRIGHT = {"pulse_energy_mj": 3260.0}  # as much light from them
_FOUR = {"columns": 2, "rows": 2}
_TWENTY_FIVE = {"columns": 5, "rows": 5, "spacing_mm": [102.0, 102.0]}
_CROSS = [(x, y) for x in (-204, 0, 204) for y in (-204, 0, 204)]
_CROSS += [(-408, 0), (408, 0), (0, -408), (0, 408)]
THIRTEEN = {"kind": "list", "places": [{"center_mm": [x, y, -516.7]} for x, y in _CROSS]}
_OBLIQUE = {"direction": [0.8, 0.6, 0.0]}
MANY = (0.05, 0.10, 0.20, 0.30, 0.40, 0.50)  # particles per pixel before many cameras
_COARSE = {"pixel_mm": 0.02, "f_number": 11.0}  # a quarter of the sensor, and 0.25 px
_HIDDEN = {"occluders": [{"center_mm": [-151.5, -158.0, -400.0], "radius_mm": 6.0}]}


@dataclass(frozen=True)
class Case:
    """Changes of a scene.

    Attributes
    ----------
    per_pixel : particles.
    light, layout, more : keys of illumination, of the layout of cameras, and of the scene.
    particles, cameras : keys of the particles, and of the cameras.
    shift_px : error of the cameras.
    scene : the bundled one that is changed.
    renderer : of the images.
    """

    per_pixel: float
    light: dict[str, Any] = field(default_factory=dict)
    layout: dict[str, Any] = field(default_factory=dict)
    more: dict[str, Any] = field(default_factory=dict)
    particles: dict[str, Any] = field(default_factory=dict)
    cameras: dict[str, Any] = field(default_factory=dict)
    shift_px: float = 0.0
    scene: str = "standard-particles"
    renderer: Renderer = "splat"


CASES = {
    "equal 0.01": Case(0.01, EQUAL, _FOUR),
    "equal 0.02": Case(0.02, EQUAL, _FOUR),
    "equal 0.05": Case(0.05, EQUAL, _FOUR),
    "equal 0.10": Case(0.10, EQUAL, _FOUR),
    "equal 0.125": Case(0.125, EQUAL, _FOUR),
    "equal 0.15": Case(0.15, EQUAL, _FOUR),
    "nine 0.05": Case(0.05, EQUAL),
    "nine 0.10": Case(0.10, EQUAL),
    "equal 0.20": Case(0.20, EQUAL),
    "equal 0.25": Case(0.25, EQUAL),
    **{f"thirteen {one:.2f}": Case(one, EQUAL, THIRTEEN) for one in MANY},
    **{f"twentyfive {one:.2f}": Case(one, EQUAL, _TWENTY_FIVE) for one in MANY},
    "scatter 0.05": Case(0.05, _BRIGHT, _FOUR, particles=_SMALL),
    "scatter 0.10": Case(0.10, _BRIGHT, _FOUR, particles=_SMALL),
    "scatter nine 0.20": Case(0.20, _BRIGHT, particles=_SMALL),
    "off 0.10": Case(0.10, EQUAL, _FOUR, shift_px=0.1),
    "mitsuba 0.10": Case(0.10, EQUAL, _FOUR, renderer="mitsuba"),
    "own 0.01": Case(0.01),
    "front 0.05": Case(0.05, {}, _FOUR),
    "front 0.10": Case(0.10, {}, _FOUR),
    "own 0.05": Case(0.05, _OBLIQUE, _FOUR),
    "hidden 0.05": Case(0.05, EQUAL, more=_HIDDEN),
    "realistic": Case(0.05, scene="realistic-particles"),
    "realistic 0.005": Case(0.005, scene="realistic-particles"),
    "realistic 0.02": Case(0.02, scene="realistic-particles"),
    "narrow": Case(0.0125, {"pulse_energy_mj": 110.0}, _FOUR, cameras=_COARSE),
    "hard": Case(0.04, {"pulse_energy_mj": 75.0}, _FOUR, shift_px=0.3),
}
SOLVERS = ("bayesian_ipr", "openlpt", "optv")


def scene_of(name: str) -> Scene:
    """Change a bundled scene to a case."""
    case = CASES[name]
    values = tomllib.loads(find(case.scene, "scenes").read_text(encoding="utf-8"))
    values["particles"] |= {"per_pixel": case.per_pixel} | case.particles
    values["illumination"] |= case.light
    values["cameras"] |= case.cameras
    layout = {} if "kind" in case.layout else values["cameras"]["layout"]
    values["cameras"]["layout"] = layout | case.layout
    values |= case.more
    if case.shift_px:
        values["calibration"] = {"shift_px": case.shift_px}
    return parse_scene(values, name)


def cpu_s() -> float:
    """Read the CPU seconds of this process and its children."""
    both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in both)


def measure(
    name: str,
    shot: Shot,
    true_cameras: tuple[Camera, ...],
    parameters: dict[str, Any] | None = None,
    recording: Recording | None = None,
) -> dict[str, Any]:
    """Run a solver on a shot and score it; the CPU seconds include no compilation."""
    solver: Any = make_algorithm(name, parameters or {})
    why = why_skipped(solver, shot.observation)
    if why:
        return {"skipped": why}
    before = cpu_s()
    found = find_particles(solver, shot.observation)
    seconds = cpu_s() - before
    scores = score_particles(found, shot, true_cameras, recording)
    return scores | {"cpu_s": round(seconds, 1)}


def warm_up(names: list[str]) -> None:
    """Compile the kernels on a few particles."""
    values = tomllib.loads(find("standard-particles", "scenes").read_text(encoding="utf-8"))
    values["cameras"] |= {"rows": 60, "columns": 80}
    values["cameras"]["layout"] |= _FOUR
    values["volume"]["size_mm"] = [4.0, 3.0, 2.0]
    values["grid"]["crop_mm"] = [0.2, 0.2, 0.0]
    shot = simulate(parse_scene(values, "warm-up"), seed=1)
    for name in names:
        find_particles(make_algorithm(name, {}), shot.observation)


def exact_cameras(case: str, shot: Shot) -> tuple[Camera, ...]:
    """Make the cameras without their error of calibration."""
    scene = scene_of(case)
    if scene.calibration is None:
        return _plain(shot.observation)
    values = scene.to_dict()
    del values["calibration"]
    values["particles"]["per_pixel"] = 0.001
    return _plain(simulate(parse_scene(values, "exact"), seed=1).observation)


def recording_of(case: str, shot: Shot, seed: int) -> Recording:
    """Give the images of a shot as they were before preprocessing."""
    scene = scene_of(case)
    if scene.preprocessing:
        raw = parse_scene({**scene.to_dict(), "preprocessing": []}, "raw")
        shot = simulate(raw, seed=seed, backend=CASES[case].renderer)
    return Recording(shot.observation.images, scene.sensor)


def _plain(case: Observation) -> tuple[Camera, ...]:
    return tuple(camera for camera in case.cameras if isinstance(camera, Camera))


def main() -> None:
    """Measure, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--solvers", nargs="+", default=list(SOLVERS))
    parser.add_argument("--output", type=Path)
    chosen = parser.parse_args()
    table: dict[str, dict[str, list[dict[str, Any]]]] = {}
    warm_up(chosen.solvers)
    for case in chosen.cases:
        for seed in chosen.seeds:
            shot = simulate(scene_of(case), seed=seed, backend=CASES[case].renderer)
            cameras, recording = exact_cameras(case, shot), recording_of(case, shot, seed)
            for name in chosen.solvers:
                row = measure(name, shot, cameras, recording=recording)
                table.setdefault(case, {}).setdefault(name, []).append({"seed": seed} | row)
                print(case, name, json.dumps({"seed": seed} | row), file=sys.stderr, flush=True)
        if chosen.output:
            write_record(chosen.output, table)  # after each case: the next may be stopped


def write_record(path: Path, table: dict[str, dict[str, list[dict[str, Any]]]]) -> None:
    """Write what was measured; other cases and solvers of the file stay as they are."""
    record = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    for case, rows in table.items():
        record[case] = record.get(case, {}) | rows
    path.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
