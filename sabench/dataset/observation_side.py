"""The observation side of a data set, apart from its truth.

It is what solvers see, and what a participant of a private test set receives.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from sabench.dataset import schema
from sabench.dataset.reader import Dataset
from sabench.utils.files import complete_or_nothing, inside


def copy_observation(dataset: Dataset, folder: Path, *, linked: bool = False) -> None:
    """Make a data set of the observation side alone in a folder.

    Its manifest has the content hash of the whole, so that results of it are results of the whole.

    Parameters
    ----------
    folder : empty, or not there yet.
    linked : whether images may be links to those of the data set (on one file system), in place of
        copies: for readers that cannot write to them.
    """
    files = {name: one for name, one in dataset.contents.files.items() if schema.is_observed(name)}
    for name in files:
        place = inside(folder, name)
        if not inside(dataset.root, name).is_file():
            continue  # whoever reads it finds the fault, and names the file
        place.parent.mkdir(parents=True, exist_ok=True)
        _copy(inside(dataset.root, name), place, linked)
    head = {
        "format": schema.FORMAT,
        "version": schema.VERSION,
        "side": "observation",
        "content_hash": dataset.content_hash,
        "files": {name: entry.model_dump() for name, entry in files.items()},
    }
    (folder / schema.MANIFEST).write_text(schema.seal(head), encoding="utf-8")


def _copy(source: Path, place: Path, linked: bool) -> None:
    if linked:
        try:
            os.link(source, place)
        except OSError:  # another file system, or one without links
            linked = False
    if not linked:
        shutil.copyfile(source, place)


def pack_observation(dataset: Dataset, out: Path, *, overwrite: bool = False) -> Path:
    """Write the observation side of a data set into a new folder.

    It appears when it is complete.

    Raises
    ------
    InputError
        The folder is there already, and `overwrite` is not set.
    """
    with complete_or_nothing(out, overwrite=overwrite) as partial:
        partial.mkdir()
        copy_observation(dataset, partial)
    return out
