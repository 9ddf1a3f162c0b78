"""Files of cameras whose numbers show that one lacks a frame."""

from __future__ import annotations

from pathlib import Path

import pytest

from sabench.dataset.import_recording import check_numbers
from sabench.images.image_files import Files
from sabench.utils.errors import InputError

EVERY = slice(None)


def taken(**names: list[str]) -> Files:
    return {name: tuple(Path(one) for one in files) for name, files in names.items()}


def test_a_gap_that_others_do_not_have_is_named() -> None:
    """With as many files in the range, too."""
    with_gap = taken(
        a=["a/B0001.tif", "a/B0002.tif", "a/B0003.tif"],
        b=["b/B0001.tif", "b/B0003.tif", "b/B0004.tif"],
    )
    for chosen in (EVERY, slice(0, 2)):
        with pytest.raises(InputError, match="b: expected an image of number 2, as other cameras"):
            check_numbers(with_gap, chosen, [])


@pytest.mark.parametrize(
    "names",
    [
        {"a": ["a1_7.tif", "a1_9.tif"], "b": ["b2_7.tif", "b2_9.tif"]},  # 8 is nowhere
        {"a": ["1_cam1.tif", "2_cam1.tif"], "b": ["1_cam2.tif", "2_cam2.tif"]},
        {"a": ["a.tif"], "b": ["b.tif"]},
        {"a": ["0.tif", "101.tif", "200.tif"], "b": ["1.tif", "99.tif", "201.tif"]},  # times
        {"a": ["early.tif", "late.tif"], "b": ["x.tif", "y.tif"]},
        {"a": ["1.tif", "2.tif", "3.tif"], "b": ["1.tif", "2.tif"]},  # counts tell of the end
    ],
)
def test_frames_without_a_gap_are_taken(names: dict[str, list[str]]) -> None:
    notes: list[str] = []
    check_numbers(taken(**names), EVERY, notes)
    assert notes == []


def test_cameras_that_begin_with_other_numbers_are_said() -> None:
    notes: list[str] = []
    check_numbers(taken(a=["a1.tif", "a2.tif"], b=["b11.tif", "b12.tif"]), EVERY, notes)
    assert notes == ["frames are paired in order, and images begin with numbers 1 of a, 11 of b"]
