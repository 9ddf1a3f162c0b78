"""Imports that must stay light."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
HEAVY = {
    "mitsuba",
    "drjit",
    "numpy",
    "scipy",
    "cv2",
    "numba",
    "h5py",
    "sabench.plugins.solvers.msa",
}


def loaded(script: str) -> set[str]:
    """Return those of the heavy modules that a script loads."""
    report = f"{script}\nimport sys; print('loaded', *({HEAVY!r} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", report],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines()[-1].split()[1:])


def test_importing_sabench_loads_nothing_heavy() -> None:
    assert not loaded("import sabench; dir(sabench)")


def test_listing_imports_no_plug_in_and_no_numerical_library() -> None:
    script = """
from typer.testing import CliRunner
from sabench.cli.main import app
out = CliRunner().invoke(app, ['list'])
assert out.exit_code == 0 and 'msa' in out.output, out.output
"""
    assert not loaded(script)


def test_names_for_completion_import_no_plug_in() -> None:
    script = """
from sabench import plugins
from sabench.cli import options
assert options.complete_solver('refr') and options.complete_scene('qu') == ['quick']
assert options.complete(lambda: plugins.list_solvers('calibration'))('m') == []
assert options.complete(plugins.list_suites)('c')
"""
    assert not loaded(script)


def test_what_plug_ins_import_loads_no_renderer() -> None:
    assert not loaded("import sabench.api") & {"mitsuba", "drjit", "cv2", "numba", "h5py"}
