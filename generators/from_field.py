"""Velocity field computed by another program."""

from __future__ import annotations

import functools
import itertools
from pathlib import Path

import numpy as np
from pydantic import Field, model_validator
from scipy.interpolate import NdBSpline, make_interp_spline

from sabench.api import F64, Domain, FileParameters, Flow, InputError
from sabench.worlds.library.array_files import (
    UnitArray,
    length_mm,
    read_arrays,
    speed_mm_s,
    time_s,
)

_DEGREE = 3
_FEWEST = _DEGREE + 1  # points along an axis
_EVEN = 1e-6  # of a spacing: how far a box that repeats may be from even


class FromFieldParameters(FileParameters):
    """Names of the file's arrays, and the position of its box in the world."""

    velocity: tuple[str, ...] = Field(
        ("u", "v", "w"),
        description="names of three arrays, or of one whose last axis has the three components",
    )
    axes: tuple[str, str, str] = Field(
        ("x", "y", "z"),
        description="names of the lattice's coordinates, which rise, by any steps",
    )
    time: str | None = Field(
        None,
        description="name of the times of a field that changes, the first axis of its arrays",
        examples=["t"],
    )
    order: str = Field("zyx", description="order of the arrays' axes, the slowest first")
    length: str | float | None = Field(
        None,
        description="unit of the coordinates, or mm in one of them; by default as the file says",
        examples=["m"],
    )
    speed: str | float | None = Field(
        None,
        description="unit of the velocities, or mm/s in one of them; by default as the file says",
        examples=["m/s"],
    )
    seconds: str | float | None = Field(
        None,
        description="unit of the times, or s in one of them; by default as the file says",
        examples=["ms"],
    )
    center_mm: tuple[float, float, float] | None = Field(
        None,
        description="where the box's middle is put; by default the file's coordinates hold",
        examples=[[0.0, 0.0, 30.0]],
    )
    periodic: str = Field(
        "",
        pattern="^x?y?z?$",
        description="axes along which the field repeats after one more spacing than the file has",
    )

    @model_validator(mode="after")
    def _check_names(self) -> FromFieldParameters:
        if len(self.velocity) not in (1, 3):
            raise ValueError(
                f"velocity: expected the names of three arrays or of one, got {len(self.velocity)}"
            )
        if sorted(self.order) != ["x", "y", "z"]:
            raise ValueError(f"order: expected x, y and z in some order, got {self.order!r}")
        return self


class FromField(Flow):
    """Flow from a field on a lattice, e.g. of a simulation.

    Cubic splines run between the lattice's points. Beyond its box, the field is that of its faces.
    """

    name = "from_field"
    Parameters = FromFieldParameters

    def check(self, domain: Domain) -> None:
        """Check that the field covers all of the volume.

        Raises
        ------
        InputError
            A box that leaves some of the volume out.
        """
        low, high = _field(self.parameters).box_mm()
        wanted = domain.low_mm, domain.low_mm + np.asarray(domain.size_mm)
        slack = 1e-6 * max(domain.size_mm)
        if (wanted[0] < low - slack).any() or (wanted[1] > high + slack).any():
            spans = [
                ", ".join(f"{a:.4g} to {b:.4g}" for a, b in zip(*pair, strict=True))
                for pair in (wanted, (low, high))
            ]
            raise InputError(
                f"{self.parameters.file}: expected a field over the whole volume ({spans[0]} mm "
                f"along x, y, z), got one over {spans[1]} mm"
            )

    def velocity(self, points_mm: F64, time_s: float) -> F64:
        """Evaluate the spline through the file's velocities."""
        return _field(self.parameters).at(points_mm, time_s, None)

    def gradient(self, points_mm: F64, time_s: float) -> F64:
        """Evaluate the spline's gradient; zero along an axis beyond the box."""
        field = _field(self.parameters)
        return np.stack([field.at(points_mm, time_s, axis) for axis in range(3)], axis=-1)


class _Spline:
    """Field of velocities in mm/s over (t, z, y, x) or (z, y, x)."""

    def __init__(self, lines: list[F64], values: F64, periodic: str) -> None:
        self._lines, self._periodic, knots = lines, periodic, []
        for number, (line, axis) in enumerate(zip(lines, _names(lines), strict=True)):
            repeats = axis in periodic
            if repeats:
                line = lines[number] = np.append(line, 2.0 * line[-1] - line[-2])
                values = np.concatenate([values, np.take(values, [0], axis=number)], axis=number)
            try:
                spline = make_interp_spline(
                    line,
                    np.moveaxis(values, number, 0),
                    _DEGREE,
                    bc_type="periodic" if repeats else None,
                )
            except (ValueError, np.linalg.LinAlgError) as error:
                raise InputError(
                    f"flow: expected coordinates {axis} and velocities through which a spline "
                    f"passes, got {error}"
                ) from error
            values = np.moveaxis(spline.c, 0, number)
            knots.append(spline.t)
        self._spline = NdBSpline(tuple(knots), np.ascontiguousarray(values), _DEGREE)

    def box_mm(self) -> tuple[F64, F64]:
        """Return corners (x, y, z) of the field's box."""
        endless = np.array([axis in self._periodic for axis in "xyz"])
        ends = np.array([(line[0], line[-1]) for line in self._lines[-3:]])[::-1]
        return np.where(endless, -np.inf, ends[:, 0]), np.where(endless, np.inf, ends[:, 1])

    def at(self, points_mm: F64, time_s: float, slope: int | None) -> F64:
        """Interpolate velocities (n, 3) at points (n, 3), or derivatives along an axis."""
        positions = np.column_stack(
            [*([np.full(len(points_mm), time_s)] * (len(self._lines) - 3)), points_mm[:, ::-1]]
        )
        held = np.empty_like(positions)
        for number, (line, axis) in enumerate(zip(self._lines, _names(self._lines), strict=True)):
            length = line[-1] - line[0]
            around = line[0] + np.mod(positions[:, number] - line[0], length)
            inside = np.clip(positions[:, number], line[0], line[-1])
            held[:, number] = around if axis in self._periodic else inside
        along = len(self._lines) - 1 - slope if slope is not None else None
        values = self._spline(held, nu=[int(number == along) for number in range(len(self._lines))])
        if along is not None and "xyz"[slope or 0] not in self._periodic:
            values[held[:, along] != positions[:, along]] = 0.0
        return np.asarray(values)


def _names(lines: list[F64]) -> str:
    return "tzyx"[-len(lines) :]


def _field(chosen: FromFieldParameters) -> _Spline:
    return _read(chosen.model_dump_json())


@functools.lru_cache(maxsize=1)
def _read(text: str) -> _Spline:
    """Read a field once for all flows with these parameters."""
    chosen = FromFieldParameters.model_validate_json(text)
    path = Path(chosen.file)
    names = [*chosen.velocity, *chosen.axes, *([chosen.time] if chosen.time else [])]
    arrays = read_arrays(path, names)
    lines = [_line(path, name, arrays[name]) for name in chosen.axes[::-1]]
    scales = [
        length_mm(chosen.length, arrays[name], f"{path}: {name}", "flow.length")
        for name in chosen.axes[::-1]
    ]
    lines = [line * scale for line, scale in zip(lines, scales, strict=True)]
    if chosen.center_mm is not None:
        lines = [
            line - (line[0] + line[-1]) / 2.0 + middle
            for line, middle in zip(lines, chosen.center_mm[::-1], strict=True)
        ]
    if chosen.time:
        scale = time_s(
            chosen.seconds, arrays[chosen.time], f"{path}: {chosen.time}", "flow.seconds"
        )
        lines.insert(0, _line(path, chosen.time, arrays[chosen.time]) * scale)
    for line, axis in zip(lines, _names(lines), strict=True):
        if axis in chosen.periodic and np.ptp(np.diff(line)) > _EVEN * np.diff(line).mean():
            got = f"{np.diff(line).min():g} to {np.diff(line).max():g} mm"
            raise InputError(
                f"{path}: {axis}: expected even spacing along an axis that repeats, got {got}"
            )
    speed = [
        speed_mm_s(chosen.speed, arrays[name], f"{path}: {name}", "flow.speed")
        for name in chosen.velocity
    ]
    return _Spline(
        lines,
        _velocities(path, chosen, arrays, [len(line) for line in lines], speed),
        chosen.periodic,
    )


def _line(path: Path, name: str, array: UnitArray) -> F64:
    """Read the coordinates of one axis."""
    values = array.values
    if values.ndim != 1 or len(values) < _FEWEST:
        raise InputError(
            f"{path}: {name}: expected {_FEWEST} coordinates of a lattice or more in one line, "
            f"got the shape {values.shape}"
        )
    if not (np.diff(values) > 0.0).all():
        raise InputError(
            f"{path}: {name}: expected rising coordinates, got "
            f"{', '.join(f'{value:g}' for value in values[:4])} ..."
        )
    return values


def _velocities(
    path: Path,
    chosen: FromFieldParameters,
    arrays: dict[str, UnitArray],
    counts: list[int],
    speed: list[float],
) -> F64:
    """Stack the velocities as (t, z, y, x, 3) or (z, y, x, 3) in mm/s."""
    parts = [
        arrays[name].values * scale for name, scale in zip(chosen.velocity, speed, strict=True)
    ]
    steady = len(counts) == 3
    numbers = ["zyx".index(axis) for axis in chosen.order]  # of the file's axes, among ours
    lattice = [counts[len(counts) - 3 + number] for number in numbers]
    expected = [*counts[:-3], *lattice, *[3] * (len(parts) == 1)]
    for name, part in zip(chosen.velocity, parts, strict=True):
        if list(part.shape) != expected:
            axes = ["t"] * (not steady) + [*chosen.order] + ["components"] * (len(parts) == 1)
            got = f"{part.shape}{_hint(part, counts)}"
            raise InputError(
                f"{path}: {name}: expected the shape {tuple(expected)} ({', '.join(axes)}) as the "
                f"coordinates have it, got {got}"
            )
    whole = np.stack(parts, axis=-1) if len(parts) == 3 else parts[0]
    first = 0 if steady else 1
    back = [first + numbers.index(number) for number in range(3)]
    return np.transpose(whole, [*range(first), *back, whole.ndim - 1])


def _hint(part: F64, counts: list[int]) -> str:
    """Name the orders of axes that would fit."""
    lengths, first = dict(zip("zyx", counts[-3:], strict=True)), len(counts) - 3
    fitting = [
        "".join(order)
        for order in itertools.permutations("zyx")
        if [lengths[a] for a in order] == list(part.shape[first : first + 3])
    ]
    return f": order would be {' or '.join(fitting)}" if fitting else ""
