"""Speed and memory of a time-resolved sequence.

`python benchmarks/sequence.py [FRAMES PARTICLES]` prints JSON.

Nine cameras of 1000 x 1000 pixels look at PARTICLES (125,000) that a flow carries; the splat
renderer writes FRAMES (100) frames and their truth in a child process, which records its
resident memory at every frame: its slope over all but the first tenth, with a standard error, is
what a frame costs. A particle-image is one particle in one camera's image of one frame. Its rate
is compared with the time that writing as many bytes takes.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.stats import linregress

from sabench.scenes import Scene, build_rig, load_scene, parse_scene

_CHILD = """
import json, pathlib, sys, time
import sabench
from sabench.simulation.recording.parts import Parts

def memory(name):
    lines = pathlib.Path("/proc/self/status").read_text().splitlines()
    return [int(line.split()[1]) / 1024.0 for line in lines if line.startswith(name)][0]

seen, put = [], Parts.put_frame
def noting(self, frame, part):
    seen.append(memory("VmRSS"))
    put(self, frame, part)
Parts.put_frame = noting
start = time.perf_counter()
sabench.generate(sys.argv[1], sys.argv[2], seed=1, backend="splat")
print(json.dumps([time.perf_counter() - start, memory("VmHWM"), seen]))
"""


def scene_of(frames: int, particles: int) -> Scene:
    """Make the scene: the demo's tank and cameras, and a chaotic flow.

    It moves particles by up to six pixels a frame.
    """
    values = load_scene("demo").to_dict()
    values["particles"] = {"generator": "uniform", "count": particles, "diameter_mm": 0.02}
    values["flow"] = {
        "generator": "abc_flow",
        "wavelength_mm": 20.0,
        "a_mm_s": 100.0,
        "b_mm_s": 80.0,
        "c_mm_s": 60.0,
    }
    return parse_scene(values | {"frames": frames, "interval_s": 0.001}, "sequence")


def measure_generation(scene: Scene, folder: Path) -> tuple[float, float, list[float]]:
    """Measure seconds, peak MiB and MiB at every frame of generating a scene.

    A child process generates it.
    """
    (folder / "scene.toml").write_text(scene.to_toml(), encoding="utf-8")
    command = [sys.executable, "-c", _CHILD, str(folder / "scene.toml"), str(folder / "set")]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    seconds, peak, seen = json.loads(done.stdout)
    return seconds, peak, seen


def write_rate(folder: Path) -> float:
    """Measure the bytes a second that a file takes."""
    block, start = bytes(1 << 24), time.perf_counter()
    with (folder / "zeros").open("wb") as file:
        for _ in range(32):
            file.write(block)
        file.flush()
    return 32 * len(block) / (time.perf_counter() - start)


def main() -> None:
    """Print one JSON object."""
    frames, particles = (
        (int(sys.argv[1]), int(sys.argv[2])) if len(sys.argv) == 3 else (100, 125_000)
    )
    with tempfile.TemporaryDirectory() as work:
        seconds, peak, seen = measure_generation(scene_of(frames, particles), Path(work))
        size = sum(path.stat().st_size for path in Path(work, "set").rglob("*") if path.is_file())
        rate = write_rate(Path(work))
    cameras, later = len(build_rig(load_scene("demo")).cameras), np.array(seen[frames // 10 :])
    fit = linregress(np.arange(len(later)), later)
    print(
        json.dumps(
            {
                "frames": frames,
                "cameras": cameras,
                "particles": particles,
                "seconds": round(seconds, 1),
                "million_particle_images_per_s": round(
                    frames * cameras * particles / seconds / 1e6, 3
                ),
                "gigabytes": round(size / 1e9, 2),
                "seconds_to_write_as_much": round(size / rate, 1),
                "peak_mib": round(peak, 1),
                "mib_per_frame": round(fit.slope, 3),
                "standard_error": round(fit.stderr, 3),
            },
            indent=1,
        )
    )


if __name__ == "__main__":
    main()
