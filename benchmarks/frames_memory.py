"""Growth of memory with the number of frames: python benchmarks/frames_memory.py.

Generates (Mitsuba), solves and scores the quick scene with few and with many frames, each step in a
child process, and prints the peak resident memory of each and the growth per added frame.
Buffers of Mitsuba and Dr.Jit fill over the first dozens of renders and then stay.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from sabench.scenes import load_scene
from sabench.utils.progress import progress_bar

_FRAMES = (25, 50, 100)
_PEAK = """
from pathlib import Path
lines = Path("/proc/self/status").read_text().splitlines()
print([line.split()[1] for line in lines if line.startswith("VmHWM")][0])
"""
_STEPS = {
    "generate": "import sabench; "
    "sabench.generate('{folder}/scene.toml', '{folder}/set', seed=1, backend='mitsuba')",
    "solve": "import sabench; sabench.solve('msa', '{folder}/set', '{folder}/result.h5')",
    "score": "import sabench; sabench.score('{folder}/set', '{folder}/result.h5')",
}


def peak_mib(code: str) -> float:
    """Measure the peak resident memory of a process that runs `code`."""
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\n{_PEAK}"], capture_output=True, text=True, check=True
    )
    return int(done.stdout.split()[-1]) / 1024.0


def main() -> None:
    """Print one JSON object."""
    scene = load_scene("quick")
    peaks: dict[str, list[float]] = {step: [] for step in _STEPS}
    with tempfile.TemporaryDirectory() as work:
        for frames, (step, code) in progress_bar(
            [(n, item) for n in _FRAMES for item in _STEPS.items()], "steps"
        ):
            folder = Path(work, str(frames))
            folder.mkdir(exist_ok=True)
            (folder / "scene.toml").write_text(
                scene.model_copy(update={"frames": frames}).to_toml(), encoding="utf-8"
            )
            peaks[step].append(round(peak_mib(code.format(folder=folder)), 1))
    growth = {
        step: round((values[-1] - values[-2]) / (_FRAMES[-1] - _FRAMES[-2]), 3)
        for step, values in peaks.items()
    }
    print(
        json.dumps({"frames": _FRAMES, "peak_mib": peaks, "mib_per_added_frame": growth}, indent=1)
    )


if __name__ == "__main__":
    main()
