"""Atomic writing of files, safe reading of JSON and of paths, and zip archives.

Folders are written atomically, too.
"""

import contextlib
import hashlib
import json
import os
import re
import shutil
import threading
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sabench.utils.errors import InputError
from sabench.utils.progress import progress_bar

_ABANDONED = re.compile(r"^\.(?P<name>.+)\.(?P<what>partial|retired)-(?P<pid>\d+)$")

LONGEST_PART = 255  # bytes of a file's name, on every system in use
LARGEST_TEXT = 100_000_000  # bytes of JSON, and of what is read without a check of its cost
LARGEST_DATA = 2_000_000_000  # bytes of a table, and of an array whose length its file sets


@contextlib.contextmanager
def complete_or_nothing(target: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Give a temporary path that replaces `target` only if the block ends well.

    The block makes a file or a folder at the path it gets, which is on the disk when it appears at
    `target`. A killed process leaves a hidden `.NAME.partial-PID`, which the next write to the same
    target removes.
    """
    target = target.absolute()
    clear_abandoned(target)
    refuse_existing(target, overwrite=overwrite)
    target.parent.mkdir(parents=True, exist_ok=True)
    with _temporary(target, f".{target.name}.partial-{os.getpid()}") as partial:
        yield partial
        put_in_place(target, partial)


@contextlib.contextmanager
def atomic_file(target: Path) -> Iterator[Path]:
    """Give a temporary path that replaces the file `target` if the block ends well.

    For many files that can be made again: several threads, processes and machines may write the
    same one simultaneously, and none waits for the disk.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    with _temporary(target, f".{os.getpid()}-{threading.get_ident()}-{target.name}") as partial:
        yield partial
        partial.replace(target)


@contextlib.contextmanager
def _temporary(target: Path, name: str) -> Iterator[Path]:
    """Give a path next to `target`; whatever is left there is removed."""
    partial = target.with_name(name)
    try:
        yield partial
    except OSError as error:
        if error.errno and not error.filename:  # a refused write does not say where
            error.filename = str(target)
        raise
    finally:
        _remove(partial)


def put_in_place(target: Path, partial: Path) -> None:
    """Put `partial` in the place of `target`, once it is on the disk.

    A folder takes two steps; `clear_abandoned` repairs a death between them.
    """
    _flush(partial)
    check_replaceable(target, *_names(partial))
    if not target.is_dir():
        partial.replace(target)
        return
    retired = target.parent / f".{target.name}.retired-{os.getpid()}"
    try:
        target.rename(retired)
        partial.rename(target)
    finally:
        if retired.exists() and not target.exists():
            retired.rename(target)
        _remove(retired)


def check_replaceable(target: Path, *names: str) -> None:
    """Raise an InputError if files would be lost that do not come again.

    `names` are those in the folder to come; none: a file. A data set replaces any other.
    """
    old = _names(target)
    lost = set() if "manifest.json" in old & {*names} else old - {*names}
    if lost or (names and target.is_file()):
        wanted = "folder that sabench made" if names else "file"
        found = f"a folder with {min(lost)}" if lost else "a file"
        expected = f"expected a {wanted} to overwrite, found {found}"
        raise InputError(f"{target}: {expected}: choose another name")


def _names(path: Path) -> set[str]:
    return {entry.name for entry in path.iterdir()} if path.is_dir() else set()


def refuse_existing(target: Path, *, overwrite: bool) -> None:
    """Raise an InputError for a path with ~, or one that may not be replaced."""
    if "~" in target.parts:
        raise InputError(f"{target}: expected a path without ~: write out the home folder")
    if target.exists() and not overwrite:
        raise InputError(f"{target} exists already: choose another name, or say --overwrite")


def clear_abandoned(target: Path) -> None:
    """Remove the files that killed processes left while writing `target`.

    A folder that they had set aside returns if nothing took its place.
    """
    for entry in sorted(target.parent.iterdir()) if target.parent.is_dir() else ():
        match = _ABANDONED.match(entry.name)
        if not match or match["name"] != target.name or _alive(int(match["pid"])):
            continue
        if match["what"] == "retired" and not target.exists():
            entry.rename(target)
        else:
            _remove(entry)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _flush(path: Path) -> None:
    for file in (path, *path.rglob("*")):
        if file.is_file():
            with file.open("rb") as handle:
                os.fsync(handle.fileno())


def file_series(path: Path) -> list[Path]:
    """List the files of a path: one, or a series if its last part has a *.

    They are sorted by the last number in their names, then by name.
    """
    if "*" not in path.name:
        return [path] if is_file(path) else []
    files = filter(Path.is_file, path.parent.glob(path.name)) if path.parent.is_dir() else ()
    return sorted(files, key=lambda file: (last_number(file), file))


def last_number(path: Path) -> int:
    """Return the last number in a file's name, without its ending; -1: none."""
    numbers = re.findall(r"\d+", path.stem)
    return int(numbers[-1]) if numbers else -1


def series_hash(path: Path) -> str:
    """Hash a file, or the names and contents of a series of files."""
    files = file_series(path)
    return sha256(path) if files == [path] else digest({file.name: sha256(file) for file in files})


def is_file(path: Path) -> bool:
    """Return whether there is a file; no for a name that no disk can hold."""
    return os.path.isfile(path)  # noqa: PTH113  # pathlib's raises an OSError


def is_folder(path: Path) -> bool:
    """Return whether there is a folder, as `is_file` does for files."""
    return os.path.isdir(path)  # noqa: PTH112


def sha256(path: Path) -> str:
    """Compute the hexadecimal SHA-256 of a file's bytes."""
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def canonical_json(value: Any) -> str:
    """Format as JSON with sorted keys and shortest numbers.

    Equal values give equal text.
    """
    text = json.dumps(value, sort_keys=True, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    # JSON can hold half a surrogate pair, UTF-8 can not
    return text.encode("utf-8", "replace").decode("utf-8")


def digest(value: Any) -> str:
    """Compute the SHA-256 of a value's canonical JSON."""
    return hashlib.sha256(canonical_json(value).encode()).hexdigest()


def read_json(path: Path) -> Any:
    """Parse a JSON file; raise an InputError if it is missing, broken or enormous."""
    try:
        if path.stat().st_size > LARGEST_TEXT:
            raise ValueError(f"{path.stat().st_size} bytes where {LARGEST_TEXT} are allowed")
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        first = str(error).splitlines()[0] if str(error) else "no detail"
        reason = f"{type(error).__name__}: {first}"
        raise InputError(f"{path}: expected a JSON file, got {reason}") from error


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file; raise an InputError if it is missing or broken."""
    try:
        return tomllib.loads(text := path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        at = re.search(r"at line (\d+)", str(error))
        line = f": {text.splitlines()[int(at[1]) - 1].strip()[:80]}" if at else ""
        raise InputError(f"{path}: expected a TOML file, got {error}{line}") from error


def inside(root: Path, name: str) -> Path:
    """Return the path of the file `name` in the folder `root`.

    Raises InputError: the name leads outside, or through a link.
    """
    path = root / name
    parts = Path(name).parts
    bad = not parts or Path(name).is_absolute() or ".." in parts or "\\" in name or "\0" in name
    bad = bad or any(len(part.encode("utf-8", "replace")) > LONGEST_PART for part in parts)
    if bad or any((root / Path(*parts[: i + 1])).is_symlink() for i in range(len(parts))):
        raise InputError(f"{root}: expected a plain file inside the folder, got {name!r}")
    return path


def zip_folder(folder: Path, out: Path) -> None:
    """Write a folder's files into an archive, without dates and without compression."""
    with zipfile.ZipFile(out, "w") as archive:
        for file in progress_bar(sorted(filter(Path.is_file, folder.rglob("*"))), "pack"):
            entry = zipfile.ZipInfo(file.relative_to(folder).as_posix())
            with file.open("rb") as source, archive.open(entry, "w", force_zip64=True) as place:
                shutil.copyfileobj(source, place)
