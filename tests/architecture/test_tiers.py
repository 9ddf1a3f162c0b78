"""The daily tier of the tests: each file has a test in it, so that no kind of law leaves it."""

from tests.architecture.tiers import laws
from tests.conftest import ROOT

# The particle search alone compiles for a minute; tests/unit/algorithms/particles tests its parts.
WHOLLY_SLOW = {"system/test_bayesian_ipr.py"}


def test_every_file_has_a_daily_test() -> None:
    folder = ROOT / "tests"
    files = folder.rglob("test_*.py")
    slow = {file.relative_to(folder).as_posix() for file in files if not any(laws(file).values())}
    assert slow == WHOLLY_SLOW
