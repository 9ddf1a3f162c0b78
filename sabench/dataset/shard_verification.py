"""Verification of shards: each sample in one of them, and in its split."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from sabench.dataset import schema
from sabench.dataset.hdf5 import walk
from sabench.dataset.hdf5_probe import probe
from sabench.dataset.shard_writer import describe
from sabench.dataset.splits import Shard, plan_shards
from sabench.dataset.stored_shard import StoredShard
from sabench.utils.errors import InputError
from sabench.utils.files import inside
from sabench.utils.processes.call import read_isolated
from sabench.utils.progress import progress_bar

Try = Callable[[Callable[[], object]], Iterator[str]]


def check_plan(root: Path, contents: schema.ShardedContents) -> None:
    """Check that the shards hold every sample once, in its split.

    Raises
    ------
    InputError
        A shard that is missing, doubled or of other samples.
    """
    path, entries = root / schema.MANIFEST, contents.shards
    stored = sum(file.bytes for entry in entries for file in entry.files.values())
    if contents.samples > stored:
        raise InputError(
            f"{path}: samples: expected as many as {stored} bytes can hold, got {contents.samples}"
        )
    expected = {one.name: one for one in plan_shards(*_plan(contents))}
    counts = Counter(entry.name for entry in entries)
    sides = schema.SIDES[: 1 if isinstance(contents, schema.SamplesObservationManifest) else 2]
    for name in sorted({*counts, *expected}):
        if counts[name] != 1 or name not in expected:
            raise InputError(
                f"{path}: shards: expected {name} {int(name in expected)} time(s), got "
                f"{counts[name]}"
            )
    for entry in entries:
        _check_entry(path, entry, expected[entry.name], sides)


def _check_entry(path: Path, entry: schema.ShardEntry, shard: Shard, sides: Sequence[str]) -> None:
    if entry != describe(shard, entry.files):
        raise InputError(
            f"{path}: shards: {entry.name}: expected {len(shard.numbers)} samples from "
            f"{shard.numbers[0]} to {shard.numbers[-1]} of {shard.split}, got {entry.samples} from "
            f"{entry.first} to {entry.last} of {entry.split}"
        )
    names = [schema.shard_file(side, entry.name) for side in sides]
    if sorted(entry.files) != names:
        raise InputError(
            f"{path}: shards: {entry.name}: expected the files {', '.join(names)}, got "
            f"{', '.join(entry.files)}"
        )


def shard_faults(root: Path, contents: schema.ShardedContents, attempt: Try) -> Iterator[str]:
    """Find shards whose arrays contradict the manifest, or each other."""
    files = [name for entry in contents.shards for name in entry.files]
    size = sum(file.bytes for entry in contents.shards for file in entry.files.values())
    if list(attempt(lambda: read_isolated(_walk_all, root, files, size_bytes=size))):
        for name in files:  # one of them, in a process of its own
            yield from attempt(partial(probe, inside(root, name)))
        return
    entries = {entry.name: entry for entry in contents.shards}
    for shard in progress_bar(plan_shards(*_plan(contents)), "verify shards"):
        stored = StoredShard(root, contents, entries[shard.name])
        yield from attempt(partial(stored.check, shard.numbers))
        stored.close()


def _plan(contents: schema.ShardedContents) -> tuple[int, tuple[float, ...], int]:
    return contents.samples, contents.shares, contents.size


def _walk_all(root: Path, names: Sequence[str]) -> None:
    for name in names:
        walk(inside(root, name))
