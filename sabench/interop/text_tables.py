"""Text files of other programs: encodings, separators and numbers as they come.

UTF-8 with or without a mark, UTF-16 with one, and Latin-1 are read; so are line ends of all
systems, columns apart by commas, semicolons, tabs or spaces, and decimal commas between semicolons.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sabench.utils.arrays import F64
from sabench.utils.errors import InputError

_LARGEST = 2_000_000_000  # bytes of a text file
_UNIT = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\])]*)[\])]$")  # x [mm], x (mm)
_NUMBER = re.compile(r"^[-+]?(?:\d|[.,]\d|nan$|inf)", re.IGNORECASE)  # begins as a number does


@dataclass(frozen=True)
class Table:
    """Numbers of a text file.

    Attributes
    ----------
    path : of the file.
    names, units : of the columns by the header, "" where it names no unit; empty without one.
    values : (rows, columns).
    lines : (rows,) numbers of the lines, from 1.
    """

    path: Path
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: F64
    lines: tuple[int, ...]


def read_text(path: Path) -> str:
    """Read a text file of any usual encoding.

    Raises
    ------
    InputError
        No file, a binary one, or one of more than 2 GB.
    """
    if not path.is_file():
        raise InputError(
            f"{path}: expected a file, found {'a folder' if path.is_dir() else 'none'}"
        )
    if path.stat().st_size > _LARGEST:
        raise InputError(f"{path}: expected at most {_LARGEST / 1e9:g} GB, got more")
    raw = path.read_bytes()
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16", "replace")
    if b"\0" in raw[:4096]:
        raise InputError(f"{path}: expected a text file, got a binary one")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def content_lines(path: Path) -> list[tuple[int, str]]:
    """List the lines that hold something, with their numbers from 1."""
    numbered = enumerate(read_text(path).splitlines(), 1)
    return [(number, line.strip()) for number, line in numbered if line.strip()]


def split_numbers(line: str, where: str, count: int | None = None) -> list[float]:
    """Read the numbers of a line, apart by commas or spaces.

    Raises
    ------
    InputError
        A word that is no finite number, or another number of them; `where` opens the sentence.
    """
    words = [word for word in re.split(r"[,;\s]+", line.strip()) if word]
    try:
        found = [float(word) for word in words]
    except ValueError:
        found = []
    expected = "numbers" if count is None else f"{count} numbers"
    wrong = len(found) != len(words) or (count is not None and len(found) != count)
    if wrong or not np.isfinite(found).all():
        raise InputError(f"{where}: expected {expected}, got {line[:80]!r}")
    return found


def read_table(path: Path, least: int, *, missing: bool = False) -> Table:
    """Read a table of numbers below an optional line of names.

    Lines that begin with # or % are comments; the last of them before the numbers is the header if
    it has as many words as there are columns. Columns behind the last name are `column_N`.

    Parameters
    ----------
    least : smallest number of columns.
    missing : whether values may be NaN or empty.

    Raises
    ------
    InputError
        A line of another number of columns, or a word that is no number, with the line's number.
    """
    lines = content_lines(path)
    mark = _separator(lines)
    header, comment = list[str](), list[str]()
    rows, numbers = list[list[float]](), list[int]()
    for number, line in lines:
        words = _split(line.lstrip("#%").strip(), mark)
        if line[0] in "#%":
            comment = comment if rows else words
            continue
        if not rows and _is_header(words):
            header = words
            continue
        rows.append(_row(path, number, words, mark, missing))
        numbers.append(number)
        if len(words) < least or len(rows[-1]) != len(rows[0]):
            expected = f"{len(rows[0])}" if len(rows[0]) >= least else f"{least} or more"
            raise InputError(
                f"{path}: line {number}: expected {expected} columns, got {len(words)}: "
                f"{line[:60]!r}"
            )
    columns = len(rows[0]) if rows else max(least, len(header))
    named = _names(header or (comment if len(comment) == columns else []), columns)
    return Table(
        path,
        tuple(name for name, _ in named),
        tuple(unit for _, unit in named),
        np.array(rows, dtype=np.float64).reshape(len(rows), columns),
        tuple(numbers),
    )


def _names(header: Sequence[str], columns: int) -> list[tuple[str, str]]:
    """Split names from units, and name the columns behind the last name."""
    if not header:
        return []
    rest = [f"column_{number}" for number in range(len(header) + 1, columns + 1)]
    return [_unit_of(word) for word in [*header, *rest][:columns]]


def _separator(lines: Sequence[tuple[int, str]]) -> str | None:
    """Find the separator of the columns: the one in the last line; None for spaces."""
    last = next((line for _, line in reversed(lines) if line[0] not in "#%"), "")
    return next((mark for mark in (";", "\t", ",") if mark in last), None)


def _split(line: str, mark: str | None) -> list[str]:
    words = line.split(mark)
    if mark and len(words) > 1 and not words[-1].strip():
        words = words[:-1]  # a separator at the end of the line
    return [word.strip().strip('"') for word in words]


def _is_header(words: Sequence[str]) -> bool:
    """Tell a line of names, in which no word is a number."""
    return not any(_NUMBER.match(word) for word in words if word)


def _row(
    path: Path, line: int, words: Sequence[str], mark: str | None, missing: bool
) -> list[float]:
    """Read one row; with semicolons, a comma is a decimal point."""
    found = []
    for column, word in enumerate(words, 1):
        text = word.replace(",", ".") if mark == ";" else word
        try:
            value = float(text) if text or not missing else float("nan")
        except ValueError:
            value = None
        if value is None or not (missing or np.isfinite(value)):
            raise InputError(
                f"{path}: line {line}, column {column}: expected a finite number, got {word[:40]!r}"
            )
        found.append(value)
    return found


def _unit_of(word: str) -> tuple[str, str]:
    match = _UNIT.match(word)
    return (match["name"].strip(), match["unit"].strip()) if match else (word, "")


def numbered_files(folder: Path, pattern: str) -> Iterator[tuple[int, Path]]:
    """Yield the files whose names match, with the number in the group `frame`."""
    compiled = re.compile(pattern)
    matches = ((compiled.fullmatch(path.name), path) for path in folder.iterdir())
    found = [(int(match["frame"]), path) for match, path in matches if match]
    return iter(sorted(found))
