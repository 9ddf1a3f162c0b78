"""Discovery of plug-ins, and their descriptions."""

import os
import sys
from pathlib import Path

import pytest

from sabench import plugins
from tests.helpers.refusals import check_sentence, refused

BROKEN = '"""Gone."""\n\nfrom sabench.reproject import sweep\n'


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of solvers that SABENCH_PLUGINS names."""
    monkeypatch.setenv("SABENCH_PLUGINS", str(tmp_path))
    (tmp_path / "solvers").mkdir()
    return tmp_path / "solvers"


@pytest.mark.parametrize(("kind", "attribute"), [("solvers", "task"), ("generators", "makes")])
def test_descriptions_equal_what_importing_would_give(kind: str, attribute: str) -> None:
    for name in plugins.names(kind):
        entry, plugin = plugins.summarise(kind, name), plugins.load(kind, name)
        assert entry.summary == plugins.summary(plugin)
        assert entry.group == getattr(plugin, attribute)
        assert entry.file == plugins.file_of(kind, name)


def test_a_broken_plug_in_is_one_fault_and_hides_nothing(folder: Path) -> None:
    before, _ = plugins.readable("solvers")
    (folder / "gone.py").write_text(BROKEN, encoding="utf-8")
    (folder / "torn.py").write_text("class Torn(Solver:\n", encoding="utf-8")
    entries, faults = plugins.readable("solvers")
    assert entries == before
    assert len(faults) == 2
    check_sentence(faults[0], "gone.py: line 3", "sabench.reproject")
    assert "torn.py: line 1" in faults[1]
    assert plugins.load("solvers", "msa").name == "msa"


def test_a_class_whose_task_cannot_be_read_is_imported(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (
        "import sabench.api\n\n"
        "class Odd(sabench.api.Solver):\n    '''Odd one.'''\n    name = 'o' + 'dd'\n"
    )
    (folder / "odd.py").write_text(text, encoding="utf-8")
    package = sys.modules["sabench.plugins.solvers"]
    monkeypatch.setattr(package, "__path__", [*map(str, plugins.folders("solvers"))])
    entry = plugins.summarise("solvers", "odd")
    assert (entry.group, entry.summary) == ("reconstruction", "Odd one.")


def test_a_folder_that_is_named_twice_counts_once(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "odd.py").write_text(BROKEN, encoding="utf-8")
    root = folder.parent
    (root / "link").symlink_to(root)
    monkeypatch.chdir(root)
    monkeypatch.setenv("SABENCH_PLUGINS", os.pathsep.join([str(root), ".", "link"]))
    assert plugins.file_of("solvers", "odd") == folder / "odd.py"


def test_two_plug_ins_of_one_name_are_refused_and_stop_no_other(folder: Path) -> None:
    (folder / "asa.py").write_text(BROKEN, encoding="utf-8")
    with refused("asa"):
        plugins.load("solvers", "asa")
    assert plugins.load("solvers", "msa").name == "msa"
    assert "asa" not in [entry.name for entry in plugins.readable("solvers")[0]]


def test_lists_of_a_task_warn_of_a_broken_plug_in(folder: Path) -> None:
    (folder / "gone.py").write_text(BROKEN, encoding="utf-8")
    with pytest.warns(UserWarning, match=r"gone\.py"):
        names = plugins.list_solvers("velocimetry")
    assert names == ["piv2d", "piv3d", "piv3d_plain"]
    assert "gone" in plugins.list_solvers()


def test_scenes_and_suites_are_listed_by_their_titles() -> None:
    assert "quick" in plugins.list_scenes()
    assert "ci" in plugins.list_suites()
    assert all(entry.summary for entry in plugins.tables("scene") + plugins.tables("suite"))
