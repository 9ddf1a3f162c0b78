"""Parts of a data set that is being made: whole or not there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from sabench.api.arrays import Array
from sabench.api.truth import Materials, View
from sabench.scenes import load_scene
from sabench.simulation.recording.parts import Entry, Job, Kept, Parts, Taken, read_job
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError


@dataclass(frozen=True)
class State(Kept):
    """What serves the recording only."""

    ARRAYS = (Array("state", (0,)),)

    state: F64


def numbers(count: int) -> Entry:
    return Materials(np.arange(count)), ""


def taken() -> Taken:
    rng = np.random.default_rng(1)
    return Taken(
        [(View(rng.random((5, 2)), np.ones(5), np.ones(5), np.ones(5, dtype=np.bool_)), "a")],
        rng.integers(0, 4095, (6, 8), dtype=np.uint16),
        rng.random((6, 8), dtype=np.float32),
    )


def test_what_is_put_is_there_and_nothing_beside_it(tmp_path: Path) -> None:
    parts, view = Parts(tmp_path), taken()
    assert not list(tmp_path.glob("views/*.npz"))
    assert not parts.has_frame(3)
    parts.put_frame(3, [numbers(4), (State(np.zeros(0)), "")])
    parts.put_view(3, "a", view)
    assert parts.has_frame(3)
    assert parts.has_view(3, "a")
    assert list(tmp_path.glob("views/*.npz"))
    assert list(parts.frame(3).truth) == ["frames/0003/material"]
    np.testing.assert_array_equal(parts.frame(3).truth["frames/0003/material"], np.arange(4))
    (seen, _), stored = view.truth[0], parts.view(3, "a")
    assert isinstance(seen, View)
    np.testing.assert_array_equal(stored.truth["frames/0003/cameras/a/pixel"], seen.pixel)
    assert sorted(stored.files) == [
        "images/frame_0003/a.exr",
        "images/frame_0003/a.tif",
    ]
    assert sorted(path.name for path in tmp_path.rglob("*") if path.is_file()) == [
        "0003-a.npz",
        "0003.npz",
        "a.exr",
        "a.tif",
    ]


def test_a_part_with_one_byte_wrong_is_not_there_or_whole(tmp_path: Path) -> None:
    parts, path = Parts(tmp_path), tmp_path / "frames" / "0003.npz"
    parts.put_frame(3, [numbers(4)])
    whole = path.read_bytes()
    refused = 0
    for position in range(len(whole)):  # compression, encryption, length, names, checksum, ...
        damaged = bytearray(whole)
        damaged[position] ^= 0x49
        path.write_bytes(damaged)
        refused += not parts.has_frame(3)
    assert refused > len(whole) / 2


@pytest.mark.parametrize("file", ["images/frame_0003/a.exr", "images/frame_0003/a.tif"])
def test_a_view_with_one_bit_wrong_in_a_picture_is_not_there(tmp_path: Path, file: str) -> None:
    parts, rng, path = Parts(tmp_path), np.random.default_rng(2), tmp_path / file
    parts.put_view(3, "a", taken())
    whole = path.read_bytes()
    for position in rng.integers(0, len(whole), 8):
        damaged = bytearray(whole)
        damaged[position] ^= 4
        path.write_bytes(damaged)
        assert not parts.has_view(3, "a")


@pytest.mark.parametrize(
    "file", ["views/0003-a.npz", "images/frame_0003/a.exr", "images/frame_0003/a.tif"]
)
def test_a_view_of_which_a_file_is_torn_or_missing_is_not_there_and_can_be_made_again(
    tmp_path: Path, file: str
) -> None:
    parts, path = Parts(tmp_path), tmp_path / file
    parts.put_view(3, "a", taken())
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert not parts.has_view(3, "a")
    path.unlink()
    assert not parts.has_view(3, "a")
    parts.put_view(3, "a", taken())
    assert parts.has_view(3, "a")


def test_a_number_of_the_truth_that_has_changed_is_not_taken_for_whole(tmp_path: Path) -> None:
    parts, path = Parts(tmp_path), tmp_path / "frames" / "0003.npz"
    parts.put_frame(3, [numbers(400)])
    damaged = bytearray(path.read_bytes())
    damaged[damaged.index(np.arange(200, 203).tobytes())] ^= 4
    path.write_bytes(damaged)
    assert not parts.has_frame(3)


def test_a_part_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"0007\.npz: expected an intact part"):
        Parts(tmp_path).frame(7)


def test_a_job_is_read_as_it_was_written_and_only_by_the_same_code(tmp_path: Path) -> None:
    job = Job(load_scene("quick"), 7, "splat", "quick")
    job.write(tmp_path)
    again = read_job(tmp_path)
    assert (again.scene.hash, again.seed, again.renderer, again.label, again.key) == (
        job.scene.hash,
        7,
        "splat",
        "quick",
        job.key,
    )
    assert (
        len(
            {
                job.key,
                Job(job.scene, 8, "splat", "quick").key,
                Job(job.scene, 7, "mitsuba", "quick").key,
            }
        )
        == 3
    )
    (tmp_path / "job.json").write_text(
        (tmp_path / "job.json").read_text().replace(job.key, "0" * 64)
    )
    with pytest.raises(InputError, match="same versions of sabench"):
        read_job(tmp_path)
    with pytest.raises(InputError, match="use a folder that all workers see"):
        read_job(tmp_path / "elsewhere")


def test_nothing_is_written_where_the_data_set_is_complete(tmp_path: Path) -> None:
    parts = Parts(tmp_path / "gone")
    with pytest.raises(InputError, match="but it is gone"):
        parts.put_frame(0, [])
    with pytest.raises(InputError, match="but it is gone"):
        parts.put_view(0, "a", taken())
    assert not list(tmp_path.iterdir())
