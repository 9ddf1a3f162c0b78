"""Fixtures of several system tests: a browser, and files that take too long to be checked."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from sabench.utils.errors import UncheckedError
from tests.helpers.browser import Browser, chromium


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as session:
        if session is None:
            pytest.skip("chromium and chromedriver are not both on the PATH")
        yield session


@pytest.fixture
def late_probe(monkeypatch: pytest.MonkeyPatch) -> None:
    def late(root: Path) -> None:
        raise UncheckedError(f"{root}: could not be checked, because reading it takes long")

    monkeypatch.setattr("sabench.dataset.verification.probe_dataset", late)
