"""Regression of the quick scene's figures. Report a change of them in the CHANGELOG."""

import json
from pathlib import Path

import numpy as np
import pytest

import sabench
from sabench.dataset.reader import Dataset

GOLDEN = Path(__file__).with_name("quick_statistics.json")


def measure(dataset: Dataset, result: Path) -> dict[str, float]:
    figures: dict[str, float] = {}
    for camera, radiance, grey in zip(
        dataset.setup.cameras, dataset.radiance(0), dataset.observation(0).images, strict=True
    ):
        figures |= {
            f"{camera.name} radiance": float(radiance.mean(dtype=np.float64)),
            f"{camera.name} grey": float(grey.mean()),
        }
    scores = sabench.score(dataset, result)
    return figures | {key: float(scores[key]) for key in ("q", "precision", "recall", "rms_px")}


def test_statistics(quick: Dataset, quick_result: Path, request: pytest.FixtureRequest) -> None:
    """Processors round single precision differently; scores move in steps of 1/255 particles."""
    figures = measure(quick, quick_result)
    if request.config.getoption("--update-golden"):
        GOLDEN.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    stored = json.loads(GOLDEN.read_text(encoding="utf-8"))
    assert list(figures) == list(stored)
    for key, value in figures.items():
        allowed = 1e-3 * stored[key] if key.startswith("camera") else 2 / 255
        assert value == pytest.approx(stored[key], abs=allowed), key
