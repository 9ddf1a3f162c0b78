"""Numbers as text, for tables on the terminal and on pages."""

from __future__ import annotations


def significant(value: float | str | None, digits: int = 4) -> str:
    """Format a number with so many significant digits, a missing one as a dash."""
    if value is None or isinstance(value, str):
        return value or "-"
    return f"{value:,.0f}" if 1e4 <= abs(value) < 1e7 else f"{value:.{digits}g}"
