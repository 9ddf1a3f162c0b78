"""Declared arrays of truth and of estimates: names, shapes and types.

A class declares its arrays in `ARRAYS`. One writer and one reader (`sabench.dataset.arrays`) and
one check (`Arrays.check`) serve all of them by these declarations.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from sabench.plotting.card import Card
from sabench.utils.arrays import I64, LARGEST, Bool
from sabench.utils.errors import InputError


@dataclass(frozen=True)
class Array:
    """One array of a class.

    Attributes
    ----------
    name : attribute, and name in the file unless `stored` says another.
    shape : sizes along the axes; a letter or word stands for a size that is the same wherever the
        class uses it, and for the grid's where it is "z", "y" or "x".
    dtype : of the attribute. Bool is stored as uint8.
    optional : whether the attribute may be None and the array missing.
    unique : whether all values must differ.
    finite : whether all values must be finite.
    largest : absolute value that no number may exceed.
    file_dtype : type in the file, where it is not the attribute's own.
    packed : whether files compress it, as one number for each pixel, mostly the same.
    encode, decode : between an attribute that is no array and its array.
    """

    name: str
    shape: tuple[str | int, ...]
    dtype: type[np.generic] = np.float64
    optional: bool = False
    unique: bool = False
    finite: bool = True
    largest: float = LARGEST
    stored: str = ""
    file_dtype: type[np.generic] | None = None
    packed: bool = False
    encode: Callable[[Any], Any] | None = None
    decode: Callable[[Any], Any] | None = None

    @property
    def label(self) -> str:
        """Name in the file."""
        return self.stored or self.name

    @property
    def kinds(self) -> str:
        """Letters of the kinds of numbers that the file may hold."""
        return {"f": "f", "i": "iu", "u": "u", "b": "u"}[np.dtype(self.dtype).kind]

    def to_file(self, value: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Convert an array to its type in files."""
        kind = np.uint8 if value.dtype == np.bool_ else self.file_dtype
        return value if kind is None else value.astype(kind)

    def from_file(self, stored: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Convert an array of a file to the declared type."""
        return (
            np.asarray(stored > 0)
            if self.dtype is np.bool_
            else stored.astype(self.dtype, copy=False)
        )

    def sizes(self, by_name: dict[str, int]) -> tuple[int | None, ...]:
        """List the sizes along the axes; None where a size is not known yet."""
        return tuple(size if isinstance(size, int) else by_name.get(size) for size in self.shape)

    def learn(self, shape: tuple[int, ...], by_name: dict[str, int]) -> None:
        """Add the sizes of an array of this declaration to the known ones."""
        pairs = zip(self.shape, shape, strict=True)
        by_name.update({name: size for name, size in pairs if isinstance(name, str)})

    def check_values(self, value: npt.NDArray[Any], where: str) -> None:
        """Check that values are finite, not too large and, where declared, unique.

        Raises an InputError; its sentence begins with `where`.
        """
        if value.dtype.kind == "f":
            bad = int(value.size - np.count_nonzero(np.isfinite(value))) if self.finite else 0
            if bad:
                raise InputError(
                    f"{where}: expected finite values, got {bad} that are NaN or infinite"
                )
            far = float(np.fmax.reduce(np.abs(value), axis=None, initial=0.0))
            if far > self.largest:
                raise InputError(
                    f"{where}: expected values of at most {self.largest:g}, got {far:g}"
                )
        if self.unique and not (value[1:] > value[:-1]).all():  # most numbers ascend
            numbers, times = np.unique(value, return_counts=True)
            if len(numbers) < value.size:
                raise InputError(
                    f"{where}: expected different numbers, "
                    f"got {numbers[times.argmax()]} {times.max()} times"
                )


class Arrays(Card):
    """Base of classes with declared arrays.

    Attributes
    ----------
    GROUP : group of the arrays in a file, below the frame's; "" for the frame's own, {} stands for
        the name or number of one of several.
    OF_FRAME : whether every frame has arrays of its own, or one group below the root serves all.
    EXACT : whether attributes must have the declared types, and not merely the shapes.
    """

    ARRAYS: ClassVar[tuple[Array, ...]]
    GROUP: ClassVar[str] = ""
    OF_FRAME: ClassVar[bool] = True
    EXACT: ClassVar[bool] = True

    @classmethod
    def of(cls, values: dict[str, Any]) -> Self:
        """Make an instance of arrays by the names of attributes."""
        coded = {one.name: one.decode for one in cls.ARRAYS if one.decode and one.name in values}
        return cls(**values | {name: decode(values[name]) for name, decode in coded.items()})

    def arrays(self) -> Iterator[tuple[Array, npt.NDArray[Any]]]:
        """Pair the declarations with the arrays of all attributes that are not None."""
        for array in self.ARRAYS:
            value = getattr(self, array.name)
            if value is not None or not array.optional:
                yield array, array.encode(value) if array.encode else value

    def rows(self, chosen: Bool | I64) -> Self:
        """Return some of the rows of all arrays, which are particles, say."""
        return type(self)(**{array.name: value[chosen] for array, value in self.arrays()})

    def check(self, **known: int) -> None:
        """Check that every array is as declared; `known` are sizes by their names.

        Raises an InputError if one is not.
        """
        sizes = dict(known)
        for array, value in self.arrays():
            kind, axes = np.dtype(array.dtype), array.sizes(sizes)
            is_array = isinstance(value, np.ndarray)
            fits = is_array and len(value.shape) == len(axes)
            fits = fits and all(a in (None, b) for a, b in zip(axes, value.shape, strict=True))
            if not fits or (self.EXACT and value.dtype != kind):
                pairs = zip(axes, array.shape, strict=True)
                names = [str(name if size is None else size) for size, name in pairs]
                shape = f"({', '.join(names)}{',' if len(names) == 1 else ''})"
                got = f"{value.dtype} of shape {value.shape}" if is_array else type(value).__name__
                raise InputError(f"{array.name}: expected {kind} of shape {shape}, got {got}")
            array.check_values(value, array.name)
            array.learn(value.shape, sizes)

    def _rows(self) -> Iterator[tuple[str, ...]]:
        yield (type(self).__name__,)
        for array, value in self.arrays():
            ends = f"{value.min():.4g} to {value.max():.4g}" if value.size else ""
            yield array.name, " x ".join(map(str, value.shape)), str(value.dtype), ends

    def _picture(self) -> bytes:
        """Draw positions, or balls, as seen along Z."""
        from sabench.plotting.drawing import draw_balls

        names = {array.name for array in self.ARRAYS} & {"position_mm", "center_mm"}
        return draw_balls(getattr(self, names.pop()), getattr(self, "radius_mm", None))
