"""Reader and writer of declared arrays, for truth, shards and results."""

from collections.abc import Callable, Collection
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from sabench.api.arrays import Array, Arrays
from sabench.dataset import schema
from sabench.utils.errors import InputError

Named = dict[str, npt.NDArray[Any]]  # arrays by their names in a file
Fetch = Callable[[str, tuple[int | None, ...], str], npt.NDArray[Any]]  # as `hdf5.read_array`
AnyArrays = TypeVar("AnyArrays", bound=Arrays)
_CHUNK = 256  # voxels along a side of the pieces in which volumes are compressed


def group_of(kind: type[Arrays], frame: int = 0, which: str | int = "") -> str:
    """Name the group of arrays in a file.

    `which` is one of several, such as a camera's name.
    """
    names = (schema.frame_group(frame) if kind.OF_FRAME else "", kind.GROUP.format(which))
    return "/".join(name for name in names if name)


def name_of(group: str, declared: Array) -> str:
    """Name an array in a file."""
    return f"{group}/{declared.label}" if group else declared.label


def read_declared(
    kind: type[AnyArrays],
    fetch: Fetch,
    group: str,
    file: object,
    sizes: dict[str, int] | None = None,
    names: Collection[str] | None = None,
) -> AnyArrays:
    """Read what a class declares.

    Parameters
    ----------
    fetch : function that reads an array by its name, shape and kinds, and checks these.
    file : its name, for errors.
    sizes : known sizes by their names in the declarations; those of the file are added.
    names : members of the group; None: no optional array is there.

    Raises InputError for an array that is missing, has another shape or type, or holds values that
    are refused.
    """
    sizes = {} if sizes is None else sizes
    values: Named = {}
    for one in kind.ARRAYS:
        if one.optional and one.label not in (names or ()):
            continue
        name = name_of(group, one)
        value = one.from_file(fetch(name, one.sizes(sizes), one.kinds))
        one.learn(value.shape, sizes)
        one.check_values(value, f"{file}: {name}")
        values[one.name] = value
    try:
        return kind.of(values)
    except InputError as error:
        raise InputError(f"{file}: {group}: {error}") from error


def named_arrays(value: Arrays, group: str) -> Named:
    """List what a class declares as a file holds it."""
    return {name_of(group, one): one.to_file(array) for one, array in value.arrays()}


def write_arrays(file: Any, value: Arrays, group: str) -> None:
    """Write what a class declares into an HDF5 file."""
    for one, array in value.arrays():
        file.create_dataset(name_of(group, one), data=one.to_file(array), **packing(one, array))


def packing(declared: Array, value: npt.NDArray[np.generic]) -> dict[str, Any]:
    """Choose the HDF5 options for an array: volumes on the grid are mostly zeros."""
    if declared.shape == ("z", "y", "x"):
        chunks = (1, *(min(_CHUNK, size) for size in value.shape[1:]))
        return {"chunks": chunks, "compression": "gzip", "compression_opts": 1}
    return dict(schema.PACK) if declared.packed else {}
