"""Every code block of the documents runs, or says why it does not. A comment before a block may say
why it is not run, `<!-- not run: REASON -->`, or under which name it is saved for the blocks after
it, `<!-- file: NAME -->`. A block in the language `output` is what the block before it prints;
`...` in it stands for any text. `python -m tests.docs` lists the blocks that are not run."""

import os
import re
import sys
from pathlib import Path

import pytest

from tests.docs.pages import PAGES, ROOT, blocks, prose, read
from tests.docs.runner import Page

_RUN = [  # `test_notebooks` runs the pages that are notebooks
    page
    for page in PAGES
    if any(one.language != "text" for one in blocks(page)) and "notebooks/" not in page
]
_TASKS = ("tasks/calibration", "tasks/particles", "tasks/reconstruction", "start/tutorial")
_FORMATS = ("formats/dataset", "formats/samples", "formats/foreign", "formats/result")
_USING = ("calibrating", "challenges", "detection", "export", "own-recordings", "planning")
_SLOW = {f"docs/{name}.md" for name in (*_TASKS, *_FORMATS, "start/experimenter")}
_SLOW |= {f"docs/using/{name}.md" for name in (*_USING, "streaming", "viewing")}
_SLOW |= {"README.md", "CONTRIBUTING.md"}
_SLOW |= {f"docs/{name}.md" for name in ("developing/participate", "reference/gallery")}


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("shared")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("scenes", "examples"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    return tmp_path


@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=pytest.mark.slow) if page in _SLOW else page for page in _RUN]
)
def test_code_blocks_run(
    page: str, folder: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    running = Page(folder, cache, monkeypatch.setenv)
    for block in blocks(page):
        if block.reason is None:
            running.run(block)


@pytest.mark.parametrize("page", PAGES)
def test_every_code_block_is_fenced_and_names_its_language(page: str) -> None:
    unnamed = [str(block) for block in blocks(page) if not block.language]
    lines = dict(prose(page))
    indented = [
        f"{page}:{number}"
        for number, line in lines.items()
        if line.startswith("    ") and not lines.get(number - 1, "fence").strip()
    ]
    assert not unnamed + indented


@pytest.mark.parametrize("page", PAGES)
def test_every_marker_stands_before_a_block(page: str) -> None:
    markers = len(re.findall(r"^ *<!-- (?:not run|file): ", read(page), re.MULTILINE))
    assert markers == sum(block.marked for block in blocks(page))
