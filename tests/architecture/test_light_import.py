"""What must stay light."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_importing_sabench_and_listing_load_neither_mitsuba_nor_drjit() -> None:
    script = (
        "import sys, sabench; from typer.testing import CliRunner; from sabench.cli.main import app;"
        "out = CliRunner().invoke(app, ['list']); assert out.exit_code == 0 and 'msa' in out.output, out.output;"
        "assert not {'mitsuba', 'drjit'} & set(sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", script],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
