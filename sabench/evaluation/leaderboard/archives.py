"""Result files and solver cards of a submission: a file, a folder or an archive.

None of it is trusted. `pack_results` makes such an archive for `sabench submit`.
"""

import contextlib
import gzip
import io
import itertools
import shutil
import stat
import tarfile
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import tomli_w

from sabench.dataset.results import read_solver
from sabench.dataset.verification import probe
from sabench.evaluation.solver_card import CARD, MOST_CASES, check_solvers, read_cards
from sabench.utils.errors import InputError
from sabench.utils.files import complete_or_nothing, zip_folder
from sabench.utils.processes.program import ProgramLimits
from sabench.utils.validation import printable

_RATIO = 200  # unpacked over packed: result files are compressed already
_SMALL_BYTES = 10_000_000  # of one piece, and of all where no ratio is required
_ENDING = ".h5"


_Files = list[tuple[str, Path]]


@dataclass(frozen=True)
class Submitted:
    """Names and paths of the files of a submission, sorted."""

    results: _Files
    cards: _Files


@dataclass(frozen=True)
class Member:
    """File inside an archive, with the name and size of its header."""

    name: str
    bytes: int
    handle: Any


@contextlib.contextmanager
def submitted_files(path: Path) -> Iterator[Submitted]:
    """List the result files and solver cards in a submission.

    It is a result file, a folder or an archive (.zip, .tar, .tar.gz). Unpacked files are deleted at
    the end of the block.

    Raises InputError: nothing there, or forbidden content: links, devices, absolute paths, `..`,
    two members of one name, or too much of anything.
    """
    if path.is_symlink() or not path.exists():
        raise InputError(
            f"{path}: expected a result file, an archive or a folder of them, found "
            f"{'a link' if path.is_symlink() else 'none'}"
        )
    if path.is_dir():
        files = []
        for number, entry in enumerate(path.rglob("*")):
            if number >= MOST_CASES:
                raise InputError(f"{path}: expected at most {MOST_CASES} files and folders")
            if entry.is_symlink():
                link = printable(entry.relative_to(path).as_posix())
                raise InputError(f"{path}: expected no links, got {link}")
            if entry.is_file() and _is_wanted(entry.name):
                files.append((entry.relative_to(path).as_posix(), entry))
        yield _sort_files(files, path)
    elif not path.is_file():
        raise InputError(f"{path}: expected a file, an archive or a folder")
    elif path.name.lower().endswith((".zip", ".tar", ".tar.gz", ".tgz")):
        with tempfile.TemporaryDirectory(prefix="sabench-") as folder:
            yield _sort_files(_unpack(path, Path(folder)), path)
    else:
        yield Submitted([(path.name, path)], [])


def _sort_files(files: _Files, path: Path) -> Submitted:
    results = sorted(entry for entry in files if entry[0].endswith(_ENDING))
    if not results:
        raise InputError(f"{path}: expected result files, whose names end in {_ENDING}, found none")
    return Submitted(results, sorted(entry for entry in files if entry not in results))


def _unpack(path: Path, folder: Path) -> _Files:
    """Unpack the archive's results and cards into `folder`, with numbers as names.

    No name of the archive becomes a name on the disk.
    """
    try:
        with _open_archive(path) as (archive, members):
            wanted = _select_members(path, members)
            return [
                (member.name, _copy(archive, member, folder / str(number), path))
                for number, member in enumerate(wanted)
            ]
    except (
        OSError,
        EOFError,
        ValueError,
        RuntimeError,
        NotImplementedError,
        zlib.error,
        tarfile.TarError,
        zipfile.BadZipFile,
    ) as error:
        raise InputError(
            f"{path}: expected an intact archive, got {type(error).__name__}: "
            f"{printable(str(error), 200)}"
        ) from error


@contextlib.contextmanager
def _open_archive(path: Path) -> Iterator[tuple[Any, Iterator[Member]]]:
    if path.name.lower().endswith(".zip"):
        with zipfile.ZipFile(path) as whole:
            yield whole, (_zip_member(path, info) for info in whole.infolist() if not info.is_dir())
    else:
        with (
            path.open("rb") as packed,
            _plain(packed) as plain,
            tarfile.open(fileobj=_InPieces(plain), mode="r:") as tape,
        ):
            yield tape, (_tar_member(path, info) for info in tape if not info.isdir())


def _plain(packed: IO[bytes]) -> IO[bytes] | gzip.GzipFile:
    compressed = packed.read(2) == b"\x1f\x8b"
    packed.seek(0)
    return gzip.GzipFile(fileobj=packed) if compressed else packed


class _InPieces(io.RawIOBase):
    """File that refuses to read one large piece.

    A tar's header sets the length of its members' names, and they are read in one piece.
    """

    def __init__(self, file: IO[bytes] | gzip.GzipFile) -> None:
        super().__init__()
        self._file = file

    def read(self, size: int = -1) -> bytes:
        """Read a few pieces at most."""
        if not 0 <= size <= _SMALL_BYTES:
            raise ValueError(f"a part of {size} bytes to be read at once")
        return self._file.read(size)

    def seek(self, offset: int, whence: int = 0) -> int:
        """Move the position in the file."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Return the position in the file."""
        return self._file.tell()


def _zip_member(path: Path, info: zipfile.ZipInfo) -> Member:
    kind = stat.S_IFMT(info.external_attr >> 16)
    if kind not in (0, stat.S_IFREG):
        raise InputError(
            f"{path}: {printable(info.filename)}: expected a plain file, got a link or device"
        )
    if info.flag_bits & 1 or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise InputError(
            f"{path}: {printable(info.filename)}: expected a file stored or deflated, without a "
            "password"
        )
    return Member(info.filename, info.file_size, info)


def _tar_member(path: Path, info: tarfile.TarInfo) -> Member:
    if not info.isreg():
        raise InputError(
            f"{path}: {printable(info.name)}: expected a plain file, got a link or device"
        )
    return Member(info.name, info.size, info)


def _select_members(path: Path, members: Iterator[Member]) -> list[Member]:
    """Check all members and select the result files and cards among them."""
    packed, total, names, every = path.stat().st_size, 0, set(), []
    for member in itertools.islice(members, MOST_CASES + 1):
        total += member.bytes
        name, parts = member.name, member.name.replace("\\", "/").split("/")
        if not name or not parts[0] or ".." in parts or ":" in parts[0] or "\0" in name:
            raise InputError(f"{path}: expected names inside the archive, got {printable(name)!r}")
        if member.name in names:
            raise InputError(
                f"{path}: expected different names, got {printable(member.name)} twice"
            )
        most_mb, total_mb = ProgramLimits.output_mb, total / 1e6
        if total_mb > most_mb or (total > _SMALL_BYTES and total > _RATIO * packed):
            raise InputError(
                f"{path}: expected at most {most_mb:.0f} MB unpacked and {_RATIO} times its size, "
                f"got {total_mb:.0f} MB or more"
            )
        names.add(member.name)
        every.append(member)
    if len(every) > MOST_CASES:
        raise InputError(f"{path}: expected at most {MOST_CASES} files, got more")
    return [member for member in every if _is_wanted(member.name.rpartition("/")[2])]


def _is_wanted(name: str) -> bool:
    return name.endswith((_ENDING, CARD)) and not name.startswith(".")


def _copy(archive: Any, member: Member, target: Path, path: Path) -> Path:
    """Copy a member to a file; refuse one that is larger than its header says."""
    source: IO[bytes] | None = (
        archive.open(member.handle)
        if isinstance(archive, zipfile.ZipFile)
        else archive.extractfile(member.handle)
    )
    assert source is not None  # a plain file, as was checked
    left = member.bytes
    with source, target.open("wb") as file:
        while piece := source.read(_SMALL_BYTES):
            left -= len(piece)
            if left < 0:
                raise InputError(
                    f"{path}: {printable(member.name)}: expected {member.bytes} bytes as its "
                    "header says, got more"
                )
            file.write(piece)
    return target


def pack_results(
    files: Submitted, out: Path, cards: Sequence[Path] = (), *, overwrite: bool = False
) -> tuple[int, list[str]]:
    """Copy results and the cards of their solvers into an archive by the name .zip.

    Returns the number of results and the solvers that have a card.

    Parameters
    ----------
    files : results, and cards next to them.
    cards : further solver cards.

    Raises InputError: another ending of the archive's name, a file that is no result, a bad card,
    or a card that belongs to no result.
    """
    check_archive_name(out)
    by_solver = read_cards(files.cards, cards)
    for _, file in files.results:
        probe(file)
    check_solvers(by_solver, [read_solver(file) for _, file in files.results])
    with (
        complete_or_nothing(out, overwrite=overwrite) as partial,
        tempfile.TemporaryDirectory(prefix="sabench-") as folder,
    ):
        for name, file in files.results:
            place = Path(folder) / name
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, place)
        for number, card in enumerate(by_solver.values()):
            place = Path(folder) / (f"{number}.{CARD}" if number else CARD)
            place.write_text(tomli_w.dumps(card.model_dump()), encoding="utf-8")
        zip_folder(Path(folder), partial)
    return len(files.results), list(by_solver)


def check_archive_name(out: Path) -> None:
    """Refuse a name that is not one of a zip archive."""
    if out.suffix != ".zip":
        raise InputError(f"{out}: expected a name that ends in .zip for an archive of results")
