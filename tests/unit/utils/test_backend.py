"""The library that Dr.Jit runs on is chosen, never left to chance."""

import ctypes
import ctypes.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

from sabench.utils import backend
from tests.helpers.refusals import check_sentence, refused

CHOICE = "from sabench.utils import backend; print(backend.choose().library)"


def choose(**environment: str) -> str:
    """Errors of the choice in a fresh process, which must fail."""
    words, env = [sys.executable, "-c", CHOICE], os.environ | environment
    done = subprocess.run(words, env=env, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    return done.stderr


def test_the_chosen_library_is_recent_and_was_asked_for_its_version() -> None:
    chosen = backend.choose()
    assert chosen.kind in ("llvm", "cuda")
    if chosen.library:
        assert backend.llvm_version(chosen.library) >= backend.OLDEST_LLVM


def test_a_library_that_is_no_llvm_is_refused() -> None:
    other = ctypes.util.find_library("z") or ctypes.util.find_library("m")
    assert other
    errors = choose(SABENCH_BACKEND="llvm", DRJIT_LIBLLVM_PATH=other)
    for key in (other, backend.REMEDY):
        assert key in errors


def test_a_library_that_is_not_there_is_not_replaced_by_another(tmp_path: Path) -> None:
    """The user wants the library that he names: a silent fallback would hide the mistake."""
    assert "none.so" in choose(SABENCH_BACKEND="llvm", DRJIT_LIBLLVM_PATH=str(tmp_path / "none.so"))


def test_candidates_put_the_wheel_before_the_system(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(backend.LLVM_VARIABLE, raising=False)
    monkeypatch.setattr(backend, "_wheel_libraries", lambda: ["/wheel/libLLVM.so"])
    monkeypatch.setattr(backend, "_SYSTEM", (__file__.removeprefix("/"),))
    assert list(backend._llvm_candidates()) == [
        ("the wheel karellen-llvm-core", "/wheel/libLLVM.so"),
        ("the system", os.path.realpath(__file__)),
    ]


def test_a_broken_wheel_is_replaced_by_the_system(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(backend.LLVM_VARIABLE, raising=False)
    both = [("the wheel", "/wheel/libLLVM.so"), ("the system", "/usr/lib/libLLVM-21.so")]
    monkeypatch.setattr(backend, "_llvm_candidates", lambda: both)
    monkeypatch.setattr(backend, "llvm_version", lambda path: -1 if "wheel" in path else 21)
    assert backend._choose_llvm().library == "/usr/lib/libLLVM-21.so"


def test_what_the_wheel_lacks_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small system (debian-slim) has no libatomic."""
    reason = "libatomic.so.1: cannot open shared object file: No such file or directory"

    def fail(path: str) -> None:
        raise OSError(reason)

    monkeypatch.setattr(ctypes, "CDLL", fail)
    monkeypatch.setattr(backend, "_llvm_candidates", lambda: [("the wheel", "/w/libLLVM.so")])
    with refused(reason, "libatomic1"):
        backend._choose_llvm()


def test_an_old_system_library_is_refused_by_its_version(monkeypatch: pytest.MonkeyPatch) -> None:
    old = [("the system", "/usr/lib/libLLVM-16.so")]
    monkeypatch.setattr(backend, "_llvm_candidates", lambda: old)
    monkeypatch.setattr(backend, "llvm_version", lambda path: 16)
    with refused("LLVM 16"):
        backend._choose_llvm()


def test_unknown_choice_is_refused() -> None:
    check_sentence(choose(SABENCH_BACKEND="metal").splitlines()[-1], "SABENCH_BACKEND", "metal")
