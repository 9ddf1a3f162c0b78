"""Commands on data: list, schema, generate, verify, export."""

from __future__ import annotations

import itertools
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from sabench import plugins
from sabench.cli import tables
from sabench.cli.options import (
    KINDS,
    AsJson,
    Cards,
    DataSet,
    Jobs,
    Overwrite,
    SceneName,
    complete_kind,
    complete_task,
    say,
    say_json,
)
from sabench.utils.errors import InputError

if TYPE_CHECKING:
    from sabench.plugins import Entry
    from sabench.scenes import Scene
    from sabench.utils.backend import Renderer


def list_all(
    kind: Annotated[
        str | None,
        typer.Option(
            metavar="KIND",
            help="List this kind only: generator, solver, scene or suite.",
            autocompletion=complete_kind,
        ),
    ] = None,
    task: Annotated[
        str | None,
        typer.Option(
            metavar="TASK",
            help="List the solvers of this task only.",
            autocompletion=complete_task,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List generators, solvers, scenes and suites."""
    entries, faults = _entries(kind)
    if task is not None:
        entries = _of_task(entries, task)
    for fault in faults:
        print(f"warning: {fault}", file=sys.stderr)
    if as_json:
        say_json([_record(entry) for entry in entries])
    elif sys.stdout.isatty():
        _show_groups(entries)
    else:
        for entry in entries:
            say(f"{entry.kind:<10} {entry.name:<30} {entry.group:<15} {entry.summary}")


def _entries(kind: str | None) -> tuple[list[Entry], list[str]]:
    if kind is not None and kind not in KINDS:
        raise InputError(f"--kind: expected one of {', '.join(KINDS)}, got {kind!r}")
    entries: list[Entry] = []
    faults: list[str] = []
    for plural in plugins.KINDS:
        if kind in (None, plural[:-1]):
            found, broken = plugins.readable(plural)
            entries += sorted(found, key=lambda entry: (entry.group, entry.name))
            faults += broken
    if kind in (None, "scene"):
        entries += plugins.tables("scene")
    if kind in (None, "suite"):
        entries += plugins.tables("suite")
    return entries, faults


def _of_task(entries: list[Entry], task: str) -> list[Entry]:
    solvers = [entry for entry in entries if entry.kind == "solver"]
    known = sorted({entry.group for entry in solvers})
    if solvers and task not in known:
        raise InputError(f"--task: expected one of {', '.join(known)}, got {task!r}")
    return [entry for entry in solvers if entry.group == task]


def _record(entry: Entry) -> dict[str, str]:
    group = {"solver": "task", "generator": "makes"}.get(entry.kind)
    own = {group: entry.group} if group else {}
    head = {"kind": entry.kind, "name": entry.name, **own}
    return {**head, "summary": entry.summary, "file": str(entry.file)}


def _show_groups(entries: list[Entry]) -> None:
    """Print one heading for each kind and group, and one line for each entry.

    A line is cut to the width of the terminal.
    """
    for (kind, group), found in itertools.groupby(entries, lambda one: (one.kind, one.group)):
        own = list(found)
        say(typer.style(f"{kind}s: {group}" if group else f"{kind}s", bold=True))
        names = max(len(entry.name) for entry in own)
        for entry in own:
            columns = tables.width() - names - 4
            say(f"  {entry.name:<{names}}  {tables.shorten(entry.summary, columns)}")


def schema() -> None:
    """Print the JSON schema of a scene file, for editors."""
    from sabench.scenes import scene_schema

    say(json.dumps(scene_schema(), indent=1))


def generate(
    scene: SceneName,
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="FOLDER", help="The data set folder to create."),
    ],
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of all random numbers.")] = 0,
    backend: Annotated[
        str, typer.Option(metavar="NAME", help="Renderer: auto, mitsuba or splat.")
    ] = "auto",
    frames: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Number of frames, overriding the scene."),
    ] = None,
    jobs: Jobs = 1,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Address of a Dask scheduler, tcp://..., whose workers do the work.",
        ),
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Number of independent samples, in shards, in place of one sequence.",
            show_default=False,
        ),
    ] = None,
    split: Annotated[
        str | None,
        typer.Option(
            metavar="SHARES",
            help="Of the samples: shares of training, validation and test, 80/10/10. "
            "[default: all for training]",
            show_default=False,
        ),
    ] = None,
    truth: Annotated[
        str | None,
        typer.Option(
            metavar="KINDS",
            help="Of the samples: truth to keep, some of particles,views,radiance, or none. "
            "[default: particles,views]",
            show_default=False,
        ),
    ] = None,
    compression: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Of the samples: none, or gzip: smaller shards, slower to read. [default: none]",
            show_default=False,
        ),
    ] = None,
    shard_size: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Of the samples: number in a shard. [default: 64 MB of grey values]",
            show_default=False,
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Generate a data set: images, cameras and truth.

    If interrupted, run the same command again to resume.
    """
    from sabench.scenes import load_scene
    from sabench.simulation.pipeline import generate as make
    from sabench.utils.progress import announce_compiling

    announce_compiling()
    loaded = load_scene(scene)
    loaded = loaded if frames is None else loaded.with_frames(frames)
    common: dict[str, Any] = {
        "seed": seed,
        "backend": cast("Renderer", backend),  # both check the word
        "name": Path(scene).stem,
        "overwrite": overwrite,
        "jobs": jobs,
        "scheduler": scheduler,
    }
    own = {"split": split, "truth": truth, "compression": compression, "shard-size": shard_size}
    given = {name: value for name, value in own.items() if value is not None}
    if samples is not None:
        _generate_samples(loaded, output, samples, given, common)
        return
    if given:
        raise InputError(f"--{next(iter(given))}: expected --samples with it, got none")
    made = make(loaded, output, **common)
    size = f"{made.setup.frames} frame(s) of {len(made.setup.cameras)} cameras"
    say(f"{made.root}: {size}, {made.manifest.renderer}, hash {made.content_hash[:12]}")


def _generate_samples(
    scene: Scene, output: Path, samples: int, given: dict[str, Any], common: dict[str, Any]
) -> None:
    from sabench.simulation.sample_shards import generate_samples

    options: dict[str, Any] = {}
    if "split" in given:
        options["split"] = _shares(given["split"])
    if "truth" in given:
        words = [] if given["truth"] == "none" else given["truth"].split(",")
        options["truth"] = [word.strip() for word in words]
    if "compression" in given:
        options["compression"] = given["compression"]
    if "shard-size" in given:
        options["size"] = given["shard-size"]
    made = generate_samples(scene, output, samples=samples, **options, **common)
    splits = ", ".join(f"{count} {name}" for name, count in made.splits.items())
    say(f"{made.root}: {splits} samples, hash {made.content_hash[:12]}")


def _shares(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split("/")]
    except ValueError as error:
        raise InputError(f"--split: expected shares such as 80/10/10, got {text}") from error


def verify(
    dataset: DataSet,
    against: Annotated[
        Path | None,
        typer.Option(
            metavar="DATASET",
            help="Another copy, perhaps of another processor, that must hold the same up to "
            "rounding.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Check every byte and every shape of a data set."""
    from sabench.dataset.copies import disagreements
    from sabench.dataset.reader import open_dataset
    from sabench.dataset.verification import describe_contents, verify as faults_of

    faults = faults_of(dataset)
    if against is not None:
        faults = faults or faults_of(against)
        faults = faults or disagreements(open_dataset(against), open_dataset(dataset))
    for fault in faults:
        say(fault)
    if faults:
        raise typer.Exit(1)
    agrees = f", agrees with {against}" if against is not None else ""
    say(f"{dataset}: intact{agrees}{describe_contents(dataset)}")


def pack(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="PATH", help="A data set folder, or a result file or a folder of some."
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="PATH", help="The folder, or .zip archive, to create."
        ),
    ],
    blind: Annotated[
        bool,
        typer.Option("--blind", help="Leave out the truth, the scene and the seed."),
    ] = False,
    card: Cards = None,
    overwrite: Overwrite = False,
) -> None:
    """Copy a data set, or results with the card of their solver, for others.

    With --blind a data set is its observation side alone, which every solver takes. An archive of
    results is what `sabench submit` takes.
    """
    if path.is_dir() and (path / "manifest.json").exists():
        if card:
            raise InputError(f"--card: expected results to pack with it, got the data set {path}")
        _pack_dataset(path, output, blind, overwrite)
    elif blind:
        raise InputError(f"{path}: expected a data set to pack with --blind, found none")
    else:
        _pack_results(path, output, card or [], overwrite)


def _pack_dataset(dataset: Path, output: Path, blind: bool, overwrite: bool) -> None:
    from sabench.dataset import schema as layout
    from sabench.dataset.copies import pack as copy, pack_samples
    from sabench.dataset.reader import open_dataset

    contents = layout.read_manifest(dataset)
    if isinstance(contents, layout.ShardedContents):
        pack_samples(dataset, output, blind=blind, overwrite=overwrite)
    else:
        copy(open_dataset(dataset), output, blind=blind, overwrite=overwrite)
    side = "observation side" if blind else "whole data set"
    say(f"{output}: {side} of {contents.content_hash[:12]}")


def _pack_results(path: Path, output: Path, cards: list[Path], overwrite: bool) -> None:
    from sabench.evaluation.leaderboard.archives import submitted_files
    from sabench.evaluation.leaderboard.result_packs import pack_results

    with submitted_files(path) as files:
        count, carded = pack_results(files, output, cards, overwrite=overwrite)
    described = f"the card of {' and '.join(carded)}" if carded else "no solver card"
    say(f"{output}: {count} result(s), {described}")
