"""Probe of untrusted HDF5 files, in a limited child process.

A damaged file may kill the HDF5 library's process.
"""

from __future__ import annotations

from pathlib import Path

from sabench.dataset import schema
from sabench.dataset.hdf5 import walk
from sabench.utils.files import inside, is_file
from sabench.utils.processes.call import preload, read_isolated

preload("sabench.dataset.hdf5")


def probe(path: Path) -> None:
    """Open an untrusted file in a child process, which HDF5 may not survive.

    Raises
    ------
    InputError
        The file is damaged, the child process crashes or exceeds its limits.
    """
    read_isolated(walk, path)


def probe_dataset(root: Path) -> None:
    """Probe the HDF5 files of a data set, if it is one at all."""
    schema.read_manifest(root)
    for name in (schema.TRUTH, schema.POINTS):
        if is_file(root / name):
            probe(inside(root, name))
