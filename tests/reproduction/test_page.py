"""The page of the documentation: every figure, table and command that it names exists."""

from __future__ import annotations

import re
import tomllib
from typing import Any

import pytest

from reproduction import MEASUREMENTS
from reproduction.page import render
from tests.docs.pages import ROOT

FOLDER = ROOT / "docs" / "results"
SECTIONS: list[dict[str, Any]] = tomllib.loads(
    (ROOT / "reproduction" / "results.toml").read_text(encoding="utf-8")
)["section"]


@pytest.mark.parametrize("section", SECTIONS, ids=lambda one: str(one["title"]))
def test_tables_are_rectangular_and_commands_exist(section: dict[str, Any]) -> None:
    for table in section.get("table", ()):
        assert {len(row) for row in table["rows"]} == {len(table["columns"])}
    words = section.get("command", "sabench reproduce").partition(" --")[0].split()
    assert words[:2] == ["sabench", "reproduce"]
    assert set(words[2:]) <= set(MEASUREMENTS)


def test_every_figure_and_link_leads_to_a_file() -> None:
    targets = re.findall(r"\]\(([^()\s]+)\)", render())
    assert len(targets) > 40
    assert not [target for target in targets if not (FOLDER / target).is_file()]


def test_every_image_of_the_folder_is_on_the_page() -> None:
    shown = set(re.findall(r"reproduction/images/([\w-]+)\.png", render()))
    assert shown == {file.stem for file in (ROOT / "reproduction" / "images").iterdir()}


def test_all_entries_have_a_verdict() -> None:
    lines = re.findall(r"^\| (?:table|fig)-\S+ \| .+ \| .+ \| .* \|$", render(), re.MULTILINE)
    assert len(lines) == 125
