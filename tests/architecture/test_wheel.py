"""What the wheel takes from outside the package, and what the metadata say."""

from __future__ import annotations

import subprocess
import tomllib

import pytest

from benchmarks import release
from tests.docs.pages import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
INCLUDED = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]


def test_what_is_included_is_there() -> None:
    assert [name for name in INCLUDED if not (ROOT / name).exists()] == []
    assert (ROOT / "sabench" / "py.typed").is_file()


def test_the_wheel_has_the_records_and_no_others() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("git does not know this checkout")
    known = subprocess.run(
        ["git", "ls-files", "leaderboard/records"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    records = {name for name in INCLUDED if name.startswith("leaderboard/records")}
    tops = {"/".join(name.split("/")[:3]) for name in known.stdout.split()}
    assert records == tops  # all pictures are those of bundled records, as other tests tell


def test_the_citation_has_the_version() -> None:
    assert release.versions_agree() is None
    assert release.metadata_is_complete() is None
