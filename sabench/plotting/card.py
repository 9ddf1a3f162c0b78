"""Values that show themselves: lines of text; in notebooks, tables and pictures."""

import base64
import contextlib
import itertools
from collections.abc import Iterator
from html import escape

_Row = tuple[str, ...]


class Card:
    """Base of values that show themselves.

    A class yields its rows and may draw a picture. What cannot be read or drawn is left out, so
    that showing a value never raises.
    """

    def _rows(self) -> Iterator[_Row]:
        """Yield rows of cells, the title first; one cell alone spans all columns."""
        yield (type(self).__name__,)

    def _picture(self) -> bytes:
        """Draw a small PNG, from one frame at most."""
        raise NotImplementedError(f"{type(self).__name__} has no picture")

    def _shown(self) -> list[_Row]:
        rows: list[_Row] = []
        with contextlib.suppress(Exception):
            rows.extend(self._rows())  # keeps the rows before an error
        return rows or [(type(self).__name__,)]

    def __repr__(self) -> str:
        """Return the rows, those between lines as an aligned table."""
        lines = []
        for single, block in itertools.groupby(self._shown(), lambda row: len(row) == 1):
            rows = [(f"{row[0]}:", row[1]) if len(row) == 2 else row for row in block]
            widths = [max(map(len, cells)) for cells in itertools.zip_longest(*rows, fillvalue="")]
            for row in rows:
                line = "  "[: len(row) - 1].join(map(str.ljust, row, widths)).rstrip()
                lines.append(line if single else f"  {line}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """Return the rows as a table, and the picture next to it."""
        rows, picture = self._shown(), ""
        columns = max(map(len, rows))
        table = "".join(
            f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>"
            if row[1:]
            else f'<tr><th colspan="{columns}" style="text-align: left">{escape(row[0])}</th></tr>'
            for row in rows
        )
        with contextlib.suppress(Exception):
            data = base64.b64encode(self._picture()).decode()
            picture = f'<img alt="{escape(rows[0][0])}" src="data:image/png;base64,{data}">'
        style = "display: flex; flex-wrap: wrap; gap: 1em; align-items: start"
        return f'<div style="{style}"><table>{table}</table>{picture}</div>'
