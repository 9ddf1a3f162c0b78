"""Frozen suites, hidden splits, and parts of a suite."""

import re
from pathlib import Path

import pytest

from sabench.evaluation.suite_loading import load_suite, read_secret
from sabench.evaluation.suites import Only
from sabench.utils.errors import InputError
from tests.helpers.refusals import check_sentence, refused

SUITE = (
    'title = "t"\nscenes = ["quick"]\nseeds = [1, 2]\nbackend = "splat"\n'
    'solvers = [{ name = "msa" }, { name = "asa", label = "additive" }]\n'
)
FROZEN = 'frozen = "' + 64 * "0" + '"\n'
SECRET = 'secret = "0123456789abcdef"\nseeds = 3\n'


def write(folder: Path, text: str, name: str = "s.toml") -> Path:
    (folder / name).write_text(text)
    return folder / name


def test_a_frozen_suite_says_its_hash_when_something_changed(tmp_path: Path) -> None:
    def fault(text: str) -> str:
        with pytest.raises(InputError) as caught:
            load_suite(write(tmp_path, text))
        check_sentence(re.sub("[0-9a-f]{64}", "HASH", str(caught.value)), "frozen")
        return str(caught.value)

    (now,) = set(re.findall("[0-9a-f]{64}", fault(SUITE + FROZEN))) - {64 * "0"}
    frozen = SUITE + FROZEN.replace(64 * "0", now)
    assert len(load_suite(write(tmp_path, frozen))[1]) == 2
    # solvers come and go
    assert load_suite(write(tmp_path, frozen.replace('{ name = "msa" }, ', "")))[1]
    fault(frozen.replace("[1, 2]", "[1, 3]"))
    fault(frozen.replace('"splat"', '"splat"\nversion = 2'))
    fault(frozen.replace('"splat"\n', '"splat"\nset = { "particles.count" = 299 }\n'))


def test_hidden_seeds_come_of_the_secret_the_suite_and_the_case_only(tmp_path: Path) -> None:
    secret = read_secret(write(tmp_path, SECRET))
    other = read_secret(write(tmp_path, SECRET.replace("f", "e"), "other.toml"))
    drawn = [
        one.seeds_of(*of)
        for one in (secret, other)
        for of in [("s", 1, "a"), ("s", 1, "b"), ("s", 2, "a"), ("t", 1, "a")]
    ]
    assert all(len(set(seeds)) == 3 and min(seeds) >= 0 and max(seeds) < 2**63 for seeds in drawn)
    assert len({seed for seeds in drawn for seed in seeds}) == 24
    assert secret.seeds_of("s", 1, "a") == read_secret(tmp_path / "s.toml").seeds_of("s", 1, "a")


def test_hidden_cases_are_named_by_their_number(tmp_path: Path) -> None:
    secret = read_secret(write(tmp_path, SECRET, "secret.toml"))
    _, cases = load_suite(write(tmp_path, SUITE), secret)
    labels = [(case.seed_label, case.shown_seed) for case in cases]
    assert labels == [("hidden0", 0), ("hidden1", 1), ("hidden2", 2)]
    assert [case.seed for case in cases] == list(secret.seeds_of("s", 1, "quick"))
    assert not any(str(case.seed) in case.file_name for case in cases)


@pytest.mark.parametrize(
    "text",
    [
        "",
        'secret = "short"',
        "secret = 5",
        "no TOML",
        SECRET + "count = 2",
        SECRET.replace("3", "0"),
    ],
)
def test_a_bad_secret_is_a_sentence_that_does_not_repeat_it(tmp_path: Path, text: str) -> None:
    with refused("s.toml: ") as caught:
        read_secret(write(tmp_path, text))
    assert "short" not in str(caught.value)
    assert "0123456789abcdef" not in str(caught.value)


def test_parts_of_a_suite(tmp_path: Path) -> None:
    _, cases = load_suite(write(tmp_path, SUITE))
    chosen = Only(("quick",), (2,), ("additive",)).select(cases)
    assert [(c.seed, [one.shown for one in c.solvers]) for c in chosen] == [(2, ["additive"])]
    assert Only().select(cases) == cases
    with refused("--solver asa"):
        Only(solvers=("asa",)).select(cases)
    with refused("--seed 7"):
        Only(seeds=(7,)).select(cases)
    with refused("--case tank"):
        Only(cases=("tank",)).select(cases)
