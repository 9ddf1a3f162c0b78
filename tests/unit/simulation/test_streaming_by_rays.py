"""Streams whose images Mitsuba traces, on LLVM and on a GPU."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sabench.simulation.in_memory import simulate
from sabench.utils.arrays import U16
from tests.unit.simulation.test_streaming import all_samples, make_scene

STREAM = """
import sys
import numpy as np
from tests.unit.simulation.test_streaming import all_samples, make_scene
scene = make_scene(illumination={"pulse_energy_mj": 0.6})  # no pixel is full
samples = all_samples(scene, samples=2, backend="mitsuba")
np.save(sys.argv[1], [one.images for one in samples])
"""
CUDA = "from sabench.utils import backend; print(backend.choose().kind)"


def run(code: str, kind: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run code in a process of its own, on LLVM or CUDA."""
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env=os.environ | {"SABENCH_BACKEND": kind},
        capture_output=True,
        text=True,
        check=False,
    )


def images_on(kind: str, folder: Path) -> U16:
    """Stream images (sample, frame, camera, row, column) on LLVM or CUDA."""
    file = folder / f"{kind}.npy"
    done = run(STREAM, kind, str(file))
    assert done.returncode == 0, done.stderr
    found: U16 = np.load(file)
    return found


@pytest.mark.slow
def test_a_traced_stream_is_what_simulate_traces_and_as_bright_as_the_analytic_one() -> None:
    scene = make_scene(illumination={"pulse_energy_mj": 0.6})  # no pixel is full
    traced = all_samples(scene, samples=2, backend="mitsuba")
    for one, splat in zip(traced, all_samples(scene, samples=2), strict=True):
        shot = simulate(one.scene, seed=one.seed, backend="mitsuba")
        np.testing.assert_array_equal(one.images[0], shot.observation.images)
        np.testing.assert_array_equal(one.particles[0].position_mm, splat.particles[0].position_mm)
        dark = scene.sensor.black_level_dn * one.images.size
        assert one.images.max() < scene.sensor.white_dn
        assert one.images.sum() - dark == pytest.approx(splat.images.sum() - dark, rel=1e-3)


def test_a_traced_stream_on_a_gpu_is_that_on_llvm(tmp_path: Path) -> None:
    if run(CUDA, "cuda").returncode:
        pytest.skip("needs a CUDA device")
    on_gpu, on_cpu = (images_on(kind, tmp_path).astype(float) for kind in ("cuda", "llvm"))
    # single precision rounds rays differently: light by less than a grey value
    apart = np.abs(on_gpu - on_cpu)
    assert apart.max() <= 1.0
    assert (apart > 0.0).mean() < 0.02
    assert on_gpu.sum() == pytest.approx(on_cpu.sum(), rel=1e-5)
