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


def test_every_offered_name_exists() -> None:
    assert "Dataset" in dir(sabench)
    for name in dir(sabench):
        assert getattr(sabench, name) is not None


def test_an_unknown_name_is_an_attribute_error() -> None:
    with refused(kind=AttributeError):
        sabench.scor  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.parametrize("name", dir(sabench))
def test_every_offered_name_has_a_docstring(name: str) -> None:
    if not name.startswith("__"):
        assert inspect.getdoc(getattr(sabench, name))


def test_the_package_declares_that_it_is_typed() -> None:
    assert (ROOT / "sabench/py.typed").is_file()
    assert (ROOT / "sabench/__init__.pyi").is_file()


def test_recorded_packages_are_dependencies() -> None:
    """Not of the extra `dev` alone, or `make demo` fails on a bare machine."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    always, full = (
        {re.split(r"[\[<>=~! ]", one)[0].lower() for one in packages}
        for packages in (project["dependencies"], project["optional-dependencies"]["full"])
    )
    recorded = {*writer._RECORDED, *parts._RENDERING}
    assert {name.lower() for name in recorded} <= always | full
