"""Commands that list, add and check parts: list, schema, new, doctor, warmup."""

from __future__ import annotations

import itertools
import json
import os
import platform
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sabench import plugins
from sabench.cli import options, tables
from sabench.cli.options import AsJson, argument, option, say, say_json
from sabench.utils.errors import InputError
from sabench.utils.version import __version__

if TYPE_CHECKING:
    from sabench.plugins import ListEntry


def list_all(
    kind: Annotated[
        str | None,
        option(
            "KIND",
            "List this kind only: generator, solver, scene or suite.",
            autocompletion=options.complete(lambda: options.KINDS),
        ),
    ] = None,
    task: Annotated[
        str | None,
        option("TASK", "List the solvers of this task only.", autocompletion=options.complete_task),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List generators, solvers, scenes and suites."""
    entries, faults = _entries(kind)
    if task is not None:
        solvers = [entry for entry in entries if entry.kind == "solver"]
        groups = sorted({entry.group for entry in solvers})
        if solvers and task not in groups:
            raise InputError(f"--task: expected one of {', '.join(groups)}, got {task!r}")
        entries = [entry for entry in solvers if entry.group == task]
    for fault in faults:
        print(f"warning: {fault}", file=sys.stderr)
    if as_json:
        say_json([_record(entry) for entry in entries])
    elif sys.stdout.isatty():  # lines are cut to the width of the terminal
        for (kind, group), members in itertools.groupby(entries, lambda row: (row.kind, row.group)):
            rows = list(members)
            say(typer.style(f"{kind}s: {group}" if group else f"{kind}s", bold=True))
            names = max(len(entry.name) for entry in rows)
            for entry in rows:
                columns = tables.width() - names - 4
                say(f"  {entry.name:<{names}}  {tables.shorten(entry.summary, columns)}")
    else:
        for entry in entries:
            say(f"{entry.kind:<10} {entry.name:<30} {entry.group:<15} {entry.summary}")


def _entries(kind: str | None) -> tuple[list[ListEntry], list[str]]:
    if kind is not None and kind not in options.KINDS:
        raise InputError(f"--kind: expected one of {', '.join(options.KINDS)}, got {kind!r}")
    entries: list[ListEntry] = []
    faults: list[str] = []
    for plural in plugins.PLUGIN_FOLDERS:
        if kind in (None, plural[:-1]):
            loaded, broken = plugins.readable(plural)
            entries += sorted(loaded, key=lambda entry: (entry.group, entry.name))
            faults += broken
    if kind in (None, "scene"):
        entries += plugins.tables("scene")
    if kind in (None, "suite"):
        entries += plugins.tables("suite")
    return entries, faults


def _record(entry: ListEntry) -> dict[str, str]:
    group = {"solver": "task", "generator": "makes"}.get(entry.kind)
    extra = {group: entry.group} if group else {}
    head = {"kind": entry.kind, "name": entry.name, **extra}
    return {**head, "summary": entry.summary, "file": str(entry.file)}


def schema() -> None:
    """Print the JSON schema of a scene file, for editors."""
    from sabench.scenes import scene_schema

    say(json.dumps(scene_schema(), indent=1))


_TEMPLATES = ("scene", "solver", "suite", "gate")


def new(
    kind: Annotated[
        str,
        argument(
            "KIND",
            "scene, solver, suite or gate.",
            autocompletion=options.complete(lambda: _TEMPLATES),
        ),
    ],
    path: Annotated[Path, argument("PATH", "The folder, or the scene file, to create.")],
    like: Annotated[
        str | None,
        option(
            "SCENE",
            "Bundled scene to copy. [default: quick]",
            autocompletion=options.complete_scene,
        ),
    ] = None,
) -> None:
    """Create a copy of a scene to change, or a folder for a solver, suite or gate.

    A folder also has tests and a workflow; its README says what to run first.
    """
    if kind not in _TEMPLATES:
        raise InputError(f"KIND: expected one of {', '.join(_TEMPLATES)}, got {kind!r}")
    if path.exists():
        raise InputError(f"{path} exists already: choose another name")
    from sabench.scenes.loading import find
    from sabench.utils.files import complete_or_nothing

    if kind == "scene":
        source = find((like or "quick"), "scenes")
        with complete_or_nothing(path) as partial:
            partial.write_bytes(source.read_bytes())
        say(f"{path}: the scene {source.stem}, to be changed")
    elif like is not None:
        raise InputError(f"--like: expected with a scene, got {like!r} with a {kind}")
    else:
        ignored = shutil.ignore_patterns("__pycache__")
        with complete_or_nothing(path) as partial:
            shutil.copytree(plugins.bundled_folder("templates") / kind, partial, ignore=ignored)
        say(f"{path}: template of a {kind}; read README.md")


_PATIENCE_S = 180
_LEAST_GB = 2.0  # memory for the suite demo


@dataclass(frozen=True)
class _Finding:
    """One line of the report; `remedy` is empty if all is well."""

    subject: str
    well: bool
    text: str
    remedy: str = ""


def doctor() -> None:
    """Check the rendering and compute back ends and say how to fix what is missing."""
    findings = examine()
    for finding in findings:
        say(f"{'ok ' if finding.well else 'BAD'} {finding.subject:<16} {finding.text}")
        if finding.remedy and not finding.well:
            say(f"    remedy: {finding.remedy}")
    if not all(finding.well for finding in findings):
        raise typer.Exit(1)


def examine() -> list[_Finding]:
    """Examine the installation.

    Trials run in child processes, which a bad library may abort.
    """
    from sabench.utils import backend

    system = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    version = f"{__version__} on Python {platform.python_version()}, {system}"
    findings = [_Finding("sabench", True, version)]
    try:
        chosen = backend.choose()
    except InputError as error:  # its message includes the remedy
        return [*findings, _Finding("backend", False, str(error))]
    findings.append(_Finding("backend", True, f"{chosen.kind}: {chosen.why}"))
    findings.append(_try("Dr.Jit kernel", "compute", backend.REMEDY))
    findings.append(_try("Mitsuba render", "render", backend.REMEDY))
    free = shutil.disk_usage(Path.cwd()).free / 1e9
    remedy = f"free some space: `sabench run demo` needs {_LEAST_GB:.0f} GB"
    findings.append(
        _Finding("disk", free > _LEAST_GB, f"{free:.1f} GB free in this folder", remedy)
    )
    count, faults = 0, []
    for kind in plugins.PLUGIN_FOLDERS:
        for name in plugins.names(kind):
            count += 1
            try:
                plugins.load(kind, name)
            except InputError as error:
                remedy = "correct or remove its file"
                faults.append(_Finding(f"{kind[:-1]} {name}", False, str(error), remedy))
    return findings + (faults or [_Finding("plug-ins", True, f"all {count} can be imported")])


def _try(subject: str, name: str, remedy: str) -> _Finding:
    """Call `try_<name>` in a child process."""
    from sabench.utils.processes.python import run_code

    code = f"from sabench.cli.maintain import try_{name}; print(try_{name}())"
    try:
        return _Finding(subject, True, run_code(code, "the trial", _PATIENCE_S))
    except InputError as error:
        return _Finding(subject, False, str(error), remedy)


def try_compute() -> str:
    """Sum a million numbers with a kernel and compare with the closed form."""
    from sabench.utils import backend

    dr, types = backend.drjit()
    count = 1_000_001
    total = float(dr.sum(dr.arange(types.Float, count) / (count - 1))[0])
    if abs(total - count / 2) > 1e-3 * count:
        raise SystemExit(f"expected {count / 2}, got {total}")
    return "sums a million numbers correctly"


def try_render() -> str:
    """Render the first camera of the scene `quick` and check its light.

    It is compared with the analytic value.
    """
    from sabench.scenes import build_rig, load_scene
    from sabench.simulation.in_memory import make_particles
    from sabench.simulation.rendering.particle_images import image_particles
    from sabench.simulation.rendering.particle_light import scatterers_of
    from sabench.simulation.rendering.particles_traced import render

    scene = load_scene("quick")
    camera, particles = build_rig(scene).cameras[0], make_particles(scene, 0, 0)
    images = image_particles(scene, camera, particles, scatterers_of(scene, (camera,), 0))
    rendered = render(camera, images, particles.position_mm, 9) * camera.etendue()
    ratio = float(rendered.sum() / images.photons[images.visible].sum())
    if not abs(ratio - 1.0) < 0.05:
        raise SystemExit(f"expected the light of the analytic sum, got {ratio:.3f} of it")
    return f"renders through glass and water, {ratio:.4f} of the analytic light"


def warmup(
    solvers: Annotated[
        list[str] | None,
        argument(
            "SOLVER", "Names of solvers; by default all.", autocompletion=options.complete_solver
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compile the kernels of solvers now, for images of containers.

    The exit code is 1 if a solver fails.
    """
    from dataclasses import asdict

    from sabench.tasks.conformance import warm_up

    options.announce_compiling()
    warmed = []
    for run in warm_up(solvers or ()):
        warmed.append(run)
        if not as_json:
            say(f"{run.compile_s:6.1f} s {run.solver}{': ' + run.text if run.text else ''}")
    if as_json:
        say_json([asdict(run) for run in warmed])
    if any(run.verdict == "broken" for run in warmed):
        raise typer.Exit(1)
