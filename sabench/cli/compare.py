"""Commands of suites, records and the thesis."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from sabench.cli import options, tables
from sabench.cli.options import AsJson, Overwrite, argument, option, output_option, say, say_json
from sabench.utils.number_text import significant

if TYPE_CHECKING:
    from sabench.api.solvers import TaskName
    from sabench.evaluation.gates.comparison import GateReport
    from sabench.evaluation.leaderboard.page_content import ScoreTable
    from sabench.evaluation.leaderboard.submissions import Standing
    from sabench.tasks.task import Score


def reproduce(
    names: Annotated[
        list[str] | None,
        argument(
            "NAME...",
            "What to measure: table-2-1, fig-2-6, ... or all; an unknown name lists them.",
        ),
    ] = None,
    as_list: Annotated[
        bool,
        typer.Option(
            "--list", help="List all tables and figures of the thesis with recorded verdicts."
        ),
    ] = False,
    as_json: AsJson = False,
    seeds: Annotated[int | None, option("N", "Number of seeds to average over.", min=1)] = None,
    pixels: Annotated[
        int | None,
        option(
            "N",
            "Use small images of this size for a quick trial; the results are not comparable.",
            min=32,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        output_option(
            "FILE", "Write each name's rows to a JSON file when it is done; other rows stay."
        ),
    ] = None,
    figures: Annotated[
        Path | None, option("FOLDER", "Write plots of the curves, and a page of all values.")
    ] = None,
    dry_run: options.DryRun = False,
) -> None:
    """Reproduce tables and figures of Belden's thesis and compare the values."""
    from sabench.apps.costs import announce, cost_of_reproduction
    from sabench.evaluation.reproduction import load_reproduction
    from sabench.utils.errors import InputError

    if as_list and names:
        raise InputError(f"reproduce: expected no names beside --list, got {names[0]}")
    if as_list:
        catalogue = load_reproduction("catalogue")
        entries = catalogue.judged(catalogue.read_rows(catalogue.MEASURED))
        if as_json:
            say_json(entries)
            return
        cells = [[row["name"], row["shows"], row["verdict"], row["item"]] for row in entries]
        tables.show_wrapped(["name", "shows", "verdict", "measured by"], cells)
    elif names:
        costs = cost_of_reproduction(names, seeds, pixels, exact=dry_run)
        announce(costs, output or Path("reproduce"), dry_run=dry_run)
        rows = load_reproduction("report").measure(names, seeds, pixels, output, figures)
        if as_json:
            say_json(rows)
            return
        cells = []
        for row in rows:
            spread = "" if row["ci95"] is None else f" ± {row['ci95']:.2g}"
            values = [significant(row["thesis"]), significant(row["measured"]) + spread]
            seeded = str(row["seeds"] or "-")
            cells.append([row["name"], *values, seeded, row["verdict"], row["note"]])
        tables.show_wrapped(["row", "thesis", "measured", "seeds", "verdict", "note"], cells)
    else:
        raise InputError("reproduce: expected names of tables and figures, all, or --list")


def run(
    suite: options.SuiteName,
    as_json: AsJson = False,
    work: Annotated[Path, option("FOLDER", "Folder of data sets and results.")] = Path("work"),
    leaderboard: options.Leaderboard = Path("leaderboard"),
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Compute everything again, including recorded results.")
    ] = False,
    case: Annotated[list[str] | None, option("NAME", "Run this case only; repeatable.")] = None,
    seed: Annotated[list[int] | None, option("N", "Run this seed only; repeatable.")] = None,
    solver: Annotated[
        list[str] | None, option("NAME", "Run this solver only, by its name in tables; repeatable.")
    ] = None,
    hidden: Annotated[
        Path | None,
        option(
            "FILE", "Run the private test set of the organiser's secret file, not the public one."
        ),
    ] = None,
    jobs: options.Jobs = 1,
    dry_run: options.DryRun = False,
) -> None:
    """Generate, solve and score a suite, then build the leaderboard page.

    Results that have a record already are not computed again.
    """
    from sabench.apps.costs import announce, cost_of_suite
    from sabench.evaluation.runner import run_suite
    from sabench.evaluation.suites import Only

    options.announce_compiling()
    only = Only(tuple(case or ()), tuple(seed or ()), tuple(solver or ()))
    what: dict[str, Any] = {"fresh": fresh, "only": only, "secret": hidden, "jobs": jobs}
    costs = cost_of_suite(suite, work, leaderboard, **what)
    announce(costs, work, dry_run=dry_run)
    records = run_suite(suite, work, leaderboard, **what)
    if as_json:
        say_json(records)
    else:
        _show_records(records)
        _say_page(leaderboard / "index.html")
    if any(record["error"] and not record["declined"] for record in records):
        raise typer.Exit(1)


def _show_records(records: list[dict[str, Any]]) -> None:
    """Print mean and 95 % confidence interval over seeds.

    There is a table for each task, with the best first, and one of its recorded data sets.
    """
    from sabench.evaluation.leaderboard.board import over_seeds
    from sabench.evaluation.leaderboard.page_content import every_table, rank_of, table_of

    rows = over_seeds(records)
    cases = list(dict.fromkeys(row["case"] for row in rows))
    for table in every_table():
        selected = sorted(
            (row for row in rows if table_of(row).name == table.name),
            key=lambda row: (cases.index(row["case"]), *rank_of(row)),
        )
        if selected:
            columns = _shown_columns(table, selected)
            headings = ["case", "solver", "seeds", *(column.key for column in columns)]
            cells = []
            for row in selected:
                values = [(row[column.key], column.decimals) for column in columns]
                texts = ["-" if value is None else value.text(digits) for value, digits in values]
                name = row.get("label") or row["solver"]
                cells.append([row["case"], name, str(len(row["seeds"])), *texts])
            tables.show(headings, cells, keys=3)


def _shown_columns(table: ScoreTable, rows: list[dict[str, Any]]) -> tuple[Score, ...]:
    """List the columns of a table: of figures without truth, those that a row has."""
    if not table.recorded:
        return table.columns
    return tuple(column for column in table.columns if any(row[column.key] for row in rows))


def _say_page(page: Path) -> None:
    say(f"page: {page.resolve()}")


def check(
    suite: options.SuiteName,
    baseline: Annotated[
        Path | None,
        option(
            "FILE",
            "Baseline to compare with. [default: the bundled one, or SUITE.baseline.json "
            "next to a suite of your own]",
        ),
    ] = None,
    update: Annotated[
        bool,
        typer.Option("--update", help="Write this run's scores to the baseline; keep tolerances."),
    ] = False,
    solver: Annotated[
        list[str] | None,
        option(
            "NAME",
            "Run this solver instead of the suite's, on cases of its task; repeatable.",
            autocompletion=options.complete_solver,
        ),
    ] = None,
    junit: Annotated[Path | None, option("FILE", "Write a JUnit XML file, too.")] = None,
    as_json: AsJson = False,
    work: Annotated[
        Path | None, option("FOLDER", "Folder of data sets and results. [default: a temporary one]")
    ] = None,
    exit_first: Annotated[
        bool,
        typer.Option(
            "-x", "--exit-first", help="Stop at the first data set or solver that got worse."
        ),
    ] = False,
) -> None:
    """Run a suite and compare every score with a baseline.

    The exit code is 1 if a score got worse.
    """
    from sabench.evaluation.gates.comparison import check as compare, write_junit

    options.announce_compiling()
    report = compare(
        suite, baseline, work, update=update, solvers=solver or (), exit_first=exit_first
    )
    if junit:
        write_junit(junit, report)
    if as_json:
        say_json(report.to_dict())
    else:
        show_report(report)
    if report.worse:
        raise typer.Exit(1)


def show_report(report: GateReport) -> None:
    """Print what got worse as a table, other changes as lines, and a summary."""
    rows = []
    for finding in report.worse:
        figures = (finding.before, finding.now, finding.change, finding.tolerance)
        texts = ["-" if value is None else f"{value:.6g}" for value in figures]
        rows.append([finding.case, finding.solver, finding.text or finding.figure, *texts])
    if rows:
        headings = ["case", "solver", "figure", "baseline", "now", "change", "tolerance"]
        tables.show(headings, rows, keys=3)
    for change in report.news:
        say(f"news: {change.sentence}")
    say(report.summary)


def submit(
    result: Annotated[
        Path,
        argument("RESULT", "A result file, or a .zip, .tar, .tar.gz or folder of result files."),
    ],
    name: Annotated[str, option("NAME", "Name of the submitter, at most 200 characters.")],
    data: Annotated[
        list[Path] | None,
        option("FOLDER", "Folder of data sets; repeatable. [default: work/datasets]"),
    ] = None,
    card: options.Cards = None,
    leaderboard: options.Leaderboard = Path("leaderboard"),
    as_json: AsJson = False,
) -> None:
    """Check and score submitted results and add them to the leaderboard."""
    from sabench.evaluation.leaderboard.submissions import submit as send

    folders = data or [Path("work/datasets")]
    standings = send(result, name, folders, leaderboard, cards=card or ())
    if as_json:
        say_json([{**row.record, "rank": row.rank, "of": row.of} for row in standings])
        return
    headings = ["case", "seed", "solver", "first score", "rank", "best other"]
    tables.show(headings, [_standing_cells(standing) for standing in standings], keys=3)
    _say_page(leaderboard / "index.html")


def _standing_cells(standing: Standing) -> list[str]:
    from sabench import tasks

    first = tasks.of(standing.record["task"]).columns[0]
    value = standing.record[first.key]
    score = "-" if value is None else f"{first.key} {value:.{first.decimals}f}"
    rival = f"{standing.best[0]}: {standing.best[1]:.{first.decimals}f}" if standing.best else "-"
    rank = f"{standing.rank} of {standing.of}" if standing.rank else "-"
    return [*(str(standing.record[key]) for key in ("case", "seed", "solver")), score, rank, rival]


def board(leaderboard: options.Leaderboard = Path("leaderboard")) -> None:
    """Build the leaderboard page from the records."""
    from sabench.evaluation.runner import build_board

    _say_page(build_board(leaderboard))


def challenge(
    suite: options.SuiteName,
    hidden: Annotated[Path, option("FILE", "The organiser's secret file: seeds come from it.")],
    output: Annotated[Path, output_option("FOLDER", "Folder of the challenge.")],
    task: Annotated[
        str | None,
        option(
            "TASK",
            "Task of all results. [default: the only one of the suite]",
            autocompletion=options.complete_task,
        ),
    ] = None,
    codabench: Annotated[
        str | None,
        option("IMAGE", "Make a bundle for Codabench, too, which scores in this Docker image."),
    ] = None,
    jobs: options.Jobs = 1,
) -> None:
    """Make a private test set, and the archive that participants receive.

    If interrupted, run the same command again to resume.
    """
    from sabench.apps.challenge.board import BUNDLE, PARTICIPANT, make_challenge

    options.announce_compiling()
    chosen = cast("TaskName | None", task)  # `make_challenge` checks the word
    test_set = make_challenge(suite, hidden, output, task=chosen, image=codabench, jobs=jobs)
    count = f"{len(test_set.data_sets)} data set(s) of the task {test_set.task}"
    say(f"{output / PARTICIPANT}: images and cameras of {count}, for participants")
    if codabench is not None:
        say(f"{output / BUNDLE}: bundle for the server, with the truth: keep it private")
    say(f"{output / 'private'}: data sets with their truth: keep them private")


def participate(
    path: Annotated[Path, argument("CHALLENGE", "The organiser's archive, or its folder.")],
    solver: Annotated[
        str,
        argument("SOLVER", "A solver, or a program.", autocompletion=options.complete_solver),
    ],
    output: Annotated[Path, output_option("ARCHIVE", "The .zip file to create.")],
    card: options.Cards = None,
    parameters: options.ParameterPairs = None,
    time_limit: options.TimeLimit = None,
    memory_limit: options.MemoryLimit = None,
    results: Annotated[Path, option("FOLDER", "Folder of results.")] = Path("work/challenge"),
    overwrite: Overwrite = False,
) -> None:
    """Solve all data sets of a challenge and pack the results.

    If interrupted, run the same command again to resume.
    """
    from sabench.apps.challenge.board import participate as solve_all
    from sabench.utils.processes.program import limits_of

    options.announce_compiling()
    count = solve_all(
        path,
        solver,
        output,
        results=results,
        cards=card or (),
        parameters=options.parse_parameters(parameters),
        limits=limits_of(time_limit, memory_limit),
        overwrite=overwrite,
    )
    say(f"{output}: {count} result(s); send it to the organiser")
