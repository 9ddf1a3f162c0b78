"""Small cases on which `ablation.py` judges rules of solvers of bubbles.

`rms_px` is the median distance of found bubbles and true ones, over the views, and of their radii.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from sabench.api import Camera, Observation
from sabench.api.make import make_algorithm
from sabench.api.truth import Bubbles
from sabench.metrics.bubble_detection import match_bubbles
from sabench.scenes import build_rig
from sabench.simulation.frames import Frames
from sabench.simulation.in_memory import observation_of, record_frame
from sabench.utils.arrays import F64
from tests.helpers.bubble_scenes import LASER, small

Shown = tuple[Observation, Bubbles]
Grey = Callable[[F64, np.random.Generator], F64]
Case = tuple[Callable[[int], Shown], Callable[[Shown], dict[str, float]]]

# spread of radii within which most bubbles of a case are
_SIZES = {"generator": "bubble_field", "radius_spread": 0.3}
_SENSOR = {"full_well_e": 20000.0, "gain_dn_e": 0.2, "bit_depth": 12, "exposure_s": 1e-4}
_BODY: dict[str, Any] = {
    "backlight": {"center_mm": [0.0, 0.0, 400.0], "size_mm": [260.0, 260.0], "exposure": 0.12},
    "illumination": LASER | {"pulse_energy_mj": 0.5, "scattering": "isotropic"},
    "particles": {"generator": "uniform", "count": 40, "diameter_mm": 0.05},
    "bubbles": {
        "generator": "bubble_field",
        "count": 12,
        "radius_mm": 0.8,
        "radius_range_mm": [0.5, 1.6],
        "low_mm": [-4.0, -9.0, 52.0],
        "high_mm": [12.0, 9.0, 68.0],
    },
    "solids": [
        {
            "generator": "cylinder",
            "radius_mm": 3.0,
            "length_mm": 12.0,
            "place_mm": [-8.5, 0.0, 60.0],
            "material": {"reflectance": 0.03},
        }
    ],
}


def shows(
    count: int,
    smallest_mm: float = 0.5,
    largest_mm: float = 1.6,
    flattest: float = 1.0,
    grey: Grey = lambda grey, rng: grey,
    white_dn: float | None = None,
    **tables: Any,
) -> Callable[[int], Shown]:
    """Make a case of one frame of five cameras.

    Parameters
    ----------
    flattest : least short over long axis.
    grey : what is done to the grey values of 12 bits.
    white_dn : of the result.
    tables : of the scene.
    """

    def make(seed: int) -> Shown:
        bubbles = _SIZES | {
            "count": count,
            "radius_mm": (smallest_mm * largest_mm) ** 0.5,
            "radius_range_mm": [smallest_mm, largest_mm],
            "aspect_range": [flattest, 1.0],
            "tilt_deg": 20.0 if flattest < 1.0 else 0.0,
        }
        changes = {"bubbles": bubbles, "sensor": _SENSOR | {"read_noise_e": 10.0}} | tables
        scene = small(**changes)
        frame = Frames(scene, build_rig(scene), seed).at(0)
        seen = observation_of(frame, record_frame(frame)[0])
        rng, white = np.random.default_rng(seed), white_dn or seen.white_dn
        images = np.clip(np.rint(grey(seen.images.astype(np.float64), rng)), 0, white)
        assert frame.bubbles is not None
        return replace(seen, images=images.astype(np.uint16), white_dn=white), frame.bubbles

    return make


def eight_bits(grey: F64, rng: np.random.Generator) -> F64:
    """Show a dim diffuser of 40 grey values above a black level of 10, with noise of 2."""
    return 10.0 + grey * (40.0 / 2800.0) + 2.0 * rng.standard_normal(grey.shape)


def noisy(grey: F64, rng: np.random.Generator) -> F64:
    """Add a tenth of the diffuser's light as noise."""
    return np.asarray(grey + 280.0 * rng.standard_normal(grey.shape))


def uneven(grey: F64, rng: np.random.Generator) -> F64:
    """Dim the diffuser towards a corner, to a quarter."""
    down, right = np.mgrid[: grey.shape[1], : grey.shape[2]]
    far = down / grey.shape[1] + right / grey.shape[2]
    return np.asarray(grey * (1.0 - 0.375 * far))


def found_by(name: str, **parameters: Any) -> Callable[[Shown], dict[str, float]]:
    """Score a solver's bubbles."""

    def score(shown: Shown) -> dict[str, float]:
        seen, true = shown
        solver: Any = make_algorithm(name, parameters)
        found = solver.solve(seen)
        i, j = match_bubbles(found.center_mm, true.center_mm, true.radius_mm)
        cameras = [camera for camera in seen.cameras if isinstance(camera, Camera)]
        figures = {
            "f1": 2.0 * len(i) / max(len(found.center_mm) + len(true.center_mm), 1),
            "true": float(len(true.center_mm)),
        }
        if len(i):
            apart = [
                np.linalg.norm(camera.project(found.center_mm[i])[0] - pixels, axis=1)
                for camera in cameras
                for pixels in [camera.project(true.center_mm[j])[0]]
            ]
            middle = true.center_mm.mean(axis=0)
            ends = cameras[0].project(middle + np.array([[0.0] * 3, [1.0, 0.0, 0.0]]))[0]
            larger = np.abs(found.radius_mm[i] - true.radius_mm[j]) * np.ptp(ends[:, 0])
            figures["rms_px"] = float(np.median(np.hypot(np.mean(apart, axis=0), larger)))
        return figures

    return score


_FIT = found_by("rim_fit")
_LIT = found_by("rim_fit", diffuser_deg=15.5)  # the search for the angle takes most of the time
BUBBLES: dict[str, Case] = {
    "few": (shows(8), _FIT),
    "many": (shows(60, 0.4, 1.2), _LIT),
    "small": (shows(40, 0.25, 0.5), _LIT),
    "large": (shows(6, 2.0, 3.5), _LIT),
    "overlapping": (shows(90, 0.4, 1.6), _LIT),
    "flat": (shows(30, 0.6, 1.6, 0.5), _LIT),
    "8 bits, dim": (shows(30, grey=eight_bits, white_dn=255.0), _LIT),
    "noisy": (shows(30, grey=noisy), _LIT),
    "uneven": (shows(30, grey=uneven), _LIT),
    "three phases": (shows(12, **_BODY), found_by("separated_bubbles")),
    "minimum image": (shows(24), found_by("minimum_image")),
    "local feature": (shows(24), found_by("local_feature")),
}
