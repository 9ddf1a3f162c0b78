"""Folder of compiled kernels, named by the hash of their sources.

numba compiles a kernel again when its own file has changed, but not when kernels or constants
that it uses from other files have. Other sources therefore have another folder.
"""

import functools
import hashlib
import os
import re
import shutil
import sys
import tempfile
import time
from pathlib import Path

from sabench.utils.code_hash import PACKAGE

_IMPORT = re.compile(r"^\s*from (sabench[\w.]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
_KEPT_S = 7 * 86400.0  # time since their last use after which folders of other sources go


def folder_of_folders() -> Path:
    """Return NUMBA_CACHE_DIR, or else sabench's folder among the user's caches."""
    if named := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(named)
    if sys.platform == "win32":
        caches = os.environ.get("LOCALAPPDATA")
    else:
        caches = os.environ.get("XDG_CACHE_HOME")
    usual = "~/Library/Caches" if sys.platform == "darwin" else "~/.cache"
    return Path(caches or Path(usual).expanduser()) / "sabench"


@functools.cache
def kernel_folder() -> Path:
    """Return the folder of the kernels of these sources.

    It is made if it is missing, in the temporary folder if the usual one cannot be written. Folders
    of other sources are removed then, but for those that were used within a week.
    """
    name = f"kernels-{hash_sources(PACKAGE)[:16]}"
    user = os.getuid() if hasattr(os, "getuid") else ""
    spare = Path(tempfile.gettempdir()) / f"sabench-{user}"
    for parent in (folder_of_folders(), spare):
        folder = parent / name
        try:
            parent.mkdir(parents=True, mode=0o700, exist_ok=True)
            if parent == spare and user not in ("", parent.stat().st_uid):
                continue  # another user made it, who could have put kernels there
            if not folder.exists():
                folder.mkdir(exist_ok=True)
                for other in parent.glob("kernels-*"):
                    if time.time() - other.stat().st_mtime > _KEPT_S:
                        shutil.rmtree(other, ignore_errors=True)
            os.utime(folder)  # the time of its last use
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    return Path(tempfile.mkdtemp(prefix="sabench-kernels-"))


def hash_sources(package: Path) -> str:
    """Compute the SHA-256 of a package's files with kernels and of their imports."""
    files = [file for file in package.rglob("*.py") if "_plugins" not in file.parts]
    contents = {file: file.read_bytes() for file in files}
    left = [file for file, content in contents.items() if b"sabench.utils.compiled" in content]
    hashed = set(left)
    while left:
        new = _imported(package, contents[left.pop()].decode()) & contents.keys() - hashed
        hashed |= new
        left += new
    whole = hashlib.sha256()
    for file in sorted(hashed):
        name = file.relative_to(package).as_posix()
        whole.update(f"{name}\0{len(contents[file])}\0".encode() + contents[file])
    return whole.hexdigest()


def _imported(package: Path, text: str) -> set[Path]:
    modules = set()
    for module, names in _IMPORT.findall(text):
        folder = package.joinpath(*module.split(".")[1:])
        modules |= {folder, *(folder / name for name in re.findall(r"\w+", names))}
    return {path.with_suffix(".py") for path in modules}
