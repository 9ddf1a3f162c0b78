"""Plug-ins that were written before the modules moved, and that used `sabench.api` alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import sabench.api
from sabench import plugins
from sabench.api import CalibrationCase, Film, ImageSequence, Target
from sabench.api.make import make_algorithm
from sabench.scenes import load_scene
from sabench.simulation.in_memory import simulate

# what the one module `sabench.api` had
NAMES = """
AnySolver Bool BubbleGenerator BubbleParameters BubbleSolver Bubbles Calibration CalibrationCase
CalibrationSolver Camera CameraModel Code CodeGenerator Detections Domain F32 F64 FileParameters
Film Flow FoundParticles Generator Grid I64 InputError LensNumber Material Observation Parameters
ParticleSolver Particles PlugIn Pose Reconstruction SeeThroughSolver SelfCalibrationSolver Shown
Solid SolidGenerator SolidParameters Solver Target TargetGenerator Track U16 Vector
VelocimetryParameters VelocimetrySolver Velocity VolumePair
"""

OLD = '''
"""Brightest pixels."""

from __future__ import annotations

import numpy as np

from sabench.api import Film, FoundParticles, ParticleSolver


class Brightest(ParticleSolver):
    """A particle in the middle of the volume, the same in every frame."""

    name = "brightest"
    references = ("none",)

    def solve(self, case: Film) -> list[FoundParticles]:
        middle = np.asarray([np.mean(axis) for axis in case.grid.axes_mm])[None]
        return [FoundParticles(middle, None, track=np.array([7])) for _ in case]
'''


@pytest.mark.parametrize("name", NAMES.split())
def test_the_old_names_are_there(name: str) -> None:
    assert hasattr(sabench.api, name)


def test_old_names_are_those_of_the_same_things() -> None:
    assert Film is ImageSequence
    target = Target("checkerboard", 2, 1, 1.0, 0.0)
    case = CalibrationCase(target, np.zeros((0, 1, 2, 2)), (), *np.ones((3, 1, 2, 3)))
    assert case.rough_mm is case.initial_mm


def test_an_old_plug_in_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "solvers").mkdir()
    (tmp_path / "solvers" / "brightest.py").write_text(OLD)
    monkeypatch.setenv("SABENCH_PLUGINS", str(tmp_path))
    plugins.mount()
    solver = make_algorithm("brightest", {})
    scene = load_scene(plugins.bundled_folder("scenes") / "conformance" / "particles.toml")
    film = Film.of([simulate(scene, seed=1).observation] * 2)
    found = solver.solve(film)  # type: ignore[arg-type]
    assert isinstance(found, list)
    assert [np.asarray(one.trajectory).tolist() for one in found] == [[7], [7]]
    assert solver.task == "particles"
