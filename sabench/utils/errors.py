"""Exceptions for faulty input."""

from collections.abc import Sequence
from typing import Any, Self

_LONGEST = 1200  # characters of a sentence that stands alone; a sixth of it ends one that is cut
LISTED = 400  # characters of each of several, and of words of others that a sentence repeats
MOST = 20  # sentences that are listed


class InputError(Exception):
    """Bad input: the file, key or camera, what was expected and what came.

    One fault is one sentence on one line. Several are a headline and one indented line for each. A
    sentence may quote any input: characters that cannot be printed become question marks, and of a
    very long sentence the middle is left out.

    Attributes
    ----------
    faults : the sentences, without the name of the file where `of` has made the error.
    arguments : those that make the same error again.
    """

    def __init__(self, sentence: str = "", faults: Sequence[str] = ()) -> None:
        head = one_line(sentence)
        self.faults = tuple(one_line(fault) for fault in faults) or (head,)
        listed = [one_line(fault, LISTED) for fault in faults[:MOST]] if len(faults) > 1 else []
        more = len(self.faults) - MOST
        rest = [f"and {more} more"] if more > 0 else []
        super().__init__("\n  ".join([head, *listed, *rest]))
        self.arguments = (sentence, tuple(faults))

    def __reduce__(self) -> tuple[Any, ...]:
        """Make the same error in another process."""
        return type(self), self.arguments

    @classmethod
    def from_faults(cls, source: str, faults: Sequence[str]) -> Self:
        """Make the error of one or more faults in `source`."""
        start = f"{source}: " if source else ""
        if len(faults) == 1:
            return cls(f"{start}{faults[0]}", faults)
        return cls(f"{start}{len(faults)} faults:", faults)


class DeclinedError(InputError):
    """Refusal of a case that a solver cannot handle, with the reason."""


class UncheckedError(InputError):
    """A file could not be checked in time, which is no fault of the file."""


def one_line(text: str, longest: int = _LONGEST) -> str:
    """Format printable text on one line; the middle of a long one is left out."""
    words = " ".join(text[: 100 * _LONGEST].split())
    line = "".join(mark if mark.isprintable() else "?" for mark in words)
    end = longest // 6
    return line if len(line) <= longest else f"{line[: longest - end]} ... {line[-end:]}"
