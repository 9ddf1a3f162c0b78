"""Statistics of scenes' images beside those of real recordings, as a table in Markdown.

    python benchmarks/recording_statistics.py [--frames N] [--seed N] [--json FILE]

Particles move by 8 pixels a frame, so that what stays is the sensor and the background. Figures of
the recordings are published ones of two public examples of 8 bit, a cavity with four cameras
(OpenPTV) and a jet with three (MyPTV), lowest to highest camera; they were measured by another
program, so that definitions may differ.
"""

import argparse
import json
import tempfile
import tomllib
from pathlib import Path

from sabench.apps.recordings import Measured, measure_dataset
from sabench.cli.own_recordings import ROWS, cell
from sabench.scenes import parse_scene
from sabench.scenes.loading import find
from sabench.simulation.pipeline import generate

_SCENES = ("standard-particles", "realistic-particles")
_VELOCITY_MM_S = [400.0, 0.0, 0.0]
_RECORDED = {  # cavity, jet
    "saturated": ("0.6-0.85", "0-0.4"),
    "background_p5": ("20", "11"),
    "background_p95": ("77", "41"),
    "fixed": ("2.9", "5.5"),
    "temporal": ("0.6-1.9", "0.9"),
    "width_p10": ("0.5", "0.5"),
    "width_p90": ("2.1", "2.9"),
    "ln_flux": ("1.0", "0.5-1.3"),
    "ln_ratio": ("", "0.42"),
    "ln_ratio_robust": ("", "0.27"),
}


def measure_scene(name: str, frames: int, seed: int) -> Measured:
    """Generate a scene's frames with moving particles and measure their images."""
    values = tomllib.loads(find(name, "scenes").read_text(encoding="utf-8"))
    values["frames"] = frames
    values["particles"]["velocity_mm_s"] = _VELOCITY_MM_S
    with tempfile.TemporaryDirectory() as folder:
        scene = parse_scene(values, f"{name}, moving")
        dataset = generate(scene, Path(folder) / name, seed=seed, backend="splat", name=name)
        return measure_dataset(dataset, frames)


def table(scenes: dict[str, Measured]) -> str:
    """Write the table: a column for each scene, and the two recordings."""
    medians = [one.medians() for one in scenes.values()]
    heads = [*(f"`{name}`" for name in scenes), "recording: cavity", "recording: jet"]
    lines = ["| median over the cameras | " + " | ".join(heads) + " |", "|---" * (len(heads) + 1)]
    lines[1] += "|"
    for label, key, factor, decimals in ROWS:
        own = [cell(one.get(key), factor, decimals) for one in medians]
        cells = [label, *own, *(text or "-" for text in _RECORDED.get(key, ("", "")))]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Print the table; write all cameras' figures to a file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    scenes = {name: measure_scene(name, chosen.frames, chosen.seed) for name in _SCENES}
    if chosen.json:
        text = json.dumps({name: one.to_json() for name, one in scenes.items()}, indent=1)
        chosen.json.write_text(text + "\n", encoding="utf-8")
    print(table(scenes))


if __name__ == "__main__":
    main()
