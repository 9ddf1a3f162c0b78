"""Content hash of a result's estimates, whatever the file calls their solver."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import h5py

from sabench.dataset.hdf5 import open_hdf5
from sabench.dataset.results import ITERATIONS

_LEFT_OUT = "track"  # sabench numbers trajectories where a file does not


def estimate_hash(path: Path) -> str:
    """Hash the names, shapes and values of all arrays of a result that sabench wrote.

    The solver's name, its parameters and costs, estimates after iterations, the numbers of
    trajectories and the compression do not count.
    """
    found: dict[str, Any] = {}

    def collect(name: str, node: Any) -> None:
        on_the_way = name.startswith(f"{ITERATIONS}/")
        if (
            isinstance(node, h5py.Dataset)
            and name.rpartition("/")[2] != _LEFT_OUT
            and not on_the_way
        ):
            found[name] = node

    content = hashlib.sha256()
    with open_hdf5(path) as file:
        file.visititems(collect)
        for name in sorted(found):
            node = found[name]
            content.update(f"{name}\0{node.shape}\0{node.dtype.str}\0".encode())
            content.update(node[...].tobytes())
    return content.hexdigest()
