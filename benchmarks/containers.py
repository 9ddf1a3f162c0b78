"""Containers of many samples: HDF5 shards, zarr shards and tar archives, side by side.

`python benchmarks/containers.py [SAMPLES]` prints a Markdown table. It needs zarr (3 or later),
which sabench does not.

SAMPLES (200) samples of `quick` are written into shards of 100 in each container: grey values in
chunks of one sample, particles as one ragged array with offsets (in a tar, as one .npy file for
each array and sample). It measures the time to write, the bytes, samples a second in order and at
random places with all files open, and the time to open the data set and read one sample. Files are
in the system's cache: a disk adds the time to fetch the bytes.
"""

import io
import shutil
import sys
import tarfile
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import zarr
from zarr.codecs import BloscCodec

from sabench.simulation.shard_job import Sample, stream
from sabench.utils.arrays import F64, U16

_SHARD, _READS = 100, 300
Pair = tuple[U16, F64]  # images and positions of a sample
Open = Callable[[int], Pair]  # reads a sample by its number


@dataclass(frozen=True)
class Container:
    """One way to write samples, and to open what was written."""

    name: str
    write: Callable[[Path, list[Sample]], None]
    open: Callable[[Path], Open]


def shards(samples: list[Sample]) -> Iterator[tuple[int, list[Sample], U16, F64, F64]]:
    """List shards: number, samples, images, positions one after the other, and their ends."""
    for number, first in enumerate(range(0, len(samples), _SHARD)):
        own = samples[first : first + _SHARD]
        positions = [one.particles[0].position_mm for one in own]
        ends = np.cumsum([len(one) for one in positions])
        yield number, own, np.stack([one.images for one in own]), np.concatenate(positions), ends


def write_hdf5(folder: Path, samples: list[Sample], **packing: Any) -> None:
    """Write one HDF5 file for each shard."""
    for number, _, images, positions, ends in shards(samples):
        with h5py.File(folder / f"{number}.h5", "w") as file:
            file.create_dataset("images", data=images, chunks=(1, *images.shape[1:]), **packing)
            file["position_mm"], file["end"] = positions, ends


def open_hdf5(folder: Path) -> Open:
    """Open all HDF5 files."""
    files = [h5py.File(folder / f"{n}.h5") for n in range(len(list(folder.iterdir())))]
    return _reader([(one["images"], one["position_mm"], one["end"][:]) for one in files])


def write_zarr(folder: Path, samples: list[Sample], compressor: Any) -> None:
    """Write one zarr group for each shard, whose arrays are one file each."""
    for number, _, images, positions, ends in shards(samples):
        group = zarr.create_group(str(folder / f"{number}.zarr"))
        group.create_array(
            "images",
            data=images,
            chunks=(1, *images.shape[1:]),
            shards=images.shape,
            compressors=compressor,
        )
        for name, value in (("position_mm", positions), ("end", ends)):
            group.create_array(name, data=value, compressors=None)


def open_zarr(folder: Path) -> Open:
    """Open all zarr groups."""
    groups: list[Any] = [
        zarr.open_group(str(folder / f"{n}.zarr"), mode="r")
        for n in range(len(list(folder.iterdir())))
    ]
    return _reader([(one["images"], one["position_mm"], one["end"][:]) for one in groups])


def _reader(opened: list[tuple[Any, Any, Any]]) -> Open:
    def read(number: int) -> Pair:
        images, positions, ends = opened[number // _SHARD]
        row = number % _SHARD
        return images[row], positions[ends[row - 1] if row else 0 : ends[row]]

    return read


def write_tar(folder: Path, samples: list[Sample]) -> None:
    """Write one archive for each shard, as WebDataset reads it."""
    for number, own, *_ in shards(samples):
        with tarfile.open(folder / f"{number}.tar", "w") as archive:
            for one in own:
                arrays: dict[str, Any] = {
                    "images": one.images,
                    "position_mm": one.particles[0].position_mm,
                }
                for name, value in arrays.items():
                    memory = io.BytesIO()
                    np.save(memory, value)
                    entry = tarfile.TarInfo(f"{one.number:08d}.{name}.npy")
                    entry.size = memory.tell()
                    memory.seek(0)
                    archive.addfile(entry, memory)


def open_tar(folder: Path) -> Open:
    """Open all archives; the index of their members is read first."""
    places: dict[str, tuple[Path, int, int]] = {}
    for file in folder.iterdir():
        with tarfile.open(file) as archive:
            for entry in archive:
                places[entry.name] = file, entry.offset_data, entry.size
    handles = {file: file.open("rb") for file in folder.iterdir()}

    def load(name: str) -> Any:
        file, offset, size = places[name]
        handles[file].seek(offset)
        return np.load(io.BytesIO(handles[file].read(size)))

    return lambda n: (load(f"{n:08d}.images.npy"), load(f"{n:08d}.position_mm.npy"))


CONTAINERS = (
    Container("HDF5", write_hdf5, open_hdf5),
    Container(
        "HDF5, shuffle and deflate 1",
        lambda folder, samples: write_hdf5(
            folder, samples, compression="gzip", compression_opts=1, shuffle=True
        ),
        open_hdf5,
    ),
    Container("zarr", lambda folder, samples: write_zarr(folder, samples, None), open_zarr),
    Container(
        "zarr, blosc zstd 1",
        lambda folder, samples: write_zarr(
            folder, samples, BloscCodec(cname="zstd", clevel=1, shuffle="bitshuffle")
        ),
        open_zarr,
    ),
    Container("tar", write_tar, open_tar),
)


def measure(container: Container, folder: Path, samples: list[Sample]) -> list[str]:
    """Measure a container; returns the cells of its row."""
    start = time.perf_counter()
    container.write(folder, samples)
    wrote = time.perf_counter() - start
    files = [one for one in folder.rglob("*") if one.is_file()]
    size = sum(one.stat().st_size for one in files)
    start = time.perf_counter()
    read = container.open(folder)
    read(0)
    opened = time.perf_counter() - start
    for one in samples[:: len(samples) // 5]:
        images, positions = read(one.number)
        np.testing.assert_array_equal(images, one.images)
        np.testing.assert_array_equal(positions, one.particles[0].position_mm)
    rates = []
    rng = np.random.default_rng(1)
    for numbers in (np.arange(len(samples)), rng.integers(0, len(samples), _READS)):
        start = time.perf_counter()
        for number in numbers.tolist():
            read(number)
        rates.append(len(numbers) / (time.perf_counter() - start))
    cells = [container.name, f"{len(files)}", f"{1e-6 * size:.0f}"]
    cells += [f"{len(samples) / wrote:.0f}", *(f"{rate:.0f}" for rate in rates)]
    return [*cells, f"{1e3 * opened:.0f}"]


def main() -> None:
    """Measure and print."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    batches = stream("quick", seed=1, batch=10, samples=count)
    samples = [one for batch in batches for one in batch.samples]
    print("| container | files | MB | written/s | in order/s | at random/s | opened in ms |")
    print("|---|---|---|---|---|---|---|")
    for container in CONTAINERS:
        folder = Path(tempfile.mkdtemp())
        try:
            print(f"| {' | '.join(measure(container, folder, samples))} |", flush=True)
        finally:
            shutil.rmtree(folder)


if __name__ == "__main__":
    main()
