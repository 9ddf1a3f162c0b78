"""Both renderers on the realistic scene and on the clean one: centroids, light and widths."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from benchmarks.renderers import Comparison, compare_renderers
from sabench.scenes import build_rig, find, parse_scene

CASES = ("standard-particles", "realistic-particles")


def compare(name: str, samples: int) -> Comparison:
    """Compare the renderers in one camera of 100 x 130 pixels, at an edge of the array."""
    values = tomllib.loads(find(name, "scenes").read_text(encoding="utf-8"))
    values["cameras"] |= {"rows": 100, "columns": 130}
    values["volume"]["size_mm"] = [6.5, 5.0, 4.0]
    values["grid"]["crop_mm"] = [0.5, 0.5, 0.0]
    values["render"] = {"samples_per_pixel": samples}
    scene = parse_scene(values, name)
    return compare_renderers(scene, build_rig(scene), 2)


@pytest.mark.parametrize("name", CASES)
def test_rays_and_formulas_agree(name: str) -> None:
    """Rays through the middles of n x n parts make a pixel narrower by 1 / 12 n2 px2."""
    found = compare(name, 9)
    assert len(found.light) > 40
    assert np.abs(found.shift_px).max() < 1e-3
    assert found.light == pytest.approx(1.0, abs=5e-4)
    fine = compare(name, 49)
    assert np.abs(fine.width - 1.0).max() < 0.3 * np.abs(found.width - 1.0).max()
    assert fine.width == pytest.approx(1.0, abs=2e-3)
