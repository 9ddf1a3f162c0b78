"""Numbers as text for tables, and round numbers for scales.

The tables are on the terminal and on pages.
"""

import math


def significant(value: float | str | None, digits: int = 4) -> str:
    """Format a number with so many significant digits, a missing one as a dash."""
    if value is None or isinstance(value, str):
        return value or "-"
    return f"{value:,.0f}" if 1e4 <= abs(value) < 1e7 else f"{value:.{digits}g}"


def format_number(value: float | None, decimals: int) -> str:
    """Format a number with so many decimals, a missing one as a dash."""
    return "-" if value is None else f"{value:.{decimals}f}"


def round_down(value: float) -> float:
    """Round down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return power * max(step for step in (1.0, 2.0, 5.0) if step <= value / power or step == 1.0)
