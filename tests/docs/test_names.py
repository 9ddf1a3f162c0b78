"""Modules, files, suites, commands and options that the documents name exist."""

import importlib
import re
from collections.abc import Iterator
from functools import cache
from typing import Any

import pytest
import typer

from sabench import plugins
from sabench.cli.main import app
from tests.docs.pages import PAGES, ROOT, blocks, prose

_CODE = re.compile(r"`([^`]+)`")
_FOLDERS = {path.name for path in ROOT.iterdir() if path.is_dir() and path.name != "leaderboard"}
_FOLDERS -= {"work", "build"}  # what commands make
_WRITTEN = {"--", "--help"}


@pytest.mark.parametrize("page", PAGES)
def test_named_modules_files_and_suites_exist(page: str) -> None:
    saved = {block.file for block in blocks(page)}
    words = {(line, word) for line, word in _words(page) if word not in saved}
    assert not [f"{page}:{line}: {word}" for line, word in words if not _exists(word)]


def _words(page: str) -> Iterator[tuple[int, str]]:
    for block in blocks(page):
        for word in (block.reason or "").split():
            yield block.line, word.strip(",;")
    for line, text in prose(page):
        for code in _CODE.findall(text):
            for word in code.split():
                yield line, word.strip(",;:()")


def _exists(word: str) -> bool:
    if re.fullmatch(r"sabench(\.\w+)+", word):
        return _is_importable(word)
    suite = re.fullmatch(r"suites/([\w-]+)", word)
    if suite is not None:
        return suite[1].isupper() or suite[1] in plugins.list_suites()
    file, _, test = word.partition("::")
    if test:
        return _exists(file) and f"def {test}(" in (ROOT / file).read_text(encoding="utf-8")
    if "/" in word and (word.endswith(".py") or word.split("/")[0] in _FOLDERS):
        pattern = re.sub(r"[A-Z]{3,}|\.\.\.", "*", word).rstrip("/")
        return any(True for _ in ROOT.glob(pattern))
    return True


def _is_importable(name: str) -> bool:
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            value: Any = importlib.import_module(".".join(parts[:count]))
        except ImportError:
            continue
        return all((value := getattr(value, part, None)) is not None for part in parts[count:])
    return False


@pytest.mark.parametrize("page", PAGES)
def test_named_commands_and_options_exist(page: str) -> None:
    lost = [f"{page}:{line}: {call}" for line, call in _calls(page) if not _is_command(call)]
    assert not lost


def _calls(page: str) -> Iterator[tuple[int, str]]:
    for line, text in prose(page):
        for code in _CODE.findall(text):
            if code.startswith("sabench "):
                yield line, code
    for block in blocks(page):
        if block.language == "sh":
            for text in block.text.splitlines():
                call = text.partition(" #")[0].strip()
                if call.startswith("sabench "):
                    yield block.line, call


def _is_command(call: str) -> bool:
    name, *rest = call.split()[1:]
    options = {word.partition("=")[0] for word in rest if word.startswith("--")}
    return name in _options() and options <= _options()[name] | _WRITTEN


@cache
def _options() -> dict[str, set[str]]:
    group: Any = typer.main.get_command(app)
    return {
        name: {word for option in command.params for word in (*option.opts, *option.secondary_opts)}
        for name, command in group.commands.items()
    }


def test_the_check_tells_names_that_exist_from_those_that_do_not() -> None:
    assert _exists("suites/standard")
    for word in ("suites/none", "velocimetry/correlation.py", "sabench.reproject.sweep"):
        assert not _exists(word)
