"""Samples in shards: 10,000 of `quick`, epochs through loaders, resumption and growth.

`python benchmarks/shards.py generate|resume|epochs|kills|growth|dask FOLDER [SAMPLES]` prints JSON.

- **generate**: SAMPLES (10,000) of `quick` into FOLDER by two processes: seconds, files, bytes, and
  the memory of the largest process; then seconds of `sabench verify`.
- **resume**: a stream that goes on at 20 random places of FOLDER, in batches of 1 to 8, is
  compared bit by bit with what is stored there.
- **epochs**: samples a second, and a CPU second with imports, and the most memory, of an epoch
  through each loader that is installed, each in a process of its own.
- **kills**: SAMPLES (20) of small images in shards of two, 50 times: the process is killed by
  `kill -9` at a moment that is uniform over the time of an undisturbed run, another one goes on,
  and its hash is compared. `benchmarks/kills.py` kills workers and schedulers of several, too.
- **growth**: a plan of 1,000,000 samples in shards of 100 for 1 to 1,000 simulated workers, with
  measured times of shards, of a task's exchange and of what one process does before and after.
- **dask**: shards a second by 1, 2, 4 and 8 processes of a Dask cluster on this machine.
"""

import functools
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import sabench
from benchmarks.generation import Times, measure_independent, round_all, simulate_workers, small
from sabench.dataset.schema import FileEntry, ShardOrigin, shard_file
from sabench.dataset.shards import ShardContents, ShardFolder, describe_shard
from sabench.scenes import load_scene
from sabench.simulation.recording.parts import Job
from sabench.simulation.recording.schedule import ProcessPool, RecordingTask, Schedule, run_schedule
from sabench.simulation.sample_shards import generate_samples, merge_shards
from sabench.simulation.shard_job import ShardJob, ShardMaker
from sabench.utils.progress import progress_bar

_SPLIT = "80/10/10"
_SHARES = (80.0, 10.0, 10.0)
_WORKERS = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1000)
_BATCH = 32


def peak_mb(who: int) -> float:
    """Return the most memory that a process had."""
    return resource.getrusage(who).ru_maxrss / 1024.0


def generate(folder: Path, samples: int) -> dict[str, Any]:
    """Generate the samples, and verify them."""
    words = [sys.executable, "-m", "sabench"]
    start = time.perf_counter()
    made = ["--samples", str(samples), "--split", _SPLIT, "--seed", "1", "--jobs", "2"]
    subprocess.run([*words, "generate", "quick", "-o", str(folder), *made], check=True)
    took = time.perf_counter() - start
    peak = peak_mb(resource.RUSAGE_CHILDREN)
    files = [path for path in folder.rglob("*") if path.is_file()]
    start = time.perf_counter()
    subprocess.run([*words, "verify", str(folder)], check=True)
    return {
        "samples": samples,
        "seconds": took,
        "samples_per_s": samples / took,
        "files": len(files),
        "gigabytes": 1e-9 * sum(path.stat().st_size for path in files),
        "peak_mb_of_a_process": peak,
        "verify_s": time.perf_counter() - start,
    }


def resume(folder: Path, samples: int) -> dict[str, Any]:
    """Compare streams from random places with what is stored."""
    stored = sabench.open_samples(folder)
    places = {one.number: row for row, one in enumerate(stored)}
    rng = np.random.default_rng(1)
    same = 0
    for start in progress_bar(rng.integers(0, len(stored), 20).tolist(), "go on"):
        batch = int(rng.integers(1, 9))
        again = next(sabench.stream("quick", seed=1, batch=batch, start=start, samples=len(stored)))
        for one in again.samples:
            other = stored[places[one.number]]
            np.testing.assert_array_equal(one.images, other.images)
            np.testing.assert_array_equal(
                one.particles[0].position_mm, other.particles[0].position_mm
            )
        same += 1
    return {"places": 20, "same": same}


def kills(folder: Path, samples: int) -> dict[str, Any]:
    """Kill runs and go on."""
    folder.mkdir(parents=True)
    start = time.perf_counter()
    os.waitpid(_fork(folder / "undisturbed", samples), 0)
    took = time.perf_counter() - start
    expected = sabench.open_samples(folder / "undisturbed").content_hash
    same, shards = 0, []
    for number in progress_bar(range(50), "kill and go on"):
        out, killed = folder / str(number), False
        while not killed:
            shutil.rmtree(out, ignore_errors=True)
            pid = _fork(out, samples)
            time.sleep(random.uniform(0.0, took))
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            killed = not out.is_dir()
        shards.append(len(list(folder.glob(f".{number}.shards/entries/*.json"))))
        os.waitpid(_fork(out, samples), 0)
        same += sabench.open_samples(out).content_hash == expected
        assert not list(folder.glob(f".{number}.*")), number
        shutil.rmtree(out)
    return {"samples": samples, "times": 50, "same_hash": same, "finished_shards_at_kill": shards}


def _fork(out: Path, samples: int) -> int:
    """Generate in a process that has all modules loaded; returns its number."""
    pid = os.fork()
    if pid == 0:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        generate_samples(small(2), out, samples=samples, split=_SHARES, size=2, seed=1)
        os._exit(0)
    return pid


def growth(folder: Path, samples: int) -> dict[str, Any]:
    """Simulate many workers with measured times."""
    folder.mkdir(parents=True)
    start = time.perf_counter()
    plan = _job(1_000_000, 100)
    count = len(plan.shards)
    before = time.perf_counter() - start
    job = _job(600, 100)
    job.write(folder / "timed")
    maker = ShardMaker(job, folder / "timed")
    seconds = [_seconds(maker, number) for number in range(4)]
    times = Times(seconds, [], merge_s(plan, folder / "merged") / count, exchange_s(folder))
    took = {
        n: simulate_workers(count, 0, n, times, chained=False)
        for n in progress_bar(_WORKERS, "simulate workers")
    }
    serial = before + times.end * count
    speed = {n: (took[1] + serial) / (one + serial) for n, one in took.items()}
    return {
        "shards": count,
        "seconds_of_a_shard": seconds,
        "seconds_before": before,
        "seconds_of_merging": times.end * count,
        "ms_per_task": 1e3 * times.scheduler,
        "speed": speed,
        "share_of_linear": {n: one / n for n, one in speed.items()},
    }


def _job(samples: int, size: int) -> ShardJob:
    own = Job(load_scene("quick"), 1, "splat", "quick")
    return ShardJob(own, samples, _SHARES, size, ShardContents())


def _seconds(maker: ShardMaker, number: int) -> float:
    start = time.perf_counter()
    maker(RecordingTask(number))
    return time.perf_counter() - start


def merge_s(job: ShardJob, root: Path) -> float:
    """Measure the seconds of merging the notes of all shards."""
    folder = ShardFolder(root)
    (root / "entries").mkdir(parents=True)
    folder.data.mkdir()
    key = job.job.key
    for shard in job.shards:
        files = {
            shard_file(side, shard.name): FileEntry(bytes=1, sha256="0" * 64)
            for side in ("observation", "truth")
        }
        note = ShardOrigin(seed=1, key=key, entry=describe_shard(shard, files))
        (root / "entries" / f"{shard.name}.json").write_text(note.model_dump_json())
    start = time.perf_counter()
    merge_shards(job, folder)
    return time.perf_counter() - start


def exchange_s(folder: Path) -> float:
    """Measure the seconds that another process's task takes beyond its own work."""
    own = Job(small(1), 1, "splat", "small")
    job, root = ShardJob(own, 2000, _SHARES, 2, ShardContents()), folder / "exchange"
    job.write(root)
    _work_off(job, root)
    again = _work_off(job, root)
    maker, start = ShardMaker(job, root), time.perf_counter()
    for number in range(len(job.shards)):
        maker(RecordingTask(number))
    return max(again - (time.perf_counter() - start), 0.0) / len(job.shards)


def _work_off(job: ShardJob, root: Path) -> float:
    pool = ProcessPool(root, 1, threads=1)
    for worker in pool.idle():
        pool.give(worker, RecordingTask(0))
    pool.wait()
    start = time.perf_counter()
    schedule = Schedule(len(job.shards), 0, chained=False, ahead=pool.ahead)
    run_schedule(pool, schedule, "exchange tasks")
    pool.close()
    return time.perf_counter() - start


def dask(folder: Path, samples: int) -> dict[str, Any]:
    """Measure the rate of Dask workers."""
    from distributed import LocalCluster

    rates = {}
    for workers in (1, 2, 4, 8):
        with LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=None
        ) as cluster:
            address = cluster.scheduler_address
            for name, count in (("warm", 10 * workers), ("timed", samples)):
                start = time.perf_counter()
                generate_samples(
                    "quick",
                    folder / f"{name}-{workers}",
                    samples=count,
                    size=10,
                    scheduler=address,
                )
                took = time.perf_counter() - start
        rates[workers] = samples / took
    alone = {count: count * measure_independent(count) for count in (1, 2, 4, 8)}
    return {
        "samples": samples,
        "samples_per_s": rates,
        "gain": {n: rate / rates[1] for n, rate in rates.items()},
        "gain_of_independent_processes": {n: one / alone[1] for n, one in alone.items()},
        "cores": os.cpu_count(),
    }


def numpy_in_order(folder: Path) -> Iterator[int]:
    """Count samples of batches in the order on disk."""
    for batch in sabench.open_samples(folder, "train").batches(_BATCH):
        yield len(batch.images)


def numpy_shuffled(folder: Path) -> Iterator[int]:
    """Count samples of shuffled batches."""
    for batch in sabench.open_samples(folder, "train").batches(_BATCH, shuffle=1):
        yield len(batch.images)


def numpy_with_truth(folder: Path) -> Iterator[int]:
    """Count samples of shuffled batches whose particles are read, too."""
    for batch in sabench.open_samples(folder, "train").batches(_BATCH, shuffle=1):
        yield len(batch.arrays(400)["position_mm"])


def torch_by_index(folder: Path) -> Iterator[int]:
    """Count samples of PyTorch's loader with two workers, shuffled."""
    from torch.utils.data import DataLoader

    from sabench.interop.training.torch_data import TorchSamples

    own = TorchSamples(sabench.open_samples(folder, "train"))
    for batch in DataLoader(own, _BATCH, shuffle=True, **_SPAWNED):
        yield len(batch["images"])


def torch_in_batches(folder: Path) -> Iterator[int]:
    """Count samples of batches that PyTorch's two workers share."""
    from torch.utils.data import DataLoader

    from sabench.interop.training.torch_data import TorchBatches

    samples = sabench.open_samples(folder, "train")
    own = TorchBatches(functools.partial(samples.batches, _BATCH, shuffle=1))
    for batch in DataLoader(own, batch_size=None, **_SPAWNED):
        yield len(batch["images"])


def jax_shuffled(folder: Path) -> Iterator[int]:
    """Count samples of shuffled batches on JAX's device."""
    from sabench.interop.training.jax_data import jax_batches

    for batch in jax_batches(sabench.open_samples(folder, "train").batches(_BATCH, shuffle=1)):
        yield len(batch["images"].block_until_ready())


def hugging_face(folder: Path) -> Iterator[int]:
    """Count samples of the package datasets, in order, as numpy arrays."""
    from sabench.interop.training.hugging_face import hugging_face_samples

    samples = sabench.open_samples(folder, "train")
    for _ in hugging_face_samples(samples).with_format("numpy"):
        yield 1


_SPAWNED: dict[str, Any] = {"num_workers": 2, "multiprocessing_context": "spawn"}
EPOCHS: dict[str, Callable[[Path], Iterator[int]]] = {
    "numpy, in order": numpy_in_order,
    "numpy, shuffled": numpy_shuffled,
    "numpy, shuffled, with positions": numpy_with_truth,
    "torch by index, 2 workers": torch_by_index,
    "torch in batches, 2 workers": torch_in_batches,
    "jax, shuffled": jax_shuffled,
    "datasets, in order": hugging_face,
}


def epochs(folder: Path, samples: int) -> dict[str, Any]:
    """Measure an epoch through each loader."""
    measured = {}
    for name in EPOCHS:
        words = [sys.executable, __file__, "epoch", str(folder), name]
        done = subprocess.run(words, stdout=subprocess.PIPE, check=False)
        if done.returncode == 0:  # else its library is not installed, and it says so
            measured[name] = json.loads(done.stdout)
    return measured


def epoch(folder: Path, name: str) -> dict[str, Any]:
    """Measure an epoch through one loader in this process."""
    start = time.perf_counter()
    count = sum(EPOCHS[name](folder))
    took = time.perf_counter() - start
    used = [resource.getrusage(one) for one in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    cpu_s = sum(one.ru_utime + one.ru_stime for one in used)
    return {
        "samples": count,
        "seconds": took,
        "samples_per_s": count / took,
        "samples_per_cpu_s": count / cpu_s,
        "peak_mb": max(one.ru_maxrss for one in used) / 1024.0,
    }


STAGES = {
    "generate": generate,
    "resume": resume,
    "epochs": epochs,
    "kills": kills,
    "growth": growth,
    "dask": dask,
}


def main() -> None:
    """Print one JSON object."""
    stage, folder = sys.argv[1], Path(sys.argv[2])
    if stage == "epoch":
        print(json.dumps(epoch(folder, sys.argv[3])))
        return
    default = {"dask": 400, "kills": 20}.get(stage, 10_000)
    samples = int(sys.argv[3]) if len(sys.argv) > 3 else default
    print(json.dumps(round_all({stage: STAGES[stage](folder, samples)}), indent=1))


if __name__ == "__main__":
    main()
