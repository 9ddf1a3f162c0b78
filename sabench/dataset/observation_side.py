"""The observation side of a data set, apart from its truth.

It is what solvers see, and what a participant of a private test set receives.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sabench.dataset import schema
from sabench.dataset.reader import Dataset
from sabench.images.tiff_exr import write_tiff
from sabench.utils.errors import InputError
from sabench.utils.files import complete_or_nothing, inside, sha256
from sabench.utils.progress import progress_bar
from sabench.utils.zip_archives import zip_folder


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
    if dataset.references is not None:
        files |= _copy_references(dataset, folder)
    head = {
        "format": schema.FORMAT,
        "version": schema.VERSION,
        "side": "observation",
        "content_hash": dataset.content_hash,
        "files": {name: entry.model_dump() for name, entry in files.items()},
    }
    (folder / schema.MANIFEST).write_text(schema.seal(head), encoding="utf-8")


def _copy_references(dataset: Dataset, folder: Path) -> dict[str, schema.FileEntry]:
    """Copy the images of a recorded data set that lie elsewhere."""
    files = {}
    for frame in range(dataset.setup.frames):
        for number, camera in enumerate(dataset.setup.cameras):
            name = schema.image_name(camera.name, frame, "tif")
            place = inside(folder, name)
            place.parent.mkdir(parents=True, exist_ok=True)
            write_tiff(place, dataset.raw_image(number, frame))
            files[name] = schema.FileEntry(bytes=place.stat().st_size, sha256=sha256(place))
    return files


def _copy(source: Path, place: Path, linked: bool) -> None:
    if linked:
        try:
            os.link(source, place)
        except OSError:  # another file system, or one without links
            linked = False
    if not linked:
        shutil.copyfile(source, place)


def pack(dataset: Dataset, out: Path, *, blind: bool, overwrite: bool = False) -> Path:
    """Copy a data set into a new folder, or into an archive by the name .zip.

    It appears when it is complete.

    Parameters
    ----------
    blind : pack the observation side alone: what a participant of a private test set receives.

    Raises
    ------
    InputError
        The folder or archive is there already, and `overwrite` is not set; or the data set is the
        observation side alone, and the whole is asked for.
    """
    with _folder_of(out, overwrite) as folder:
        _copy_side(dataset, folder, blind)
    return out


def pack_samples(root: Path, out: Path, *, blind: bool, overwrite: bool = False) -> Path:
    """Copy a data set of samples as `pack` does one of frames."""
    contents = schema.read_manifest(root)
    if not isinstance(contents, schema.ShardedContents):
        raise InputError(f"{root}: expected a data set of samples, got one of frames")
    files = [name for name in contents.all_files if not blind or schema.is_observed(name)]
    with _folder_of(out, overwrite) as folder:
        for name in progress_bar(files, "copy"):
            place = inside(folder, name)
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(inside(root, name), place)
        text = (root / schema.MANIFEST).read_text(encoding="utf-8")
        if blind:
            text = schema.seal(_without_truth(contents))
        (folder / schema.MANIFEST).write_text(text, encoding="utf-8")
    return out


def _without_truth(contents: schema.ShardedContents) -> dict[str, Any]:
    """Make the manifest of the observation side of samples."""
    keys = set(schema.ShardedContents.model_fields)
    head = contents.model_dump(mode="json", include=keys) | {"side": "observation"}
    for files in (head["files"], *(entry["files"] for entry in head["shards"])):
        for name in [name for name in files if not schema.is_observed(name)]:
            del files[name]
    return head


@contextlib.contextmanager
def _folder_of(out: Path, overwrite: bool) -> Iterator[Path]:
    """Give a folder to fill, which becomes `out`, as an archive by the name .zip."""
    with complete_or_nothing(out, overwrite=overwrite) as partial:
        folder = partial.with_name(f"{partial.name}.files") if out.suffix == ".zip" else partial
        folder.mkdir()
        try:
            yield folder
            if folder is not partial:
                zip_folder(folder, partial)
        finally:
            if folder is not partial:
                shutil.rmtree(folder, ignore_errors=True)


def _copy_side(dataset: Dataset, folder: Path, blind: bool) -> None:
    if blind:
        copy_observation(dataset, folder)
        return
    if dataset.references is not None:
        raise InputError(
            f"{dataset.root}: expected a data set that holds its images, got one that references "
            "them; pack it with --blind, which copies them"
        )
    whole = dataset.contents if dataset.recorded else dataset.manifest
    for name in [*whole.files, schema.MANIFEST]:
        place = inside(folder, name)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(inside(dataset.root, name), place)
