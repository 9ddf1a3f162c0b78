"""The command `sabench`."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, cast

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from sabench import plugins
from sabench.scenes import find
from sabench.utils.errors import InputError
from sabench.utils.version import __version__

if TYPE_CHECKING:
    from sabench.evaluation.gates.comparison import Report

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    help="Synthetic data with known truth for volumetric velocimetry, and benchmarks on it.",
)

Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON value.")]
Leaderboard = Annotated[Path, typer.Option(help="Folder of the records and the page.")]


@app.command("list")
def list_all() -> None:
    """Generators, solvers, scenes and suites, each with one line."""
    for kind in plugins.KINDS:
        for name in plugins.names(kind):
            _say(f"{kind[:-1]:<10} {name:<20} {plugins.summary(plugins.load(kind, name))}")
    for kind, folder in (("scene", "scenes"), ("suite", "scenes/suites")):
        for file in sorted((plugins.bundled("scenes").parent / folder).glob("*.toml")):
            _say(
                f"{kind:<10} {file.stem:<20} {tomllib.loads(find(file, folder).read_text(encoding='utf-8'))['title']}"
            )


@app.command()
def schema() -> None:
    """The JSON schema of a scene file, for editors."""
    from sabench.scenes import scene_schema

    _say(json.dumps(scene_schema(), indent=1))


@app.command()
def generate(
    scene: Annotated[str, typer.Argument(help="A scene file, or the name of a bundled scene.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The data set folder to make.")],
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.")] = 0,
    backend: Annotated[str, typer.Option(help="auto, mitsuba or splat.")] = "auto",
    frames: Annotated[
        int | None, typer.Option(min=1, help="How many, in place of what the scene says.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes that share the work.")] = 1,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Address of a Dask scheduler, tcp://..., whose workers do the work."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Make a data set: pictures, cameras and truth. Interrupted, the same command goes on with it."""
    from sabench.scenes import load_scene
    from sabench.simulation.pipeline import generate as make
    from sabench.simulation.renderer_choice import Renderer

    loaded = load_scene(scene) if frames is None else load_scene(scene).with_frames(frames)
    kind = cast(Renderer, backend)  # `make` checks the word
    made = make(
        loaded,
        output,
        seed=seed,
        backend=kind,
        name=Path(scene).stem,
        overwrite=overwrite,
        jobs=jobs,
        scheduler=scheduler,
    )
    _say(
        f"{made.root}: {made.rig.frames} frame(s) of {len(made.rig.cameras)} cameras, {made.manifest.renderer}, hash {made.content_hash[:12]}"
    )


@app.command()
def verify(dataset: Annotated[Path, typer.Argument(help="A data set folder.")]) -> None:
    """Check every byte and every shape of a data set."""
    from sabench.dataset.verification import verify as faults_of

    faults = faults_of(dataset)
    for fault in faults:
        _say(fault)
    if faults:
        raise typer.Exit(1)
    _say(f"{dataset}: whole")


@app.command()
def solve(
    solver: Annotated[
        str,
        typer.Argument(
            help="Name of a solver, or path of a program (see docs/developing/participate.md)."
        ),
    ],
    dataset: Annotated[Path, typer.Argument(help="A data set folder.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The result file to make.")],
    parameter: Annotated[
        list[str] | None, typer.Option("-p", "--parameter", help="name=value, as often as needed.")
    ] = None,
    time_limit: Annotated[
        float | None, typer.Option(help="Of a program: seconds; by default 3600.")
    ] = None,
    memory_limit: Annotated[
        float | None,
        typer.Option(
            help="Of a program's processes together: MB; by default nine tenths of what is free."
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Reconstruct a data set."""
    from sabench.dataset.hdf5_probe import probe_dataset
    from sabench.tasks.solve_and_score import solve as run_solver
    from sabench.utils.processes.limited import limits_of

    probe_dataset(dataset)
    limits = limits_of(time_limit, memory_limit)
    result = run_solver(
        solver,
        dataset,
        output,
        parameters=_parameters(parameter or []),
        limits=limits,
        overwrite=overwrite,
    )
    _say(
        f"{output}: {result.solver}, {result.seconds:.2f} s per frame, {result.peak_mb or float('nan'):.0f} MB at most"
    )


@app.command()
def score(
    dataset: Annotated[Path, typer.Argument(help="A data set folder.")],
    result: Annotated[
        str, typer.Argument(help="A result file, or truth or empty: the ends of every scale.")
    ],
    task: Annotated[
        str | None,
        typer.Option(help="Task by whose scores `truth` and `empty` are scored."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Score a result against the truth."""
    from sabench.dataset.hdf5_probe import probe, probe_dataset
    from sabench.tasks.solve_and_score import score as scores_of

    probe_dataset(dataset)
    if result not in ("truth", "empty") and Path(result).is_file():
        probe(Path(result))
    scores = scores_of(dataset, result, task)
    if as_json:
        _say(json.dumps(scores, allow_nan=False))
    else:
        _show_scores(scores)


@app.command()
def export(
    dataset: Annotated[Path, typer.Argument(help="A data set folder.")],
    result: Annotated[
        Path | None,
        typer.Argument(help="A result of it; without one, the data set's truth is exported."),
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="The folder to make.")] = Path(
        "vtk"
    ),
    to: Annotated[str, typer.Option(help="vtk: files that ParaView opens.")] = "vtk",
    overwrite: Overwrite = False,
) -> None:
    """Write volumes, particles, velocity fields, bubbles and bodies for other programs."""
    from sabench.interop.vtkhdf import Format
    from sabench.interop.vtkhdf import export as write

    out = write(
        dataset, output, result, to=cast(Format, to), overwrite=overwrite
    )  # `write` checks the word
    _say(f"{out}: {', '.join(sorted(path.name for path in out.iterdir()))}")


@app.command()
def calibrate(
    folder: Annotated[
        Path,
        typer.Argument(
            help="Folder of calibration.toml and images or points.csv (see docs/using/calibrating.md)."
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="The folder to make; by default `result` in that folder."
        ),
    ] = None,
    solver: Annotated[
        str, typer.Option(help="Name of a calibration solver.")
    ] = "refractive_autocal",
    parameter: Annotated[
        list[str] | None, typer.Option("-p", "--parameter", help="name=value, as often as needed.")
    ] = None,
    as_json: AsJson = False,
    overwrite: Overwrite = False,
) -> None:
    """Calibrate your own cameras by images or points of a target: cameras.json and a report."""
    from dataclasses import asdict

    from sabench.tasks.own_calibration import calibrate as make

    out = output or folder / "result"
    report = make(folder, out, solver, _parameters(parameter or []), overwrite=overwrite)
    if as_json:
        _say(json.dumps(asdict(report), allow_nan=False))
        return
    table = Table("camera or frame", "found", "used", "mean px", "largest px")
    for line in (*report.cameras, *report.frames):
        name = line["name"] if isinstance(line["name"], str) else f"frame {line['name']}"
        table.add_row(
            name,
            str(line["found"]),
            str(line["used"]),
            *(
                "-" if line[key] is None else f"{line[key]:.3f}"
                for key in ("mean_px", "largest_px")
            ),
        )
    _print(table)
    _say(
        f"noise of a pixel coordinate {report.noise_px:.4f} px; to be expected: {report.true_px:.4f} px of true error, points scattered by"
    )
    x, y, z = report.std_mm
    _say(
        f"{x:.4f}, {y:.4f}, {z:.4f} mm along X, Y, Z, and all of them together {report.depth_mm:.3f} mm too deep or not deep enough"
    )
    _say(f"{out}: cameras.json, report.json, errors.png")


@app.command()
def run(
    suite: Annotated[str, typer.Argument(help="A suite file, or the name of a bundled suite.")],
    as_json: AsJson = False,
    work: Annotated[Path, typer.Option(help="Folder for data sets and results.")] = Path("work"),
    leaderboard: Leaderboard = Path("leaderboard"),
    fresh: Annotated[
        bool,
        typer.Option(
            "--fresh", help="Compute again what is there: data sets, and results with a record."
        ),
    ] = False,
    case: Annotated[
        list[str] | None, typer.Option(help="Only this case, as often as needed.")
    ] = None,
    seed: Annotated[
        list[int] | None, typer.Option(help="Only this seed, as often as needed.")
    ] = None,
    solver: Annotated[
        list[str] | None,
        typer.Option(help="Only this solver, by the name in tables, as often as needed."),
    ] = None,
    hidden: Annotated[
        Path | None,
        typer.Option(
            help="The organiser's secret file: run the hidden split in place of the public one."
        ),
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes that generate a data set.")] = 1,
) -> None:
    """Generate, solve and score a whole suite, then build the page; what has a record already is not computed again."""
    from sabench.evaluation.hidden_split import read_secret
    from sabench.evaluation.runner import Only, run_suite

    only = Only(tuple(case or ()), tuple(seed or ()), tuple(solver or ()))
    records = run_suite(
        suite,
        work,
        leaderboard,
        fresh=fresh,
        only=only,
        secret=read_secret(hidden) if hidden else None,
        jobs=jobs,
    )
    if as_json:
        _say(json.dumps(records, allow_nan=False))
    else:
        _show_records(records)
        _say(f"page: {(leaderboard / 'index.html').resolve()}")
    if any(record["error"] and not record["declined"] for record in records):
        raise typer.Exit(1)


@app.command()
def check(
    suite: Annotated[str, typer.Argument(help="A suite file, or the name of a bundled suite.")],
    baseline: Annotated[
        Path | None,
        typer.Option(help="Figures to compare with; by default the bundled ones of the suite."),
    ] = None,
    update: Annotated[
        bool,
        typer.Option("--update", help="Write this run's figures as the baseline; tolerances stay."),
    ] = False,
    solver: Annotated[
        list[str] | None,
        typer.Option(help="In place of the suite's, on its cases of the same task; repeatable."),
    ] = None,
    junit: Annotated[Path | None, typer.Option(help="A JUnit XML file to make.")] = None,
    as_json: AsJson = False,
    work: Annotated[
        Path | None,
        typer.Option(help="Folder for data sets and results; by default a temporary one."),
    ] = None,
    exit_first: Annotated[
        bool,
        typer.Option(
            "-x", "--exit-first", help="Stop at the first data set or solver with something worse."
        ),
    ] = False,
) -> None:
    """Run a suite and compare every figure with a baseline: exit code 1 and a table if something got worse."""
    from sabench.evaluation.gates.comparison import check_file
    from sabench.evaluation.gates.junit import write_junit

    report = check_file(
        suite, baseline, work, update=update, solvers=solver or (), exit_first=exit_first
    )
    if junit:
        write_junit(junit, report)
    if as_json:
        _say(json.dumps(report.to_dict(), allow_nan=False))
    else:
        _show_report(report)
    if report.worse:
        raise typer.Exit(1)


@app.command()
def reproduce(
    tables: Annotated[
        list[str], typer.Argument(help="table-2-1, fig-2-6 or others: an unknown name lists them.")
    ],
    as_json: AsJson = False,
    seeds: Annotated[
        int | None, typer.Option(min=1, help="How many seeds each figure is the mean of.")
    ] = None,
    pixels: Annotated[
        int | None,
        typer.Option(
            min=32,
            help="Side of the images in a coarse copy of each array: to try it, not to compare.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="A JSON file for the rows, too, written after each of them."
        ),
    ] = None,
    figures: Annotated[
        Path | None, typer.Option(help="A folder for pictures of the curves.")
    ] = None,
) -> None:
    """Measure tables and figures of Belden's thesis again, their values beside ours."""
    from dataclasses import asdict

    from sabench.evaluation.thesis import reproduce as measure
    from sabench.plotting.charts import Figure, draw
    from sabench.utils.files import canonical_json, complete_or_nothing
    from sabench.utils.progress import console

    rows: list[dict[str, Any]] = []
    for row in measure(tables, seeds, pixels):
        if isinstance(row, Figure):
            if figures:
                figures.mkdir(parents=True, exist_ok=True)
                with complete_or_nothing(figures / f"{row.name}.png", overwrite=True) as partial:
                    partial.write_bytes(draw(row))
            continue
        console.print(
            f"{row.name}: {_figure(row.measured)}, thesis {_figure(row.thesis)}: {row.verdict}",
            markup=False,
            highlight=False,
        )
        rows.append(asdict(row))
        if output:  # after every row: an interrupted run keeps what it has
            with complete_or_nothing(output, overwrite=True) as partial:
                partial.write_text(canonical_json(rows), encoding="utf-8")
    if as_json:
        _say(json.dumps(rows, allow_nan=False))
    else:
        _show_rows(rows)


@app.command()
def submit(
    result: Annotated[
        Path,
        typer.Argument(help="A result file, or a .zip, .tar, .tar.gz or folder of result files."),
    ],
    name: Annotated[str, typer.Option(help="Who submits: at most 80 characters.")],
    data: Annotated[
        list[Path] | None,
        typer.Option(help="Folder of data sets, as often as needed; by default work/datasets."),
    ] = None,
    leaderboard: Leaderboard = Path("leaderboard"),
    as_json: AsJson = False,
) -> None:
    """Check and score results from elsewhere and put them on the leaderboard."""
    from sabench import tasks
    from sabench.evaluation.leaderboard.submissions import submit as send

    standings = send(result, name, data or [Path("work/datasets")], leaderboard)
    if as_json:
        _say(
            json.dumps(
                [{**one.record, "rank": one.rank, "of": one.of} for one in standings],
                allow_nan=False,
            )
        )
        return
    table = Table("case", "seed", "solver", "first score", "rank", "best other")
    for one in standings:
        first = tasks.of(one.record["task"]).columns[0]
        score = (
            "-"
            if one.record[first.key] is None
            else f"{first.key} {one.record[first.key]:.{first.decimals}f}"
        )
        rival = f"{one.best[0]}: {one.best[1]:.{first.decimals}f}" if one.best else "-"
        rank = f"{one.rank} of {one.of}" if one.rank else "-"
        table.add_row(
            *(
                escape(str(text))
                for text in (
                    one.record["case"],
                    one.record["seed"],
                    one.record["solver"],
                    score,
                    rank,
                    rival,
                )
            )
        )
    _print(table)
    _say(f"page: {(leaderboard / 'index.html').resolve()}")


@app.command()
def board(leaderboard: Leaderboard = Path("leaderboard")) -> None:
    """Build the page from the records."""
    from sabench.evaluation.runner import build_board

    _say(f"page: {build_board(leaderboard).resolve()}")


@app.command()
def doctor() -> None:
    """What this machine renders and computes on, tried, with the remedy for what is missing."""
    from sabench.cli.doctor import examine

    findings = examine()
    for finding in findings:
        _say(f"{'ok ' if finding.well else 'BAD'} {finding.subject:<16} {finding.text}")
        if finding.remedy and not finding.well:
            _say(f"    remedy: {finding.remedy}")
    if not all(finding.well for finding in findings):
        raise typer.Exit(1)


@app.callback(invoke_without_command=True)
def top(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """Synthetic data with known truth for volumetric velocimetry, and benchmarks on it."""
    if version:
        _say(f"sabench {__version__}")
        raise typer.Exit


def _parameters(pairs: list[str]) -> dict[str, Any]:
    """name=value pairs; a value is what TOML takes it for, else a string."""
    values: dict[str, Any] = {}
    for pair in pairs:
        name, sign, text = pair.partition("=")
        if not sign or not name:
            raise InputError(f"-p {pair}: expected name=value")
        try:
            values[name] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            values[name] = text
    return values


def _show_scores(scores: dict[str, Any]) -> None:
    from sabench import tasks

    columns = tasks.of(scores["task"]).columns
    table = Table("data set", "solver", *(column.key for column in columns))
    figures = [
        "-" if scores[column.key] is None else f"{scores[column.key]:.{column.decimals}f}"
        for column in columns
    ]
    table.add_row(scores["dataset"][:12], scores["solver"], *figures)
    _print(table)


def _show_records(records: list[dict[str, Any]]) -> None:
    """Mean and 95 % confidence interval over the seeds of every case and solver, one table for each task, the best of each case first."""
    from sabench import tasks
    from sabench.evaluation.leaderboard.rows import over_seeds

    rows = over_seeds(records)
    order = list(dict.fromkeys(row["case"] for row in rows))
    for task in tasks.every():
        columns, own = task.columns, [row for row in rows if row["task"] == task.name]
        sign, first = -1.0 if columns[0].better == "larger" else 1.0, columns[0].key
        table = Table("case", "solver", "seeds", *(column.key for column in columns))
        for row in sorted(
            own,
            key=lambda row: (
                order.index(row["case"]),
                sign * row[first].mean if row[first] else float("inf"),
            ),
        ):
            figures = [
                "-" if row[column.key] is None else row[column.key].text(column.decimals)
                for column in columns
            ]
            table.add_row(
                row["case"], row.get("label") or row["solver"], str(len(row["seeds"])), *figures
            )
        if own:
            _print(table)


def _show_report(report: Report) -> None:
    """What got worse as a table, what else has changed in lines, and one line for all of it."""
    table = Table("case", "solver", "figure", "baseline", "now", "change", "tolerance")
    for one in report.worse:
        figures = (
            "-" if value is None else f"{value:.6g}"
            for value in (one.before, one.now, one.change, one.tolerance)
        )
        table.add_row(one.case, one.solver, one.text or one.figure, *figures)
    if report.worse:
        _print(table)
    for one in report.news:
        _say(f"news: {one.sentence}")
    _say(report.summary)


def _show_rows(rows: list[dict[str, Any]]) -> None:
    """What the thesis says beside what was measured."""
    table = Table("row", "thesis", "measured", "seeds", "verdict", "note")
    for row in rows:
        spread = "" if row["ci95"] is None else f" ± {row['ci95']:.2g}"
        table.add_row(
            row["name"],
            _figure(row["thesis"]),
            _figure(row["measured"]) + spread,
            str(row["seeds"] or "-"),
            row["verdict"],
            row["note"],
        )
    _print(table)


def _figure(value: float | str | None) -> str:
    if value is None:
        return "-"
    if isinstance(value, str):
        return value
    return f"{value:,.0f}" if 1e4 <= abs(value) < 1e7 else f"{value:.4g}"


def _print(table: Table) -> None:
    Console(width=None if sys.stdout.isatty() else 200).print(table)


_INTERRUPTED = "interrupted: what was finished is kept, nothing half-written is left"


def _say(text: str) -> None:
    typer.echo(text)


def main() -> NoReturn:
    """Run the command; faults of the input, the disk or the user's Ctrl-C end in one sentence and exit code 2."""
    try:
        code = app(standalone_mode=False)
    except InputError as error:
        _fail(str(error))
    except KeyboardInterrupt:
        _fail(_INTERRUPTED)
    except BrokenPipeError:
        os.dup2(
            os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno()
        )  # the reader has gone: no more output, and no complaint at exit
        sys.exit(0)
    except OSError as error:
        _fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except MemoryError as error:
        _fail(f"out of memory: {error}")
    except Exception as error:
        if not hasattr(error, "exit_code"):
            raise
        _usage(error)
    if code == 130:  # the command-line library's way to say Ctrl-C
        _fail(_INTERRUPTED)
    sys.exit(code if isinstance(code, int) else 0)


def _usage(error: Any) -> NoReturn:
    """A wrong command line, or an interrupt that the command-line library turned into its own exception."""
    if type(error).__name__ == "Abort":
        _fail(_INTERRUPTED)
    _fail(error.format_message())


def _fail(sentence: str) -> NoReturn:
    with contextlib.suppress(OSError):
        lines = [" ".join(line.split()) for line in sentence.splitlines()]
        print("\n  ".join([f"sabench: {lines[0] if lines else ''}", *lines[1:]]), file=sys.stderr)
    sys.exit(2)
