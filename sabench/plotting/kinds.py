"""Found, missed, ghost and duplicate: a definition, a name and a colour each."""

DEFINITION = (
    "Found: an estimated particle paired with a true one within the matching distance, one to one, "
    "the closest first; missed: a true particle without a pair; ghost: an estimated one without a "
    "pair; duplicate: a ghost within that distance of a true particle."
)
# Okabe and Ito: colours that the colour-blind can distinguish, on white and on black
COLOURS = {"found": "#009E73", "missed": "#0072B2", "ghost": "#D55E00", "duplicate": "#CC79A7"}
KINDS = ("true", *COLOURS)  # pages draw them in this order: errors above the others
TRUE, FOUND, MISSED, GHOST, DUPLICATE = range(len(KINDS))


def rgb(kind: str) -> tuple[int, ...]:
    """Return a kind's colour as red, green and blue from 0 to 255."""
    return tuple(bytes.fromhex(COLOURS[kind][1:]))
