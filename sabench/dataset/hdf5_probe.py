"""Probe of untrusted HDF5 files, in a child process.

A damaged file may kill the HDF5 library's process.
"""

from __future__ import annotations

from pathlib import Path

from sabench.dataset import schema
from sabench.dataset.hdf5 import walk
from sabench.utils.files import inside, is_file
from sabench.utils.processes.isolated import call_isolated

# seconds for the structure of a file: a damaged one can send the library into an endless loop that
# Ctrl-C does not end
_PROBE_S = 4.0
_PROBE_RATE = 2e7  # bytes of a file for each further second


def probe(path: Path) -> None:
    """Open an untrusted file in a child process, which HDF5 may not survive.

    Raises
    ------
    InputError
        The child process crashes or takes too long.
    """
    call_isolated(
        walk, path, doing=f"{path}: reading it", time_s=_PROBE_S + path.stat().st_size / _PROBE_RATE
    )


def probe_dataset(root: Path) -> None:
    """Probe the HDF5 files of a data set, if it is one at all."""
    schema.read_manifest(root)
    for name in (schema.TRUTH, schema.POINTS):
        if is_file(root / name):
            probe(inside(root, name))
