"""Speed and memory of a time-resolved sequence: `python benchmarks/sequence.py [FRAMES PARTICLES]` prints JSON.

Nine cameras of 1000 x 1000 pixels look at PARTICLES (125,000) that a flow carries; the splat renderer writes FRAMES (100) frames and their truth and,
in a process of its own, a fifth as many: the difference of the peak memories is what frames cost. A particle-image is one particle in one
camera's image of one frame. Beside it stands the time that writing as many bytes takes.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from sabench.progress import track
from sabench.rig import build_rig, load_scene
from sabench.scene import Scene, parse_scene

_PEAK = "print([w.split()[1] for w in pathlib.Path('/proc/self/status').read_text().splitlines() if w.startswith('VmHWM')][0])"
_MAKE = (
    "import pathlib, time, sabench; start = time.perf_counter(); sabench.generate({scene!r}, {out!r}, seed=1, backend='splat'); "
    "print(time.perf_counter() - start)"
)


def scene_of(frames: int, particles: int) -> Scene:
    """The demo's tank and cameras; a chaotic flow that moves particles by up to six pixels a frame."""
    values = load_scene("demo").to_dict()
    values["particles"] = {"generator": "uniform", "count": particles, "diameter_mm": 0.02}
    values["flow"] = {"generator": "abc_flow", "wavelength_mm": 20.0, "a_mm_s": 100.0, "b_mm_s": 80.0, "c_mm_s": 60.0}
    return parse_scene(values | {"frames": frames, "interval_s": 0.001}, "sequence")


def made(scene: Scene, folder: Path) -> tuple[float, float, int]:
    """Seconds and peak MiB of generating a scene in a process of its own, and the bytes that it wrote."""
    folder.mkdir()
    (folder / "scene.toml").write_text(scene.to_toml(), encoding="utf-8")
    code = _MAKE.format(scene=str(folder / "scene.toml"), out=str(folder / "set"))
    done = subprocess.run([sys.executable, "-c", f"{code}\n{_PEAK}"], stdout=subprocess.PIPE, text=True, check=True)
    seconds, peak = done.stdout.split()
    size = sum(path.stat().st_size for path in (folder / "set").rglob("*") if path.is_file())
    return float(seconds), int(peak) / 1024.0, size


def write_rate(folder: Path) -> float:
    """Bytes a second that a file takes."""
    block, start = bytes(1 << 24), time.perf_counter()
    with (folder / "zeros").open("wb") as file:
        for _ in range(32):
            file.write(block)
        file.flush()
    return 32 * len(block) / (time.perf_counter() - start)


def main() -> None:
    """Print one JSON object."""
    frames, particles = (int(sys.argv[1]), int(sys.argv[2])) if len(sys.argv) == 3 else (100, 125_000)
    counts = [max(2, frames // 5), frames]
    with tempfile.TemporaryDirectory() as work:
        steps = [made(scene_of(count, particles), Path(work, str(count))) for count in track(counts, "sequences")]
        rate = write_rate(Path(work))
    cameras = len(build_rig(load_scene("demo")).cameras)
    seconds, _, size = steps[-1]
    print(json.dumps({
        "frames": frames, "cameras": cameras, "particles": particles, "seconds": round(seconds, 1),
        "million_particle_images_per_s": round(frames * cameras * particles / seconds / 1e6, 3), "gigabytes": round(size / 1e9, 2),
        "seconds_to_write_as_much": round(size / rate, 1), "peak_mib": [round(peak, 1) for _, peak, _ in steps],
        "mib_per_added_frame": round((steps[1][1] - steps[0][1]) / (counts[1] - counts[0]), 3),
    }, indent=1))  # fmt: skip


if __name__ == "__main__":
    main()
