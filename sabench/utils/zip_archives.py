"""Zip archives of folders."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

from sabench.utils.progress import progress_bar


def zip_folder(folder: Path, out: Path) -> None:
    """Write a folder's files into an archive, without dates and without compression."""
    with zipfile.ZipFile(out, "w") as archive:
        for file in progress_bar(sorted(one for one in folder.rglob("*") if one.is_file()), "pack"):
            entry = zipfile.ZipInfo(file.relative_to(folder).as_posix())
            with file.open("rb") as source, archive.open(entry, "w", force_zip64=True) as place:
                shutil.copyfileobj(source, place)
