"""File that lists the data sets of a challenge."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from sabench.api.solvers import TaskName
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, inside, read_json
from sabench.utils.validation import printable, validate

FILE = "challenge.json"


class Challenge(BaseModel):
    """Content of the file, which participants receive, too."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal["sabench-challenge"] = "sabench-challenge"
    version: Literal[1] = 1
    title: str
    task: TaskName
    sabench: str = Field(description="version that made the data sets and scores the results")
    data_sets: dict[str, str] = Field(description="content hashes by the names of the folders")


def write_challenge(challenge: Challenge, folder: Path) -> None:
    """Write the file into a folder of data sets."""
    text = canonical_json(challenge.model_dump(mode="json"))
    (folder / FILE).write_text(text, encoding="utf-8")


def read_challenge(folder: Path) -> Challenge:
    """Read the file of a folder of data sets.

    Raises
    ------
    InputError
        No such file, another format, or a folder that is missing or outside.
    """
    path = folder / FILE
    if not path.is_file():
        raise InputError(f"{folder}: expected a challenge, with a file {FILE}, found none")
    challenge = validate(Challenge, read_json(path), str(path))
    for name in challenge.data_sets:
        if not inside(folder, name).is_dir():
            raise InputError(f"{path}: data_sets: expected a folder {printable(name)}, found none")
    return challenge


@contextlib.contextmanager
def opened_challenge(path: Path) -> Iterator[Path]:
    """Give the folder of a challenge, unpacked for a while if it is an archive.

    Raises
    ------
    InputError
        Neither a folder nor an intact archive, or one that does not fit onto the disk.
    """
    if path.is_dir():
        yield path
        return
    if not path.is_file():
        raise InputError(f"{path}: expected a challenge's folder or archive, found none")
    with tempfile.TemporaryDirectory(prefix="sabench-") as folder:
        _unpack(path, Path(folder))
        yield Path(folder)


def _unpack(path: Path, folder: Path) -> None:
    try:
        with zipfile.ZipFile(path) as archive:
            needed = sum(one.file_size for one in archive.infolist())
            if needed > shutil.disk_usage(folder).free:
                raise InputError(f"{path}: expected {needed / 1e6:.0f} MB of free disk in {folder}")
            archive.extractall(folder)
    except (zipfile.BadZipFile, ValueError, RuntimeError, EOFError) as error:
        raise InputError(f"{path}: expected an intact .zip archive, got {error}") from error
