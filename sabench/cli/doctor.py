"""What this machine renders and computes on: tried, not guessed, with the remedy for what is missing."""

from __future__ import annotations

import os
import platform
import shutil
from dataclasses import dataclass
from pathlib import Path

from sabench import plugins
from sabench.utils import backend
from sabench.utils.errors import InputError
from sabench.utils.processes.child import run_code
from sabench.utils.version import __version__

_PATIENCE_S = 180


@dataclass(frozen=True)
class Finding:
    """One line of the doctor's report; `remedy` only where it is not well."""

    subject: str
    well: bool
    text: str
    remedy: str = ""


def examine() -> list[Finding]:
    """All findings; the trials run in processes of their own, since a bad library can abort one."""
    findings = [
        Finding(
            "sabench",
            True,
            f"{__version__} on Python {platform.python_version()}, {platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        )
    ]
    try:
        chosen = backend.choose()
    except InputError as error:
        return [*findings, Finding("backend", False, str(error))]  # its text holds the remedy
    findings.append(Finding("backend", True, f"{chosen.kind}: {chosen.why}"))
    findings.append(_trial("Dr.Jit kernel", "compute"))
    findings.append(_trial("Mitsuba render", "render"))
    findings.append(_space())
    return [*findings, *_plugin_findings()]


def _trial(subject: str, name: str) -> Finding:
    code = f"from sabench.cli.doctor import try_{name}; print(try_{name}())"
    try:
        return Finding(subject, True, run_code(code, "the trial", _PATIENCE_S))
    except InputError as error:
        return Finding(subject, False, str(error), backend.REMEDY)


def try_compute() -> str:
    """Sum a million numbers with a kernel and compare with the closed form."""
    dr, types = backend.drjit()
    count = 1_000_001
    total = float(dr.sum(dr.arange(types.Float, count) / (count - 1))[0])
    if abs(total - count / 2) > 1e-3 * count:
        raise SystemExit(f"expected {count / 2}, got {total}")
    return "a sum of a million numbers is right"


def try_render() -> str:
    """Render the quick scene's first camera through its wall and compare the light with the analytic sum."""
    from sabench.scenes import build_rig, load_scene
    from sabench.simulation.in_memory import make_particles
    from sabench.simulation.rendering.particle_images import image_particles, scattering_table
    from sabench.simulation.rendering.particles_traced import render

    scene = load_scene("quick")
    camera, particles = build_rig(scene).cameras[0], make_particles(scene, 0, 0)
    images = image_particles(
        scene, camera, particles, scattering_table(scene, (camera,), particles)
    )
    ratio = float(
        (render(camera, images, particles.position_mm, 9) * camera.etendue()).sum()
        / images.photons[images.visible].sum()
    )
    if not abs(ratio - 1.0) < 0.05:
        raise SystemExit(f"expected as much light as the analytic sum, got {ratio:.3f} of it")
    return f"through glass into water, with {ratio:.4f} of the analytic light"


def _space() -> Finding:
    free = shutil.disk_usage(Path.cwd()).free / 1e9
    return Finding(
        "disk",
        free > 2.0,
        f"{free:.1f} GB free here",
        "" if free > 2.0 else "free some space: the demo needs 2 GB",
    )


def _plugin_findings() -> list[Finding]:
    findings = []
    for kind in plugins.KINDS:
        for name in plugins.names(kind):
            try:
                plugins.load(kind, name)
            except InputError as error:
                findings.append(
                    Finding(f"{kind[:-1]} {name}", False, str(error), "mend or remove its file")
                )
    return findings
