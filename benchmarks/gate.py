"""Sensitivity of the gate: planted bugs it catches, honest reruns it passes.

    python benchmarks/gate.py                       # 43 bugs, 50 reruns: two hours on two cores
    python benchmarks/gate.py --bugs 3 --reruns 2
    python benchmarks/gate.py --skip 20 --narrow --reruns 0

Each bug is one line changed in a copy of the source; `sabench check ci` there must end with exit
code 1, and with 0 where nothing was changed. A bug that the gate cannot see names the unit tests
that must fail. `--narrow` runs only the case of `ci` that is meant to catch a bug, and only the
tests of a bug that is theirs to catch. The copy's compiled kernels are kept, except those of
the changed file and of all files that import it: numba looks for changes in a kernel's own file
only. Prints a line for every run and a summary; exit code 1 if a bug was missed, a rerun was not
silent, or a replacement does not fit.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

ROOT = Path(__file__).resolve().parents[1]
_COPIED = (
    "sabench",
    "solvers",
    "generators",
    "scenes",
    "leaderboard",
    "tests",
    "pyproject.toml",
)


@dataclass(frozen=True)
class Bug:
    """Replacement of a line in a file; `old` must be there exactly once.

    Attributes
    ----------
    case : case of `ci` that is meant to catch it; the whole suite by default.
    tests : unit tests that catch it where `ci` does not.
    """

    title: str
    file: str
    old: str
    new: str
    case: str = ""
    tests: str = ""


BUGS = (
    Bug(
        "light half a pixel to the right of where it belongs",
        "sabench/simulation/rendering/particles_splatted.py",
        "_shares(pixel[i, 0], sigma[i, 0], left, right)",
        "_shares(pixel[i, 0] + 0.5, sigma[i, 0], left, right)",
    ),
    Bug(
        "x and z of a velocity field's lattice swapped",
        "sabench/algorithms/velocimetry/multipass.py",
        "np.asarray(values[::-1]) for values in (self.windows.origin",
        "np.asarray(values) for values in (self.windows.origin",
    ),
    Bug(
        "light in the fluid at the angle that it has in the glass",
        "sabench/geometry/refraction.py",
        "angle_in(self.indices, -1, slope)",
        "angle_in(self.indices, 1, slope)",
    ),
    Bug(
        "a camera's rotation transposed",
        "sabench/geometry/camera.py",
        "local = leaving @ np.asarray(self.rotation).T\n",
        "local = leaving @ np.asarray(self.rotation)\n",
    ),
    Bug(
        "planes counted from one",
        "sabench/algorithms/refocus/slabs.py",
        "depths = grid.axes_mm[2][first : first + count]",
        "depths = grid.axes_mm[2][first : first + count] + grid.voxel_mm[2]",
    ),
    Bug(
        "sign of the distortion's p1",
        "sabench/geometry/camera.py",
        "u = x * radial + 2.0 * lens.p1 * x * y",
        "u = x * radial - 2.0 * lens.p1 * x * y",
    ),
    Bug(
        "thickness of the glass forgotten in fast projection",
        "sabench/geometry/projection_kernels.py",
        "if ratios[0] > 1.0 else None,\n        before + wall.thickness_mm",
        "if ratios[0] > 1.0 else None,\n        before",
    ),
    Bug(
        "black level not subtracted",
        "sabench/images/brightness.py",
        "_scale(grey, float(black_dn), 1.0",
        "_scale(grey, 0.0, 1.0",
    ),
    Bug(
        "SMART's exponents not over the number of cameras",
        "sabench/algorithms/tomography/art_updates.py",
        "exponents /= state.seen",
        "exponents /= 1.0",
    ),
    Bug(
        "SMART's relaxation left out",
        "sabench/algorithms/tomography/art_updates.py",
        "multiply(state.values, exponents, np.float32(relaxation))",
        "multiply(state.values, exponents, np.float32(1.0))",
    ),
    Bug(
        "no median test of vectors",
        "sabench/algorithms/velocimetry/multipass.py",
        "    valid = near_the_median(peaks.shift, valid, plan.median)\n",
        "",
    ),
    Bug(
        "bubbles' diameters for radii",
        "solvers/minimum_image.py",
        "np.sqrt(kept[:, 3] * kept[:, 4])",
        "2.0 * np.sqrt(kept[:, 3] * kept[:, 4])",
    ),
    Bug(
        "degrees taken for radians",
        "sabench/scenes/nominal_cameras.py",
        "rotation_matrices(np.deg2rad(spec.turn_deg) * rng",
        "rotation_matrices(spec.turn_deg * rng",
    ),
    Bug(
        "the last camera left out where lines of sight are intersected",
        "sabench/geometry/triangulation.py",
        "zip(cameras, pixels, strict=True):\n        here, valid",
        "zip(cameras[:-1], pixels, strict=False):\n        here, valid",
    ),
    Bug(
        "Snell's law upside down on the way into the fluid",
        "sabench/geometry/refraction.py",
        "normal) * (before / after)",
        "normal) * (after / before)",
    ),
    Bug(
        "ghosts relative to all detections",
        "sabench/metrics/particle_detection.py",
        "100.0 * ghosts / self.matched if",
        "100.0 * ghosts / self.detections if",
    ),
    Bug(
        "bubbles match within their radius, not half of it",
        "sabench/metrics/bubble_detection.py",
        "_NEAR * radius_mm",
        "2.0 * _NEAR * radius_mm",
    ),
    Bug(
        "a factor 2 lost in the calibration's distortion",
        "sabench/algorithms/calibration/kernels.py",
        "p1 * (s + 2.0 * v * v) + 2.0 * p2 * u * v\n    uu",
        "p1 * (s + v * v) + 2.0 * p2 * u * v\n    uu",
    ),
    Bug(
        "quantum efficiency forgotten",
        "sabench/simulation/rendering/sensor.py",
        "mean = sensor.quantum_efficiency * photons",
        "mean = 1.0 * photons",
    ),
    Bug(
        "index of bubbles over that of the fluid upside down",
        "sabench/simulation/rendering/bubble_integrator.py",
        "self.eta = dr.opaque(mi.Float, stage.eta)",
        "self.eta = dr.opaque(mi.Float, 1.0 / stage.eta)",
    ),
    Bug(
        "planes refocused .3 px to the right",
        "sabench/algorithms/refocus/slabs.py",
        "return camera.project(plane_points(box, z_mm, unit))[0]",
        "return camera.project(plane_points(box, z_mm, unit))[0] + [0.3, 0.0]",
        case="particles",
    ),
    Bug(
        "index of the fluid off by .5 %",
        "sabench/scenes/tank.py",
        "media = (spec.air_index, layers, spec.fluid_index)",
        "media = (spec.air_index, layers, 1.005 * spec.fluid_index)",
        case="particles",
    ),
    Bug(
        "the last frame of a sequence lost",
        "sabench/metrics/trajectories.py",
        "itertools.pairwise(frames):",
        "itertools.pairwise(frames[:-1]):",
        case="tracking",
    ),
    Bug(
        "column and row swapped in one camera",
        "sabench/simulation/rendering/particle_images.py",
        "    return (\n        paths.leaving,\n        paths.arriving,\n        pixel,\n",
        "    return (\n        paths.leaving,\n        paths.arriving,\n"
        "        pixel[:, ::-1] if camera.name == 'camera_02' else pixel,\n",
        case="particles",
    ),
    Bug(
        "the automatic threshold one step too low",
        "sabench/algorithms/refocus/thresholding.py",
        "float(levels[enough[0]]) if len(enough)",
        "float(levels[max(enough[0] - 1, 0)]) if len(enough)",
        tests="tests/unit/algorithms/refocus/test_thresholding.py",
    ),
    Bug(
        "Mie's lobes rotated by a degree",
        "sabench/simulation/rendering/particle_light.py",
        "np.arccos(np.clip(-arriving @ forward, -1.0, 1.0))",
        "np.arccos(np.clip(-arriving @ forward, -1.0, 1.0)) + np.deg2rad(1.0)",
        case="particles",
    ),
    Bug(
        "two cameras share their sensor's noise",
        "sabench/simulation/frame_content.py",
        'stream(self.seed, "sensor", self.number, camera)',
        'stream(self.seed, "sensor", self.number, camera // 2)',
        tests="tests/unit/simulation/test_frame_content.py",
    ),
    Bug(
        "the sensor's noise ignores the seed",
        "sabench/simulation/frame_content.py",
        'stream(self.seed, "sensor", self.number, camera)',
        'stream(0, "sensor", self.number, camera)',
        tests="tests/unit/simulation/test_frame_content.py",
    ),
    Bug(
        "the sensor's noise is the same in all frames",
        "sabench/simulation/frame_content.py",
        'stream(self.seed, "sensor", self.number, camera)',
        'stream(self.seed, "sensor", 0, camera)',
        tests="tests/unit/simulation/test_frame_content.py",
    ),
    Bug(
        "duplicate detections are no ghosts",
        "sabench/metrics/particle_detection.py",
        "    return _counts(chosen, matched, estimate, truth, scored_estimate, scored_truth)\n",
        "    near = np.isfinite(distance) & ~np.isin(np.arange(len(distance)), chosen)\n"
        "    return _counts(chosen, matched, estimate, truth, scored_estimate & ~near, "
        "scored_truth)\n",
        tests="tests/unit/metrics/test_quality_factor.py",
    ),
    Bug(
        "links are searched for where a particle is a frame later",
        "sabench/algorithms/particles/linking.py",
        "live.velocity[old] * (time - live.time[old])[:, None]",
        "2.0 * live.velocity[old] * (time - live.time[old])[:, None]",
        case="tracking",
    ),
    Bug(
        "trajectories of the first two links swapped",
        "sabench/algorithms/particles/linking.py",
        "number[j] = live.number[i]",
        "number[j] = live.number[np.concatenate([i[:2][::-1], i[2:]])]",
        tests="tests/unit/algorithms/particles/test_linking.py",
    ),
    Bug(
        "the sign of w wrong",
        "sabench/algorithms/velocimetry/multipass.py",
        "self.shift * voxel / interval_s,",
        "self.shift * voxel * [1.0, 1.0, -1.0] / interval_s,",
        tests="tests/unit/algorithms/velocimetry/test_windows.py",
    ),
    Bug(
        "Snell's law upside down at a cylinder",
        "sabench/geometry/cylinder_kernels.py",
        "if _cross(faces[m], indices[m] / indices[m + 1], at",
        "if _cross(faces[m], indices[m + 1] / indices[m], at",
        tests="tests/unit/geometry/test_cylinder_wall.py",
    ),
    Bug(
        "all cameras behind the first face of a tank",
        "sabench/scenes/tank.py",
        "return walls[int(np.argmax(entered))]",
        "return walls[0]",
        tests="tests/unit/scenes/test_tank.py",
    ),
    Bug(
        "bubbles' radii drawn as diameters",
        "sabench/worlds/library/size_distributions.py",
        "out[left] = spectrum.radius_mm * np.exp(",
        "out[left] = 0.5 * spectrum.radius_mm * np.exp(",
        case="bubbles",
    ),
    Bug(
        "the gain applied twice",
        "sabench/simulation/rendering/sensor.py",
        "electrons *= sensor.gain_dn_e",
        "electrons *= sensor.gain_dn_e**2",
        case="particles",
    ),
    Bug(
        "the read noise's variance for its standard deviation",
        "sabench/simulation/rendering/sensor.py",
        "sensor.read_noise_e * rng.standard_normal",
        "sensor.read_noise_e**2 * rng.standard_normal",
        case="particles",
    ),
    Bug(
        "the same particles enter in every frame",
        "sabench/worlds/tracers.py",
        'stream(self.seed, "entering", frame)',
        'stream(self.seed, "entering", 1)',
        case="tracking",
    ),
    Bug(
        "the distance of matched particles without z",
        "sabench/metrics/particle_detection.py",
        "    offset = estimate[a[inside]] - truth[b[inside]]\n",
        "    offset = (estimate[a[inside]] - truth[b[inside]])[:, :2]\n",
        case="particles",
    ),
    Bug(
        "effectiveness counts particles of one frame",
        "sabench/metrics/trajectories.py",
        "(most / frames)[frames > 1]",
        "(most / frames)[frames > 0]",
        case="tracking",
    ),
    Bug(
        "the optical axis at half the columns",
        "sabench/scenes/build.py",
        "principal_point_px=((spec.columns - 1) / 2.0,",
        "principal_point_px=(spec.columns / 2.0,",
        case="particles",
    ),
    Bug(
        "hot pixels are not looked for",
        "sabench/images/repair.py",
        "points[:] = find_points(grey, black_dn)",
        "points[:] = False",
        tests="tests/unit/images/test_repair.py",
    ),
    Bug(
        "the brightest pixel alone sets the brightness scale",
        "sabench/images/brightness.py",
        "min(levels[-1], _PEAKS * peak) if peak else levels[-1]",
        "levels[-1]",
        tests="tests/unit/images/test_repair.py",
    ),
    Bug(
        "two cameras share their sensor's pattern",
        "sabench/simulation/grey_values.py",
        'stream(frame.seed, "sensor pattern", camera)',
        'stream(frame.seed, "sensor pattern", camera // 2)',
        tests="tests/unit/simulation/test_grey_values.py",
    ),
)


def main() -> None:
    """Run bugs and reruns, and print both tables."""
    parser = argparse.ArgumentParser(description="planted bugs and honest reruns of the gate")
    parser.add_argument("--bugs", type=int, default=len(BUGS), help="how many of the planted bugs")
    parser.add_argument("--skip", type=int, default=0, help="how many of them to pass over")
    parser.add_argument("--reruns", type=int, default=50, help="how many honest reruns")
    parser.add_argument("--baseline", type=Path, default=ROOT / "leaderboard/baselines/ci.json")
    parser.add_argument("--narrow", action="store_true", help="only what is to catch each bug")
    asked = parser.parse_args()
    chosen = BUGS[asked.skip :][: asked.bugs]
    with tempfile.TemporaryDirectory(prefix="sabench-gate-") as folder:
        pristine = copy_tree(ROOT, Path(folder) / "pristine")
        caught = [
            plant_bug(bug, pristine, Path(folder) / "planted", asked.baseline, asked.narrow)
            for bug in chosen
        ]
        silent = [
            honest(number, pristine, Path(folder), asked.baseline) for number in range(asked.reruns)
        ]
    print(
        f"{sum(caught)} of {len(caught)} planted bugs caught, "
        f"{sum(silent)} of {len(silent)} honest reruns silent"
    )
    sys.exit(not all(caught + silent))


def copy_tree(source: Path, target: Path) -> Path:
    """Copy the parts of a source tree that a check needs, and compiled kernels."""
    for name in _COPIED:
        if (source / name).is_dir():
            shutil.copytree(source / name, target / name)
        else:
            shutil.copy2(source / name, target / name)
    return target


def plant_bug(bug: Bug, pristine: Path, tree: Path, baseline: Path, narrow: bool) -> bool:
    """Check a copy with the bug; returns whether the gate or its tests caught it."""
    text = (pristine / bug.file).read_text(encoding="utf-8")
    if text.count(bug.old) != 1:
        print(
            f"{bug.file}: {bug.title}: expected the text once, "
            f"got it {text.count(bug.old)} times: {bug.old!r}",
            flush=True,
        )
        return False
    copy_tree(pristine, tree)
    (tree / bug.file).write_text(text.replace(bug.old, bug.new), encoding="utf-8")
    if "njit" in text:
        forget(tree, bug.file)
    caught = False
    if not (narrow and bug.tests):
        suite, figures = select_case(tree, baseline, bug.case) if narrow else ("ci", baseline)
        caught = is_alarmed(bug, tree, figures, suite)
    if not caught and bug.tests:
        caught = is_tested(bug, tree)
    shutil.rmtree(tree)
    return caught


def select_case(tree: Path, baseline: Path, case: str) -> tuple[str, Path]:
    """Write a suite of one case of `ci`, and its baseline; all cases if it is empty."""
    if not case:
        return "ci", baseline
    suite = tomllib.loads((tree / "scenes/suites/ci.toml").read_text(encoding="utf-8"))
    suite["cases"] = [one for one in suite["cases"] if one["name"] == case]
    figures = json.loads(baseline.read_text(encoding="utf-8"))
    figures["cases"] = [one for one in figures["cases"] if one["case"] == case]
    folder = tree / "narrow"
    folder.mkdir()
    (folder / "ci.toml").write_text(tomli_w.dumps(suite), encoding="utf-8")
    (folder / "ci.json").write_text(json.dumps(figures), encoding="utf-8")
    return "narrow/ci.toml", folder / "ci.json"


def is_alarmed(bug: Bug, tree: Path, baseline: Path, suite: str) -> bool:
    """Run the gate on a copy with a bug; print what it says first."""
    code, seconds, found = check(tree, baseline, suite)
    first = found["worse"][0] if found["worse"] else {}
    by = (
        f"{first['case']}, {first['solver']}: {first['text'] or first['figure']}"
        if first
        else "nothing"
    )
    was = (
        f" {first['before']:.5g} -> {first['now']:.5g}"
        if first and first["before"] is not None and first["now"] is not None
        else ""
    )
    print(
        f"{'caught' if code == 1 else 'MISSED'}  {seconds:4.0f} s  {bug.title} | {by}{was} | "
        f"{len(found['worse'])} figures",
        flush=True,
    )
    return code == 1


def is_tested(bug: Bug, tree: Path) -> bool:
    """Run the tests of a bug on a copy with it; print the first that fails."""
    start = time.perf_counter()
    words = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", bug.tests]
    environment = os.environ | {"PYTHONPATH": str(tree)}
    done = subprocess.run(
        words, cwd=tree, env=environment, capture_output=True, text=True, check=False
    )
    failed = next((line for line in done.stdout.splitlines() if line.startswith("FAILED")), "")
    print(
        f"{'caught' if failed else 'MISSED'}  {time.perf_counter() - start:4.0f} s  {bug.title} | "
        f"{failed.partition(' - ')[0] or done.stdout[-500:]}",
        flush=True,
    )
    return bool(failed)


def honest(number: int, tree: Path, folder: Path, baseline: Path) -> bool:
    """Check the copy as it is; returns whether it was silent."""
    code, seconds, found = check(tree, baseline)
    said = "; ".join(
        f"{one['case']}, {one['solver']}: {one['text'] or one['figure']} "
        f"{one['before']} -> {one['now']}"
        for one in found["worse"]
    )
    print(
        f"{'silent' if code == 0 else 'FAILED'}  {seconds:4.0f} s  rerun {number + 1} {said}",
        flush=True,
    )
    return code == 0


def check(tree: Path, baseline: Path, suite: str = "ci") -> tuple[int, float, dict[str, Any]]:
    """Run `sabench check` in a source tree: exit code, seconds, findings."""
    start = time.perf_counter()
    words = [
        sys.executable,
        "-m",
        "sabench",
        "check",
        suite,
        "--baseline",
        str(baseline.resolve()),
        "--json",
        "--exit-first",
    ]
    done = subprocess.run(
        words,
        cwd=tree,
        env=os.environ | {"PYTHONPATH": str(tree)},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode not in (0, 1) or not done.stdout:
        print(f"exit code {done.returncode}: {done.stderr[-500:]}", flush=True)
        return done.returncode, time.perf_counter() - start, {"worse": []}
    return done.returncode, time.perf_counter() - start, json.loads(done.stdout.splitlines()[-1])


def forget(tree: Path, changed: str) -> None:
    """Remove the compiled kernels of a changed file and of its importers.

    Importers are all files with kernels that import it, directly or through others with kernels.
    """
    files = {
        path: path.read_text(encoding="utf-8")
        for path in (
            *tree.rglob("sabench/**/*.py"),
            *tree.glob("solvers/*.py"),
            *tree.glob("generators/*.py"),
        )
    }
    files = {
        path: text for path, text in files.items() if "njit" in text or path.name == "__init__.py"
    }
    stale, waiting = {tree / changed}, [tree / changed]
    while waiting:
        one = waiting.pop()
        module = (
            one.relative_to(tree)
            .with_suffix("")
            .as_posix()
            .removesuffix("/__init__")
            .replace("/", ".")
        )
        parent, _, name = module.rpartition(".")
        imports = re.compile(
            rf"(from|import) {re.escape(module)}\b|from {re.escape(parent)} import [^\n]*\b{name}\b"
        )
        fresh = [path for path, text in files.items() if path not in stale and imports.search(text)]
        stale.update(fresh)
        waiting += fresh
    for path in stale:
        for entry in (
            *path.parent.glob(f"__pycache__/{path.stem}.*.nbi"),
            *path.parent.glob(f"__pycache__/{path.stem}.*.nbc"),
        ):
            entry.unlink()


if __name__ == "__main__":
    main()
