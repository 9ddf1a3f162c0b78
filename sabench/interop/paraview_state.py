"""State file for ParaView: shows all that an export wrote.

It is a state in Python, which ParaView loads as it does its own (File, Load State), and which
can be read and changed.
"""

from __future__ import annotations

from pathlib import Path

NAME = "state.py"
_TEMPLATE = Path(__file__).with_name("paraview_state.py.j2")


def write_state(root: Path, home: Path) -> None:
    """Write a state into an export's folder, whose files it finds when it is loaded.

    Parameters
    ----------
    home : where the folder will lie, for a ParaView that does not tell where the state is.
    """
    text = _TEMPLATE.read_text(encoding="utf-8").replace("{{ folder }}", repr(str(home)))
    (root / NAME).write_text(text, encoding="utf-8")
