"""The one exception that means: the input is wrong, and here is the sentence that says how."""

_LONGEST, _END = 1200, 200  # characters of a sentence, and of its end where its middle is left out


class InputError(Exception):
    """Bad input: one sentence that names the file, key or camera, what was expected and what came.

    It may quote what came, whatever that is: what cannot be printed becomes a question mark, and of
    very long ones the middle is left out.
    """

    def __init__(self, sentence: str = "") -> None:
        line = "".join(
            mark if mark.isprintable() else "?"
            for mark in " ".join(sentence[: 100 * _LONGEST].split())
        )
        super().__init__(
            line if len(line) <= _LONGEST else f"{line[: _LONGEST - _END]} ... {line[-_END:]}"
        )


class DeclinedError(InputError):
    """A solver cannot take a case, and says why: not a fault of either."""
