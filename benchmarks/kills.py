"""Generation killed at random moments and resumed: the data set is the same.

`python benchmarks/kills.py [TIMES FRAMES]` prints JSON, and exits 1 if it is not. A third argument,
`samples`, makes FRAMES independent samples in shards of ten in place of a sequence.

TIMES (50) runs of FRAMES (500) frames with two processes are killed by `kill -9` at a moment that
is uniform over the time that an undisturbed run takes: alternately the scheduler, a worker, or the
whole process group. The same command is then started again and must end with the content hash of
the undisturbed run.
"""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import sabench
from sabench.scenes import load_scene, parse_scene
from sabench.utils.progress import progress_bar

_WHOM = ("scheduler", "worker", "group")


def scene_file(folder: Path, frames: int) -> Path:
    """Make the scene: small images of few particles, many tasks in little time."""
    values = load_scene("quick").to_dict()
    values["particles"] = {"generator": "uniform", "count": 50}
    values["flow"] = {
        "generator": "abc_flow",
        "wavelength_mm": 30.0,
        "a_mm_s": 40.0,
        "b_mm_s": 30.0,
        "c_mm_s": 20.0,
    }
    values["cameras"] |= {
        "rows": 48,
        "columns": 64,
        "layout": {"kind": "grid", "columns": 2, "rows": 1, "spacing_mm": [240.0, 240.0]},
    }
    file = folder / "scene.toml"
    file.write_text(
        parse_scene(values | {"frames": frames, "interval_s": 0.02}, "kills").to_toml(),
        encoding="utf-8",
    )
    return file


def start(scene: Path, out: Path, more: Sequence[str]) -> subprocess.Popen[bytes]:
    """Generate in a process group of its own, with more words of the command."""
    words = [
        sys.executable,
        "-m",
        "sabench",
        "generate",
        str(scene),
        "-o",
        str(out),
        "--backend",
        "splat",
        "--jobs",
        "2",
        *more,
    ]
    return subprocess.Popen(
        words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )


def workers(pid: int) -> list[int]:
    """List the processes that a process has started."""
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text()
    return [int(word) for word in text.split()]


def kill(process: subprocess.Popen[bytes], whom: str) -> bool:
    """Kill one of them, or all; returns whether there was something to kill."""
    if process.poll() is not None:
        return False
    if whom == "group":
        os.killpg(process.pid, signal.SIGKILL)
    elif whom == "scheduler":
        process.kill()
    else:
        found = workers(process.pid)
        if not found:
            return False
        os.kill(random.choice(found), signal.SIGKILL)
    return True


def run_to_end(scene: Path, out: Path, more: Sequence[str]) -> str:
    """Run the command to its end; returns the content hash."""
    with start(scene, out, more) as process:
        process.wait()
    return sabench.open_samples(out).content_hash


def kill_and_resume(scene: Path, out: Path, more: Sequence[str], whom: str, within_s: float) -> str:
    """Kill once, then run to the end; returns the content hash.

    The moment is one at which there is something to kill.
    """
    killed = False
    while not killed:
        shutil.rmtree(out, ignore_errors=True)
        with start(scene, out, more) as process:
            time.sleep(random.uniform(0.0, within_s))
            killed = kill(process, whom)
            process.wait()
    if out.is_dir():
        return sabench.open_samples(out).content_hash
    return run_to_end(scene, out, more)


def main() -> None:
    """Print one JSON object."""
    times, frames = (int(sys.argv[1]), int(sys.argv[2])) if len(sys.argv) >= 3 else (50, 500)
    shards = sys.argv[3:] == ["samples"]
    more = ["--samples", str(frames), "--shard-size", "10", "--split", "80/10/10"] * shards
    random.seed(1)
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        scene, begun = scene_file(folder, 2 if shards else frames), time.perf_counter()
        expected = run_to_end(scene, folder / "undisturbed", more)
        took = time.perf_counter() - begun
        same, killed = 0, dict.fromkeys(_WHOM, 0)
        for number in progress_bar(range(times), "kill and go on"):
            whom, out = _WHOM[number % 3], folder / str(number)
            same += kill_and_resume(scene, out, more, whom, took) == expected
            killed[whom] += 1
            left = [entry.name for entry in folder.glob(f".{number}.*")]
            assert not left, left
            shutil.rmtree(out)
    print(
        json.dumps(
            {
                "samples" if shards else "frames": frames,
                "seconds_undisturbed": round(took, 1),
                "times": times,
                "killed": killed,
                "same_hash": same,
            },
            indent=1,
        )
    )
    sys.exit(same != times)


if __name__ == "__main__":
    main()
