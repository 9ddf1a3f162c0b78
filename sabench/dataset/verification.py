"""Verification of a data set: checksums of all bytes, shapes of all arrays.

A damaged file may kill the HDF5 library's process, so that files are probed in a limited child
process first.
"""

import functools
import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from sabench.dataset import schema
from sabench.dataset.hdf5 import walk
from sabench.dataset.reader import Dataset
from sabench.dataset.sample_set import open_samples
from sabench.dataset.shards import Shard, describe_shard, plan_shards
from sabench.dataset.stored_samples import StoredShard
from sabench.utils.errors import LISTED, MOST, InputError, UncheckedError, one_line
from sabench.utils.files import inside, is_file
from sabench.utils.processes.call import preload, read_isolated
from sabench.utils.progress import progress_bar

preload("sabench.dataset.hdf5")


def probe(path: Path) -> None:
    """Open an untrusted file in a child process, which HDF5 may not survive.

    Raises InputError if the file is damaged, the child process crashes or exceeds its limits.
    """
    read_isolated(walk, path)


def probe_dataset(root: Path) -> None:
    """Probe the HDF5 files of a data set, if it is one at all."""
    schema.read_manifest(root)
    for name in (schema.TRUTH, schema.POINTS):
        if is_file(root / name):
            probe(inside(root, name))


def _check_plan(root: Path, contents: schema.ShardedContents) -> None:
    """Check that the shards hold every sample once, in its split.

    Raises InputError for a shard that is missing, doubled or of other samples.
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
    if entry != describe_shard(shard, entry.files):
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


def _shard_faults(root: Path, contents: schema.ShardedContents) -> Iterator[str]:
    """Find shards whose arrays contradict the manifest, or each other."""
    files = [name for entry in contents.shards for name in entry.files]
    size = sum(file.bytes for entry in contents.shards for file in entry.files.values())
    if list(_try(lambda: read_isolated(_walk_all, root, files, size_bytes=size))):
        for name in files:  # one of them, in a process of its own
            yield from _try(partial(probe, inside(root, name)))
        return
    entries = {entry.name: entry for entry in contents.shards}
    for shard in progress_bar(plan_shards(*_plan(contents)), "verify shards"):
        stored = StoredShard(root, contents, entries[shard.name])
        yield from _try(partial(stored.check, shard.numbers))
        stored.close()


def _plan(contents: schema.ShardedContents) -> tuple[int, tuple[float, ...], int]:
    return contents.samples, contents.shares, contents.size


def _walk_all(root: Path, names: Sequence[str]) -> None:
    for name in names:
        walk(inside(root, name))


def verify(path: str | Path) -> list[str]:
    """Find a data set's faults: one short sentence each, the first twenty.

    Each names the file; the list is empty if the data set is intact.

    Raises UncheckedError if a file could not be checked in time, so the data set may be intact.
    """
    root = Path(path)
    if not root.is_dir():
        raise InputError(f"{root}: expected a data set folder, found none")
    try:
        manifest = schema.read_manifest(root)
    except InputError as error:
        return [_sentence(error)]
    # a file may claim any number of frames
    faults = list(itertools.islice(_byte_faults(root, manifest), MOST))
    if not faults:
        if isinstance(manifest, schema.ShardedContents):
            inner = _shard_faults(root, manifest)
        else:
            inner = _content_faults(Dataset(root, manifest))
        faults = list(itertools.islice(inner, MOST))
    return [one_line(fault, LISTED) for fault in faults]


def describe_contents(path: str | Path) -> str:
    """Say what samples or a recorded data set hold, to end a sentence; "" for others."""
    contents = schema.read_manifest(Path(path))
    if isinstance(contents, schema.ShardedContents):
        splits = ", ".join(f"{n} {name}" for name, n in open_samples(path).splits.items())
        return f"; {contents.samples} samples: {splits}"
    dataset = Dataset(Path(path), contents)
    if not dataset.recorded:
        return ""
    frames, cameras = dataset.setup.frames, len(dataset.setup.cameras)
    masks = "" if dataset.masked is None else ", masks"
    elsewhere = "" if dataset.references is None else f", images in {dataset.references.folder}"
    size = f"{frames} frame(s) of {cameras} camera(s)"
    return f"; recorded: {size}{masks}{elsewhere}; no truth, no scene"


def _byte_faults(root: Path, manifest: schema.Contents) -> Iterator[str]:
    files = manifest.all_files
    part = schema.ObservationManifest | schema.SamplesObservationManifest
    if not isinstance(manifest, part) and manifest.content_hash != schema.content_hash(files):
        yield f"{root / schema.MANIFEST}: its content_hash does not match its files"
    present = {
        entry.relative_to(root).as_posix()
        for entry in root.rglob("*")
        if entry.is_symlink() or not entry.is_dir()
    }
    if isinstance(manifest, schema.ShardedContents):
        yield from _try(lambda: _check_plan(root, manifest))
    for name in sorted(present - set(files) - {schema.MANIFEST}):
        yield f"{root / name}: a file that the manifest does not list"
    names = {entry.sha256: name for name, entry in files.items()}
    for name, entry in progress_bar(files.items(), "verify checksums"):
        try:
            file = inside(root, name)
            if not file.is_file():
                yield f"{file}: missing"
                continue
            got = schema.FileEntry.of(file)
            if got != entry:
                guess = (
                    f": {got.bytes} of {entry.bytes} are left" if got.bytes < entry.bytes else ""
                )
                if got.sha256 in names:
                    guess = f": they are those of {names[got.sha256]}"
                yield f"{file}: its bytes do not match the manifest{guess}"
        except (InputError, OSError) as error:
            yield _sentence(error)


def _content_faults(dataset: Dataset) -> Iterator[str]:
    """Find files that are as they were written, but contradict each other."""
    if deadly := list(_try(lambda: probe_dataset(dataset.root))):
        yield from deadly
        return
    if dataset.has_truth:
        yield from _try(lambda: _check_scene(dataset))
    if broken := list(_try(lambda: dataset.setup)):
        yield from broken
        return
    if not dataset.has_truth:
        yield from _observation_faults(dataset)
        return
    yield from _try(lambda: dataset.true_cameras)
    if dataset.shows_target:
        for whole in (dataset.calibration_case, dataset.placed, dataset.sightings):
            yield from _try(whole)
        return
    for frame in progress_bar(range(dataset.setup.frames), "verify shapes"):
        parts: list[Callable[[int], object]] = [dataset.observation, dataset.radiance]
        parts += [dataset.particles, dataset.views] if "particles" in dataset.shows else []
        parts += [dataset.bubbles, dataset.solids] if "bubbles" in dataset.shows else []
        for part in parts:
            yield from _try(functools.partial(part, frame))
        for camera in dataset.setup.cameras if "bubbles" in dataset.shows else ():
            yield from _try(functools.partial(dataset.sight, frame, camera))


def _observation_faults(dataset: Dataset) -> Iterator[str]:
    if dataset.shows_target:
        yield from _try(dataset.calibration_case)
        return
    if broken := list(_try(lambda: (dataset.masked, dataset.references))):
        yield from broken
        return
    if dataset.references is not None:
        yield from dataset.references.faults()
    for frame in progress_bar(range(dataset.setup.frames), "verify shapes"):
        yield from _try(functools.partial(dataset.observation, frame))


def _check_scene(dataset: Dataset) -> None:
    """Check that the resolved scene is the manifest's; its generator may be missing."""
    path, scene = inside(dataset.root, schema.SCENE), dataset.scene
    if scene.hash != dataset.manifest.scene_hash:
        raise InputError(
            f"{path}: its hash {scene.hash[:12]} is not the manifest's scene_hash "
            f"{dataset.manifest.scene_hash[:12]}"
        )


def _try(read: Callable[[], object]) -> Iterator[str]:
    try:
        read()
    except UncheckedError:
        raise
    except (InputError, ValueError) as error:
        yield _sentence(error)


def _sentence(error: Exception) -> str:
    """Describe the fault in one short sentence; of several faults it gives the first."""
    if isinstance(error, InputError) and len(error.faults) > 1:
        return one_line(f"{str(error).splitlines()[0]} {error.faults[0]}, ...", LISTED)
    return one_line(str(error), LISTED)
