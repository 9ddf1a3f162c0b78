"""Liquid jet in a cross-flow of gas: its column and its drops.

Sources: Wu, Kirkendall, Fuller and Nejad, J. Propul. Power 13, 64 (1997): the column's path y / d =
1.37 (q x / d)^0.5 up to y / d = 3.44 q^0.5, where it breaks; the same, J. Propul. Power 14, 173
(1998): the spray's upper edge y / d = 4.3 q^0.33 (x / d)^0.33 and its width z / d = 7.86 q^0.17 (x
/ d)^0.33. x is along the gas, y along the nozzle, d its diameter, q the ratio of the momentum
fluxes of liquid and gas.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydantic import BaseModel, Field
from scipy.optimize import brentq

from sabench.utils.arrays import F64
from sabench.utils.rng import stream
from sabench.utils.validation import Vector

_PATH, _BREAK = 1.37, 3.44
_UPPER, _WIDTH, _POWER = (4.3, 0.33), (7.86, 0.17), 0.33
_PIECES = 48  # of the column
_NODES = 4001  # of a table over time
# wavelength of the column's waves in nozzle diameters, and their amplitude at its end in radii
_WAVE, _GROWN = 1.6, 0.25
# radii of ligaments where they begin and end, and of the balls there, in nozzle diameters
_THICK, _THIN, _BULB = 0.28, 0.07, 0.11
_LONG = (1.0, 3.5)  # ligaments' lengths, in the same
_BEND = np.array([0.35, 0.0, 0.0])  # into the gas, for each of their three pieces

Cones = tuple[F64, F64, F64, F64]


class Crossflow(BaseModel):
    """The jet; the gas blows along +X, the nozzle points along -Y, which is up."""

    nozzle_mm: Vector = Field((0.0, 0.0, 0.0), description="middle of the nozzle's mouth")
    diameter_mm: float = Field(3.0, gt=0.0, description="diameter of the nozzle")
    momentum_ratio: float = Field(
        10.0, gt=0.0, le=200.0, description="momentum flux of the liquid over that of the gas"
    )
    ligaments: int = Field(
        40, ge=0, le=400, description="number of ligaments that leave the column"
    )

    @property
    def break_mm(self) -> tuple[float, float]:
        """Point where the column breaks, along the gas and along the nozzle."""
        rise = _BREAK * np.sqrt(self.momentum_ratio)
        along = (rise / _PATH) ** 2 / self.momentum_ratio * self.diameter_mm
        return float(along), float(rise * self.diameter_mm)

    def upper_mm(self, x: F64) -> F64:
        """Compute the spray's upper edge above the nozzle, at x > 0 along the gas."""
        return self._edge(x, *_UPPER)

    def width_mm(self, x: F64) -> F64:
        """Compute the width of the spray at distances along the gas."""
        return self._edge(x, *_WIDTH)

    def _edge(self, x: F64, scale: float, power: float) -> F64:
        along = (x / self.diameter_mm) ** _POWER
        return np.asarray(scale * self.momentum_ratio**power * along * self.diameter_mm)

    def cones(self, seed: int) -> Cones:
        """Make column and ligaments as rounded cones.

        Starts (k, 3) and ends (k, 3) from the nozzle along the world's axes, and their radii.
        """
        rng = stream(seed, "liquid jet")
        column = self._column(rng)
        parts = [column, *(self._ligament(column, rng) for _ in range(self.ligaments))]
        starts, ends, first, last = (np.concatenate(values) for values in zip(*parts, strict=True))
        return starts, ends, first, last

    def _column(self, rng: np.random.Generator) -> Cones:
        along = np.linspace(0.0, 1.0, _PIECES + 1)
        y = along * self.break_mm[1]
        x = (y / self.diameter_mm / _PATH) ** 2 / self.momentum_ratio * self.diameter_mm
        path = np.column_stack([x, -y, np.zeros_like(y)])
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
        phase = 2.0 * np.pi * (length / (_WAVE * self.diameter_mm) + rng.random())
        waves = _GROWN * along * np.sin(phase)
        radii = self.diameter_mm / 2.0 * (1.0 - 0.35 * along) * (1.0 + waves)
        return path[:-1], path[1:], radii[:-1], radii[1:]

    def _ligament(self, column: Cones, rng: np.random.Generator) -> Cones:
        """Make a ligament that bends into the gas, thins, and ends in a ball.

        It starts anywhere on the column's later two thirds.
        """
        starts, _, radii, _ = column
        where = int(rng.integers(_PIECES // 3, _PIECES))
        root, least = starts[where], radii[where]
        x, y = rng.uniform(0.2, 1.0), rng.uniform(-0.7, 0.7)
        direction = np.array([x, y, rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 1.0)])
        length = rng.uniform(*_LONG) * self.diameter_mm
        positions = [root]
        for _ in range(3):
            direction = direction + _BEND
            step = direction / np.linalg.norm(direction) * (length + least) / 3.0
            positions.append(positions[-1] + step)
        ends = np.array(positions)
        thickness = np.linspace(min(_THICK * self.diameter_mm, least), _THIN * self.diameter_mm, 4)
        bulb = np.array([_BULB * self.diameter_mm])
        return (
            np.concatenate([ends[:-1], ends[-1:]]),
            np.concatenate([ends[1:], ends[-1:]]),
            np.concatenate([thickness[:-1], bulb]),
            np.concatenate([thickness[1:], bulb]),
        )


@dataclass(frozen=True)
class Spray:
    """Lines that drops follow from where the column breaks up.

    A drop stays at its share of the spray's height and width, and approaches the gas's speed.

    Attributes
    ----------
    lower : the spray's lower edge over its upper one.
    gas_mm_s, response_s : the gas's speed, and the response time of a drop: x'' = (gas -
        x') / response, from rest.
    end_mm : where drops are no longer followed, along the gas from the nozzle.
    """

    jet: Crossflow
    lower: float
    gas_mm_s: float
    response_s: float
    end_mm: float

    @property
    def start_mm(self) -> float:
        """Distance along the gas to the start of the spray."""
        return self.jet.break_mm[0]

    @cached_property
    def ages(self) -> tuple[F64, F64]:
        """Times since break-up until `end_mm`, and the drop's distance along the gas."""
        length = self.end_mm - self.start_mm
        last = brentq(
            lambda time: float(self._way(np.array(time))) - length,
            0.0,
            length / self.gas_mm_s + self.response_s,
        )
        time = np.linspace(0.0, last, _NODES)
        return time, self.start_mm + self._way(time)

    def _way(self, time: F64) -> F64:
        lag = self.response_s * np.expm1(-time / self.response_s)
        return np.asarray(self.gas_mm_s * (time + lag))

    def positions(self, age: F64, line: F64) -> F64:
        """Compute positions (n, 3) from the nozzle at ages (n,), of lines (n, 2).

        Lines are shares of height and of width, both from 0 to 1.
        """
        x = np.interp(age, *self.ages)
        y = -self.jet.upper_mm(x) * (self.lower + (1.0 - self.lower) * line[:, 0])
        return np.column_stack([x, y, self.jet.width_mm(x) * (line[:, 1] - 0.5)])

    def velocities(self, age: F64, positions: F64) -> F64:
        """Compute velocities (n, 3) at positions. Height and width grow as a power of x."""
        speed = -self.gas_mm_s * np.expm1(-age / self.response_s)
        slope = positions * _POWER / positions[:, :1]
        slope[:, 0] = 1.0
        return np.asarray(speed[:, None] * slope)

    def ages_and_lines(self, positions: F64) -> tuple[F64, F64]:
        """Compute ages (n,) and lines (n, 2) of positions (n, 3) from the nozzle."""
        x = positions[:, 0]
        height = (-positions[:, 1] / self.jet.upper_mm(x) - self.lower) / (1.0 - self.lower)
        time, ways = self.ages
        side = positions[:, 2] / self.jet.width_mm(x) + 0.5
        return np.interp(x, ways, time), np.column_stack([height, side])
