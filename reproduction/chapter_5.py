"""Plunging jets: rendered frames, detected bubbles, tables 5.1 and 5.2."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sabench.api import Detections, Observation
from sabench.api.truth import Bubbles
from sabench.evaluation.reproduction import Item, Row
from sabench.metrics.bubble_detection import AnyBubbles, detection_scores
from sabench.metrics.plunging_jet import DEPTH_MM, JetFigures
from sabench.plotting.drawing import Figure, Panel, Space
from sabench.scenes import Scene, build_rig, load_scene
from sabench.simulation.camera_view import render_camera_view
from sabench.simulation.frames import FrameContent, Frames
from sabench.simulation.in_memory import observation_of
from sabench.simulation.rendering.sensor import expose
from sabench.tasks.bubbles import jet_figures, jet_of
from sabench.utils.arrays import F64
from sabench.utils.progress import progress_bar

from .common import AGREES, claim, coarsen, finite_row, make_row, report, run
from .rise_velocity import Liquid

FRAMES = 50  # the thesis's number of time steps: of true bubbles, which need no images
SOLVER = "rim_fit"


@dataclass(frozen=True)
class Jet:
    """Values of tables 5.1 and 5.2 and of the text for one height of the nozzle.

    V_i and D_i stand in each other's column there: `speed_m_s` is printed as D_i.
    """

    speed_m_s: float
    diameter_mm: float
    reynolds: float
    froude: float
    weber: float
    total_percent: float
    penetration_mm: float
    equivalent_mm: float
    angle_deg: float
    axes_mm: tuple[float, float]  # smallest and largest


JETS = {
    7: Jet(3.45, 6.29, 2.17e4, 112.0, 514.0, 0.02, 211.5, 87.0, 11.6, (0.138, 2.38)),
    21: Jet(3.59, 6.17, 2.21e4, 119.0, 544.0, 0.23, 160.0, 61.6, 10.9, (0.244, 2.44)),
    43: Jet(3.78, 6.01, 2.27e4, 128.0, 589.0, 0.34, 120.0, 48.1, 11.3, (0.1946, 4.32)),
}  # mm of the nozzle above the surface
NOZZLE_MM, MORTON = 6.35, 2.52e-11
HEIGHTS = tuple(JETS)


@dataclass(frozen=True)
class JetFrames:
    """Bubbles of several frames of a jet, true ones and those found in the images."""

    height: int
    scene: Scene
    true: list[AnyBubbles]
    found: list[AnyBubbles]

    @property
    def printed(self) -> Jet:
        """The thesis's values."""
        return JETS[self.height]

    @property
    def impact_mm(self) -> F64:
        """Point (3,) where the jet meets the surface."""
        jet = jet_of(self.scene)
        return np.asarray(jet["impact_mm"] if jet else np.zeros(3), dtype=np.float64)

    def analyse(self) -> dict[str, JetFigures]:
        """Analyse found and true bubbles, and true ones of `FRAMES` frames."""
        return {
            "found": jet_figures(self.scene, self.found),
            "true": jet_figures(self.scene, self.true),
            "many": jet_figures(self.scene, true_bubbles(self.scene, FRAMES)),
        }


def detect_jets(seeds: Sequence[int], pixels: int | None) -> Iterator[JetFrames]:
    """Find the bubbles of every jet in one frame for each seed."""
    for height in HEIGHTS:
        scene = coarsen(load_scene(f"plunging-jet-{height}"), pixels)
        yield detect_jet(height, scene, seeds)


def detect_jet(height: int, scene: Scene, seeds: Sequence[int]) -> JetFrames:
    """Find the bubbles of one jet in one frame for each seed."""
    pairs = [detect_frame(scene, seed) for seed in seeds]
    return JetFrames(height, scene, [true for true, _ in pairs], [bubbles for _, bubbles in pairs])


_detected: dict[tuple[str, int, str], tuple[Bubbles, Detections]] = {}
_true: dict[tuple[str, int], list[AnyBubbles]] = {}


def detect_frame(scene: Scene, seed: int) -> tuple[Bubbles, Detections]:
    """Find the bubbles of a scene's first frame.

    They are cached, because several figures use them.
    Returns the true and the found ones.
    """
    key = scene.hash, seed, SOLVER
    if key not in _detected:
        _, bubbles, case = render_first_frame(scene, seed)
        start = time.perf_counter()
        _detected[key] = bubbles, run(SOLVER, case)
        report(
            f"{scene.title}, seed {seed}: {len(_detected[key][1].center_mm)} of {len(bubbles)} "
            f"bubbles in {time.perf_counter() - start:.0f} s"
        )
    return _detected[key]


def true_bubbles(scene: Scene, count: int) -> list[AnyBubbles]:
    """Make the bubbles of the first frames of seeds 1 to `count`; cached."""
    key = scene.hash, count
    if key not in _true:
        rig = build_rig(scene, scene.title)
        frames = [Frames(scene, rig, seed).at(0).bubbles for seed in range(1, count + 1)]
        _true[key] = [bubbles for bubbles in frames if bubbles is not None]
    return _true[key]


def jet_rows(
    name: str, thesis: float | None, found: float, true: float, many: float | None = None
) -> Iterator[Row]:
    """Make rows of a value of a jet.

    The thesis's value is a mean over `FRAMES` frames of its own jet, to which the scene was built:
    it is compared with `many`, that of the true bubbles of as many frames. The value of found
    bubbles is compared with that of true ones in the same, fewer frames.
    """
    if many is not None:
        values = [many] if np.isfinite(many) else []
        note = "" if thesis is None else "the scene was built to the thesis's value"
        row = f"{name}, true bubbles of {FRAMES} frames"
        yield make_row(row, thesis, values, note)
    finite = np.isfinite(true) and np.isfinite(found)
    yield claim(
        f"{name}, found bubbles",
        f"true bubbles of the same frames: {true:.4g}",
        found if np.isfinite(found) else None,
        bool(finite and abs(found - true) <= AGREES * abs(true)),
        f"{100.0 * (found / true - 1.0):+.1f} %" if finite and true else "",
    )


Rendered = tuple[FrameContent, Bubbles, Observation]  # a frame, its bubbles, what a solver gets


def render_first_frame(scene: Scene, seed: int) -> Rendered:
    """Render the first frame of the data set that `generate` would make, in memory."""
    return next(render_frames(scene, seed))


def render_frames(scene: Scene, seed: int) -> Iterator[Rendered]:
    """Render all frames of the data set that `generate` would make."""
    frames = Frames(scene, build_rig(scene, scene.title), seed)
    for number in range(scene.frames):
        frame = frames.at(number)
        if frame.bubbles is None:
            raise ValueError(f"{scene.title}: expected a scene with bubbles")
        cameras = range(len(frame.rig.cameras))
        images = [
            expose(
                scene.sensor, render_camera_view(frame, camera).photons, frame.sensor_noise(camera)
            )
            for camera in progress_bar(
                cameras, f"render {scene.title}, seed {seed}, frame {number}"
            )
        ]
        yield frame, frame.bubbles, observation_of(frame, images)


_WATER = Liquid()
_DROP, _ABOVE = 21.6, 18.3  # Y / D_i of two neighbouring bins of figure 5-21, h = 43 mm


def reynolds(speed_m_s: float, diameter_mm: float, liquid: Liquid) -> float:
    """Compute the Reynolds number, equation 5.1."""
    return speed_m_s * 1e-3 * diameter_mm / liquid.viscosity


def froude(speed_m_s: float, diameter_mm: float, liquid: Liquid) -> float:
    """Compute the Froude number, equation 5.2."""
    return speed_m_s**2 / (liquid.gravity * 1e-3 * diameter_mm)


def weber(speed_m_s: float, diameter_mm: float, liquid: Liquid) -> float:
    """Compute the Weber number, equation 5.3."""
    return liquid.density * speed_m_s**2 * 1e-3 * diameter_mm / liquid.tension


def fall(
    speed_m_s: float, diameter_mm: float, height_mm: float, liquid: Liquid
) -> tuple[float, float]:
    """Compute speed and diameter of a jet after a fall, by Bernoulli and continuity."""
    speed = float(np.sqrt(speed_m_s**2 + 2.0 * liquid.gravity * 1e-3 * height_mm))
    return speed, diameter_mm * float(np.sqrt(speed_m_s / speed))


def table_5_1(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Compute the table from printed speeds and diameters; nothing is simulated.

    The table's columns of V_i and D_i are exchanged: V_i D_i^2 is constant, as the flow through one
    nozzle is, and depths over D_i in figure 5-21 are whole bins only if the column of V_i holds D_i
    in mm. The rows use them in this order. The printed Weber numbers have the radius for the
    diameter, the printed Froude numbers are V / (g R), without the square. With that Froude number
    in Bernoulli's equation, V_i^2 = V_0^2 (1 + 2 h / (Fr R)), the printed speeds and diameters
    follow to all digits.
    """
    yield from _order()
    for height, jet in JETS.items():
        yield from _numbers(height, jet)
    yield make_row("Morton number", MORTON, [_WATER.morton], "nu = 1e-6 m2/s, 73 mN/m")
    yield from _falls()


def _order() -> Iterator[Item]:
    """Decide which column is the speed."""
    flows = np.array([jet.speed_m_s * jet.diameter_mm**2 for jet in JETS.values()])
    printed = np.array([jet.diameter_mm * jet.speed_m_s**2 for jet in JETS.values()])
    spread, other = (float(100.0 * np.ptp(flow) / flow.mean()) for flow in (flows, printed))
    yield claim(
        "V_i D_i^2, columns exchanged: spread, %",
        "one nozzle, one flow rate",
        spread,
        spread < 0.5,
        f"as printed {other:.1f} %: V_i and D_i stand in each other's column",
    )
    bin_mm = (_DROP - _ABOVE) * JETS[43].diameter_mm
    yield make_row(
        "bin of figure 5-21 in mm, D_i = 6.01 mm",
        DEPTH_MM,
        [bin_mm],
        f"D_i as printed: {(_DROP - _ABOVE) * JETS[43].speed_m_s:.1f} mm",
    )


def _numbers(height: int, jet: Jet) -> Iterator[Item]:
    flow = jet.speed_m_s, jet.diameter_mm, _WATER
    name = f"h = {height} mm: "
    yield make_row(f"{name}Reynolds number (5.1)", jet.reynolds, [reynolds(*flow)])
    half = weber(jet.speed_m_s, jet.diameter_mm / 2.0, _WATER)
    yield make_row(
        f"{name}Weber number (5.3)",
        jet.weber,
        [weber(*flow)],
        f"with the radius instead of the diameter {half:.0f}",
    )
    yield make_row(
        f"{name}Froude number (5.2)",
        jet.froude,
        [froude(*flow)],
        "V / (g R), without the square and with the radius, "
        f"{2e3 * jet.speed_m_s / (_WATER.gravity * jet.diameter_mm):.0f}",
    )


def _falls() -> Iterator[Item]:
    """Compute speed and diameter of each jet from the flow through the nozzle."""
    flows = [jet.speed_m_s * jet.diameter_mm**2 for jet in JETS.values()]
    start = float(np.mean(flows)) / NOZZLE_MM**2
    for height, jet in JETS.items():
        speed, diameter = fall(start, NOZZLE_MM, height, _WATER)
        slip, narrower = fall(start, NOZZLE_MM, height * start, _WATER)
        name = f"h = {height} mm: "
        note = f"from {start:.3f} m/s at the nozzle; with 2 g h / V for 2 g h / V^2 "
        yield make_row(f"{name}V_i, m/s", jet.speed_m_s, [speed], f"{note}{slip:.2f}")
        yield make_row(f"{name}D_i, mm", jet.diameter_mm, [diameter], f"{note}{narrower:.2f}")


_FIGURES = dict(zip(JETS, ("5-18", "5-19", "5-20"), strict=True))
_LARGE = {
    "f1_large": "F1 of bubbles of 0.5 mm radius and more",
    "radius_percent": "radius error, %",
    "depth_mm": "depth error, mm",
}
_WEIGHT, _WIDTH = 0.903, 0.1894  # of equation 5.18


def table_5_2(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure errors of the bubbles, and the jet's figures, per jet.

    Errors are means over frames. Figures are from all frames together, of detected bubbles; notes
    give those of true ones.

    All values are those of bubbles detected in rendered frames. The scenes were built to the
    thesis's values, which are measurements of its own jets.
    """
    for jet in detect_jets(seeds, pixels):
        # draw the true and the found bubbles of the first frame in space
        panels = tuple(
            Panel(title, "X, mm", "", (Space("radius, mm", bubbles.center_mm, bubbles.radius_mm),))
            for title, bubbles in (("true", jet.true[0]), ("found", jet.found[0]))
        )
        number = _FIGURES[jet.height]
        yield Figure(f"fig-{number}", f"bubbles, h = {jet.height} mm", panels, inch=(4.6, 6.4))
        scores = [
            detection_scores(estimate, true, np.ones(len(true.center_mm)))
            for estimate, true in zip(jet.found, jet.true, strict=True)
        ]
        for key, name in _LARGE.items():
            values = [score[key] for score in scores]
            yield finite_row(f"h = {jet.height} mm, {SOLVER}: {name}", values)
        yield from _table(jet)


def _table(jet: JetFrames) -> Iterator[Item]:
    every, printed = jet.analyse(), jet.printed
    for key, name, thesis in (
        ("cone_percent", "C_tot, %", printed.total_percent),
        ("penetration_mm", "Y_p, mm", printed.penetration_mm),
        ("equivalent_mm", "D_eq, mm", printed.equivalent_mm),
        ("angle_deg", "angle, degrees", printed.angle_deg),
        ("weight", "A of equation 5.18", _WEIGHT),
        ("width", "s of equation 5.18", _WIDTH),
    ):
        values = [float(getattr(figures, key)) for figures in every.values()]
        yield from jet_rows(f"h = {jet.height} mm: {name}", thesis, *values)
