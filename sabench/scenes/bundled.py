"""Scenes and suites that come with this installation, found by name."""

from __future__ import annotations

import difflib
from pathlib import Path

from sabench import plugins
from sabench.utils.errors import InputError


def find(name: str | Path, folder: str) -> Path:
    """Find a file by its path, or by its stem in a bundled folder.

    Bundled folders are scenes and scenes/suites; suites are also found in reproduction/suites.

    Raises
    ------
    InputError
        No such file, with the nearest name.
    """
    direct = Path(name)
    if any(len(part.encode("utf-8", "replace")) > 255 for part in direct.parts) or "\0" in str(
        name
    ):
        raise InputError(f"{name}: expected a file's name")
    if direct.is_file():
        return direct
    inside = [plugins.bundled_folder("scenes").parent / folder]
    if folder == "scenes/suites":
        inside = plugins.suite_folders()
    stem = direct.name.removesuffix(".toml")
    files = {file.stem: file for one in inside for file in one.glob("*.toml")}
    if stem in files and direct.parent in (Path(), Path(folder), Path("suites")):
        return files[stem]
    known = sorted(files)
    near = difflib.get_close_matches(stem, known, 1)
    raise InputError(
        f"{name}: expected a file or one of {', '.join(known)}"
        + (f"; did you mean {near[0]}?" if near else "")
    )
