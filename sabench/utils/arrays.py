"""Array types and checks shared by public functions."""

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]
C128 = npt.NDArray[np.complex128]
F32 = npt.NDArray[np.float32]
U32 = npt.NDArray[np.uint32]
U16 = npt.NDArray[np.uint16]
I64 = npt.NDArray[np.int64]
I32 = npt.NDArray[np.int32]
U8 = npt.NDArray[np.uint8]
Bool = npt.NDArray[np.bool_]
Rows = tuple[tuple[float, ...], ...]

# no length, velocity, angle or coefficient is beyond it, and its square still has many digits
UP = (0.0, -1.0, 0.0)  # Y points down, as in the images
LARGEST = 1e12
FROM_MAD = 1.4826  # standard deviation of normal numbers over their median absolute deviation


def triple(values: npt.ArrayLike) -> tuple[float, float, float]:
    """Return three numbers as a tuple of Python floats, for frozen values."""
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return x, y, z


def unit(vector: npt.ArrayLike) -> F64:
    """Return the vector (n,) of length 1 in the direction of another."""
    return np.asarray(np.asarray(vector) / np.linalg.norm(vector))


def nested(matrix: F64) -> Rows:
    """Return a matrix as a tuple of tuples of Python floats, for frozen values."""
    return tuple(tuple(row) for row in matrix.tolist())


def rows_of(values: npt.ArrayLike, width: int, what: str) -> F64:
    """Return `values` as a float64 array of shape (n, width).

    Raises ValueError: another shape; `what` names the values.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != width:
        raise ValueError(f"{what}: expected an array of shape (n, {width}), got {array.shape}")
    return array


def all_in_row(flags: Bool) -> Bool:
    """Return which rows of flags (n, 3) are all true, 10 times as fast as `all`."""
    return np.asarray(flags[:, 0] & flags[:, 1] & flags[:, 2])


def in_box(points: F64, low: npt.ArrayLike, high: npt.ArrayLike) -> Bool:
    """Mark points (n, 3) in a box, its faces included.

    It goes by coordinates: numpy's loops over three are ten times as slow.
    """
    inside = np.ones(len(points), dtype=np.bool_)
    for values, least, most in zip(points.T, np.asarray(low), np.asarray(high), strict=True):
        inside &= (values >= least) & (values <= most)
    return inside


def in_portions(sizes: I64, most: int) -> list[I64]:
    """Divide places (n,) of things into runs, each of about `most` in size."""
    ends = np.cumsum(sizes)
    return np.split(np.arange(len(sizes)), np.searchsorted(ends, np.arange(most, ends[-1], most)))
