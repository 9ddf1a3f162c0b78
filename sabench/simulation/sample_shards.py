"""Independent samples of a scene, generated into shards with a description.

Any process may make a shard, in any order; the manifest of the data set is merged from what the
writers noted of theirs. README.md is a data card, croissant.json metadata in the format Croissant
1.0 (https://docs.mlcommons.org/croissant/docs/croissant-spec.html), samples.csv an index of
samples. None of them holds truth.
"""

import contextlib
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from sabench.dataset import schema
from sabench.dataset.sample_set import SampleSet, open_samples
from sabench.dataset.shards import (
    Compression,
    Shard,
    ShardContents,
    ShardFolder,
    TruthKind,
    check_shares,
)
from sabench.dataset.writer import list_versions, with_copies
from sabench.scenes import Scene, build_rig
from sabench.simulation.pipeline import check_affordable, load_checked, locked, worker_pool
from sabench.simulation.recording.parts import Job
from sabench.simulation.recording.schedule import Schedule, UnfinishedError, run_schedule
from sabench.simulation.shard_job import PLAN, ShardJob, ShardMaker
from sabench.utils.backend import Renderer, choose_renderer
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, put_in_place, refuse_existing, sha256

CROISSANT, CARD = "croissant.json", "README.md"
_COLUMNS = {"number": "sc:Integer", "split": "sc:Text", "shard": "sc:Text", "row": "sc:Integer"}
_MEANINGS = {
    "number": "number of the sample",
    "split": "train, validation, test, ...",
    "shard": "name of the files observation/NAME.h5 and truth/NAME.h5",
    "row": "row of the sample in the arrays of its shard, from 0",
}
_TERMS = (  # of the vocabulary "cr"
    "citeAs column equivalentProperty extract field fileObject fileProperty fileSet format "
    "includes isLiveDataset jsonPath key md5 parentField path recordSet references regex "
    "repeated replace samplingRate separator source subField transform"
)
_CONTEXT = {name: f"cr:{name}" for name in _TERMS.split()} | {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "sc": "https://schema.org/",
}


def write_card(root: Path, head: dict[str, Any], title: str, shards: Sequence[Shard]) -> None:
    """Write all three into a data set in the making.

    Parameters
    ----------
    head : keys of its manifest.
    """
    lines = [
        ",".join(_COLUMNS),
        *(
            f"{number},{shard.split},{shard.name},{row}"
            for shard in shards
            for row, number in enumerate(shard.numbers.tolist())
        ),
    ]
    (root / schema.INDEX).write_text("\n".join(lines) + "\n", encoding="utf-8")
    sides = list(schema.SIDES)
    (root / CARD).write_text(_card(head, title, shards), encoding="utf-8")
    text = canonical_json(_croissant(root, head, title, sides))
    (root / CROISSANT).write_text(text, encoding="utf-8")


def _croissant(root: Path, head: dict[str, Any], title: str, sides: list[str]) -> dict[str, Any]:
    """Make the metadata: the shards as sets of files, the index as records."""
    index = {
        "@type": "cr:FileObject",
        "@id": schema.INDEX,
        "name": schema.INDEX,
        "contentUrl": schema.INDEX,
        "encodingFormat": "text/csv",
        "sha256": sha256(root / schema.INDEX),
    }
    sets = [
        {
            "@type": "cr:FileSet",
            "@id": side,
            "name": side,
            "encodingFormat": "application/x-hdf5",
            "includes": f"{side}/*.h5",
        }
        for side in sides
    ]
    fields = [
        {
            "@type": "cr:Field",
            "@id": f"samples/{name}",
            "name": name,
            "description": _MEANINGS[name],
            "dataType": kind,
            "source": {"fileObject": {"@id": schema.INDEX}, "extract": {"column": name}},
        }
        for name, kind in _COLUMNS.items()
    ]
    records = {"@type": "cr:RecordSet", "@id": "samples", "name": "samples", "field": fields}
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": head["scene"],
        "description": f"{head['samples']} synthetic samples with known truth: {title}",
        "version": "2.0.0",
        "distribution": [index, *sets],
        "recordSet": [records],
    }


def _card(head: dict[str, Any], title: str, shards: Sequence[Shard]) -> str:
    counts: dict[str, int] = {}
    for shard in shards:
        counts[shard.split] = counts.get(shard.split, 0) + len(shard.numbers)
    frames, cameras, rows, columns = head["shape"]
    splits = "\n".join(f"| {name} | {count} |" for name, count in counts.items())
    truth = ", ".join(head["truth"]) or "seeds and drawn values"
    return "\n".join(
        [
            f"# {head['scene']}",
            f"\n{title}\n",
            "Synthetic images of particles with known truth, generated by sabench "
            f"{head['versions']['sabench']}: {head['samples']} independent samples of "
            f"{frames} frame(s) by {cameras} camera(s) of {rows} x {columns} pixels, 16 bit.\n",
            f"| split | samples |\n|---|---|\n{splits}\n",
            "A sample's split follows from a hash of its number; no sample is in two.\n",
            "- `observation/`: images and nominal cameras, what an experimenter has.",
            f"- `truth/`: what a solver that is judged must not see: {truth}.",
            f"- `{schema.INDEX}`: number, split, shard and row of every sample.",
            f"- `{schema.SCENE}`: the scene, which tells how the samples vary.",
            f"- `{schema.MANIFEST}`: sizes and SHA-256 of all files; `sabench verify` checks them.",
            "\nShards are HDF5 files, whose arrays `docs/formats/samples.md` of sabench describes. "
            'In Python, `sabench.open_samples(FOLDER, "train")` reads them.\n',
            f"Limits: renderings (renderer `{head['renderer']}`) of ideal particles through "
            "modelled optics and sensors, without dirt, vibration and faults of real recordings "
            "unless the scene has them.\n",
        ]
    )


_SHARD_BYTES, _MOST_SAMPLES = 64_000_000, 1000  # of grey values in a shard, and of samples


def generate_samples(
    scene: Scene | str | Path,
    out: str | Path,
    *,
    samples: int,
    split: Sequence[float] = (100.0,),
    seed: int = 0,
    backend: Renderer = "splat",
    truth: Sequence[TruthKind] = ("particles", "views"),
    compression: Compression = "none",
    size: int | None = None,
    name: str | None = None,
    overwrite: bool = False,
    jobs: int = 1,
    scheduler: str | None = None,
) -> SampleSet:
    """Generate independent samples in shards, resuming an interrupted run.

    They are those of `stream` with the same scene, seed and renderer. The bytes do not
    depend on the number or order of workers.

    Parameters
    ----------
    scene : with particles alone; also a file, or the name of a bundled scene.
    out : the folder to make.
    split : shares of training, validation and test samples, and of further splits.
    backend : "splat" or "mitsuba".
    truth : kinds that are kept: "particles"; "views", their images in each camera; "radiance", the
        images without noise.
    compression : "gzip" makes shards smaller, and slower to read.
    size : samples of a shard; by default 64 MB of grey values, and at most 1000.
    name, overwrite, jobs, scheduler : as for `generate`.

    Raises InputError as `stream`; an existing folder, an unfinished data set of something else, a
    full disk, or shards that failed again and again.
    """
    counts = {"samples": samples, "jobs": jobs, "size": 1 if size is None else size}
    loaded, label = load_checked(scene, name, seed, **counts)
    check_shares(split)
    target, kept = Path(out).absolute(), ShardContents(tuple(truth), compression)
    rig = build_rig(loaded, label)
    pixels = len(rig.cameras) * loaded.cameras.rows * loaded.cameras.columns * loaded.frames
    size = size or min(_MOST_SAMPLES, max(1, _SHARD_BYTES // (2 * pixels)))
    base = Job(loaded, seed, choose_renderer("splat" if backend == "auto" else backend), label)
    job = ShardJob(base, samples, tuple(float(share) for share in split), size, kept)
    refuse_existing(target, overwrite=overwrite)
    copies = samples if compression == "none" else 1
    check_affordable(label, loaded, rig, target.parent, copies=copies)
    with _folder(target, job, overwrite=overwrite) as root:
        shards = job.shards
        maker = ShardMaker(job, root)  # finds faults of the scene before anything is rendered
        doing = f"make shards of {label} with {base.renderer}"
        with worker_pool(root, maker, jobs, scheduler) as workers:
            schedule = Schedule(len(shards), 0, chained=False, ahead=workers.ahead)
            run_schedule(workers, schedule, doing, name=lambda task: shards[task.frame].name)
        merge_shards(job, ShardFolder(root))
        put_in_place(target, root / "data")
    return open_samples(target)


@contextlib.contextmanager
def _folder(target: Path, job: ShardJob, *, overwrite: bool) -> Iterator[Path]:
    """Lock the folder of a data set's shards, next to the data set.

    It is removed when the data set is complete, or if there is no shard, and kept otherwise.
    """
    root = target.parent / f".{target.name}.shards"
    root.mkdir(parents=True, exist_ok=True)
    try:
        with locked(root, target), _cleaned(root):
            if overwrite and job.changes(root):
                for name in ("data", "entries"):
                    shutil.rmtree(root / name, ignore_errors=True)
                (root / PLAN).unlink()
            job.write(root)
            shutil.rmtree(root / "making", ignore_errors=True)
            yield root
    except OSError as error:
        why = f"{error.filename}: {error.strerror}" if error.filename else str(error)
        raise InputError(
            f"{target}: {why}; finished shards are kept: run the same command again to resume"
        ) from error


@contextlib.contextmanager
def _cleaned(root: Path) -> Iterator[None]:
    """Remove a folder in the end, unless shards are left in it."""
    try:
        yield
    finally:
        if not any(root.glob("entries/*.json")) or not (root / "data").is_dir():
            shutil.rmtree(root, ignore_errors=True)


def merge_shards(job: ShardJob, folder: ShardFolder) -> None:
    """Write the manifest from what was noted of each shard, without its pixels."""
    base, key = job.job, job.job.key  # the key takes milliseconds, and there may be 10,000 shards
    entries = [folder.note(shard, base.seed, key) for shard in job.shards]
    shards = tuple(entry for entry in entries if entry is not None)
    if len(shards) < len(entries):
        raise UnfinishedError(f"{folder.root}: expected a note of each shard; run it again")
    root = folder.data
    shutil.rmtree(root / schema.GIVEN, ignore_errors=True)
    (root / schema.SCENE).write_text(with_copies(base.scene, root).to_toml(), encoding="utf-8")
    head: dict[str, Any] = {
        "version": schema.SAMPLES_VERSION,
        "samples": job.samples,
        "shares": list(job.shares),
        "size": job.size,
        "shape": list(job.shape),
        "truth": list(job.kept.truth),
        "scene": base.label,
        "scene_hash": base.scene.hash,
        "seed": base.seed,
        "renderer": base.renderer,
        "key": key,
        "versions": list_versions(),
        "shards": [entry.model_dump() for entry in shards],
    }
    write_card(root, head, base.scene.title, job.shards)
    in_shards = {name: file for entry in shards for name, file in entry.files.items()}
    listed = schema.list_files(root, in_shards)
    files = {name: entry for name, entry in listed.items() if name not in in_shards}
    whole = schema.content_hash(files | in_shards)
    schema.write_manifest(root, files, content_hash=whole, **head)
