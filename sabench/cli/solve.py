"""Commands on one data set or solver: solve, score, conform, calibrate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sabench.cli import tables
from sabench.cli.options import (
    AsJson,
    DataSet,
    MemoryLimit,
    Overwrite,
    ParameterPairs,
    TimeLimit,
    complete_calibration_solver,
    complete_solver,
    complete_task,
    parse_parameters,
    say,
    say_json,
)

if TYPE_CHECKING:
    from sabench.tasks.calibration_report import Report


def solve(
    solver: Annotated[
        str,
        typer.Argument(
            metavar="SOLVER",
            help="Name of a solver, or path of a program (see docs/developing/participate.md).",
            autocompletion=complete_solver,
        ),
    ],
    dataset: DataSet,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="The result file to create.")
    ],
    parameter: ParameterPairs = None,
    time_limit: TimeLimit = None,
    memory_limit: MemoryLimit = None,
    overwrite: Overwrite = False,
) -> None:
    """Run a solver on a data set and write its result file."""
    from sabench.dataset.verification import probe_dataset
    from sabench.tasks.solve_and_score import solve as run_solver
    from sabench.utils.processes.program import limits_of
    from sabench.utils.progress import announce_compiling

    announce_compiling()
    probe_dataset(dataset)
    result = run_solver(
        solver,
        dataset,
        output,
        parameters=parse_parameters(parameter),
        limits=limits_of(time_limit, memory_limit),
        overwrite=overwrite,
    )
    memory = f"{result.peak_mb:.0f} MB" if result.peak_mb else "unknown memory"
    say(f"{output}: {result.solver}, {result.seconds:.2f} s per frame, at most {memory}")


def score(
    dataset: DataSet,
    result: Annotated[
        str,
        typer.Argument(
            metavar="RESULT",
            help="A result file, or truth or empty for the best and worst possible scores.",
        ),
    ],
    task: Annotated[
        str | None,
        typer.Option(
            metavar="TASK",
            help="Task whose scores truth and empty get, if the data set serves several.",
            autocompletion=complete_task,
        ),
    ] = None,
    track: Annotated[str | None, typer.Option(hidden=True, help="Former name of --task.")] = None,
    as_json: AsJson = False,
) -> None:
    """Score a result against the truth."""
    from sabench.dataset.verification import probe, probe_dataset
    from sabench.tasks.solve_and_score import score as scores_of
    from sabench.utils.progress import announce_compiling

    announce_compiling()
    probe_dataset(dataset)
    if result not in ("truth", "empty") and Path(result).is_file():
        probe(Path(result))
    scores = scores_of(dataset, result, task or track)
    if as_json:
        say_json(scores)
    else:
        _show_scores(scores)


def _show_scores(scores: dict[str, Any]) -> None:
    from sabench import tasks

    columns = tasks.of(scores["task"]).columns
    figures = [tables.format_number(scores[column.key], column.decimals) for column in columns]
    headings = ["data set", "solver", *(column.key for column in columns)]
    tables.show(headings, [[scores["dataset"][:12], scores["solver"], *figures]])


def conform(
    solver: Annotated[
        str,
        typer.Argument(metavar="SOLVER", help="Name of a solver.", autocompletion=complete_solver),
    ],
    parameter: ParameterPairs = None,
    as_json: AsJson = False,
) -> None:
    """Test a solver against the laws that every solver obeys.

    The exit code is 1 if it breaks one.
    """
    from dataclasses import asdict

    from sabench.tasks.conformance import check_solver
    from sabench.utils.progress import announce_compiling

    announce_compiling()
    findings = []
    for finding in check_solver(solver, parse_parameters(parameter)):
        findings.append(finding)
        if not as_json:
            say(f"{finding.verdict:<8} {finding.law}{': ' + finding.text if finding.text else ''}")
    if as_json:
        say_json([asdict(finding) for finding in findings])
    if any(finding.verdict == "broken" for finding in findings):
        raise typer.Exit(1)


def calibrate(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER",
            help="A folder with calibration.toml and images or points.csv "
            "(see docs/using/calibrating.md).",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FOLDER",
            help="The folder to create. [default: result, in that folder]",
            show_default=False,
        ),
    ] = None,
    solver: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Name of a calibration solver.",
            autocompletion=complete_calibration_solver,
        ),
    ] = "refractive_autocal",
    parameter: ParameterPairs = None,
    unknowns: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Unknowns besides the focal lengths, separated by commas, in place of those of "
            "calibration.toml; or auto: those that make held-out frames fit better.",
            show_default=False,
        ),
    ] = None,
    as_json: AsJson = False,
    overwrite: Overwrite = False,
) -> None:
    """Calibrate your own cameras from images or points of a target."""
    from dataclasses import asdict

    from sabench.tasks.own_calibration import calibrate as make
    from sabench.utils.progress import announce_compiling

    announce_compiling()
    out = output or folder / "result"
    report = make(
        folder,
        out,
        solver,
        parse_parameters(parameter),
        unknowns=unknowns,
        overwrite=overwrite,
    )
    if as_json:
        say_json(asdict(report))
    else:
        _show_calibration(report, out)


def _show_unknowns(report: Report) -> None:
    lines = []
    for row in report.compared:
        name = f"+ {' and '.join(row.added)}" if row.added else "focal lengths"
        figures = [
            tables.format_number(value, 4)
            for value in (row.held_out_px, row.change_px, row.sigma_px)
        ]
        lines.append([name, *figures, row.remark or ("yes" if row.chosen else "no")])
    tables.show(["unknowns", "held-out px", "change", "standard error", "keep"], lines)
    quoted = ", ".join(f'"{name}"' for name in report.unknown)
    say(f"recommended and used: unknown = [{quoted}]")


def _show_calibration(report: Report, out: Path) -> None:
    for sentence in report.summary:
        say(sentence)
    if report.compared:
        _show_unknowns(report)
    rows = []
    for line in (*report.cameras, *report.frames):
        name = line["name"] if isinstance(line["name"], str) else f"frame {line['name']}"
        errors = [tables.format_number(line[key], 3) for key in ("mean_px", "largest_px")]
        rows.append([name, str(line["found"]), str(line["used"]), *errors])
    tables.show(["camera or frame", "found", "used", "mean px", "largest px"], rows)
    say(f"residuals: {report.noise_px:.4f} px, of which neighbours share {report.misfit_px:.4f} px")
    if report.true_px is not None:
        say(f"expected true error, misfit included: {report.true_px:.4f} px")
    if held := report.held_out:
        figures = [
            (f"reprojection {held.reprojection_px:.4f} px", held.reprojection_px),
            (f"off a rigid target {held.rigidity_mm or 0.0:.4f} mm", held.rigidity_mm),
            (f"off known places {held.known_mm or 0.0:.4f} mm", held.known_mm),
        ]
        what = "frames" if held.frames <= len(report.frames) else "points"
        lost = f" ({held.failed} fits failed)" if held.failed else ""
        good = ", ".join(text for text, there in figures if there)
        say(f"{held.frames} {what} held out{lost}: {good}")
    _show_expected(report)
    _show_wall(report)
    say(f"{out}: cameras.json, report.json, target.csv, errors.png, residuals/")


def _show_wall(report: Report) -> None:
    if not report.wall:
        return
    rows = []
    for one in report.wall:
        figures = [tables.format_number(value, 4) for value in (one.nominal, one.found, one.std)]
        rows.append([one.name, one.unit or "-", *figures, "yes" if one.shown else "no"])
    tables.show(["unknown of the wall", "unit", "nominal", "found", "bound", "shown"], rows)


def _show_expected(report: Report) -> None:
    where = "along the wall's X and Y and its normal"
    for name, std in (("misfit included", report.std_mm), ("noise alone", report.noise_std_mm)):
        if std is not None:
            x, y, z = std
            say(f"expected scatter of points {where}, {name}: {x:.4f}, {y:.4f}, {z:.4f} mm")
    if report.depth_mm is not None:
        say(f"expected error of the distance of all points from the wall: {report.depth_mm:.3g} mm")
