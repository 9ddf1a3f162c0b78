"""Views of cameras: what is computed for one image."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sabench.scenes import build_rig, load_scene
from sabench.simulation import camera_view
from sabench.simulation.frames import Frames
from sabench.simulation.rendering import particles_splatted
from sabench.simulation.rendering.particle_images import ParticleImages, image_particles


def test_images_of_a_short_pulse_are_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene("quick")
    frame = Frames(scene, build_rig(scene), 1, "splat").at(0)
    calls: list[ParticleImages] = []

    def counted(*given: Any) -> ParticleImages:
        calls.append(image_particles(*given))
        return calls[-1]

    monkeypatch.setattr(camera_view, "image_particles", counted)
    view = camera_view.render(frame, 2)
    assert len(calls) == 1
    assert view.particles is calls[0]
    expected = particles_splatted.render(frame.rig.cameras[2], calls[0])
    np.testing.assert_array_equal(view.photons, expected)
