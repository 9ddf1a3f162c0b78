"""Plug-ins that tests write where `SABENCH_PLUGINS` names a folder."""

import textwrap
from pathlib import Path

_SOURCE = '''"""Plug-in of a test."""

import os, pathlib, sys, time
import numpy as np
from sabench.api import {imports}
{head}

class Made({base}):
    """Made for a test."""

    name = "{name}"

{body}
'''


def write_solver(folder: Path, name: str, solve: str, head: str = "", base: str = "Solver") -> Path:
    """Write a solver with this body of `solve(self, case)`; return the folder of all plug-ins."""
    body = f"def solve(self, case):\n{textwrap.indent(solve.strip(), '    ')}"
    return write_plug_in(folder, "solvers", name, body, head, base)


def write_plug_in(
    folder: Path, kind: str, name: str, body: str, head: str = "", base: str = "Solver"
) -> Path:
    imports = ", ".join(sorted({base, "Calibration", "Parameters", "Reconstruction"}))
    own = textwrap.indent(body.strip(), "    ")
    text = _SOURCE.format(imports=imports, head=head, base=base, name=name, body=own)
    (folder / kind).mkdir(parents=True, exist_ok=True)
    (folder / kind / f"{name}.py").write_text(text, encoding="utf-8")
    return folder
