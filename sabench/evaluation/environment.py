"""Machine and versions of a run, which its records name."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from pathlib import Path
from typing import Any

from sabench.utils import backend
from sabench.utils.errors import InputError
from sabench.utils.version import __version__


def versions() -> dict[str, str]:
    """List the versions of everything that affects the scores."""
    libraries = {name: version_of(name) for name in ("mitsuba", "drjit", "numpy", "scipy")}
    return libraries | {"sabench": __version__, "python": platform.python_version()}


def machine() -> dict[str, Any]:
    """Describe the machine of this run."""
    info = Path("/proc/cpuinfo")
    models = (
        [
            line.split(":", 1)[1].strip()
            for line in info.read_text().splitlines()
            if line.startswith("model name")
        ]
        if info.exists()
        else []
    )
    try:
        kind = backend.choose().kind
    except InputError:
        kind = "none"
    cpu = models[0] if models else platform.processor() or platform.machine()
    return {
        "cpu": cpu,
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "backend": kind,
    }


def version_of(package: str) -> str:
    """Return the version of an installed package."""
    return importlib.metadata.version(package)
