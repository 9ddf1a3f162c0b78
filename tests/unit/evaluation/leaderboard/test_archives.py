"""Archives from outside.

The files that are taken out of them, and the errors before anything is unpacked.
"""

from __future__ import annotations

import gzip
import io
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from sabench.evaluation.leaderboard.archives import submitted_files
from sabench.utils.errors import InputError

Make = Callable[[Path], Path]


def zipped(
    path: Path, members: dict[str, bytes], mode: int = 0, method: int = zipfile.ZIP_DEFLATED
) -> Path:
    with zipfile.ZipFile(path, "w", method) as file:
        for name, content in members.items():
            info = zipfile.ZipInfo(name)
            info.external_attr, info.compress_type = mode << 16, method
            file.writestr(info, content)
    return path


def taped(
    path: Path, name: str, content: bytes = b"", kind: bytes = tarfile.REGTYPE, target: str = ""
) -> Path:
    with tarfile.open(path, "w:gz" if path.suffix == ".gz" else "w") as file:
        info = tarfile.TarInfo(name)
        info.type, info.linkname, info.size = kind, target, len(content)
        file.addfile(info, io.BytesIO(content))
    return path


@pytest.mark.parametrize("ending", ["zip", "tar", "tar.gz"])
def test_result_files_come_out_as_they_went_in(tmp_path: Path, ending: str) -> None:
    path, content = tmp_path / f"a.{ending}", bytes(range(256)) * 50
    if ending == "zip":
        zipped(
            path,
            {
                "b/two.h5": content,
                "notes.txt": b"no result",
                "__MACOSX/._two.h5": b"no result",
                "__MACOSX/._card.toml": b"no card",
                "b/card.toml": b"card",
            },
        )
    else:
        taped(path, "b/two.h5", content)
    with submitted_files(path) as found:
        assert [(name, file.read_bytes()) for name, file in found.results] == [
            ("b/two.h5", content)
        ]
        assert [name for name, _ in found.cards] == ["b/card.toml"] * (ending == "zip")
        places = [file for _, file in (*found.results, *found.cards)]
    assert not any(place.exists() for place in places)


def test_a_folder_and_a_single_file(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for name in ("b.h5", "in/a.h5", "notes.txt", "in/my.card.toml"):
        (tmp_path / name).write_bytes(b"x")
    with submitted_files(tmp_path) as found:
        assert [name for name, _ in found.results] == ["b.h5", "in/a.h5"]
        assert [name for name, _ in found.cards] == ["in/my.card.toml"]
    with submitted_files(tmp_path / "notes.txt") as found:
        assert [name for name, _ in found.results] == ["notes.txt"]


def bomb(path: Path) -> Path:
    return zipped(path, {"a.h5": bytes(50_000_000)})


def long_name(path: Path) -> Path:
    """An archive with a member's name of 100 MB.

    A reader of names would hold all of it in memory.
    """
    info = tarfile.TarInfo("././@LongLink")
    info.type, info.size = tarfile.GNUTYPE_LONGNAME, 100_000_000
    path.write_bytes(gzip.compress(info.tobuf(tarfile.GNU_FORMAT) + bytes(100_000_000), 1))
    return path


def many(path: Path) -> Path:
    return zipped(path, {f"{number}.h5": b"" for number in range(1001)})


BAD: list[tuple[str, Make, str]] = [
    ("a.zip", lambda path: zipped(path, {"/etc/x.h5": b"x"}), "names inside the archive"),
    ("b.zip", lambda path: zipped(path, {"a/../../x.h5": b"x"}), "names inside the archive"),
    ("c.zip", lambda path: zipped(path, {"c:\\x.h5": b"x"}), "names inside the archive"),
    ("d.zip", lambda path: zipped(path, {"x.h5": b"/etc/passwd"}, 0o120777), "a link or device"),
    (
        "e.zip",
        lambda path: zipped(path, {"x.h5": b"x"}, method=zipfile.ZIP_LZMA),
        "stored or deflated",
    ),
    ("f.zip", bomb, "times its size"),
    ("g.zip", many, "at most 1000 files"),
    ("h.zip", lambda path: zipped(path, {"notes.txt": b"x"}), "found none"),
    ("i.zip", lambda path: (path.write_bytes(b"PK no zip") and path) or path, "an intact archive"),
    (
        "j.tar",
        lambda path: taped(path, "x.h5", kind=tarfile.SYMTYPE, target="/etc/passwd"),
        "a link or device",
    ),
    (
        "k.tar",
        lambda path: taped(path, "x.h5", kind=tarfile.LNKTYPE, target="../x"),
        "a link or device",
    ),
    ("l.tar", lambda path: taped(path, "x.h5", kind=tarfile.CHRTYPE), "a link or device"),
    ("m.tar", lambda path: taped(path, "../x.h5", b"x"), "names inside the archive"),
    ("n.tar.gz", lambda path: taped(path, "x.h5", bytes(50_000_000)), "times its size"),
    ("o.tar.gz", long_name, "to be read at once"),
]


@pytest.mark.parametrize(("name", "make", "words"), BAD, ids=[name for name, *_ in BAD])
def test_what_no_honest_archive_has_is_refused(
    tmp_path: Path, name: str, make: Make, words: str
) -> None:
    path = make(tmp_path / name)
    with pytest.raises(InputError, match=words), submitted_files(path):
        pytest.fail("it was opened")
    assert list(tmp_path.iterdir()) == [path]


def test_two_members_of_one_name(tmp_path: Path) -> None:
    path = tmp_path / "a.tar"
    with tarfile.open(path, "w") as file:
        for _ in range(2):
            file.addfile(tarfile.TarInfo("a.h5"))
    with pytest.raises(InputError, match="different names"), submitted_files(path):
        pytest.fail("it was opened")


def test_links_in_folders(tmp_path: Path) -> None:
    (tmp_path / "a.h5").symlink_to("/etc/passwd")
    with pytest.raises(InputError, match="no links"), submitted_files(tmp_path):
        pytest.fail("it was opened")
    with pytest.raises(InputError, match="a link"), submitted_files(tmp_path / "a.h5"):
        pytest.fail("it was opened")
