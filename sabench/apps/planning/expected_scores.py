"""Expected scores of solvers: a Gaussian process fitted to measured scenes.

`benchmarks/planner.py` measures the scenes, fits the model and writes `expected_scores.json`: the
figures and scores of the scenes, and the lengths over which scores change. The figures of density
are those of `plan_density`: particles per pixel, overlap and ghosts.

Source: Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), sections 2.2 and
5.4.1.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sabench.apps.planning.optics import ParticleSample
from sabench.apps.planning.viewing import Advice, Quantity, Section, Viewing
from sabench.metrics.particle_detection import ghost_ratio
from sabench.scenes import Scene
from sabench.utils.arrays import F64


@dataclass(frozen=True)
class Kernel:
    """Squared exponential with one length per feature, plus a linear part.

    Attributes
    ----------
    lengths : (feature,).
    amplitude, slope, noise : standard deviations of the two parts, and of the values' noise.
    """

    lengths: F64
    amplitude: float
    slope: float
    noise: float

    def __call__(self, points: F64, other: F64) -> F64:
        """Compute covariances (n, m) of points (n, feature) and (m, feature)."""
        apart = (points[:, None] - other[None]) / self.lengths
        near = self.amplitude**2 * np.exp(-0.5 * np.sum(apart**2, axis=2))
        return np.asarray(near + self.slope**2 * (1.0 + points @ other.T))


@dataclass(frozen=True)
class GaussianProcess:
    """Values (n,) measured at points (n, feature), and the kernel that joins them."""

    points: F64
    values: F64
    kernel: Kernel

    @cached_property
    def _inverse(self) -> F64:
        """Inverse covariance (n, n) of the measured values."""
        covariance = self.kernel(self.points, self.points)
        covariance[np.diag_indices_from(covariance)] += self.kernel.noise**2
        return np.asarray(np.linalg.inv(covariance))

    @cached_property
    def _weights(self) -> F64:
        return np.asarray(self._inverse @ (self.values - self.values.mean()))

    def predict(self, points: F64) -> tuple[F64, F64]:
        """Predict means and deviations (m,) of new values at points (m, feature).

        Equations 2.25 and 2.26.
        """
        across = self.kernel(points, self.points)
        prior = np.array([self.kernel(point[None], point[None])[0, 0] for point in points])
        explained = np.einsum("ij,jk,ik->i", across, self._inverse, across)
        variance = np.maximum(prior + self.kernel.noise**2 - explained, 0.0)
        return self.values.mean() + across @ self._weights, np.sqrt(variance)

    def left_out(self) -> F64:
        """Predict each value (n,) from all others.

        Equation 5.12.
        """
        return np.asarray(self.values - self._weights / np.diag(self._inverse))

    def surprise(self) -> float:
        """Compute the negative logarithm of the values' likelihood, without its constant.

        Equation 2.30.
        """
        sign, determinant = np.linalg.slogdet(self._inverse)
        if sign <= 0.0 or not np.isfinite(determinant):
            return float("inf")
        centred = self.values - self.values.mean()
        return float(0.5 * centred @ self._weights - 0.5 * determinant)


_NEIGHBOUR = 0.55396  # mean distance of the nearest neighbour x (number density)^(1/3)
_MOST_COVERED = 0.5  # share of the images
_DENSITIES = ("per_pixel", "per_mm3", "count")


def plan_density(scene: Scene, view: Viewing, sample: ParticleSample) -> Section:
    """Compute particles per pixel, covered pixels and the ghosts of equation 3.14."""
    cameras, count = view.rig.cameras, len(sample.particles)
    per_mm3 = count / math.prod(scene.volume.size_mm)
    pixels = float(np.mean([camera.rows * camera.columns for camera in cameras]))
    per_pixel = sample.visible_share * count / pixels
    with np.errstate(divide="ignore"):  # a line of sight along an edge leaves no other face
        path_mm = np.min(np.asarray(scene.volume.size_mm) / np.abs(view.directions), axis=1)
    densest = per_mm3 * float(np.nanmean(path_mm * view.pixels_mm**2))
    area = math.pi / 4.0 * sample.diameter_px**2
    planes = view.rig.grid.shape[2 - view.axis]
    ghosts = ghost_ratio(densest, len(cameras), area, planes)
    covered = 1.0 - math.exp(-densest * area)
    quantities = (
        Quantity("particles", count, "particles in the volume", "scene"),
        Quantity("per_mm3", per_mm3, "their number density C, 1/mm3", "scene"),
        Quantity(
            "neighbour_mm",
            _NEIGHBOUR * per_mm3 ** (-1 / 3) if count else None,
            _NEAREST,
            "0.554 C^(-1/3)",
        ),
        Quantity("ppp", per_pixel, "particles per pixel of an image", "projected"),
        Quantity("ppp_center", densest, "particles per pixel at the images' middle", "C Z_o dX^2"),
        Quantity("source_density", densest * area, "particles per image area there", "ppp A_p"),
        Quantity("covered_share", covered, "share of pixels covered there", "1 - exp(-ppp A_p)"),
        Quantity("ghosts_per_particle", ghosts, "lit voxels; an upper limit", "(3.14)"),
    )
    advice = []
    if covered > _MOST_COVERED:
        key = density_key(scene)
        advice.append(
            Advice(
                key,
                f"images cover {covered:.0%} of the pixels at the middle: reduce {key} by a factor "
                f"of {densest * area / -math.log(1.0 - _MOST_COVERED):.3g}, or volume.size_mm",
            )
        )
    return Section("density", quantities, tuple(advice))


_NEAREST = "mean distance of nearest neighbours"


def density_key(scene: Scene) -> str:
    """Name the key that sets the number of particles."""
    given = scene.particle_world.particles
    return "particles." + next((key for key in _DENSITIES if key in given), "generator")


MODEL = Path(__file__).with_name("expected_scores.json")
GHOST_FLOOR = 0.01  # ghosts per particle that count as none
_COST = 0.02  # of Q
EDGE = 0.05  # relative: so little outside of the range is inside
_LEAST = 0.005  # distance of scores from 0 and 1 for the logit

_Values = Mapping[str, float]


class Feature(NamedTuple):
    """Figure of a plan that scores depend on."""

    value: Callable[[_Values], float]
    logarithmic: bool = True


FEATURES: dict[str, Feature] = {
    "cameras": Feature(lambda v: v["cameras"]),
    "ppp_center": Feature(lambda v: v["ppp_center"]),
    "image_px": Feature(lambda v: v["image_px"]),
    "peak_snr": Feature(lambda v: v["peak_snr"]),
    "elongation": Feature(lambda v: v["elongation"]),
    "depth in pixels": Feature(lambda v: v["depth_mm"] / v["pixel_center_mm"]),
    "voxel_length": Feature(lambda v: v["voxel_length"]),
    "coarsest / inner pixel": Feature(lambda v: v["pixel_coarsest_mm"] / v["pixel_center_mm"]),
    "light_scatter": Feature(lambda v: v["light_scatter"], False),
    "light_spread": Feature(lambda v: v["light_spread"], False),
    "(calibration_px / image_px)^2": Feature(
        lambda v: (v["calibration_px"] / v["image_px"]) ** 2, False
    ),
}
_IMAGE = list(FEATURES).index("image_px")
_CALIBRATION = list(FEATURES).index("(calibration_px / image_px)^2")


class ExpectedScore(NamedTuple):
    """Score that the model gives: the solver, its score in records, and its meaning."""

    solver: str
    score: str
    meaning: str


SCORES = {
    "q_synthetic_aperture": ExpectedScore("msa", "q", "Q of msa, default threshold"),
    "q_mart": ExpectedScore("mlos_smart", "q", "Q of mlos_smart"),
    "ghosts_synthetic_aperture": ExpectedScore(
        "msa", "ghosts", "ghosts / true particles, peaks of msa"
    ),
    "f1_mart": ExpectedScore("mlos_smart", "f1", "F1 of the peaks of mlos_smart"),
    "f1_triangulation": ExpectedScore("ray_triangulation", "f1", "F1 of ray_triangulation"),
    "f1_bayesian": ExpectedScore("bayesian_ipr", "f1", "F1 of bayesian_ipr"),
}


def features_of(values: _Values) -> F64:
    """Compute the features (feature,) of a plan's figures, without logarithms."""
    return np.array([feature.value(values) for feature in FEATURES.values()])


def transform(features: F64) -> F64:
    """Take the logarithms of features (..., feature) that have them."""
    logarithmic = np.array([feature.logarithmic for feature in FEATURES.values()])
    return np.where(logarithmic, np.log(np.where(logarithmic, features, 1.0)), features)


def link_function(score: str, value: F64) -> F64:
    """Stretch a score to all numbers: the logit of Q and F1, the logarithm of ghosts."""
    if score == "ghosts":
        return np.asarray(np.log(value + GHOST_FLOOR))
    inside = np.clip(value, _LEAST, 1.0 - _LEAST)
    return np.asarray(np.log(inside / (1.0 - inside)))


def unlink(score: str, value: F64) -> F64:
    """Invert `link`."""
    if score == "ghosts":
        return np.asarray(np.maximum(np.exp(value) - GHOST_FLOOR, 0.0))
    return np.asarray(1.0 / (1.0 + np.exp(-value)))


@dataclass(frozen=True)
class ScoreModel:
    """Fitted model.

    Attributes
    ----------
    low, high : (feature,) range of the fitted scenes.
    mean, scale : (feature,) of their features with logarithms.
    processes : of linked scores, by the keys of `SCORES`.
    widening : factors from errors of means over data sets to those of single ones.
    """

    low: F64
    high: F64
    mean: F64
    scale: F64
    processes: Mapping[str, GaussianProcess]
    widening: Mapping[str, float]

    def predict(self, key: str, features: F64) -> tuple[F64, F64]:
        """Predict a score (n,) of features (n, feature), and its standard error.

        Both are those of a single data set.

        Features are clipped to the fitted range.
        """
        inside = np.clip(features, self.low, self.high)
        value, error = self.processes[key].predict((transform(inside) - self.mean) / self.scale)
        score, error = SCORES[key].score, self.widening[key] * error
        spread = unlink(score, value + error) - unlink(score, value - error)
        return unlink(score, value), spread / 2.0

    def allowed_error_px(self, key: str, features: F64, image_px: float) -> float:
        """Find the calibration error that costs 0.02 in a score, within the range."""
        steps = np.linspace(0.0, self.high[_CALIBRATION], 200)
        tried = np.tile(features, (len(steps), 1))
        tried[:, _CALIBRATION] = steps
        expected, _ = self.predict(key, tried)
        over = np.flatnonzero(expected[0] - expected > _COST)
        return float(np.sqrt(steps[over[0] if len(over) else -1])) * image_px


@cache
def load_model() -> ScoreModel:
    """Load the bundled model."""
    return read_model(json.loads(MODEL.read_text(encoding="utf-8")))


def read_model(stored: Mapping[str, Any]) -> ScoreModel:
    """Make a model of what `expected_scores.json` holds."""
    features = np.array(stored["features"])
    low, high = features.min(axis=0), features.max(axis=0)
    low[[not feature.logarithmic for feature in FEATURES.values()]] = 0.0
    points = transform(features)
    mean, scale = points.mean(axis=0), points.std(axis=0)
    processes = {}
    for key, score in SCORES.items():
        values = np.array(stored["scores"][key], dtype=np.float64)  # NaN: not measured
        measured = np.isfinite(values)
        given = stored["kernels"][key]
        kernel = Kernel(np.array(given["lengths"]), *(given[name] for name in _DEVIATIONS))
        processes[key] = GaussianProcess(
            ((points - mean) / scale)[measured],
            link_function(score.score, values[measured]),
            kernel,
        )
    return ScoreModel(low, high, mean, scale, processes, stored["widening"])


_DEVIATIONS = ("amplitude", "slope", "noise")


def feature_values(sections: Sequence[Section]) -> F64 | None:
    """Compute the features (feature,) of a plan; None where a figure is missing."""
    values = {
        quantity.key: quantity.value
        for section in sections
        for quantity in section.quantities
        if quantity.value is not None
    }
    if not {"elongation", "ppp_center"} <= values.keys() or not values["peak_snr"]:
        return None
    return features_of(values)


def plan_scores(sections: Sequence[Section]) -> Section | None:
    """Predict scores from the figures of a plan; None where a figure is missing."""
    features = feature_values(sections)
    if features is None:
        return None
    model = load_model()
    if outside := _outside(model, features):
        why = f"none, {' and '.join(outside)}: use --measure"
        return Section("expected scores", (Quantity("expected", None, why, _SOURCE),), ())
    quantities = []
    for key, score in SCORES.items():
        value, error = (float(each[0]) for each in model.predict(key, features[None]))
        quantities.append(Quantity(key, value, f"{score.meaning}, +- {error:.2g}", _SOURCE))
    for key, name in (("q_synthetic_aperture", "msa"), ("q_mart", "mlos_smart")):
        allowed = model.allowed_error_px(key, features, features[_IMAGE])
        meaning = f"calibration error that costs {name} {_COST:g} in Q"
        quantities.append(Quantity(f"calibration_{name}_px", allowed, meaning, _SOURCE))
    return Section("expected scores", tuple(quantities), ())


_SOURCE = "fitted to measured scenes"


def _outside(model: ScoreModel, features: F64) -> list[str]:
    """List the figures outside the range of the fitted scenes.

    More light than in these is none of them: their brightest hardly show noise.
    """
    outside = []
    for name, value, low, high in zip(FEATURES, features, model.low, model.high, strict=True):
        below, above = value < low * (1.0 - EDGE), value > high * (1.0 + EDGE)
        if below or (above and name != "peak_snr"):
            outside.append(f"{name} is {value:.3g} (measured: {low:.3g} to {high:.3g})")
    return outside
