"""Shards of independent samples: which sample is in which, and their writer.

A sample's split follows from a hash of its number, and a shard holds samples of one split: no
sample can be in two splits, for any number of samples and workers. Observations of many samples are
in one file, their truth in another. A process that is killed leaves neither; the entry of a shard
is written last and completes it.
"""

import contextlib
import itertools
import json
import os
import shutil
import tempfile
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from sabench.api.truth import Particles, ParticleView
from sabench.dataset import schema
from sabench.dataset.hdf5 import create_hdf5, delay_interrupts
from sabench.utils.arrays import F32, I64, U8, U16
from sabench.utils.errors import InputError
from sabench.utils.files import atomic_file, canonical_json, read_json, sha256
from sabench.utils.validation import validate


def split_of(number: int, shares: Sequence[float]) -> str:
    """Name the split of a sample: "train", "validation", "test", "split-3" and on.

    It follows from a hash of its number, so that it does not depend on the number of samples.
    """
    return split_names(len(shares))[int(_splits([number], shares)[0])]


def _splits(numbers: Iterable[int], shares: Sequence[float]) -> I64:
    """Return the numbers (n,) of samples' splits."""
    check_shares(shares)
    hashes = np.array([zlib.crc32(n.to_bytes(8, "little")) for n in numbers])
    places = hashes / 2.0**32 * sum(shares)
    ends = list(itertools.accumulate(shares))
    return np.minimum(np.searchsorted(ends, places, side="right"), len(shares) - 1)


def split_names(count: int) -> list[str]:
    """Name a number of splits."""
    return ["train", "validation", "test", *(f"split-{n}" for n in range(3, count))][:count]


def check_shares(shares: Sequence[float]) -> None:
    """Refuse shares that no sample can be divided by."""
    if not shares or min(shares) < 0.0 or not 0.0 < sum(shares) < float("inf"):
        raise InputError(
            f"split: expected shares of 0 or more, not all of them 0, got {list(shares)}"
        )


@dataclass(frozen=True)
class Shard:
    """Samples of one shard.

    Attributes
    ----------
    name : "train-00000" and on; of its files, too.
    split : of all its samples.
    numbers : (n,) of its samples, ascending.
    """

    name: str
    split: str
    numbers: I64


def plan_shards(samples: int, shares: Sequence[float], size: int) -> list[Shard]:
    """Divide samples from 0 on into shards of at most `size`, split by split.

    All shards of a split but its last are full.
    """
    splits = _splits(range(samples), shares)
    return [
        Shard(f"{name}-{place:05d}", name, numbers[first : first + size])
        for split, name in enumerate(split_names(len(shares)))
        for numbers in [np.flatnonzero(splits == split)]
        for place, first in enumerate(range(0, len(numbers), size))
    ]


TruthKind = Literal["particles", "views", "radiance"]
Compression = Literal["none", "gzip"]
_MAKING = "making"  # folder of shards that are being written


@dataclass(frozen=True)
class SampleRecord:
    """One sample, as a shard stores it.

    Attributes
    ----------
    number, seed, drawn, redrawn : as those of a stream's sample.
    setup, true_cameras : what cameras.json and true_cameras.json of a data set hold.
    images : (frame, camera, row, column) grey values.
    particles : of each frame.
    views : of each frame and camera.
    radiance : (frame, camera, row, column), where it is kept.
    """

    number: int
    seed: int
    drawn: dict[str, Any]
    redrawn: int
    setup: dict[str, Any]
    true_cameras: dict[str, Any] | None
    images: U16
    particles: tuple[Particles, ...]
    views: tuple[tuple[ParticleView, ...], ...]
    radiance: F32 | None


@dataclass(frozen=True)
class ShardContents:
    """Contents of shards: the kinds of truth, and how pixels are compressed."""

    truth: tuple[TruthKind, ...] = ("particles", "views")
    compression: Compression = "none"

    def __post_init__(self) -> None:
        for word in self.truth:
            if word not in get_args(TruthKind):
                raise InputError(
                    f"truth: expected some of {', '.join(get_args(TruthKind))}, got {word!r}"
                )
        if "views" in self.truth and "particles" not in self.truth:
            raise InputError("truth: expected particles wherever there are views of them")
        if self.compression not in get_args(Compression):
            raise InputError(f"compression: expected none or gzip, got {self.compression!r}")


class ShardFolder:
    """Folder where processes make the shards of one data set.

    Attributes
    ----------
    data : the data set in the making.
    """

    def __init__(self, root: Path) -> None:
        self.root, self.data = root, root / "data"

    def read(self, shard: Shard, seed: int, key: str) -> schema.ShardEntry | None:
        """Read the entry of a shard; None unless both of its files are there and intact."""
        if (entry := self.note(shard, seed, key)) is None:
            return None
        for name, file in entry.files.items():
            path = self.data / name
            if not path.is_file() or path.stat().st_size != file.bytes:
                return None
            if sha256(path) != file.sha256:
                return None
        return entry

    def note(self, shard: Shard, seed: int, key: str) -> schema.ShardEntry | None:
        """Read the note of a shard's writer; None without one of these samples."""
        path = self._note(shard)
        if not path.is_file():
            return None
        try:
            origin = validate(schema.ShardOrigin, read_json(path), str(path))
        except InputError:  # damaged: it is made again
            return None
        same = (origin.seed, origin.key) == (seed, key)
        files = origin.entry.files
        return origin.entry if same and origin.entry == describe_shard(shard, files) else None

    def write(
        self,
        shard: Shard,
        samples: Iterable[SampleRecord],
        shape: tuple[int, int, int, int],
        kept: ShardContents,
        origin: tuple[int, str],
    ) -> None:
        """Write the shard of samples that are made one after the other.

        Parameters
        ----------
        shape : of each sample's images.
        origin : seed and key of the stream.
        """
        names = [schema.shard_file(side, shard.name) for side in schema.SIDES]
        with self._making(shard) as making:
            paths = [making / f"{side}.h5" for side in schema.SIDES]
            _write_files(paths, len(shard.numbers), samples, shape, kept)
            files = {
                name: schema.FileEntry.of(path) for name, path in zip(names, paths, strict=True)
            }
            for name, path in zip(names, paths, strict=True):
                with path.open("rb") as file:
                    os.fsync(file.fileno())
                (self.data / name).parent.mkdir(parents=True, exist_ok=True)
                path.replace(self.data / name)
        seed, key = origin
        note = schema.ShardOrigin(seed=seed, key=key, entry=describe_shard(shard, files))
        with atomic_file(self._note(shard)) as partial:
            partial.write_text(canonical_json(note.model_dump(mode="json")), encoding="utf-8")

    @contextlib.contextmanager
    def _making(self, shard: Shard) -> Iterator[Path]:
        """Make a folder of this process's own for as long as the block runs."""
        if not self.data.is_dir():
            raise InputError(f"{self.root}: expected a data set that is being made, but it is gone")
        (self.root / _MAKING).mkdir(exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f"{shard.name}-", dir=self.root / _MAKING))
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _note(self, shard: Shard) -> Path:
        return self.root / "entries" / f"{shard.name}.json"


def describe_shard(shard: Shard, files: dict[str, schema.FileEntry]) -> schema.ShardEntry:
    """Describe a shard with the files that hold it."""
    return schema.ShardEntry(
        name=shard.name,
        split=shard.split,
        first=int(shard.numbers[0]),
        last=int(shard.numbers[-1]),
        samples=len(shard.numbers),
        files=files,
    )


def _write_files(
    paths: Sequence[Path],
    count: int,
    samples: Iterable[SampleRecord],
    shape: tuple[int, int, int, int],
    kept: ShardContents,
) -> None:
    """Write both files of a shard; its pixels are never in memory together."""
    with contextlib.ExitStack() as stack:
        opened = [stack.enter_context(create_hdf5(path)) for path in paths]
        (seen, check_seen), (truth, check_truth) = opened
        collected = _Collected()
        with delay_interrupts():
            for file in (seen, truth):
                file.attrs["format"], file.attrs["version"] = schema.FORMAT, schema.SAMPLES_VERSION
            images = _pixels(seen, "images", (count, *shape), "u2", kept)
            light = None
            if "radiance" in kept.truth:
                light = _pixels(truth, "radiance", (count, *shape), "f4", kept)
        for row, one in enumerate(samples):
            _check_shape(one, shape)
            with delay_interrupts():
                images[row] = one.images
                if light is not None:
                    light[row] = one.radiance
            check_seen()
            check_truth()
            collected.add(one)
        with delay_interrupts():
            collected.store(seen, truth, kept)


def _pixels(file: Any, name: str, shape: tuple[int, ...], kind: str, kept: ShardContents) -> Any:
    """Make a data set of images; compressed ones lie in chunks of one image."""
    packed = kept.compression == "gzip"
    chunks = {"chunks": (1, 1, 1, *shape[3:]), **schema.PACK} if packed else {}
    return file.create_dataset(name, shape, dtype=kind, **chunks)


def _check_shape(one: SampleRecord, shape: tuple[int, int, int, int]) -> None:
    if one.images.shape != shape:
        raise InputError(
            f"sample {one.number}: expected images (frame, camera, row, column) of one shape in "
            f"all samples, got {shape} and {one.images.shape}"
        )


@dataclass
class _Texts:
    """Different JSON values of samples, and which one each sample has."""

    values: list[Any] = field(default_factory=list)
    places: dict[str, int] = field(default_factory=dict)
    rows: list[int] = field(default_factory=list)

    def add(self, value: Any) -> None:
        text = canonical_json(value)
        place = self.places.setdefault(text, len(self.values))
        if place == len(self.values):
            self.values.append(json.loads(text))
        self.rows.append(place)


class _Collected:
    """All of a shard's samples but their pixels."""

    def __init__(self) -> None:
        self._samples: list[SampleRecord] = []
        self._setups, self._true = _Texts(), _Texts()

    def add(self, one: SampleRecord) -> None:
        """Keep what is small of a sample."""
        self._setups.add(one.setup)
        if one.true_cameras is not None:
            self._true.add(one.true_cameras)
        self._samples.append(replace(one, images=np.empty_like(one.images[:0]), radiance=None))

    def store(self, seen: Any, truth: Any, kept: ShardContents) -> None:
        """Store it in the files of both sides."""
        rows = self._samples
        for file in (seen, truth):
            file["number"] = np.array([one.number for one in rows])
        seen["setups"], seen["setup"] = as_text(self._setups.values), np.array(self._setups.rows)
        if self._true.rows:
            truth["true_cameras"] = as_text(self._true.values)
            truth["true_camera"] = np.array(self._true.rows)
        truth["seed"] = np.array([one.seed for one in rows])
        truth["redrawn"] = np.array([one.redrawn for one in rows])
        truth["drawn"] = as_text([one.drawn for one in rows])
        if "particles" in kept.truth:
            frames = [one for sample in self._samples for one in sample.particles]
            ends = np.cumsum([len(one) for one in frames])
            truth["particles/end"] = ends.reshape(len(self._samples), -1)
            for one in Particles.ARRAYS:
                own = [getattr(particles, one.name) for particles in frames]
                truth[f"particles/{one.label}"] = np.concatenate(own)
        if "views" in kept.truth:
            of_frames = [one for sample in self._samples for one in sample.views]
            for one in ParticleView.ARRAYS:
                stacked = [
                    np.stack([getattr(v, one.name) for v in views], axis=1) for views in of_frames
                ]
                truth[f"views/{one.label}"] = one.to_file(np.concatenate(stacked))


def as_text(value: Any) -> U8:
    """Encode a JSON value as bytes (n,)."""
    return np.frombuffer(canonical_json(value).encode(), dtype=np.uint8)
