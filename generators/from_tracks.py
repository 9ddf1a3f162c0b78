"""Particles on trajectories that another program found or computed."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import Field, model_validator

from sabench.api import (
    F64,
    I64,
    Bool,
    Domain,
    FileParameters,
    Generator,
    InputError,
    Particles,
    stream,
)
from sabench.worlds.library.array_files import (
    UnitArray,
    length_mm,
    read_arrays,
    speed_mm_s,
    time_s,
)


class FromTracksParameters(FileParameters):
    """Names of the file's arrays, and the position of its coordinates in the world.

    Each array has one value for each point of each trajectory. A `file` with a * in its last part
    is a series of files; `file_number` is then an array of the numbers in their names. Columns of
    text without a line of names are "1", "2" and so on.
    """

    id: str = Field("particle", description="column of the trajectory's number")
    time: str = Field("frame", description="column of the time, or of the frame's number")
    axes: tuple[str, str, str] = Field(("x", "y", "z"), description="columns of the coordinates")
    velocity: tuple[str, str, str] | None = Field(
        None,
        description="columns of the velocity; by default it follows from neighbouring points",
        examples=[["vx", "vy", "vz"]],
    )
    diameter: str | None = Field(
        None, description="column of the diameter, in the unit of length", examples=["diameter"]
    )
    diameter_mm: float = Field(
        0.05, gt=0.0, description="diameter of all particles, where the file has none"
    )
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
        description="unit of the times, or s in one of them or in a frame; by default as the "
        "file says",
        examples=["ms"],
    )
    start_s: float | None = Field(
        None,
        description="time on the file's clock at which the first frame is taken; by default the "
        "first in the file",
        examples=[0.0],
    )
    skip_lines: int = Field(
        0, ge=0, description="number of lines left out at the top of each text file"
    )
    share: float = Field(
        1.0, gt=0.0, le=1.0, description="fraction of the trajectories that is kept, at random"
    )
    scale: float = Field(
        1.0, gt=0.0, description="factor of positions and velocities, about the origin"
    )
    center_mm: tuple[float, float, float] | None = Field(
        None,
        description="where the middle of all points is put; by default they stay",
        examples=[[0.0, 0.0, 30.0]],
    )

    @model_validator(mode="after")
    def _different(self) -> FromTracksParameters:
        if len({self.id, self.time, *self.axes}) < 5:
            raise ValueError(
                "expected five different arrays for id, time and axes, got "
                f"{[self.id, self.time, *self.axes]}"
            )
        return self


class FromTracks(Generator):
    """Particles on trajectories from a file.

    Cubics interpolate between a trajectory's points; their slopes there are its velocities.
    """

    name = "from_tracks"
    Parameters = FromTracksParameters

    def particles(self, domain: Domain, seed: int, frame: int, time_s: float) -> Particles:
        """Return the particles in the volume at a time.

        Raises
        ------
        InputError
            A time without a trajectory in the volume.
        """
        chosen: FromTracksParameters = self.parameters
        tracks = _read(chosen.model_dump_json())
        now = time_s + (tracks.time_s.min() if chosen.start_s is None else chosen.start_s)
        position, velocity, points = tracks.at(now)
        inside = (
            (position >= domain.low_mm) & (position <= domain.low_mm + np.asarray(domain.size_mm))
        ).all(axis=1)
        inside &= tracks.chosen(seed, chosen.share)[points]
        if not inside.any():
            low, high = tracks.place_mm.min(axis=0), tracks.place_mm.max(axis=0)
            spans = ", ".join(f"{a:.4g} to {b:.4g}" for a, b in zip(low, high, strict=True))
            times = f"{tracks.time_s.min():.6g} to {tracks.time_s.max():.6g}"
            raise InputError(
                f"{chosen.file}: expected a trajectory in the volume in frame {frame}, at "
                f"{now:.6g} s, got none of {len(position)}: "
                f"they run over {spans} mm along x, y, z and {times} s"
            )
        points = points[inside]
        diameter_mm = tracks.diameter_mm[points]
        return Particles(tracks.id[points], position[inside], diameter_mm, velocity[inside])


@dataclass(frozen=True)
class _Tracks:
    """Points of trajectories, sorted by trajectory and time; velocities in mm/s."""

    id: I64
    time_s: F64
    place_mm: F64
    velocity: F64
    diameter_mm: F64

    def chosen(self, seed: int, share: float) -> Bool:
        """Mark the points (n,) of a share of the trajectories, the same in all frames."""
        number, which = np.unique(self.id, return_inverse=True)
        drawn: Bool = stream(seed, "from_tracks").random(len(number)) < share
        return drawn[which]

    def at(self, now: float) -> tuple[F64, F64, I64]:
        """Interpolate all trajectories that have begun and not ended.

        Returns positions and velocities (n, 3), and the numbers (n,) of the points before them.
        """
        slack = 1e-9 * max(abs(now), float(np.ptp(self.time_s)))
        same = self.id[1:] == self.id[:-1]
        across = np.flatnonzero(
            same & (self.time_s[:-1] - slack <= now) & (now < self.time_s[1:] - slack)
        )
        last = np.flatnonzero(~np.append(same, False) & (np.abs(self.time_s - now) <= slack))
        before, after = np.concatenate([across, last]), np.concatenate([across + 1, last])
        step = (self.time_s[after] - self.time_s[before])[:, None]
        part = np.divide(
            now - self.time_s[before][:, None], step, out=np.zeros_like(step), where=step > 0.0
        )
        return (*self._between(before, after, np.clip(part, 0.0, 1.0), step), before)

    def _between(self, before: I64, after: I64, t: F64, step: F64) -> tuple[F64, F64]:
        """Evaluate Hermite's cubic and its slope."""
        p, q = self.place_mm[before], self.place_mm[after]
        u, v = self.velocity[before] * step, self.velocity[after] * step
        position = (
            (2 * t**3 - 3 * t**2 + 1) * p
            + (t**3 - 2 * t**2 + t) * u
            + (3 * t**2 - 2 * t**3) * q
            + (t**3 - t**2) * v
        )
        slope = (6 * t**2 - 6 * t) * (p - q) + (3 * t**2 - 4 * t + 1) * u + (3 * t**2 - 2 * t) * v
        return position, np.where(
            step > 0.0, slope / np.where(step > 0.0, step, 1.0), self.velocity[before]
        )


@functools.lru_cache(maxsize=1)
def _read(text: str) -> _Tracks:
    """Read a file once for all frames."""
    chosen = FromTracksParameters.model_validate_json(text)
    arrays = _read_columns(chosen)
    identity = _whole_numbers(chosen, arrays)
    time = arrays[chosen.time].values * time_s(
        chosen.seconds, arrays[chosen.time], _where(chosen, chosen.time), "particles.seconds"
    )
    position, diameter = _positions(chosen, arrays), _diameters(chosen, arrays)
    order = np.lexsort((time, identity))
    number, time, position = identity[order].astype(np.int64), time[order], position[order]
    _check_times(chosen, number, time)
    if chosen.velocity:
        velocity = _velocities(chosen, chosen.velocity, arrays)[order]
    else:
        velocity = _slopes(number, time, position)
    return _Tracks(number, time, position, velocity, diameter[order])


def _where(chosen: FromTracksParameters, name: str) -> str:
    """Name an array of the file in an error."""
    return f"{Path(chosen.file)}: {name}"


def _read_columns(chosen: FromTracksParameters) -> dict[str, UnitArray]:
    """Read the named arrays, and check that each has one value for each point."""
    names = [chosen.id, chosen.time, *chosen.axes, *(chosen.velocity or ())]
    names += [chosen.diameter] if chosen.diameter else []
    arrays = read_arrays(Path(chosen.file), names, chosen.skip_lines)
    count = arrays[chosen.id].values.size
    for name in names:
        if arrays[name].values.shape != (count,) or count < 1:
            raise InputError(
                f"{_where(chosen, name)}: expected one value for each of {count} points, and one "
                f"point or more, got {arrays[name].values.shape}"
            )
    return arrays


def _whole_numbers(chosen: FromTracksParameters, arrays: dict[str, UnitArray]) -> F64:
    """Return each point's trajectory, and check that it is a whole number."""
    identity = arrays[chosen.id].values
    broken = identity != np.rint(identity)
    if broken.any():
        raise InputError(
            f"{_where(chosen, chosen.id)}: expected whole numbers, got {identity[broken][0]:g}"
        )
    return identity


def _lengths(chosen: FromTracksParameters, arrays: dict[str, UnitArray], name: str) -> F64:
    """Convert an array to mm."""
    where = _where(chosen, name)
    return arrays[name].values * length_mm(chosen.length, arrays[name], where, "particles.length")


def _positions(chosen: FromTracksParameters, arrays: dict[str, UnitArray]) -> F64:
    """Return positions (n, 3), moved to where the file's middle is to be."""
    lengths = [_lengths(chosen, arrays, name) for name in chosen.axes]
    position = chosen.scale * np.stack(lengths, axis=1)
    if chosen.center_mm is not None:
        middle = (position.min(axis=0) + position.max(axis=0)) / 2.0
        position += np.asarray(chosen.center_mm) - middle
    return position


def _diameters(chosen: FromTracksParameters, arrays: dict[str, UnitArray]) -> F64:
    """Return diameters (n,), by default the same for all."""
    if not chosen.diameter:
        return np.full(len(arrays[chosen.id].values), chosen.diameter_mm)
    diameter = _lengths(chosen, arrays, chosen.diameter)
    if not (diameter > 0.0).all():
        raise InputError(
            f"{_where(chosen, chosen.diameter)}: expected positive diameters, got "
            f"{diameter.min():g} mm"
        )
    return diameter


def _velocities(
    chosen: FromTracksParameters, names: tuple[str, str, str], arrays: dict[str, UnitArray]
) -> F64:
    """Convert the file's velocities (n, 3) to mm/s."""
    speeds = [
        speed_mm_s(chosen.speed, arrays[name], _where(chosen, name), "particles.speed")
        for name in names
    ]
    pairs = zip(names, speeds, strict=True)
    return chosen.scale * np.stack([arrays[name].values * speed for name, speed in pairs], axis=1)


def _check_times(chosen: FromTracksParameters, number: I64, time: F64) -> None:
    """Check that a trajectory has one point at a time."""
    double = np.flatnonzero((number[1:] == number[:-1]) & (time[1:] == time[:-1]))
    if len(double):
        raise InputError(
            f"{Path(chosen.file)}: expected one point of a trajectory at a time, got two of "
            f"trajectory {number[double[0]]} at {time[double[0]]:g} s"
        )


def _slopes(identity: I64, time: F64, position: F64) -> F64:
    """Estimate velocities at points.

    They are slopes of the parabola through each point and its neighbours, or of the last three or
    two points at ends. Single points have zero velocity.
    """
    out = np.zeros_like(position)
    # whether the next point is of the same trajectory
    same = np.append(identity[1:] == identity[:-1], False)
    step = np.append(np.diff(time), 1.0)[:, None]
    moves = np.append(np.diff(position, axis=0), np.zeros((1, 3)), axis=0)
    pace = moves / np.where(same[:, None], step, 1.0)
    middle = np.flatnonzero(same & np.roll(same, 1))
    before, after = step[middle - 1], step[middle]
    out[middle] = (pace[middle - 1] * after + pace[middle] * before) / (before + after)
    begin, end = np.flatnonzero(same & ~np.roll(same, 1)), np.flatnonzero(~same & np.roll(same, 1))
    out[begin], out[end] = pace[begin], pace[end - 1]
    begin, end = begin[same[begin + 1]], end[np.isin(end - 1, middle)]
    # a parabola's slope changes evenly
    first, last = 2.0 * pace[begin] - out[begin + 1], 2.0 * pace[end - 1] - out[end - 1]
    out[begin], out[end] = first, last
    return out
