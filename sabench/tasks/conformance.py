"""Conformance tests of solvers, bundled or not, and compilation ahead of time.

`check_solver` tests the laws on a small data set of the solver's task, generated from
`scenes/conformance/`. `sabench conform` and the fixture `sabench_conform` of the pytest plug-in
call it.

`warm_up` calls each solver on that data set and scores its result, which compiles and stores all
kernels that `generate`, `solve` and `score` call, e.g. when a container image is built.
"""

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sabench import plugins, tasks
from sabench.api import (
    CalibrationCase,
    FoundParticles,
    ImagePair,
    ImageSequence,
    Observation,
    Reconstruction,
    SequenceSolver,
    VolumePair,
)
from sabench.api.estimates import Estimate
from sabench.api.make import make_algorithm
from sabench.dataset.reader import Dataset, open_dataset
from sabench.images.flaws import Flaws
from sabench.scenes import load_scene
from sabench.simulation.pipeline import generate
from sabench.tasks.solve_and_score import score, solve
from sabench.tasks.solver_call import image_sequence
from sabench.tasks.task import Task
from sabench.utils.errors import DeclinedError, InputError

_SEED = 5

Verdict = Literal["obeyed", "broken", "skipped"]


@dataclass(frozen=True)
class LawResult:
    """Result of one law; `text` is the reason why it is broken or skipped."""

    law: str
    verdict: Verdict
    text: str = ""


def _expect(condition: Any, text: str) -> None:
    if not condition:
        raise AssertionError(text)


class _SkippedError(Exception):
    """Law that does not apply to a solver."""


@dataclass(frozen=True)
class _Trial:
    """One solver on the data set of its task."""

    solver: str
    parameters: dict[str, Any]
    task: Task
    data: Dataset
    folder: Path

    def case(self) -> Any:
        """Make the case that the solver receives."""
        case = first_case(self.solver, self.data, self.parameters)
        return _image_sequence(case, list(case)) if isinstance(case, ImageSequence) else case

    @cached_property
    def first(self) -> tuple[Any, list[Estimate]]:
        """A case after the solver has received it, and its estimates."""
        case = self.case()
        return case, self.solve(case)

    def solve(self, case: Any) -> list[Estimate]:
        """Call a new solver on a case and check its estimates as declared."""
        algorithm: Any = make_algorithm(self.solver, self.parameters)
        reason = algorithm.skip(case)
        if reason:
            raise _SkippedError(f"the solver declines the case: {reason}")
        answer = algorithm.solve(case)
        estimates: list[Estimate] = list(answer) if isinstance(case, ImageSequence) else [answer]
        for estimate in estimates:
            if not isinstance(estimate, self.task.estimate):
                kind, got = self.task.estimate.__name__, type(estimate).__name__
                raise AssertionError(f"expected {kind}, got {got}")
            estimate.check(**dict(zip("zyx", self.data.setup.grid.shape, strict=True)))
        return estimates


def describe_itself(trial: _Trial) -> None:
    """Check the solver's description.

    The docstring's first line is a sentence, references are given, and every parameter has a
    description and a default.
    """
    plugin = plugins.load("solvers", trial.solver)
    _expect(plugins.summary(plugin).endswith("."), "the docstring's first line must be a sentence")
    _expect(plugin.references, "references: expected at least one, got none")
    for key, field in plugin.Parameters.model_fields.items():
        _expect(field.description, f"parameter {key}: expected a description, got none")
        _expect(not field.is_required(), f"parameter {key}: expected a default, got none")


def return_declared_arrays(trial: _Trial) -> None:
    """Check that estimates have the declared arrays, with finite values."""
    case, estimates = trial.first
    expected = len(case) if isinstance(case, ImageSequence) else 1
    _expect(len(estimates) == expected, f"expected {expected} estimates, got {len(estimates)}")


def repeat_itself(trial: _Trial) -> None:
    """Check that the same case gives the same estimate, bit for bit."""
    for estimate, other in zip(trial.first[1], trial.solve(trial.case()), strict=True):
        for (declared, a), (_, b) in zip(estimate.arrays(), other.arrays(), strict=True):
            same = a.shape == b.shape and np.array_equal(a, b)
            _expect(same, f"{declared.name}: expected the same values twice, got others")


def leave_the_case_alone(trial: _Trial) -> None:
    """Check that the solver does not change the arrays that it receives."""
    for array, other in zip(_arrays(trial.first[0]), _arrays(trial.case()), strict=True):
        same = np.array_equal(array, other, equal_nan=array.dtype.kind == "f")
        _expect(same, "expected the case's arrays unchanged, got other values")


def beat_nothing(trial: _Trial) -> None:
    """Check that the result scores better than an empty one."""
    out = trial.folder / "result.h5"
    try:
        solve(trial.solver, trial.data, out, parameters=trial.parameters, overwrite=True)
    except DeclinedError as error:
        raise _SkippedError(str(error)) from error
    task = trial.task
    first, gate = task.columns[0], task.gate
    scores, nothing = score(trial.data, out), task.score(trial.data, "empty")
    _expect(scores[first.key] is not None, f"{first.key}: expected a figure, got none")
    if gate is not None:
        admitted = f"{gate.key}: expected at least {gate.least:g}, got {scores[gate.key]}"
        _expect(task.admits(scores), admitted)
    better = f"{first.key}: expected better than {nothing[first.key]}, got {scores[first.key]}"
    _expect(task.rank(scores) < task.rank(nothing), better)


def find_nothing_in_the_dark(trial: _Trial) -> None:
    """Check that images of a dark volume of particles give no particles.

    Solvers of other tasks may refuse such images with an InputError.
    """
    for estimate in trial.solve(_with_images(trial.case(), np.full_like)):
        if isinstance(estimate, Reconstruction) and trial.task.shown == "particles":
            dark = not estimate.volume.any()
            _expect(dark, "volume: expected zeros without light, got intensities")
        if isinstance(estimate, FoundParticles):
            count = len(estimate.position_mm)
            _expect(not count, f"expected no particles without light, got {count}")


def survive_a_covered_camera(trial: _Trial) -> None:
    """Check that one black image of several does no harm.

    The solver finishes or raises an InputError, and its values are finite.
    """

    def cover(images: Any, black: int) -> Any:
        covered = images.copy()
        covered[1] = black
        return covered

    trial.solve(_with_images(trial.case(), cover))


def take_cameras_in_any_order(trial: _Trial) -> None:
    """Check that cameras in reverse order give a similar estimate."""
    backward = trial.solve(_reverse_cameras(trial.case()))
    for estimate, other in zip(trial.first[1], backward, strict=True):
        alike = trial.task.alike(trial.data, estimate, other)
        _expect(alike, "expected a similar estimate, got another one")


LAWS: tuple[Callable[[_Trial], None], ...] = (
    describe_itself,
    return_declared_arrays,
    repeat_itself,
    leave_the_case_alone,
    beat_nothing,
    find_nothing_in_the_dark,
    survive_a_covered_camera,
    take_cameras_in_any_order,
)


def check_solver(
    solver: str,
    parameters: dict[str, Any] | None = None,
    *,
    folder: Path | None = None,
    laws: tuple[Callable[[Any], None], ...] = LAWS,
) -> Iterator[LawResult]:
    """Test a solver against the laws; yield each finding as soon as it is made.

    Parameters
    ----------
    solver : name of a plug-in.
    parameters : of the solver; the others keep their defaults.
    folder : for the data set; one that is already there is used again. None: a temporary folder.

    Raises InputError for an unknown solver or parameter.
    """
    plugin = plugins.load("solvers", solver)
    make_algorithm(solver, parameters or {})
    with tempfile.TemporaryDirectory(prefix="sabench-conform-") as scratch:
        data = example_for(solver, folder or Path(scratch))
        trial = _Trial(solver, parameters or {}, tasks.of(plugin.task), data, Path(scratch))
        for law in laws:
            yield _try(law, trial)


def _try(law: Callable[[_Trial], None], trial: _Trial) -> LawResult:
    name = law.__name__.replace("_", " ")
    try:
        law(trial)
    except _SkippedError as reason:
        return LawResult(name, "skipped", str(reason))
    except AssertionError as error:
        return LawResult(name, "broken", str(error).split("\n")[0])
    except InputError as error:
        if law in (find_nothing_in_the_dark, survive_a_covered_camera):
            # an InputError is a valid answer to such images
            return LawResult(name, "obeyed", f"it refuses such images: {error}")
        return LawResult(name, "broken", str(error))
    except Exception as error:
        return LawResult(name, "broken", f"{type(error).__name__}: {error}")
    return LawResult(name, "obeyed")


def first_case(solver: str, data: Dataset, parameters: Mapping[str, Any] | None = None) -> Any:
    """Make the first case of a data set as a solver receives it."""
    algorithm = make_algorithm(solver, dict(parameters or {}))
    if isinstance(algorithm, SequenceSolver):
        return image_sequence(data, data.setup.sequences()[0])[0]
    return tasks.of(algorithm.task).case_for(algorithm, data)


def example_for(solver: str, folder: Path) -> Dataset:
    """Generate the small data set for a solver, or open it if it is there.

    Solvers of image sequences have that of velocimetry, which has a pair of frames.
    """
    plugin = plugins.load("solvers", solver)
    task = tasks.of("velocimetry" if issubclass(plugin, SequenceSolver) else plugin.task)
    return example(task, task.seen_by(plugin), folder)


def example(task: Task, sees: str, folder: Path) -> Dataset:
    """Generate the small data set of a task, or open it if it is in the folder."""
    name = task.name if sees == task.shown else f"{task.name}_by_{sees}"
    path = folder / name
    if path.is_dir():
        return open_dataset(path)
    scene = load_scene(plugins.bundled_folder("scenes") / "conformance" / f"{name}.toml")
    renders = scene.bubbles is not None or bool(scene.solids)
    return generate(scene, path, seed=_SEED, backend="mitsuba" if renders else "splat", name=name)


def _arrays(case: Any) -> list[Any]:
    if isinstance(case, ImageSequence):
        return [frame.images for frame in case]
    if isinstance(case, Observation):
        return [case.images]
    if isinstance(case, ImagePair):
        return [case.first.images, case.second.images]
    if isinstance(case, VolumePair):
        return [case.first, case.second]
    return [case.pixels, case.initial_mm, case.known_mm, case.known_sigma_mm]


def _image_sequence(like: ImageSequence, frames: list[Observation]) -> ImageSequence:
    return ImageSequence(frames[0].cameras, like.grid, like.times_s, frames.__getitem__)


def _change_frames(case: Any, change: Callable[[Any], Any]) -> Any:
    """Change every frame of a case."""
    if isinstance(case, ImageSequence):
        return _image_sequence(case, [change(frame) for frame in case])
    if isinstance(case, ImagePair):
        return ImagePair(change(case.first), change(case.second), case.interval_s)
    return change(case)


def _with_images(case: Any, change: Callable[[Any, int], Any]) -> Any:
    def with_changed(frame: Any) -> Observation:
        if not isinstance(frame, Observation):
            raise _SkippedError("its cases have no images")
        return replace(frame, images=change(frame.images, int(frame.black_dn)))

    return _change_frames(case, with_changed)


def _reverse_cameras(case: Any) -> Any:
    def reverse(frame: Any) -> Any:
        if isinstance(frame, Observation):
            flaws = frame.flaws and Flaws(*(kind[::-1].copy() for kind in frame.flaws))
            images, cameras = frame.images[::-1].copy(), frame.cameras[::-1]
            return replace(frame, images=images, cameras=cameras, flaws=flaws)
        if isinstance(frame, CalibrationCase):
            return replace(frame, pixels=frame.pixels[::-1].copy(), cameras=frame.cameras[::-1])
        raise _SkippedError("its cases have no cameras")

    return _change_frames(case, reverse)


@dataclass(frozen=True)
class Warmed:
    """A solver that was called.

    Attributes
    ----------
    compile_s : seconds of compilation and of loading kernels: few if all were there.
    verdict, text : as `conform` gives for a result that is worth something.
    """

    solver: str
    compile_s: float
    verdict: Verdict
    text: str


def warm_up(solvers: Sequence[str] = ()) -> Iterator[Warmed]:
    """Compile the kernels of some solvers, or all; InputError for an unknown solver."""
    from sabench.utils.compiled import compile_s  # numba takes half a second to import

    names = solvers or plugins.names("solvers")
    for name in names:
        plugins.load("solvers", name)
    with tempfile.TemporaryDirectory(prefix="sabench-warmup-") as scratch:
        for name in names:
            before = compile_s()
            finding = next(check_solver(name, folder=Path(scratch), laws=(beat_nothing,)))
            yield Warmed(name, compile_s() - before, finding.verdict, finding.text)
