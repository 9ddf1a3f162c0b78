"""Task `velocimetry`: velocity fields from two frames, and their figures.

Some solvers take the images, others volumes that are reconstructed from them. Fields are scored at
nodes of the grid or, where a thin laser sheet lights the particles, in its plane.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.api import (
    AnySolver,
    ImagePair,
    PlanarVelocimetrySolver,
    Reconstruction,
    SequenceSolver,
    Velocity,
    VolumePair,
)
from sabench.api.make import make_reconstruction_solver
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result, ResultWriter
from sabench.geometry.grid import Grid, gradient, vorticity
from sabench.metrics import velocity_error
from sabench.metrics.averages import finite_or_none
from sabench.plotting.drawing import Cloud, Curve, Figure, Panel, Slice, draw
from sabench.simulation.rendering.lamps import enter_fluid
from sabench.tasks import reconstruction
from sabench.tasks.solver_call import SolverClock, call_solver
from sabench.tasks.task import (
    ANY,
    ERROR,
    PERCENT,
    Captions,
    Figures,
    Gate,
    Score,
    Source,
    Task,
    check_estimate,
)
from sabench.utils import memory
from sabench.utils.arrays import F64, triple
from sabench.utils.errors import InputError
from sabench.utils.progress import progress_bar
from sabench.worlds.advection import advect
from sabench.worlds.library.overlaps import contains
from sabench.worlds.tracers import TOLERANCE, flow_of


def field_figure(field: Velocity, exact_mm_s: F64, unit_mm_s: F64, solver: str) -> Figure:
    """Draw the middle plane of a field, its errors, and a profile.

    Parameters
    ----------
    exact_mm_s : (z, y, x, 3) the true velocities at its nodes.
    unit_mm_s : (3,) velocities of one voxel between the two volumes, the unit of errors.
    """
    errors = (field.velocity_mm_s - exact_mm_s) / unit_mm_s
    # find the axis with the most vorticity in the middle plane across it
    spin = _vorticity(field)
    normal = int(np.argmax([np.square(_middle(spin, axis)[..., axis]).mean() for axis in range(3)]))
    off = Slice("voxels", *_axes(field, normal), np.linalg.norm(_middle(errors, normal), axis=-1))
    panels = (
        slice_panel(field, normal),
        Panel("length of the error there", *_labels(normal), (off,)),
        error_scatter("errors", errors[field.valid]),
        profile_panel(field, exact_mm_s, normal),
    )
    return Figure("velocity", solver, panels, across=2)


def _vorticity(field: Velocity) -> F64:
    return np.asarray(np.nan_to_num(vorticity(gradient(field.velocity_mm_s, field.step_mm))))


def _middle(values: npt.NDArray[Any], normal: int) -> npt.NDArray[Any]:
    """Cut the middle plane across an axis out of values (z, y, x, ...).

    Its rows run along the later of the other two axes.
    """
    axis = 2 - normal
    return np.asarray(np.take(values, values.shape[axis] // 2, axis=axis))


def _section_axes(normal: int) -> tuple[int, int]:
    """Return the axes of columns and rows of a plane."""
    first, second = (axis for axis in range(3) if axis != normal)
    return first, second


def _axes(field: Velocity, normal: int) -> tuple[F64, F64]:
    """Compute the coordinates of a plane's columns and rows."""
    columns, rows = (
        field.low_mm[axis] + field.step_mm[axis] * np.arange(field.valid.shape[2 - axis])
        for axis in _section_axes(normal)
    )
    return np.asarray(columns, dtype=np.float64), np.asarray(rows, dtype=np.float64)


def _labels(normal: int) -> tuple[str, str]:
    columns, rows = (f"{'xyz'[axis]}, mm" for axis in _section_axes(normal))
    return columns, rows


def slice_panel(field: Velocity, normal: int) -> Panel:
    """Draw vectors and vorticity in the middle plane across an axis (0 to 2).

    The vorticity is the one about that axis; invalid vectors are left out.
    """
    arrows = np.where(
        _middle(field.valid, normal)[..., None],
        _middle(field.velocity_mm_s, normal)[..., list(_section_axes(normal))],
        np.nan,
    )
    node = field.valid.shape[2 - normal] // 2
    position_mm = field.low_mm[normal] + field.step_mm[normal] * node
    spin = Slice(
        f"vorticity about {'xyz'[normal]}, 1/s",
        *_axes(field, normal),
        _middle(_vorticity(field), normal)[..., normal],
        True,
        arrows,
    )
    return Panel(f"measured, {'xyz'[normal]} = {position_mm:.4g} mm", *_labels(normal), (spin,))


def error_scatter(title: str, errors: F64) -> Panel:
    """Draw errors (n, 3) in voxels of v and w over those of u; thesis, figure 2-9."""
    u, v, w = errors.T
    return Panel(
        title, "error of u, voxels", "error of v or w, voxels", (Cloud("v", u, v), Cloud("w", u, w))
    )


def profile_panel(field: Velocity, exact_mm_s: F64, normal: int) -> Panel:
    """Draw the measured and exact components along a line through a plane's middle.

    The line runs along the columns' axis.
    """
    columns, _ = _axes(field, normal)
    curves = [
        Curve(
            f"{name}{note}",
            list(columns),
            list(_middle(values, normal)[len(_middle(values, normal)) // 2, :, number]),
        )
        for number, name in enumerate("uvw")
        for note, values in (("", field.velocity_mm_s), (" exact", exact_mm_s))
    ]
    along = "xyz"[_section_axes(normal)[0]]
    return Panel(f"along {along} through the middle", f"{along}, mm", "mm/s", tuple(curves))


_POINTS = 5  # points of the quadrature across a sheet
_THIN = 0.5  # largest thickness of a light sheet, share of the grid's extent across it


@dataclass(frozen=True)
class LightSheet:
    """Plane of a thin laser sheet, and the weights of its light across it.

    Attributes
    ----------
    point_mm, normal : (3,) a point in its middle, and its unit normal.
    offsets_mm, weights : (k,) distances from the plane and shares of the light there.
    """

    point_mm: F64
    normal: F64
    offsets_mm: F64
    weights: F64

    def average(self, velocity: Callable[[F64], F64], points_mm: F64) -> F64:
        """Average a velocity at points (n, 3) of the plane over the light across it."""
        layers = (velocity(points_mm + offset * self.normal) for offset in self.offsets_mm)
        return np.asarray(sum(w * layer for w, layer in zip(self.weights, layers, strict=True)))


def light_sheet(data: Dataset) -> LightSheet | None:
    """Find the light sheet of a data set with particles; None where a volume is lit.

    Light is a sheet where its thickness is at most half of the grid's extent along its normal, or
    where the grid has a single plane of voxels across it.
    """
    scene, grid = data.scene, data.setup.grid
    center = np.asarray(scene.volume.center_mm)
    light = enter_fluid(scene.light, center, scene.fluid_index)
    normal = np.asarray(light.sheet_normal) / np.linalg.norm(light.sheet_normal)
    if light.thickness_mm > _thickest(grid, normal):
        return None
    shifts = scene.timing.shift_mm if scene.timing and scene.timing.shift_mm else (0.0,)
    offset = (light.shift_mm or 0.0) + float(np.mean(shifts))
    offsets, weights = _across(light.profile, light.thickness_mm)
    return LightSheet(center + offset * normal, normal, offsets, weights)


def _thickest(grid: Grid, normal: F64) -> float:
    voxel, across = np.asarray(grid.voxel_mm), np.abs(normal)
    single = np.asarray(grid.shape[::-1]) == 1
    share = np.where(single, 1.0, _THIN)
    return float(across @ (share * voxel * grid.shape[::-1]))


def _across(profile: str, thickness_mm: float) -> tuple[F64, F64]:
    """Place points (k,) across a sheet, with weights (k,) by Gaussian quadrature."""
    if profile == "top-hat":
        points, weights = np.polynomial.legendre.leggauss(_POINTS)
        return points * thickness_mm / 2.0, weights / 2.0
    points, weights = np.polynomial.hermite_e.hermegauss(_POINTS)
    return points * thickness_mm / 4.0, weights / weights.sum()


_NEIGHBOURS = 8  # number of true particles averaged where a data set has no flow


class VelocimetryTask(Task):
    """Measurement of velocity fields in pairs of frames."""

    name = "velocimetry"
    shown = "particles"
    estimate = Velocity
    # fmt: off
    scores = (
        Score("rms_voxel", "smaller", 3, "root mean square length of the error"),
        Score("u_p90_voxel", "smaller", 3, "half width of the interval about zero that holds 90 % "
              "of the errors of the displacement along X", heading="u 90 % voxel"),
        Score("v_p90_voxel", "smaller", 3, "the same along Y", heading="v 90 % voxel"),
        Score("w_p90_voxel", "smaller", 3, "the same along Z", heading="w 90 % voxel"),
        Score("bias_voxel", "smaller", 4, "length of the mean error", range=ANY),
        Score("yield_percent", "larger", 1, "share of the evaluation nodes at which the velocity "
              "was measured", counted=True, range=PERCENT),
        Score("response", "unity", 3,
              "the part of the true field's variation that is found", range=ANY),
        Score("divergence_1_s", "smaller", 3,
              "root mean square error of the divergence, by central differences"),
        Score("vorticity_percent", "smaller", 1,
              "root mean square error of the vorticity over its own root mean square"),
        Score("reconstruction_s", "smaller", 2, "time of the reconstruction of one frame"),
        *(
            Score(f"{name}_{kind}_voxel", "smaller", 4,
                  f"{word} of the displacement along {axis}", hidden=True, range=limits)
            for kind, word, limits in (
                ("bias", "mean error", ANY),
                ("rms", "root mean square error", ERROR),
            )
            for name, axis in zip("uvw", "XYZ", strict=True)
        ),
    )
    # fmt: on
    sufficient = 0.25  # voxel
    gate = Gate("yield_percent", 50.0)
    picture_has_truth = True
    captions = Captions(
        heading="Fields",
        estimates="The first pair: vectors and vorticity of a middle plane, errors there, all "
        "errors against each other, a profile next to the exact one.",
        cameras=reconstruction.PARTICLE_IMAGES,
        wide=True,
        truth=False,  # each figure has it
    )

    def accepts(self, data: Dataset) -> bool:
        """Check whether a data set shows particles alone and has pairs of frames."""
        return data.shows == (self.shown,) and bool(data.setup.pairs())

    def scores_data(self, data: Dataset) -> bool:
        """Check whether a data set shows particles and has pairs of frames."""
        return self.shown in data.shows and bool(data.setup.pairs())

    def frames(self, data: Dataset) -> Sequence[int]:
        """List the first frames of the pairs."""
        return [first for first, _ in data.setup.pairs()]

    def case(self, data: Dataset) -> VolumePair:
        """Make the first pair of true volumes."""
        pair = data.setup.pairs()[0]
        first, second = (reconstruction.TASK.truth(data, frame).volume for frame in pair)
        return VolumePair(first, second, data.setup.grid, interval_s(data, pair))

    def run(self, algorithm: Any, name: str, data: Dataset, writer: ResultWriter) -> list[float]:
        """Measure the field of every pair, of reconstructed volumes or of images.

        Returns the seconds without those of reconstruction.
        """
        pairs = data.setup.pairs()
        if not pairs:
            frames = data.setup.frames
            raise InputError(f"{data.root}: expected pairs of frames, got {frames} that make none")
        planar = isinstance(algorithm, PlanarVelocimetrySolver)
        volumes = None if planar else _Volumes(data, algorithm.parameters.reconstruction)
        seconds = []
        for pair in progress_bar(pairs, f"velocity by {name}"):
            case = volumes.pair(pair) if volumes else _images(data, pair)
            field, took = call_solver(algorithm, name, case, Velocity, f" on frame {pair[0]}")
            seconds.append(took)
            check_estimate(field, name, data, pair[0])
            writer.add(field, pair[0])
            memory.trim()
        if volumes:
            writer.set(reconstruction_s=float(np.mean(volumes.seconds)))
        return seconds

    def seen_by(self, plugin: type[AnySolver]) -> str:
        """Name what a solver has to see: planar ones need a light sheet."""
        planar = issubclass(plugin, PlanarVelocimetrySolver)
        return "light_sheet" if planar else super().seen_by(plugin)

    def case_for(self, algorithm: Any, data: Dataset) -> VolumePair | ImagePair:
        """Make the first pair as a solver receives it."""
        if isinstance(algorithm, PlanarVelocimetrySolver):
            return _images(data, data.setup.pairs()[0])
        return self.case(data)

    def truth(self, data: Dataset, frame: int) -> Velocity:
        """Make the true velocity at the evaluation nodes."""
        lattice = self.empty(data, frame)
        pair = next(pair for pair in data.setup.pairs() if pair[0] == frame)
        return replace(lattice, velocity_mm_s=truth_at(data, pair, lattice))

    def empty(self, data: Dataset, frame: int) -> Velocity:
        """Make a field at rest: what an estimate that sees no motion returns."""
        return evaluation_nodes(data)

    def wrong(self, data: Dataset, frame: int) -> Velocity:
        """Slow the true velocity by a tenth, add a wave, and leave one corner unmeasured."""
        grid, field = data.setup.grid, self.truth(data, frame)
        low, size = np.asarray(grid.low_mm), np.asarray(grid.voxel_mm) * grid.shape[::-1]
        true, away_mm = field.velocity_mm_s, field.positions_mm - low
        wave = np.sin(2.0 * np.pi * away_mm / size * [1.0, 2.0, 1.5])
        velocity = 0.9 * true + 0.05 * np.abs(true).max() * wave
        return replace(field, velocity_mm_s=velocity, valid=(away_mm < 0.7 * size).any(axis=-1))

    def score(self, data: Dataset, source: Source) -> Figures:
        """Average the scores of the pairs."""
        pairs = [
            score_pair(data, pair, self.read(data, source, pair[0]))
            for pair in progress_bar(data.setup.pairs(), "score")
        ]
        means = {key: float(np.mean([figures[key] for figures in pairs])) for key in pairs[0]}
        scores = {key: finite_or_none(value) for key, value in means.items()}
        spent = source.reconstruction_s if isinstance(source, Result) else None
        return {**scores, "reconstruction_s": spent}

    def picture(self, data: Dataset, source: Source) -> bytes:
        """Draw the first pair's field, its errors and a profile as a PNG."""
        pair = data.setup.pairs()[0]
        given = self.read(data, source, pair[0])
        exact = truth_at(data, pair, given) @ given.axes.T
        field = given.in_own_axes()
        edges_mm = velocity_error.lengths_along(given.axes, data.setup.grid.voxel_mm)
        voxel = edges_mm / interval_s(data, pair)
        label = source.solver if isinstance(source, Result) else source
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of arrows and axes without length
            return draw(field_figure(field, exact, voxel, label))


class _Volumes:
    """Reconstructed volumes of a pair's frames; those of the next pair are kept."""

    def __init__(self, data: Dataset, solver: str) -> None:
        self._data, self._name = data, solver
        self._solver = make_reconstruction_solver(solver, {})
        self._kept: dict[int, Reconstruction] = {}
        self.seconds: list[float] = []

    def pair(self, pair: tuple[int, int]) -> VolumePair:
        """Reconstruct the volumes of a pair, unless they are already there."""
        if isinstance(self._solver, SequenceSolver):
            return self._together(self._solver, pair)
        self._kept = {frame: volume for frame, volume in self._kept.items() if frame in pair}
        for frame in pair:
            if frame not in self._kept:
                volume, took = reconstruction.TASK.call(self._solver, self._name, self._data, frame)
                self._kept[frame] = volume
                self.seconds.append(took)
        first, second = (self._kept[frame].volume for frame in pair)
        return VolumePair(first, second, self._data.setup.grid, interval_s(self._data, pair))

    def _together(self, solver: SequenceSolver, pair: tuple[int, int]) -> VolumePair:
        """Reconstruct both frames of a pair from each other."""
        clock, frames = SolverClock(), range(pair[0], pair[1] + 1)
        estimates = reconstruction.TASK.call_sequence(solver, self._name, self._data, frames, clock)
        first, second = (estimate.volume for estimate in estimates)
        self.seconds.append(clock.seconds / len(frames))
        return VolumePair(first, second, self._data.setup.grid, interval_s(self._data, pair))


def _images(data: Dataset, pair: tuple[int, int]) -> ImagePair:
    first, second = (data.observation(frame) for frame in pair)
    return ImagePair(first, second, interval_s(data, pair))


def interval_s(data: Dataset, pair: tuple[int, int]) -> float:
    """Compute the time between the frames of a pair."""
    return data.setup.time_s(pair[1]) - data.setup.time_s(pair[0])


def evaluation_nodes(data: Dataset) -> Velocity:
    """Make the nodes for scoring fields: in the light sheet, if there is one."""
    grid, sheet = data.setup.grid, light_sheet(data)
    if sheet is None:
        return velocity_error.evaluation_lattice(grid)
    return velocity_error.planar_lattice(grid, sheet.point_mm, sheet.normal)


def score_pair(data: Dataset, pair: tuple[int, int], field: Velocity) -> dict[str, float]:
    """Score one pair's field, sampled at the evaluation nodes outside bodies.

    In a light sheet, the components in its plane count, along the nodes' axes.
    """
    nodes = evaluation_nodes(data)
    sampled, measured = velocity_error.sample_velocity(field, nodes.positions_mm.reshape(-1, 3))
    counted = nodes.components(sampled.reshape(nodes.velocity_mm_s.shape))
    # mark the nodes (z, y, x) that no body contains in either frame of a pair
    points = nodes.positions_mm.reshape(-1, 3)
    fluid = np.ones(len(points), dtype=np.bool_)
    for frame in pair if data.scene.solids else ():
        for body in data.solids(frame):
            fluid &= ~contains(body, points)
    return velocity_error.velocity_scores(
        counted,
        nodes.components(truth_at(data, pair, nodes)),
        measured.reshape(nodes.valid.shape),
        fluid.reshape(nodes.valid.shape) & nodes.valid,
        nodes.step_mm,
        interval_s(data, pair),
        triple(velocity_error.lengths_along(nodes.axes, data.setup.grid.voxel_mm)),
    )


def truth_at(data: Dataset, pair: tuple[int, int], lattice: Velocity) -> F64:
    """Compute the true velocity (z, y, x, 3) at the nodes of a lattice.

    For a planar one in a light sheet, it is the mean over the light across the sheet, without the
    component across the plane.
    """
    points = lattice.positions_mm.reshape(-1, 3)
    sheet = None if lattice.plane_axes is None else light_sheet(data)
    exact = partial(true_velocity, data, pair)
    velocity = exact(points) if sheet is None else sheet.average(exact, points)
    return (lattice.components(velocity) @ lattice.axes).reshape(lattice.velocity_mm_s.shape)


def true_velocity(data: Dataset, pair: tuple[int, int], points_mm: F64) -> F64:
    """Average the true velocity over a pair's interval at points (n, 3).

    It is the displacement of the fluid that is at the points in the middle of the interval, over
    the interval. Where the data set has no flow, it is the mean of the nearest true particles.
    """
    flow, (start, end) = (
        flow_of(data.scene, data.manifest.seed),
        (data.setup.time_s(frame) for frame in pair),
    )
    if flow is None:
        from scipy.spatial import cKDTree

        first, second = (data.particles(frame) for frame in pair)
        _, rows, other = np.intersect1d(first.id, second.id, return_indices=True)
        if not len(rows):
            raise InputError(
                f"{data.root}: frames {pair[0]} and {pair[1]}: "
                "expected particles that are in both, got none"
            )
        positions = (first.position_mm[rows] + second.position_mm[other]) / 2.0
        moves = (second.position_mm[other] - first.position_mm[rows]) / interval_s(data, pair)
        count = min(_NEIGHBOURS, len(positions))
        near = cKDTree(positions).query(points_mm, k=count)[1].reshape(len(points_mm), count)
        return np.asarray(moves[near].mean(axis=1))
    middle, tolerance = (start + end) / 2.0, TOLERANCE * max(data.scene.volume.size_mm)
    after, before = (advect(flow, points_mm, middle, time, tolerance) for time in (end, start))
    return (after - before) / (end - start)


TASK = VelocimetryTask()
