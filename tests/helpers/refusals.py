"""Errors and their sentences: tests name the kind and the key, a snapshot holds the sentences.

tests/sentences.json lists for each test the sentences of its errors, with `#` for numbers and `~`
for folders. `pytest --update-sentences TESTS` writes them anew.
"""

import fcntl
import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from sabench.utils.errors import InputError

SNAPSHOT = Path(__file__).resolve().parents[1] / "sentences.json"
# any folder, or the last name of pytest's own, which a second run numbers anew
_FOLDER = re.compile(r"(?:/[\w.@+-]+)+/(?:test_\w+\d\b(?!\.))?")
_NUMBER = re.compile(r"(?<![A-Za-z_])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_sentences: dict[str, list[str]] = (
    json.loads(SNAPSHOT.read_text(encoding="utf-8")) if SNAPSHOT.exists() else {}
)
_reached: dict[str, int] = {}  # sentences of the running test that were compared
update = False  # set by the option of pytest


def begin() -> None:
    _reached.clear()


@contextmanager
def refused(*keys: str, kind: type[Exception] = InputError) -> Iterator[Any]:
    """Expect an error of a kind whose sentence has every key, and is that of the snapshot."""
    with pytest.raises(kind) as end:
        yield end
    check_sentence(str(end.value), *keys)


def check_sentence(text: str, *keys: str) -> None:
    """Compare a sentence with the snapshot of the running test."""
    for key in keys:
        assert key in text
    sentence = _NUMBER.sub("#", _FOLDER.sub("~/", " ".join(text.split())))
    test = os.environ["PYTEST_CURRENT_TEST"].rpartition(" (")[0]
    number = _reached.get(test, 0)
    _reached[test] = number + 1
    stored = _sentences.get(test, [])
    if update:
        _store(test, number, sentence)
    else:
        expected = stored[number] if number < len(stored) else None
        assert sentence == expected, "changed on purpose? pytest --update-sentences"


def _store(test: str, number: int, sentence: str) -> None:
    """Store a sentence; tests that run side by side wait for each other."""
    with SNAPSHOT.open("a+", encoding="utf-8") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        file.seek(0)
        stored = json.loads(file.read() or "{}")
        stored[test] = [*stored.get(test, [])[:number], sentence]
        file.truncate(0)
        file.write(json.dumps(stored, indent=0, sort_keys=True, ensure_ascii=False) + "\n")
