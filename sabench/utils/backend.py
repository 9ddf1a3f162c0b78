"""Chooses what Mitsuba and Dr.Jit run on; nothing else in sabench names a variant or a library path.

CUDA where a driver answers, else LLVM. Dr.Jit loads libLLVM at run time and would take any that the
system offers, also one that aborts the whole process in the middle of a render, so the library is
chosen and its version asked before.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import functools
import importlib
import importlib.metadata
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sabench.utils.errors import InputError
from sabench.utils.progress import console

LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
CHOICE_VARIABLE = "SABENCH_BACKEND"
OLDEST_LLVM = 19  # tried: 14 is refused by Dr.Jit, 15 and 16 abort in renders, 19 and 23 work
_SYSTEM = (
    "usr/lib/llvm-*/lib/libLLVM*.so*",
    "usr/lib/*/libLLVM*.so*",
    "usr/lib*/libLLVM*.so*",
    "opt/homebrew/opt/llvm/lib/libLLVM*.dylib",
)
REMEDY = (
    f"install the wheel karellen-llvm-core (Linux x86-64) or an LLVM of version {OLDEST_LLVM} or later (Debian: libllvm19), "
    f"or set {LLVM_VARIABLE} to its libLLVM"
)


@dataclass(frozen=True)
class Backend:
    """What was chosen: "cuda" or "llvm", the library (None for cuda), and one line that says why."""

    kind: str
    library: str | None
    why: str


@functools.cache
def choose() -> Backend:
    """The backend of this process. SABENCH_BACKEND=llvm or =cuda overrides the choice.

    Raises
    ------
    InputError
        No working backend, or the asked one does not work; the text holds the remedy.
    """
    asked = os.environ.get(CHOICE_VARIABLE, "auto")
    if asked not in ("auto", "cuda", "llvm"):
        raise InputError(f"{CHOICE_VARIABLE}: expected auto, cuda or llvm, got {asked!r}")
    devices = 0 if asked == "llvm" else _cuda_devices()
    if devices:
        return Backend("cuda", None, f"CUDA driver with {devices} device(s)")
    if asked == "cuda":
        raise InputError(
            f"{CHOICE_VARIABLE}=cuda: expected a CUDA driver with a device, found none"
        )
    return _choose_llvm()


def _choose_llvm() -> Backend:
    refused = []
    for origin, path in _llvm_candidates():
        version = llvm_version(path)
        if version >= OLDEST_LLVM:
            return Backend("llvm", path, f"LLVM {version} from {origin}: {path}")
        refused.append(
            f"{path} ({'LLVM 15 or older' if version == 0 else 'cannot be loaded' if version < 0 else f'LLVM {version}'})"
        )
        if origin == LLVM_VARIABLE:
            break
    found = f"refused {', '.join(refused)}" if refused else "found none"
    raise InputError(f"no LLVM library that Dr.Jit can run on: {found}; {REMEDY}")


def _llvm_candidates() -> list[tuple[str, str]]:
    """(origin, path) in order of trust: the variable, the wheel, the system's libraries from the newest down."""
    variable = os.environ.get(LLVM_VARIABLE)
    if variable:
        return [(LLVM_VARIABLE, variable)]
    wheel = [("the wheel karellen-llvm-core", path) for path in _wheel_libraries()]
    paths = {os.path.realpath(path) for pattern in _SYSTEM for path in Path("/").glob(pattern)}
    numbered = (
        sorted(((llvm_version(path), path) for path in paths), reverse=True) if not wheel else []
    )
    return wheel + [("the system", path) for _, path in numbered]


def _wheel_libraries() -> list[str]:
    try:
        files = importlib.metadata.files("karellen-llvm-core") or []
    except importlib.metadata.PackageNotFoundError:
        return []
    paths = {
        os.path.realpath(str(file.locate())) for file in files if file.name.startswith("libLLVM")
    }
    return sorted(path for path in paths if Path(path).is_file())


def llvm_version(path: str) -> int:
    """Major version of a libLLVM; 0 for one too old to say (15 and before), -1 for one that cannot be loaded."""
    try:
        library = ctypes.CDLL(path)
    except OSError:
        return -1
    if not hasattr(library, "LLVMGetVersion"):
        return 0
    major, minor, patch = ctypes.c_uint(), ctypes.c_uint(), ctypes.c_uint()
    library.LLVMGetVersion(ctypes.byref(major), ctypes.byref(minor), ctypes.byref(patch))
    return major.value


def _cuda_devices() -> int:
    name = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"
    try:
        driver = ctypes.CDLL(name)
    except OSError:
        return 0
    count = ctypes.c_int()
    if driver.cuInit(0) != 0 or driver.cuDeviceGetCount(ctypes.byref(count)) != 0:
        return 0
    return count.value


@functools.cache
def _prepare() -> Backend:
    backend = choose()
    if backend.library:
        os.environ[LLVM_VARIABLE] = backend.library
        import drjit as dr

        loaded = dr.detail.llvm_version()[0]
        if loaded < OLDEST_LLVM:  # somebody imported drjit before the variable was set
            raise InputError(
                f"drjit was imported before sabench and took LLVM {loaded}, which aborts in renders: expected sabench's choice, {backend.library}; "
                f"import sabench.utils.backend and call its mitsuba() first, or set {LLVM_VARIABLE}"
            )
    console.print(f"computing on {backend.why}", style="dim", highlight=False, soft_wrap=True)
    return backend


def mitsuba() -> Any:
    """The module mitsuba with its variant set."""
    backend = _prepare()
    import mitsuba as mi

    mi.set_variant(f"{backend.kind}_ad_mono")
    return mi


def drjit() -> tuple[Any, Any]:
    """The module drjit, and the module of its array types (drjit.llvm or drjit.cuda) for this backend."""
    backend = _prepare()
    import drjit as dr

    return dr, importlib.import_module(f"drjit.{backend.kind}")


def limit(threads: int) -> None:
    """Have this process's Dr.Jit use so many threads."""
    drjit()[0].set_thread_count(threads)
