"""The command `sabench doctor`: tests of the installation, with remedies."""

from __future__ import annotations

import os
import platform
import shutil
from dataclasses import dataclass
from pathlib import Path

import typer

from sabench import plugins
from sabench.cli.options import say
from sabench.utils.errors import InputError
from sabench.utils.version import __version__

_PATIENCE_S = 180
_LEAST_GB = 2.0  # what the suite demo needs


@dataclass(frozen=True)
class Finding:
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


def examine() -> list[Finding]:
    """Examine the installation.

    Trials run in child processes, which a bad library may abort.
    """
    from sabench.utils import backend

    system = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    version = f"{__version__} on Python {platform.python_version()}, {system}"
    findings = [Finding("sabench", True, version)]
    try:
        chosen = backend.choose()
    except InputError as error:  # its message includes the remedy
        return [*findings, Finding("backend", False, str(error))]
    findings.append(Finding("backend", True, f"{chosen.kind}: {chosen.why}"))
    findings.append(_try("Dr.Jit kernel", "compute", backend.REMEDY))
    findings.append(_try("Mitsuba render", "render", backend.REMEDY))
    return [*findings, _examine_disk(), *_examine_plugins()]


def _try(subject: str, name: str, remedy: str) -> Finding:
    """Call `try_<name>` in a child process."""
    from sabench.utils.processes.python import run_code

    code = f"from sabench.cli.doctor import try_{name}; print(try_{name}())"
    try:
        return Finding(subject, True, run_code(code, "the trial", _PATIENCE_S))
    except InputError as error:
        return Finding(subject, False, str(error), remedy)


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


def _examine_disk() -> Finding:
    free = shutil.disk_usage(Path.cwd()).free / 1e9
    remedy = f"free some space: `sabench run demo` needs {_LEAST_GB:.0f} GB"
    return Finding("disk", free > _LEAST_GB, f"{free:.1f} GB free in this folder", remedy)


def _examine_plugins() -> list[Finding]:
    """Import every plug-in."""
    faults = []
    for kind in plugins.KINDS:
        for name in plugins.names(kind):
            try:
                plugins.load(kind, name)
            except InputError as error:
                subject, remedy = f"{kind[:-1]} {name}", "correct or remove its file"
                faults.append(Finding(subject, False, str(error), remedy))
    count = sum(len(plugins.names(kind)) for kind in plugins.KINDS)
    return faults or [Finding("plug-ins", True, f"all {count} can be imported")]
