"""Small cases on which `ablation.py` judges rules: of particles, tracks, targets and bubbles.

A case makes what a solver sees and the truth of it, once for each seed: `work/ablation` keeps
them, so that a rule that simulation uses, too, changes the solver's side only. Then it scores a
solver: each figure is better the larger it is, but `rms_px` and `cpu_s`.
"""

import pickle
import time
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from benchmarks.ablation_bubbles import BUBBLES
from benchmarks.ablation_calibration import CALIBRATION
from benchmarks.ablation_rules import ROOT
from benchmarks.particle_scores import score_particles
from sabench.api import Camera, ImageSequence
from sabench.api.make import make_algorithm
from sabench.evaluation.suite_loading import load_suite
from sabench.evaluation.suites import SceneCase
from sabench.images.dark_noise import measure_dark_noise
from sabench.scenes import find, parse_scene
from sabench.simulation.in_memory import Shot, simulate, simulate_sequence
from sabench.utils.arrays import F64, U16

FOLDER = ROOT / "work" / "ablation"
_EQUAL = {"scattering": "isotropic", "pulse_energy_mj": 6.5}
_DISC = [{"center_mm": [-72.5, -79.0, -400.0], "radius_mm": 6.0}]
_POST = {"generator": "cylinder", "radius_mm": 0.8, "length_mm": 3.0, "place_mm": [0.0] * 3}
_LAMPS = {"lamps": [{"center_mm": [0.0, -300.0, -600.0]}], "exposure": 0.005}
_CLEAN = {"shot_noise": False, "read_noise_e": 0.0, "dark_current_e_s": 0.0, "gain_dn_e": 1.0}

NOWHERE_PX = 9.0  # RMS distance where nothing is found

Truth = list[Shot] | U16


@dataclass(frozen=True)
class Case:
    """Images and truth of a seed, and the score of a solver on them."""

    make: Callable[[int], Any]
    score: Callable[[Any], dict[str, float]]


def small_scene(per_pixel: float, **changes: Any) -> Any:
    """Change the standard scene to 120 x 140 pixels of four cameras with equal light."""
    values = tomllib.loads(find("standard-particles", "scenes").read_text(encoding="utf-8"))
    values["volume"]["size_mm"], values["grid"]["crop_mm"] = [7.0, 6.0, 5.0], [0.8, 0.8, 0.3]
    values["cameras"] |= {"rows": 120, "columns": 140}
    values["cameras"]["layout"] |= {"columns": 2, "rows": 2}
    values["illumination"] |= _EQUAL
    values["particles"]["per_pixel"] = per_pixel
    return parse_scene(_changed(values, changes), "small")


def realistic_scene(per_pixel: float, across: int = 2) -> Any:
    """Change the realistic scene to 120 x 160 pixels of so many cameras across and down."""
    values = tomllib.loads(find("realistic-particles", "scenes").read_text(encoding="utf-8"))
    values["volume"]["size_mm"], values["grid"]["crop_mm"] = [8.0, 6.0, 5.0], [0.8, 0.8, 0.3]
    values["cameras"] |= {"rows": 120, "columns": 160}
    values["cameras"]["layout"] |= {"columns": across, "rows": across}
    values["particles"]["per_pixel"] = per_pixel
    return parse_scene(values, "realistic")


def _changed(values: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    for key, update in changes.items():
        merge = isinstance(update, dict) and key in values
        values[key] = _changed(values[key], update) if merge else update
    return values


def one(scene: Callable[[], Any]) -> Callable[[int], Truth]:
    """Make a case of one frame of a scene."""
    return lambda seed: [simulate(scene(), seed=seed)]


def plain(per_pixel: float, **changes: Any) -> Callable[[int], Truth]:
    """Make a case of one frame of the small scene, with changes."""
    return one(lambda: small_scene(per_pixel, **changes))


def of_suite(name: str) -> Callable[[int], Truth]:
    """Make a case of suite `particles` in its whole size: small images do not show everything."""
    cases = [case for case in load_suite("particles")[1] if isinstance(case, SceneCase)]
    scenes = {case.name: case.scene for case in cases}
    return one(lambda: scenes[name])


def discs(per_pixel: float, radius_px: float) -> Callable[[int], Truth]:
    """Make a case of particles far out of focus: their images are discs."""

    def make(seed: int) -> Truth:
        shot = simulate(small_scene(per_pixel), seed=seed)
        grey = shot.observation.images
        steps = np.mgrid[-4:5, -4:5].reshape(2, -1).T
        steps = steps[np.hypot(*steps.T) <= radius_px]
        blurred = np.mean([np.roll(grey, step, (1, 2)) for step in steps], axis=0)
        noisy = blurred + 2.0 * np.random.default_rng(seed).standard_normal(grey.shape)
        images = np.clip(np.rint(noisy), 0, 65535).astype(np.uint16)
        return [replace(shot, observation=replace(shot.observation, images=images))]

    return make


def eight_bits(
    background: Callable[[np.random.Generator, tuple[int, ...]], F64],
    take_away: Callable[[F64, F64, float], F64] = lambda grey, known, noise: grey,
) -> Callable[[int], Truth]:
    """Make a case of dim particles in 8 bits, as a stranger brings them: black 0, white 255.

    Peaks are some 8 to 32 grey values above a background whose noise is 1.3 to 1.8: five deviations
    or more. `take_away` (grey, true background, noise) is what their owner did.
    """

    def make(seed: int) -> Truth:
        rng = np.random.default_rng(seed)
        shot = simulate(
            small_scene(0.02, sensor=_CLEAN, particles={"diameter_spread": 0.15}), seed=seed
        )
        light = shot.observation.images - shot.observation.black_dn
        peaks = light[(light == maximum_filter(light, (1, 5, 5))) & (light > 0.05 * light.max())]
        light *= 16.0 / np.median(peaks)
        level = np.stack([background(rng, image.shape) for image in light])
        noise = np.sqrt(1.0 + 0.03 * (light + level))
        grey = np.rint(light + level + noise * rng.standard_normal(light.shape))
        grey = np.clip(np.rint(take_away(grey, level, 1.5)), 0, 255).astype(np.uint16)
        return [
            replace(
                shot,
                observation=replace(shot.observation, images=grey, black_dn=0.0, white_dn=255.0),
            )
        ]

    return make


def smooth(rng: np.random.Generator, shape: tuple[int, ...]) -> F64:
    """Draw a background of 20 to 45 grey values that changes slowly."""
    rough = gaussian_filter(rng.standard_normal(shape), 30.0)
    return np.asarray(20.0 + 25.0 * (rough - rough.min()) / np.ptp(rough))


def structured(rng: np.random.Generator, shape: tuple[int, ...]) -> F64:
    """Draw a background with edges: a bar, and blotches a few pixels wide."""
    blotches = gaussian_filter(rng.standard_normal(shape), 6.0)
    out = 22.0 + 6.0 * blotches / blotches.std() * 0.5
    column = int(rng.integers(20, shape[1] - 40))
    out[:, column : column + 15] += 15.0
    return np.asarray(np.maximum(out, 5.0))


def cut(share: float) -> Callable[[F64, F64, float], F64]:
    """Subtract the background and so many deviations of noise, and cut at 0."""
    return lambda grey, known, noise: np.maximum(grey - known - share * noise, 0.0)


def sliding(grey: F64, known: F64, noise: float) -> F64:
    """Subtract a sliding minimum of 25 x 25 pixels."""
    return np.asarray(grey - minimum_filter(grey, (1, 25, 25)))


def tracked() -> Callable[[int], Truth]:
    """Make six frames of the tracking scene with half of its edge and more particles."""

    def make(seed: int) -> Truth:
        values = tomllib.loads(find("particle-tracking", "scenes").read_text(encoding="utf-8"))
        values |= {"frames": 6}
        values["volume"]["size_mm"] = [7.0, 7.0, 4.0]
        values["cameras"] |= {"rows": 140, "columns": 140}
        values["particles"]["per_pixel"] = 0.04
        return list(simulate_sequence(parse_scene(values, "tracks"), seed=seed))

    return make


def found_by(name: str, **parameters: Any) -> Callable[[Truth], dict[str, float]]:
    """Score a solver's particles; over time, the mean of the second half of the frames."""

    def score(truth: Truth) -> dict[str, float]:
        assert isinstance(truth, list)
        solver: Any = make_algorithm(name, parameters)
        interval = 0.01 if len(truth) > 1 else None
        frames = [shot.observation for shot in truth]
        case = ImageSequence.of(frames, interval) if interval else ImageSequence.of(frames)
        found = list(solver.solve(case))
        rows = [
            score_particles(
                each, shot, [c for c in shot.observation.cameras if isinstance(c, Camera)], None
            )
            for each, shot in zip(found, truth, strict=True)
        ][len(truth) // 2 :]
        names = ("f1", "recall", "ghosts", "rms_px", "true")
        rows = [row | {"rms_px": row["rms_px"] or NOWHERE_PX} for row in rows]
        return {key: float(np.mean([row[key] for row in rows])) for key in names}

    return score


def noise_images(kind: str) -> Callable[[int], Truth]:
    """Make four images of noise alone, of a kind."""

    def make(seed: int) -> Truth:
        rng = np.random.default_rng(seed)
        shape = (4, 256, 256)
        level = 30.0 + smooth(rng, shape[1:]) * (kind == "uneven")
        grey = level + 2.0 * rng.standard_normal(shape)
        if kind == "cut":
            grey = np.maximum(np.rint(grey) - level, 0.0)
        if kind == "cut hard":
            grey = np.maximum(np.rint(grey) - level - 2.0, 0.0)
        if kind == "photons":
            grey = 20.0 + 2.0 * rng.poisson(3.0, shape) + rng.standard_normal(shape)
        return np.clip(np.rint(grey), 0, 4095).astype(np.uint16)

    return make


def false_alarms(truth: Truth) -> dict[str, float]:
    """Compare the pixels above the threshold with the stated share, 1e-3.

    The figure is 1 where they agree, 0.5 where they are off by a factor of two, either way.
    """
    assert isinstance(truth, np.ndarray)
    limit = measure_dark_noise(truth).threshold(1e-3)
    share = max(float((truth > limit).mean()), 1e-6)
    return {"f1": min(share / 1e-3, 1e-3 / share)}


_BAYES, _RAYS = found_by("bayesian_ipr"), found_by("ray_triangulation")
PARTICLES = {
    "bright": Case(plain(0.05), _BAYES),
    "dense": Case(plain(0.11), _BAYES),
    "thin": Case(plain(0.004), _BAYES),
    "realistic": Case(one(lambda: realistic_scene(0.03)), _BAYES),
    "realistic, thin": Case(one(lambda: realistic_scene(0.003)), _BAYES),
    "realistic, hardly any": Case(one(lambda: realistic_scene(0.001, across=3)), _BAYES),
    "crowded": Case(plain(0.15), _BAYES),
    "crowded, light differs": Case(plain(0.1, particles={"diameter_spread": 0.3}), _BAYES),
    "faint": Case(
        plain(
            0.02,
            illumination={"scattering": "mie", "pulse_energy_mj": 22.0},
            cameras={"layout": {"columns": 3, "rows": 3}},
        ),
        _BAYES,
    ),
    "light differs": Case(
        plain(
            0.04,
            illumination={
                "scattering": "mie",
                "pulse_energy_mj": 220.0,
                "direction": [0.8, 0.6, 0.0],
            },
        ),
        _BAYES,
    ),
    "cameras off": Case(plain(0.04, calibration={"shift_px": 0.3}), _BAYES),
    "many cameras": Case(plain(0.1, cameras={"layout": {"columns": 3, "rows": 3}}), _BAYES),
    "hidden area": Case(plain(0.05, occluders=_DISC), _BAYES),
    "behind a post": Case(
        plain(0.04, solids=[_POST | {"material": {"reflectance": 0.05}}], lighting=_LAMPS), _BAYES
    ),
    "lit body": Case(plain(0.02, solids=[_POST], lighting=_LAMPS | {"exposure": 0.02}), _BAYES),
    "out of focus": Case(plain(0.02, cameras={"f_number": 4.0, "pixel_mm": 0.01}), _BAYES),
    "discs": Case(discs(0.02, 2.5), _BAYES),
    "flawed pixels": Case(plain(0.04, sensor={"hot_pixels": 0.001, "dead_pixels": 0.001}), _BAYES),
    "narrow images": Case(
        plain(
            0.04,
            cameras={"pixel_mm": 0.02, "f_number": 11.0},
            volume={"size_mm": [14.0, 12.0, 2.0]},
            grid={"crop_mm": [2.0, 2.0, 0.0]},
        ),
        _BAYES,
    ),
    "noise, whole images": Case(of_suite("noise"), _BAYES),
    "realistic, nine cameras": Case(of_suite("realistic"), _BAYES),
    "dim 8 bits": Case(eight_bits(smooth), _BAYES),
    "8 bits, sliding minimum": Case(eight_bits(smooth, sliding), _BAYES),
    "8 bits, cut": Case(eight_bits(smooth, cut(0.0)), _BAYES),
    "8 bits, cut hard": Case(eight_bits(smooth, cut(1.0)), _BAYES),
    "structured": Case(eight_bits(structured), _BAYES),
    "rays": Case(plain(0.01), _RAYS),
    "rays, realistic": Case(one(lambda: realistic_scene(0.01)), _RAYS),
    "rays, 8 bits cut": Case(eight_bits(smooth, cut(0.0)), _RAYS),
    "rays, structured": Case(eight_bits(structured), _RAYS),
    "over time": Case(tracked(), found_by("shake_the_box")),
    **{
        f"noise, {kind}": Case(noise_images(kind), false_alarms)
        for kind in ("even", "uneven", "photons", "cut", "cut hard")
    },
}
CASES: dict[str, dict[str, Case]] = {
    "algorithms/particles": PARTICLES,
    "images": PARTICLES,
    "algorithms/calibration": {name: Case(*case) for name, case in CALIBRATION.items()},
    "algorithms/bubbles": {name: Case(*case) for name, case in BUBBLES.items()},
}


def run(room: str, name: str, seed: int) -> dict[str, float]:
    """Score a case of a room for a seed, with the CPU seconds of the solver."""
    case, path = CASES[room][name], FOLDER / f"{name}-{seed}.pickle"
    if not path.exists():
        FOLDER.mkdir(parents=True, exist_ok=True)
        path.with_suffix(".tmp").write_bytes(pickle.dumps(case.make(seed)))
        path.with_suffix(".tmp").replace(path)
    truth = pickle.loads(path.read_bytes())
    start = time.process_time()
    figures = case.score(truth)
    return figures | {"cpu_s": time.process_time() - start}
