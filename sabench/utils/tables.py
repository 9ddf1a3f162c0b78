"""Tables in text files: encodings, separators and numbers as they come.

UTF-8 with or without a mark, UTF-16 with one, and Latin-1 are read; so are line ends of all
systems, columns apart by commas, semicolons, tabs or spaces, and decimal commas between semicolons.
"""

import contextlib
import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.files import LARGEST_DATA
from sabench.utils.validation import printable

_UNIT = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\])]*)[\])]$")  # x [mm], x (mm)
_NUMBER = re.compile(r"^[-+]?(?:\d|[.,]\d|nan$|inf)", re.IGNORECASE)  # begins as a number does


@dataclass(frozen=True)
class UnitArray:
    """Array with the unit that its file names."""

    values: F64
    unit: str | None = None


@dataclass(frozen=True)
class NumberTable:
    """Numbers of a text file.

    Attributes
    ----------
    names, units : of the columns by the header, "" where it names no unit; empty without one.
    values : (rows, columns).
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: F64

    def columns(self) -> dict[str, UnitArray]:
        """Return the columns by their names, or by their numbers from 1 without a header."""
        names = self.names or tuple(str(i + 1) for i in range(self.values.shape[1]))
        units = self.units or ("",) * len(names)
        return {
            name: UnitArray(self.values[:, i], units[i] or None) for i, name in enumerate(names)
        }


def read_text(path: Path) -> str:
    """Read a text file of any usual encoding.

    Raises InputError: no file, a binary one, or one of more than 2 GB.
    """
    if not path.is_file():
        kind = "a folder" if path.is_dir() else "none"
        raise InputError(f"{path}: expected a file, found {kind}")
    if path.stat().st_size > LARGEST_DATA:
        raise InputError(f"{path}: expected at most {LARGEST_DATA / 1e9:g} GB, got more")
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

    Raises InputError: a word that is no finite number, or another number of them; `where` opens the
    sentence.
    """
    words = [word for word in re.split(r"[,;\s]+", line.strip()) if word]
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    expected = "numbers" if count is None else f"{count} numbers"
    wrong = len(numbers) != len(words) or (count is not None and len(numbers) != count)
    if wrong or not np.isfinite(numbers).all():
        raise InputError(f"{where}: expected {expected}, got {line[:80]!r}")
    return numbers


def read_table(
    path: Path, least: int, *, missing: bool = False, skip_lines: int = 0
) -> NumberTable:
    """Read a table of numbers below an optional line of names.

    Lines that begin with # or % are comments; the last of them before the numbers is the header if
    it has as many words as there are columns. Of several lines without a number, the first with as
    many words as columns is the header. Columns behind the last name are `column_N`. Columns of
    text, where there are names, are NaN.

    Parameters
    ----------
    least : smallest number of columns.
    missing : whether values may be NaN or empty.
    skip_lines : lines at the top of the file that are left out.

    Raises InputError: a line of another number of columns, or a word that is no number, with the
    line's number.
    """
    lines = [line for line in content_lines(path) if line[0] > skip_lines]
    mark = _separator(lines)
    heads, body = _split_head(lines, mark)
    ends = [_split(line, mark) for _, line in (body[:1] + body[-1:])]
    columns = len(ends[0]) if body else max([least, *(len(words) for words in heads)])
    if columns < least:
        raise InputError(
            f"{path}: line {body[0][0]}: expected {least} or more columns, got {columns}: "
            f"{body[0][1][:60]!r}"
        )
    names = _names(heads, columns)
    numeric = [i for i in range(columns) if not names or not _is_text(ends, i)]
    values = _read_fast(body, mark, numeric, columns) if body else np.zeros((0, columns))
    if values is None or not (missing or np.isfinite(values).all()):
        values = _read_slowly(path, body, mark, numeric, columns, missing=missing)
    return NumberTable(tuple(name for name, _ in names), tuple(unit for _, unit in names), values)


def read_named_rows(
    path: Path, needed: Sequence[str], possible: Sequence[str], aliases: Mapping[str, str]
) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield the lines below a header as words by name, with their places.

    Capitals and blanks in the header do not matter. Decimal commas become points.

    Parameters
    ----------
    needed, possible : names of columns that the header must have, and that it may have.
    aliases : other spellings of names.
    """
    numbered = list(enumerate(read_text(path).splitlines(), 1))
    mark = _separator(numbered[:1]) or ","
    rows = [(number, words) for number, line in numbered if any(words := _words(line, mark))]
    cells = rows[0][1] if rows else []
    names = [aliases.get(head, head) for head in (cell.lower() for cell in cells)]
    wrong = [name for name in names if name not in (*needed, *possible)]
    if wrong or len(set(names)) != len(names) or not set(needed) <= set(names):
        also = f" and possibly {','.join(possible)}" if possible else ""
        raise InputError(
            f"{path}: expected the first line {','.join(needed)}{also}, got "
            f"{printable(','.join(cells))}"
        )
    for number, words in rows[1:]:
        where = f"{path}: line {number}"
        if len(words) != len(names):
            raise InputError(f"{where}: expected {len(names)} columns, got {len(words)}")
        plain = words if mark == "," else [word.replace(",", ".") for word in words]
        yield where, dict(zip(names, plain, strict=True))


def _split_head(
    lines: Sequence[tuple[int, str]], mark: str | None
) -> tuple[list[list[str]], list[tuple[int, str]]]:
    """Split lines of names, as words, from lines of numbers; drop comments.

    The last comment before the numbers comes last, behind the lines of names.
    """
    heads, comment, body = list[list[str]](), list[list[str]](), list[tuple[int, str]]()
    for number, line in lines:
        words = [] if body else _split(line.lstrip("#%").strip(), mark)
        if line[0] in "#%":
            comment = comment if body else [words]
        elif body or any(_NUMBER.match(word) for word in words if word):
            body.append((number, line))
        else:
            heads.append(words)
    if not heads and body:  # a comment is the header if it has as many words as there are columns
        comment = [words for words in comment if len(words) == len(_split(body[0][1], mark))]
    return [*heads, *comment], body


def _names(heads: Sequence[Sequence[str]], columns: int) -> list[tuple[str, str]]:
    """Choose the header, split names from units, and name further columns."""
    if not heads:
        return []
    header = next((words for words in heads if len(words) == columns), heads[-1])
    rest = [f"column_{number}" for number in range(len(header) + 1, columns + 1)]
    words = [(word, _UNIT.match(word)) for word in [*header, *rest][:columns]]
    return [
        (match["name"].strip(), match["unit"].strip()) if match else (word, "")
        for word, match in words
    ]


def _separator(lines: Sequence[tuple[int, str]]) -> str | None:
    """Find the separator of the columns: the one in the last line; None for spaces."""
    last = next((line for _, line in reversed(lines) if line[0] not in "#%"), "")
    return next((mark for mark in (";", "\t", ",") if mark in last), None)


def _split(line: str, mark: str | None) -> list[str]:
    """Split a line of a table of numbers, which may end with a separator."""
    words = _words(line, mark)
    return words[:-1] if mark and len(words) > 1 and not words[-1] else words


def _words(line: str, mark: str | None) -> list[str]:
    words = line.split(mark)
    if mark and '"' in line:
        with contextlib.suppress(csv.Error):
            words = next(csv.reader([line], delimiter=mark))
    return [word.strip().strip('"') for word in words]


def _is_text(rows: Sequence[Sequence[str]], column: int) -> bool:
    words = [row[column] for row in rows if column < len(row)]
    return bool(words) and all(word and not _NUMBER.match(word) for word in words)


def _read_fast(
    body: Sequence[tuple[int, str]], mark: str | None, numeric: Sequence[int], columns: int
) -> F64 | None:
    """Read a plain table; None for one that is not."""
    try:
        values = np.loadtxt([line for _, line in body], delimiter=mark, comments=None, ndmin=2)
    except ValueError:
        return None
    return np.asarray(values) if values.shape[1] == columns == len(numeric) else None


def _read_slowly(
    path: Path,
    body: Sequence[tuple[int, str]],
    mark: str | None,
    numeric: Sequence[int],
    columns: int,
    *,
    missing: bool,
) -> F64:
    """Read a table word by word, and name the line of a fault."""
    rows = []
    for number, line in body:
        words = _split(line, mark)
        if len(words) != columns:
            raise InputError(
                f"{path}: line {number}: expected {columns} columns, got {len(words)}: "
                f"{line[:60]!r}"
            )
        where = f"{path}: line {number}, column"
        rows.append([_value(f"{where} {i + 1}", words[i], mark, missing=missing) for i in numeric])
    values = np.full((len(body), columns), np.nan)
    values[:, numeric] = np.array(rows, dtype=np.float64).reshape(len(body), len(numeric))
    return values


def _value(where: str, word: str, mark: str | None, *, missing: bool) -> float:
    """Read one word; with semicolons, a comma is a decimal point."""
    try:
        value = float(word.replace(",", ".") if mark == ";" else word or "nan")
    except ValueError:
        value = np.inf
    if not np.isfinite(value) and not (missing and np.isnan(value)):
        raise InputError(f"{where}: expected a finite number, got {word[:40]!r}")
    return value


def numbered_files(folder: Path, pattern: str) -> Iterator[tuple[int, Path]]:
    """Yield the files with matching names, with the number in the group `frame`."""
    compiled = re.compile(pattern)
    matches = ((compiled.fullmatch(path.name), path) for path in folder.iterdir())
    files = [(int(match["frame"]), path) for match, path in matches if match]
    return iter(sorted(files))
