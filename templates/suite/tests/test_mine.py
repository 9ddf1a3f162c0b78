"""The suite is read, and its cases can be simulated."""

from pathlib import Path

from sabench.evaluation.suite_loading import load_suite


def test_the_suite_is_read():
    suite, cases = load_suite(Path(__file__).parents[1] / "mine.toml")
    assert len(cases) == 2 * len(suite.seeds)
