"""Hash of the source code, which changes with every line of it."""

import functools
import hashlib
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent


def code_hash(*files: Path) -> str:
    """Compute the SHA-256 of sabench's sources, without its page, and further files."""
    whole = hashlib.sha256(_own_hash().encode())
    for file in files:
        whole.update(hashlib.sha256(file.read_bytes()).digest())
    return whole.hexdigest()


@functools.cache
def _own_hash() -> str:
    whole = hashlib.sha256()
    for file in sorted(PACKAGE.rglob("*.py")):
        if "_plugins" not in file.parts:
            name = f"{file.relative_to(PACKAGE).as_posix()}\0"
            whole.update(name.encode() + hashlib.sha256(file.read_bytes()).digest())
    return whole.hexdigest()
