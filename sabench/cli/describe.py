"""Command that describes a part by its name: info."""

from __future__ import annotations

import functools
import inspect
import itertools
import statistics
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin

from sabench import plugins
from sabench.cli import options, tables
from sabench.cli.options import argument, say
from sabench.utils.errors import InputError

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from sabench.tasks.task import Score

_SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


def info(
    name: Annotated[
        str,
        argument(
            "NAME",
            "Name of a solver, generator, scene, suite or score.",
            autocompletion=options.complete(lambda: _parts()),
        ),
    ],
) -> None:
    """Describe a solver, generator, scene, suite or score."""
    from sabench.utils.validation import nearest_word

    parts = _parts()
    if name not in parts:
        near = nearest_word(name, parts, 0.6)
        hint = f"did you mean {near}?" if near else "sabench list has their names"
        raise InputError(f"{name}: expected a solver, generator, scene, suite or score; {hint}")
    for describe in parts[name]:
        describe(name)


def _parts() -> dict[str, list[Callable[[str], None]]]:
    """Map names to what describes them: a scene and a suite may have the same."""
    from sabench import tasks

    scores = {score.key: None for task in tasks.every() for score in task.all_scores}
    parts: dict[str, list[Callable[[str], None]]] = {}
    for names, describe in (
        (plugins.names("solvers"), _solver),
        (plugins.names("generators"), functools.partial(_plug_in, "generators")),
        (plugins.list_scenes(), _scene),
        (plugins.list_suites(), _suite),
        (scores, _score),
    ):
        for name in names:
            parts.setdefault(name, []).append(describe)
    return parts


def _solver(name: str) -> None:
    _plug_in("solvers", name)
    say(_results(name) + f"\n\nsabench solve {name} DATASET -o RESULT.h5")


def _plug_in(kind: str, name: str) -> None:
    """Print docstring, limits, parameters and sources."""
    entry, plugin = plugins.summarise(kind, name), plugins.load(kind, name)
    say(f"{entry.kind} {name} ({entry.group})\n\n{inspect.getdoc(plugin)}")
    if "skip" in vars(plugin):
        say(f"\nLimits: {inspect.getdoc(plugin.skip)}")
    fields = plugin.Parameters.model_fields.items()
    if fields:
        head = "parameter", "default", "allowed", "meaning"
        tables.show_wrapped(head, [(key, *_field(field)) for key, field in fields])
    for source in plugin.references:
        say(f"Source: {source}")


def _field(field: FieldInfo) -> tuple[str, str, str]:
    """Give a parameter's default, choices or limits, and meaning."""
    kinds = [field.annotation, *get_args(field.annotation)]
    choices = [
        str(word) for kind in kinds if get_origin(kind) is Literal for word in get_args(kind)
    ]
    limits = [
        f"{sign} {getattr(limit, key):g}"
        for limit in field.metadata
        for key, sign in _SIGNS.items()
        if hasattr(limit, key)
    ]
    default = "" if field.is_required() else str(field.get_default(call_default_factory=True))
    return default, ", ".join(choices + limits), field.description or ""


def _results(name: str) -> str:
    """Sum up a solver's place among the bundled records of its task."""
    from sabench import tasks
    from sabench.evaluation.records import read_records

    task = tasks.of(plugins.summarise("solvers", name).group)
    score = task.scores[0]
    sets: dict[str, list[dict[str, Any]]] = {}
    for row in read_records(plugins.bundled_folder("leaderboard") / "records"):
        if row["task"] == task.name and row.get(score.key) is not None:
            sets.setdefault(row["dataset"], []).append(row)
    own = [row for rows in sets.values() for row in rows if row["solver"] == name]
    if not own:
        return "\nThe records of the leaderboard do not have it."
    best = [row for row in own if task.rank(row) == min(map(task.rank, sets[row["dataset"]]))]
    solvers = {row["solver"] for rows in sets.values() for row in rows}
    seconds = [row["seconds"] for row in own if row["seconds"] is not None]
    took = f"; median time {statistics.median(seconds):.2g} s" if seconds else ""
    return (
        f"\nIn the records of the leaderboard, {len(own)} results: median {score.heading} "
        f"{statistics.median(row[score.key] for row in own):.{score.decimals}f}; best of the "
        f"{len(solvers)} solvers, or as good as the best, in {len(best)}{took}"
    )


def _scene(name: str) -> None:
    from sabench.scenes import build_rig, find, load_scene

    scene = load_scene(name)
    size = " x ".join(f"{mm:g}" for mm in scene.volume.size_mm)
    suites = [
        suite
        for suite in plugins.list_suites()
        if f'"{name}"' in find(suite, "scenes/suites").read_text(encoding="utf-8")
    ]
    picture = plugins.bundled_folder("scenes") / "pictures" / f"{name}.webp"
    say(
        f"scene {name}\n\n{scene.title}\n\n{len(build_rig(scene, name).cameras)} cameras of "
        f"{scene.cameras.columns} x {scene.cameras.rows} px, a volume of {size} mm, frames: "
        f"{scene.frames}\nSuites: {', '.join(suites) or 'none'}\nPicture: {picture}\n\n"
        f"sabench plan {name}\nsabench generate {name} -o DATASET"
    )


def _suite(name: str) -> None:
    from sabench.evaluation.suite_loading import load_suite

    suite, cases = load_suite(name)
    solvers = sorted({solver.name for case in cases for solver in case.solvers})
    say(
        f"suite {name}\n\n{suite.title}\n\n{len(cases)} data sets of "
        f"{len({case.name for case in cases})} cases, seeds: {len(suite.seeds)}\n"
        f"Solvers: {', '.join(solvers)}\n\nsabench run {name}"
    )


def _score(name: str) -> None:
    """Print a score's meaning in each task; some follow on the score before them."""
    from sabench import tasks

    texts: dict[str, list[str]] = {}
    for task in tasks.every():
        for before, score in itertools.pairwise((None, *task.all_scores)):
            if score is not None and score.key == name:
                own = before is not None and score in task.scores
                after = f"\n(it follows {before.key}: {before.meaning})" if before and own else ""
                text = f"{score.meaning}{after}\n\n{_range(score)}"
                texts.setdefault(text, []).append(task.name)
    for text, names in texts.items():
        say(f"score {name} ({', '.join(names)})\n\n{text}")


def _range(score: Score) -> str:
    """Say in which direction a score is better, and between which values it lies."""
    from sabench.tasks.task import ANY, BETTER, ERROR

    low, high = score.range
    ends = "" if score.range in (ANY, ERROR) else f", from {low:g} to {high:g}"
    return f"{BETTER[score.better]}{ends}" + (f", in {score.unit}" if score.unit else "")
