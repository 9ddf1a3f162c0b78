"""The whole chain from a scene to a score, its two ends, and its invariants."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sabench
from sabench import tasks
from sabench.api.make import make_solver
from sabench.dataset.reader import Dataset
from sabench.dataset.results import result_writer
from sabench.dataset.schema import image_name
from sabench.dataset.verification import verify
from sabench.scenes import load_scene
from sabench.simulation.in_memory import simulate, simulate_sequence
from sabench.utils.files import sha256
from tests.conftest import Command, pinholes
from tests.helpers.commands import local_page, refuse, succeed
from tests.helpers.plug_ins import write_plug_in


def test_pictures_show_the_particles_where_the_truth_says(quick: Dataset) -> None:
    """Rendering, projection and axes agree; the data set is intact and rendered."""
    assert verify(quick.root) == []
    assert quick.manifest.renderer == "mitsuba"
    assert quick.observation(0).images.shape == (4, 240, 320)
    assert quick.observation(0).images.dtype == np.uint16
    case = quick.observation(0)
    for image, view in zip(case.images, quick.views(0), strict=True):
        seen = view.pixel[view.visible > 0]
        bright = np.argwhere(image > case.black_dn + 0.1 * (case.white_dn - case.black_dn))[:, ::-1]
        distance = np.linalg.norm(bright[:, None] - seen[None], axis=2).min(axis=1)
        assert len(bright) > 300
        assert distance.max() < 2.5


def test_same_seed_same_bytes_other_seed_other_bytes(quick: Dataset, tmp_path: Path) -> None:
    again = sabench.generate("quick", tmp_path / "again", seed=1, backend="mitsuba")
    assert again.manifest == quick.manifest
    for name in quick.manifest.files:
        assert sha256(again.root / name) == sha256(quick.root / name)
    other = sabench.generate("quick", tmp_path / "other", seed=2, backend="splat")
    assert other.content_hash != quick.content_hash


def test_a_shot_in_memory_is_the_frame_that_is_written(tmp_path: Path) -> None:
    scene = load_scene("quick")
    written = sabench.generate("quick", tmp_path / "set", seed=3, backend="splat")
    shot, stored = simulate(scene, seed=3), written.observation(0)
    np.testing.assert_array_equal(shot.observation.images, stored.images)
    for name in ("grid", "black_dn", "white_dn", "cameras"):
        assert getattr(shot.observation, name) == getattr(stored, name)
    np.testing.assert_array_equal(shot.particles.position_mm, written.particles(0).position_mm)
    for mine, theirs in zip(shot.views, written.views(0), strict=True):
        np.testing.assert_array_equal(mine.pixel, theirs.pixel)
        np.testing.assert_array_equal(mine.photons, theirs.photons)


def test_frames_do_not_depend_on_how_many_there_are(tmp_path: Path) -> None:
    scenes = [load_scene("quick").with_frames(n) for n in (1, 3)]
    few, many = (
        sabench.generate(one, tmp_path / str(one.frames), seed=3, backend="splat", name="s")
        for one in scenes
    )
    for frame, shot in enumerate(simulate_sequence(scenes[1], seed=3)):
        for one in (simulate(scenes[1], seed=3, frame=frame).observation, many.observation(frame)):
            np.testing.assert_array_equal(shot.observation.images, one.images)
    for camera in few.setup.cameras:
        name = image_name(camera.name, 0, "tif")
        assert sha256(few.root / name) == sha256(many.root / name)
    np.testing.assert_array_equal(few.particles(0).position_mm, many.particles(0).position_mm)


@pytest.mark.slow
def test_both_solvers_find_particles(quick: Dataset, quick_result: Path, tmp_path: Path) -> None:
    multiplicative = sabench.score(quick, quick_result)
    assert multiplicative["q"] > 0.6
    assert multiplicative["recall"] > 0.85  # particles that one camera sees dark are lost
    assert multiplicative["precision"] > 0.3  # and weak ghosts pass the automatic threshold
    assert multiplicative["rms_px"] < 0.4
    sabench.solve("asa", quick, tmp_path / "asa.h5", parameters={"k": 12.0})
    assert 0.5 < sabench.score(quick, tmp_path / "asa.h5")["q"] < multiplicative["q"]


@pytest.mark.slow
def test_a_solver_without_the_wall_is_lost(quick: Dataset, tmp_path: Path) -> None:
    """Cameras that ignore the glass and the water reconstruct almost nothing. This is the point of
    the project."""
    case = quick.observation(0)
    cameras = tuple(replace(camera, wall=None) for camera in pinholes(case.cameras))
    blind = replace(case, cameras=cameras)
    with result_writer(tmp_path / "blind.h5", quick, "blind", "reconstruction", {}) as writer:
        writer.add(make_solver("msa", {}).solve(blind))
    assert sabench.score(quick, tmp_path / "blind.h5")["recall"] < 0.05


@pytest.mark.slow
def test_auto_renderer_falls_back_without_mitsuba(own_process: Command, tmp_path: Path) -> None:
    broken = {"DRJIT_LIBLLVM_PATH": "/nowhere/libLLVM.so", "SABENCH_BACKEND": "llvm"}
    done = succeed(own_process("generate", "quick", "-o", tmp_path / "fallback", env=broken))
    assert "splat" in done.stdout
    words = ("generate", "quick", "-o", tmp_path / "asked", "--backend", "mitsuba")
    refuse(own_process(*words, env=broken), "/nowhere/libLLVM.so", "karellen-llvm-core")


@pytest.mark.slow
def test_steps_at_the_command_line(command: Command, quick: Dataset, tmp_path: Path) -> None:
    assert command("verify", quick.root).returncode == 0
    succeed(command("solve", "msa", quick.root, "-o", "r.h5", "-p", "k=2.5", "-p", "keep=whole"))
    scores = json.loads(command("score", quick.root, "r.h5", "--json").stdout)
    about = "dataset task solver parameters seconds peak_mb compile_s isolated whole_process"
    task = tasks.of("reconstruction")
    assert set(scores) == {*about.split(), *(one.key for one in (*task.scores, *task.curve))}
    assert scores["dataset"] == quick.content_hash
    assert scores["parameters"]["k"] == 2.5
    assert scores["seconds"] > 0
    assert scores["peak_mb"] > 50


BAD = """
class Parameters(Parameters):
    die: bool = False

def solve(self, case):
    if self.parameters.die:
        os.abort()
    raise RuntimeError("no luck <script>")
"""


@pytest.mark.slow
def test_suite_makes_records_and_page_and_survives_a_failing_solver(
    own_process: Command, command: Command, tmp_path: Path
) -> None:
    write_plug_in(tmp_path / "mine", "solvers", "bad", BAD)
    (tmp_path / "suite.toml").write_text(
        'title = "t"\nscenes = ["quick"]\nbackend = "splat"\n[[solvers]]\nname = "bad"\n'
        '[[solvers]]\nname = "bad"\nparameters = { die = true }\n'
        '[[solvers]]\nname = "msa"\n'
    )
    environment = {"SABENCH_PLUGINS": str(tmp_path / "mine")}
    done = own_process("run", "suite.toml", "--json", env=environment)
    assert done.returncode == 1, done.stderr
    raised, died, good = json.loads(done.stdout)
    assert "RuntimeError: no luck" in raised["error"]
    assert "signal SIGABRT" in died["error"]
    assert good["error"] is None
    assert good["q"] > 0.6
    page = local_page(tmp_path)
    assert "no luck \\u003cscript>" in page
    assert "no luck <script>" not in page
    succeed(command("board"))
