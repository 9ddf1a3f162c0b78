"""Records of runs, as JSON lines, with the machine and the versions of each run.

Many processes may append to a file without losing or tearing a line. Readers do not trust its
content.
"""

import datetime
import importlib.metadata
import json
import os
import platform
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from filelock import FileLock

from sabench.evaluation.record_schema import Record, RecordHead, parse_record
from sabench.evaluation.solver_card import LONGEST_TEXT
from sabench.utils import backend
from sabench.utils.errors import MOST, InputError
from sabench.utils.progress import say
from sabench.utils.validation import printable
from sabench.utils.version import __version__


def versions() -> dict[str, str]:
    """List the versions of everything that affects the scores."""
    libraries = {name: version_of(name) for name in ("mitsuba", "drjit", "numpy", "scipy")}
    return libraries | {"sabench": __version__, "python": platform.python_version()}


def machine() -> dict[str, Any]:
    """Describe the machine of this run."""
    info = Path("/proc/cpuinfo")
    models = (
        [
            line.split(":", 1)[1].strip()
            for line in info.read_text().splitlines()
            if line.startswith("model name")
        ]
        if info.exists()
        else []
    )
    try:
        kind = backend.choose().kind
    except InputError:
        kind = "none"
    cpu = models[0] if models else platform.processor() or platform.machine()
    return {
        "cpu": cpu,
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "backend": kind,
    }


def version_of(package: str) -> str:
    """Return the version of an installed package."""
    return importlib.metadata.version(package)


_RUN = ("scene_hash", "seed", "split", "renderer", "solver", "parameters", "machine", "submission")


def read_records(folder: Path) -> list[Record]:
    """Read all records of a folder's *.jsonl files and fill in defaults.

    The order is that of the files' names and of their lines. A line that is no record is left out,
    with a message on standard error; the torn last line of a killed run is left out without a
    message.
    """
    files = (path for path in sorted(folder.glob("*.jsonl")) if path.is_file())
    return [record for path in files for record in _read_file(path)]


def _read_file(path: Path) -> Iterator[Record]:
    bad = 0
    for number, (line, ended) in enumerate(_lines(path), 1):
        if not line.strip():
            continue
        try:
            yield parse_record(line)
        except (ValueError, RecursionError) as error:
            if not ended:
                continue
            bad += 1
            if bad <= MOST:
                text = f"{path}: line {number} is left out: expected a record, got {error}"
                say(printable(text, 1000), "red")
    if bad > MOST:
        say(f"{path}: {bad - MOST} more lines are left out", "red")


def _lines(path: Path) -> Iterator[tuple[bytes, bool]]:
    """Give every line, and whether it ends with a newline.

    Of a line that is too long only the first bytes are held in memory.
    """
    with path.open("rb") as file:
        while line := file.readline(LONGEST_TEXT + 1):
            last = line
            while not last.endswith(b"\n") and (last := file.readline(LONGEST_TEXT)):
                pass
            yield line, last.endswith(b"\n")


def append(path: Path, record: Record) -> None:
    """Append one line and flush it to the disk.

    The torn last line of a killed run is removed first. Many processes may append simultaneously.

    Raises InputError: a record that `read_records` would leave out.
    """
    line = encode(record)
    path.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(path.with_name(f".{path.name}.lock")), path.open("a+b") as file:
        file.truncate(_whole(file))
        file.write(line)
        file.flush()
        os.fsync(file.fileno())


def encode(record: Record) -> bytes:
    """Make the line of a record; raises InputError if it breaks the schema."""
    head = {key: RecordHead.model_fields[key].default for key in ("format", "version")}
    try:
        line = json.dumps(head | record, sort_keys=True, allow_nan=False).encode()
        parse_record(line)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"expected values that a record may have, got {error}") from error
    return line + b"\n"


def _whole(file: Any) -> int:
    """Count the bytes up to the last newline, which is searched from the end."""
    end, piece = file.seek(0, os.SEEK_END), 1 << 16
    while end > 0:
        start = max(0, end - piece)
        file.seek(start)
        newline = file.read(end - start).rfind(b"\n")
        if newline >= 0:
            return int(start + newline + 1)
        end = start
    return 0


def latest(records: list[Record]) -> list[Record]:
    """Select the newest record of each run, in the order of the first ones.

    Records of one run have the same scene, seed, split, renderer, solver, parameters, machine and
    submission. Records without a date are the oldest; of equally old ones the last is selected. Of
    submitted results, the first record is selected: no later one replaces it.
    """
    selected: dict[str, Record] = {}
    for record in records:
        other = selected.setdefault(run_key(record), record)
        newer = (record.get("date") or "") >= (other.get("date") or "")
        if newer and not record.get("submission"):
            selected[run_key(record)] = record
    return list(selected.values())


def now() -> str:
    """Return the time of this moment as records write it."""
    return datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def run_key(record: Record) -> str:
    """Identify a run: records of the same run have the same key."""
    return key_of(record, _RUN)


def key_of(record: Record, names: tuple[str, ...]) -> str:
    """Combine the given values of a record in one text."""
    return json.dumps([record.get(name) for name in names], sort_keys=True)


def same_data(one: Record, other: Record) -> bool:
    """Return whether two records are of copies of one data set.

    Copies made on different processors have one identity and different content hashes.
    """
    same = one.get("identity") is not None and one.get("identity") == other.get("identity")
    return same or bool(one["dataset"] == other["dataset"])
