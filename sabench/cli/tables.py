"""Tables of the command, fitted to the terminal.

They are 200 columns wide where the output is piped.
"""

import shutil
import sys
from collections.abc import Sequence

PIPED_WIDTH = 200
_BORDER = 3  # columns of a cell's padding and of one vertical line

_Rows = Sequence[Sequence[str]]


def width() -> int:
    """Measure the columns that output may take."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else PIPED_WIDTH


def show(headings: Sequence[str], rows: _Rows, keys: int = 1) -> None:
    """Print a table.

    If it is too wide, transpose a single row, else split the columns.

    Parameters
    ----------
    keys : number of first columns that every part of a split table repeats.
    """
    sizes = [max(map(len, column)) + _BORDER for column in zip(headings, *rows, strict=True)]
    if sum(sizes) + 1 <= width():
        _print(headings, rows)
    elif len(rows) == 1:
        _print(("", "value"), list(zip(headings, rows[0], strict=True)))
    else:
        first = list(range(keys))
        parts: list[list[int]] = [[]]
        free = left = width() - 1 - sum(sizes[:keys])
        for column in range(keys, len(sizes)):
            if parts[-1] and sizes[column] > left:
                parts.append([])
                left = free
            parts[-1].append(column)
            left -= sizes[column]
        for part in [first + part for part in parts]:
            _print([headings[i] for i in part], [[row[i] for i in part] for row in rows])


def show_wrapped(headings: Sequence[str], rows: _Rows) -> None:
    """Print a table with sentences in its last columns, wrapped at words."""
    _print(headings, rows, wrap=True)


def _print(headings: Sequence[str], rows: _Rows, *, wrap: bool = False) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table()
    for number, heading in enumerate(headings):
        table.add_column(escape(heading), no_wrap=not (wrap and number), overflow="fold")
    for row in rows:
        table.add_row(*map(escape, row))
    Console(width=width()).print(table)


def shorten(text: str, columns: int) -> str:
    """Cut a text that is longer than so many columns, with an ellipsis at its end."""
    return text if len(text) <= columns else f"{text[: max(columns - 1, 0)].rstrip()}…"
