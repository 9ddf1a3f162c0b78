"""Calls in a child process: results, faults, and this process's environment."""

from __future__ import annotations

import os
import time

import pytest

from sabench.utils.errors import InputError
from sabench.utils.processes.call import call_isolated


def add(one: int, other: int) -> int:
    return one + other


def pid_and(variable: str) -> tuple[int, str | None]:
    return os.getpid(), os.environ.get(variable)


def refuse() -> None:
    raise InputError("no")


def break_off() -> None:
    os.abort()


def test_a_result_comes_back() -> None:
    assert call_isolated(add, 2, 3, doing="sum") == 5


def test_the_child_has_the_environment_of_the_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its server started earlier, with another one."""
    call_isolated(add, 2, 3, doing="sum")
    monkeypatch.setenv("SABENCH_TEST", "now")
    child, value = call_isolated(pid_and, "SABENCH_TEST", doing="look")
    assert value == "now"
    assert child != os.getpid()
    monkeypatch.delenv("SABENCH_TEST")
    assert call_isolated(pid_and, "SABENCH_TEST", doing="look")[1] is None


def test_faults_become_input_errors() -> None:
    with pytest.raises(InputError, match=r"^no$"):
        call_isolated(refuse, doing="sum")
    with pytest.raises(InputError, match=r"^sum: its process ended with signal SIGABRT"):
        call_isolated(break_off, doing="sum")
    with pytest.raises(InputError, match=r"^sleep: expected an end within 0.2 s"):
        call_isolated(time.sleep, 60.0, doing="sleep", time_s=0.2)
