"""Quantities and advice that a plan consists of."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Quantity:
    """One figure of a plan.

    Attributes
    ----------
    key : its name in tables and JSON, with the unit.
    value : None where the scene has no such figure.
    meaning : one line.
    source : equation or method that it comes from; numbers in brackets are those of Belden's
        thesis.
    """

    key: str
    value: float | None
    meaning: str
    source: str

    @property
    def text(self) -> str:
        """Value with three digits, a missing one as a dash."""
        if self.value is None:
            return "-"
        return f"{self.value:,.0f}" if 1e3 <= abs(self.value) < 1e7 else f"{self.value:.3g}"


@dataclass(frozen=True)
class Advice:
    """Warning of a plan.

    Attributes
    ----------
    key : key of the scene, or option of the command, to change.
    sentence : what is wrong and how to change it.
    """

    key: str
    sentence: str


@dataclass(frozen=True)
class Section:
    """Figures of one subject with their warnings."""

    title: str
    quantities: tuple[Quantity, ...]
    advice: tuple[Advice, ...] = ()

    def value(self, key: str) -> float | None:
        """Return the value of a quantity.

        Raises
        ------
        KeyError
            No quantity of this key.
        """
        return {one.key: one.value for one in self.quantities}[key]
