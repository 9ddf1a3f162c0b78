"""What must stay light, and what may not point the wrong way."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LEVELS = [
    {"errors", "arrays", "theory", "statistics", "rooflines", "columns", "plots", "jets", "linking", "foils", "code", "reference_kernel"},
    {"files", "seeds", "progress", "plugins", "memory", "sentences", "preprocessing", "apart", "archives"},
    {"records"},
    {"backend", "confined"},
    {"field"},
    {"optics", "world", "volume"},
    {"api", "scene", "swirl", "foreign", "dispersed", "placement", "implicit", "crossflow"},
    {"parsing", "hidden", "rig", "extraction", "targets", "detection", "calibration", "flows"},
    {"imaging", "metrics", "reproject", "motion", "ipr", "velocimetry", "velocity_figures", "phases"},
    {"multiphase", "codes", "bubblefit", "bubblefeature", "ellipses", "featurepeaks", "bubble_figures"},
    {"dataset", "exchange"},
    {"tomography"},
    {"recording"},
    {"generation", "programs", "solving", "scoring", "tracks", "pictures", "page", "board"},
    {"suite"},
    {"run", "reproduce", "doctor", "calibrate", "export", "retrace", "fingerprint", "probe", "baseline", "submission"},
    {"gate"},
    {"junit", "pytest_plugin"},
    {"cli"},
]


def test_importing_sabench_and_listing_load_neither_mitsuba_nor_drjit() -> None:
    script = (
        "import sys, sabench; from typer.testing import CliRunner; from sabench.cli import app;"
        "out = CliRunner().invoke(app, ['list']); assert out.exit_code == 0 and 'msa' in out.output, out.output;"
        "assert not {'mitsuba', 'drjit'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", script], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_imports_point_one_way() -> None:
    level = {name: number for number, names in enumerate(LEVELS) for name in names}
    wrong = []
    for file in sorted((ROOT / "sabench").rglob("*.py")):
        own = file.relative_to(ROOT / "sabench").parts[0].removesuffix(".py")
        if own in ("__init__", "__main__"):
            continue
        for target in _imports(file):
            if target != own and level[target] > level[own]:
                wrong.append(f"{file.relative_to(ROOT)} imports sabench.{target}")
    assert not wrong


def _imports(file: Path) -> set[str]:
    """Modules of sabench that a file imports at its top level; inside functions it may look up to break no circle."""
    found = set()
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("sabench."):
            found.add(node.module.split(".")[1])
        elif isinstance(node, ast.ImportFrom) and node.module == "sabench":
            found |= {alias.name for alias in node.names if alias.name != "__version__"}
    return found
