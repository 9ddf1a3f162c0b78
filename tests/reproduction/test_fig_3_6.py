"""Figure 3-6: points from the literature."""

from __future__ import annotations

import numpy as np
import pytest

from reproduction import chapter_3
from sabench.scenes import build_rig, load_scene
from sabench.simulation.in_memory import simulate


def test_the_slice_has_the_voxels_and_the_angles_of_the_paper() -> None:
    scene = load_scene("atkinson-1000x1x200")
    rig = build_rig(scene)
    assert rig.grid.shape[::-1] == (1000, 1, 200)
    angles = [np.degrees(np.arctan2(c.center_mm[0], -c.center_mm[2])) for c in rig.cameras]
    assert angles == pytest.approx([-30.0, 0.0, 30.0], abs=0.01)
    shot = simulate(scene, seed=1)
    assert len(shot.particles) == 50
    assert abs(50 / 1000 / 3 - 0.0167) < 1e-4
    for camera in rig.cameras:
        pixels = camera.project(shot.particles.position_mm)[0]
        assert ((pixels > 0) & (pixels < [999, 8])).all()


def test_iterations_remove_ghosts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chapter_3, "_SLICES", 3)
    curve = [chapter_3._Point(5, 85.0, 200.0, 0.0), chapter_3._Point(25, 85.0, 5.0, 0.0)]
    rows = list(chapter_3._atkinson_rows([1], curve))
    ghosts = [row.measured or 0.0 for row in rows if row.name.endswith("ghost %")]
    assert len(ghosts) == 3
    assert ghosts == sorted(ghosts, reverse=True)
    true = [row.measured or 0.0 for row in rows if row.name.endswith("true %")]
    assert min(true) > 85.0
    assert rows[-1].verdict == "reproduced"
    assert rows[-1].note.endswith("[25] cameras")
