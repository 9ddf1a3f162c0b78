"""Commands that make data: plan, generate, verify, pack."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from sabench.cli import options, tables
from sabench.cli.options import AsJson, Overwrite, argument, option, output_option, say, say_json
from sabench.utils.errors import InputError

if TYPE_CHECKING:
    from sabench.apps.planning.plan import Plan
    from sabench.scenes import Scene
    from sabench.utils.backend import Renderer


_BASE = "standard-particles"  # scene that a design changes


def plan(
    scene: Annotated[
        str | None,
        argument(
            "SCENE",
            "A scene file, or the name of a bundled scene; with --depth, the scene to change.",
            autocompletion=options.complete_scene,
        ),
    ] = None,
    page: Annotated[
        Path | None, option("FILE", "Write the plan with drawings of the rig as a page.", "--html")
    ] = None,
    bus_mb_s: Annotated[float, option("X", "Transfer rate of one bus, MB/s.")] = 80.0,
    memory_gb: Annotated[float, option("X", "Memory for the images of a recording, GB.")] = 8.0,
    gap_us: Annotated[float, option("X", "Shortest time between two exposures, us.")] = 250.0,
    depth: Annotated[float | None, option("X", "Wanted depth of the volume, mm.")] = None,
    density: Annotated[float | None, option("X", "Wanted density, particles per mm3.")] = None,
    resolution: Annotated[float | None, option("X", "Wanted pixel in the volume, mm.")] = None,
    output: Annotated[Path | None, output_option("FILE", "Write the scene that is wanted.")] = None,
    measure: Annotated[
        bool, typer.Option("--measure", help="Measure scores on small data sets: minutes.")
    ] = False,
    as_json: AsJson = False,
    overwrite: Overwrite = False,
) -> None:
    """Plan an experiment: resolution, depth, light, density and data rate of a scene."""
    from sabench.apps.planning.plan import RecordingSystem, plan as make

    options.announce_compiling()
    recorder = RecordingSystem(bus_mb_s, memory_gb, gap_us)
    wanted = {"depth": depth, "density": density, "resolution": resolution, "output": output}
    if any(value is not None for value in wanted.values()):
        planned = make(_design(scene, wanted, overwrite=overwrite), recorder)
    elif scene is None:
        raise InputError("SCENE: expected a scene file, or the name of a bundled scene, got none")
    else:
        planned = make(scene, recorder)
    if measure:
        from sabench.apps.planning.measured_scores import measure_scores

        planned = measure_scores(planned)
    if page is not None:
        from sabench.apps.planning.page import render_plan
        from sabench.utils.files import complete_or_nothing

        with complete_or_nothing(page, overwrite=overwrite) as partial:
            partial.write_text(render_plan(planned), encoding="utf-8")
    if as_json:
        say_json(planned.to_dict())
    else:
        _show(planned)
        if output is not None:
            say(f"{output}: the scene that is wanted")
        if page is not None:
            say(f"{page}: the plan with drawings")


def _design(scene: str | None, wanted: dict[str, Any], *, overwrite: bool) -> Scene:
    from sabench.apps.planning.plan import Wanted, design_scene
    from sabench.scenes import load_scene
    from sabench.utils.files import complete_or_nothing, refuse_existing

    if missing := [f"--{name}" for name, value in wanted.items() if value is None]:
        raise InputError(f"{', '.join(missing)}: expected next to the other options of a design")
    refuse_existing(wanted["output"], overwrite=overwrite)
    numbers = Wanted(wanted["depth"], wanted["density"], wanted["resolution"])
    designed = design_scene(load_scene(scene or _BASE), numbers)
    with complete_or_nothing(wanted["output"], overwrite=overwrite) as partial:
        partial.write_text(designed.to_toml(), encoding="utf-8")
    return designed


def _show(planned: Plan) -> None:
    rows = [
        (section.title if number == 0 else "", entry.key, entry.text, entry.meaning, entry.source)
        for section in planned.sections
        for number, entry in enumerate(section.quantities)
    ]
    say(planned.scene.title)
    tables.show_wrapped(("", "figure", "value", "meaning", "equation or source"), rows)
    for advice in planned.advice:
        say(f"warning: {advice.key}: {advice.sentence}")


def generate(
    scene: options.SceneName,
    output: Annotated[Path, output_option("FOLDER", "The data set folder to create.")],
    seed: Annotated[int, option("N", "Seed of all random numbers.")] = 0,
    backend: Annotated[str, option("NAME", "Renderer: auto, mitsuba or splat.")] = "auto",
    frames: Annotated[int | None, option("N", "Frames, in place of the scene's.", min=1)] = None,
    jobs: options.Jobs = 1,
    scheduler: Annotated[
        str | None,
        option("ADDRESS", "Address of a Dask scheduler, tcp://..., whose workers do the work."),
    ] = None,
    samples: Annotated[
        int | None,
        option("N", "Number of independent samples, in shards, in place of one sequence.", min=1),
    ] = None,
    split: Annotated[
        str | None,
        option(
            "SHARES",
            "Of the samples: shares of training, validation and test, 80/10/10. "
            "[default: all for training]",
        ),
    ] = None,
    truth: Annotated[
        str | None,
        option(
            "KINDS",
            "Of the samples: truth to keep, some of particles,views,radiance, or none. "
            "[default: particles,views]",
        ),
    ] = None,
    compression: Annotated[
        str | None,
        option("NAME", "Of the samples: none, or gzip: smaller, slower to read. [default: none]"),
    ] = None,
    shard_size: Annotated[
        int | None,
        option("N", "Of the samples: number in a shard. [default: 64 MB of grey values]", min=1),
    ] = None,
    dry_run: options.DryRun = False,
    overwrite: Overwrite = False,
) -> None:
    """Generate a data set: images, cameras and truth.

    If interrupted, run the same command again to resume.
    """
    from sabench.apps.costs import announce, cost_of_generation
    from sabench.scenes import load_scene
    from sabench.scenes.usual import unusual_values
    from sabench.simulation.pipeline import generate as make

    options.announce_compiling()
    loaded = load_scene(scene)
    for key, sentence in unusual_values(loaded):
        print(f"warning: {scene}: {key}: {sentence}", file=sys.stderr)
    loaded = loaded if frames is None else loaded.with_frames(frames)
    common: _Keys = {"seed": seed, "backend": cast("Renderer", backend), "name": Path(scene).stem}
    common |= {"overwrite": overwrite, "jobs": jobs, "scheduler": scheduler}
    shards = {"split": split, "truth": truth, "compression": compression, "shard-size": shard_size}
    given = {name: value for name, value in shards.items() if value is not None}
    if samples is not None:
        _generate_samples(loaded, output, samples, given, common, dry_run=dry_run)
        return
    if given:
        raise InputError(f"--{next(iter(given))}: expected --samples with it, got none")
    costs = cost_of_generation(loaded, seed, common["backend"], jobs, exact=dry_run)
    announce(costs, output, dry_run=dry_run)
    data = make(loaded, output, **common)
    size = f"{data.setup.frames} frame(s) of {len(data.setup.cameras)} cameras"
    say(f"{data.root}: {size}, {data.manifest.renderer}, hash {data.content_hash[:12]}")


_Keys = dict[str, Any]


def _generate_samples(
    scene: Scene, output: Path, samples: int, given: _Keys, common: _Keys, *, dry_run: bool
) -> None:
    from sabench.apps.costs import announce, cost_of_samples
    from sabench.simulation.sample_shards import generate_samples

    keys = {name.replace("shard-", ""): value for name, value in given.items()}
    if "split" in keys:
        keys["split"] = _shares(keys["split"])
    if "truth" in keys:
        words = [] if keys["truth"] == "none" else keys["truth"].split(",")
        keys["truth"] = [word.strip() for word in words]
    costs = cost_of_samples(scene, samples, keys, common, exact=dry_run)
    announce(costs, output, dry_run=dry_run)
    data = generate_samples(scene, output, samples=samples, **keys, **common)
    splits = ", ".join(f"{count} {name}" for name, count in data.splits.items())
    say(f"{data.root}: {splits} samples, hash {data.content_hash[:12]}")


def _shares(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split("/")]
    except ValueError as error:
        raise InputError(f"--split: expected shares such as 80/10/10, got {text}") from error


def verify(
    dataset: options.DataSet,
    against: Annotated[
        Path | None,
        option(
            "DATASET",
            "Another copy, perhaps of another processor, that must hold the same up to rounding.",
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
    path: Annotated[Path, argument("PATH", "A data set folder, a result, or a folder of some.")],
    output: Annotated[Path, output_option("PATH", "The folder, or .zip archive, to create.")],
    blind: Annotated[
        bool, typer.Option("--blind", help="Leave out the truth, the scene and the seed.")
    ] = False,
    card: options.Cards = None,
    overwrite: Overwrite = False,
) -> None:
    """Copy a data set, or results with the card of their solver, for others.

    With --blind a data set is its observation side alone, which every solver takes. An archive of
    results is what `sabench submit` takes.
    """
    if path.is_dir() and (path / "manifest.json").exists():
        if card:
            raise InputError(f"--card: expected results to pack with it, got the data set {path}")
        from sabench.dataset import schema as layout
        from sabench.dataset.copies import pack as copy, pack_samples
        from sabench.dataset.reader import open_dataset

        contents = layout.read_manifest(path)
        if isinstance(contents, layout.ShardedContents):
            pack_samples(path, output, blind=blind, overwrite=overwrite)
        else:
            copy(open_dataset(path), output, blind=blind, overwrite=overwrite)
        side = "observation side" if blind else "whole data set"
        say(f"{output}: {side} of {contents.content_hash[:12]}")
    elif blind:
        raise InputError(f"{path}: expected a data set to pack with --blind, found none")
    else:
        from sabench.evaluation.leaderboard.archives import pack_results, submitted_files

        with submitted_files(path) as files:
            count, carded = pack_results(files, output, (card or []), overwrite=overwrite)
        described = f"the card of {' and '.join(carded)}" if carded else "no solver card"
        say(f"{output}: {count} result(s), {described}")
