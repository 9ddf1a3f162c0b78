"""Packages whose versions data sets record are installed wherever data sets are made."""

from __future__ import annotations

import re
import tomllib

from sabench.dataset import writer
from sabench.simulation.recording import parts
from tests.docs.pages import ROOT


def test_recorded_packages_are_dependencies() -> None:
    """Not of the extra `dev` alone, or `make demo` fails on a bare machine."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    always, full = (
        {re.split(r"[\[<>=~! ]", one)[0].lower() for one in packages}
        for packages in (project["dependencies"], project["optional-dependencies"]["full"])
    )
    recorded = {*writer._RECORDED, *parts._RENDERING}
    assert {name.lower() for name in recorded} <= always | full
