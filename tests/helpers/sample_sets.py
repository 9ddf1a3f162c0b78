"""Small data set of samples that vary, of two frames and with cameras that are off."""

from pathlib import Path
from typing import Any

from sabench.dataset.sample_set import SampleSet
from sabench.scenes import Scene
from sabench.simulation.sample_shards import generate_samples
from tests.unit.simulation.test_streaming import VARIED, make_scene, vary

SHARES = (60.0, 25.0, 15.0)
COUNT, SIZE = 21, 4


def scene() -> Scene:
    """Two frames, values that vary, and cameras that are off."""
    return make_scene(
        frames=2,
        interval_s=0.01,
        flow={"generator": "linear_flow", "velocity_mm_s": [10.0, 0.0, 0.0]},
        calibration={"shift_px": 0.5},
        vary=vary(**VARIED),
    )


def make(folder: Path, **options: Any) -> SampleSet:
    given: dict[str, Any] = {"samples": COUNT, "split": SHARES, "size": SIZE, "seed": 4} | options
    return generate_samples(given.pop("scene", None) or scene(), folder, **given)
