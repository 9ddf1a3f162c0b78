"""The wheel, its metadata, and the names that the package offers."""

import inspect
import re
import subprocess
import tomllib

import pytest

import sabench
from benchmarks import release
from sabench.dataset import writer
from sabench.simulation.recording import parts
from tests.docs.pages import ROOT
from tests.helpers.refusals import refused

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
INCLUDED = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]


def test_what_is_included_is_there() -> None:
    typed = ("sabench/py.typed", "sabench/__init__.pyi")
    assert [name for name in (*INCLUDED, *typed) if not (ROOT / name).exists()] == []


def test_the_wheel_has_the_records_and_no_others() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("git does not know this checkout")
    known = subprocess.check_output(["git", "ls-files", "leaderboard/records"], cwd=ROOT, text=True)
    records = {name for name in INCLUDED if name.startswith("leaderboard/records")}
    tops = {"/".join(name.split("/")[:3]) for name in known.split()}
    assert records == tops  # all pictures are those of bundled records, as other tests tell


def test_the_citation_has_the_version() -> None:
    assert release.versions_agree() is None
    assert release.metadata_is_complete() is None


def test_every_offered_name_exists_and_has_a_docstring() -> None:
    assert "Dataset" in dir(sabench)
    offered = {name: getattr(sabench, name) for name in dir(sabench)}
    own = {name: value for name, value in offered.items() if not name.startswith("__")}
    assert [name for name, value in own.items() if not inspect.getdoc(value)] == []


def test_an_unknown_name_is_an_attribute_error() -> None:
    with refused("scor", kind=AttributeError):
        sabench.scor  # type: ignore[attr-defined]  # noqa: B018


def test_recorded_packages_are_dependencies() -> None:
    """Not of the extra `dev` alone, or `make demo` fails on a bare machine."""
    project = PROJECT["project"]
    packages = [*project["dependencies"], *project["optional-dependencies"]["full"]]
    names = {re.split(r"[\[<>=~! ]", one)[0].lower() for one in packages}
    assert {name.lower() for name in (*writer._RECORDED, *parts._RENDERING)} <= names
