"""Tables in Markdown."""

from collections.abc import Iterable, Sequence


def written(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Write a table, a line for each row."""
    cells = [head, ["---"] * len(head), *([escaped(cell) for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(row)} |" for row in cells)


def escaped(cell: str) -> str:
    """Escape what would end a cell."""
    return cell.replace("|", "\\|")
