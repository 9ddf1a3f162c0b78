"""Counter-based random numbers, and points in boxes."""

import numpy as np
import pytest

from sabench.utils.arrays import in_box
from sabench.utils.philox import block, draw_key, fill_blocks


def words(text: str) -> tuple[np.uint64, ...]:
    return tuple(np.uint64(int(word, 16)) for word in text.split())


PI = "243f6a88 85a308d3 13198a2e 03707344"


@pytest.mark.parametrize(
    ("counter", "key", "answer"),
    [  # kat_vectors of Random123 1.14.0, philox4x32 with 10 rounds
        ("0 0 0 0", "0 0", "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
        (4 * "ffffffff ", 2 * "ffffffff ", "408f276d 41c83b0e a20bc7c6 6d5451fd"),
        (PI, "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
    ],
)
def test_blocks_are_those_of_random123(counter: str, key: str, answer: str) -> None:
    assert block(words(key), *words(counter)) == words(answer)


def test_rows_of_blocks_count_their_first_word() -> None:
    key, (first, second, third, fourth) = draw_key(np.random.default_rng(3)), words("7 5 3 1")
    rows = np.empty((4, 50), dtype=np.uint32)
    fill_blocks(key, first, second, third, fourth, rows)
    for n in (0, 1, 31, 49):
        expected = block(key, first + np.uint64(n), second, third, fourth)
        assert tuple(rows[:, n]) == tuple(int(word) for word in expected)


def test_every_bit_of_key_and_counter_changes_half_of_the_bits() -> None:
    given = [int(word) for word in draw_key(np.random.default_rng(4))] + [1, 2, 3, 4]

    def bits(values: list[int]) -> np.ndarray:
        key, counter = values[:2], values[2:]
        made = block(tuple(np.uint64(word) for word in key), *(np.uint64(word) for word in counter))
        return np.unpackbits(np.array([int(word) for word in made], dtype=np.uint32).view(np.uint8))

    for word in range(6):
        for bit in range(32):
            other = given.copy()
            other[word] ^= 1 << bit
            assert 32 <= int((bits(given) != bits(other)).sum()) <= 96  # 5.6 sigma about 64 of 128


def test_a_key_is_that_of_its_generator() -> None:
    first, again, other = (draw_key(np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first == again != other
    assert max(first) < 1 << 32


def test_a_box_includes_its_faces_and_no_point_without_coordinates() -> None:
    """Each coordinate is compared with its own sides."""
    low, high = (0.0, -1.0, 5.0), (1.0, 1.0, 9.0)
    inside = [[0.0, -1.0, 5.0], [1.0, 1.0, 9.0], [0.5, 0.0, 7.0]]
    outside = [[1.1, 0.0, 7.0], [0.5, -1.1, 7.0], [0.5, 0.0, 0.5], [np.nan, 0.0, 7.0]]
    found = in_box(np.array(inside + outside), low, high)
    assert found.tolist() == [True] * len(inside) + [False] * len(outside)
    assert in_box(np.zeros((0, 3)), low, high).shape == (0,)
