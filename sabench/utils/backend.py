"""Choice of the backend of Mitsuba and Dr.Jit.

CUDA if there is a driver and a device, else LLVM. Dr.Jit loads libLLVM at run time and takes any
that the system offers, also one that aborts the process during a render. So this module selects the
library and checks its version first. No other module of sabench names a variant or a library path.
"""

import contextlib
import ctypes
import ctypes.util
import functools
import importlib
import importlib.metadata
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from sabench.utils.errors import InputError
from sabench.utils.progress import say

Renderer = Literal["auto", "mitsuba", "splat"]
LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
CHOICE_VARIABLE = "SABENCH_BACKEND"
OLDEST_LLVM = 19  # tested: Dr.Jit refuses 14; 15 and 16 abort during renders; 19 and 23 work
_SYSTEM = (
    "usr/lib/llvm-*/lib/libLLVM*.so*",
    "usr/lib/*/libLLVM*.so*",
    "usr/lib*/libLLVM*.so*",
    "opt/homebrew/opt/llvm/lib/libLLVM*.dylib",
)
REMEDY = (
    "install the wheel karellen-llvm-core (Linux x86-64) or an LLVM of version "
    f"{OLDEST_LLVM} or later (Debian: libllvm19), or set {LLVM_VARIABLE} to its libLLVM"
)


@dataclass(frozen=True)
class Backend:
    """Backend of Mitsuba and Dr.Jit.

    "cuda" or "llvm", its library (None for cuda), and one line with the reason.
    """

    kind: str
    library: str | None
    why: str


@functools.cache
def choose() -> Backend:
    """Choose the backend of this process.

    SABENCH_BACKEND=llvm or =cuda overrides the choice.

    Raises InputError: there is no working backend, or the requested one does not work; the message
    says how to fix it.
    """
    asked = os.environ.get(CHOICE_VARIABLE, "auto")
    if asked not in ("auto", "cuda", "llvm"):
        raise InputError(f"{CHOICE_VARIABLE}: expected auto, cuda or llvm, got {asked!r}")
    devices = 0 if asked == "llvm" else _cuda_devices()
    if devices:
        return Backend("cuda", None, f"CUDA driver with {devices} device(s)")
    if asked == "cuda":
        sentence = f"{CHOICE_VARIABLE}=cuda: expected a CUDA driver with a device, found none"
        raise InputError(sentence)
    return _choose_llvm()


_LIBATOMIC = "libatomic.so.1"  # which libc++ of the wheel needs, and small systems lack


def _choose_llvm() -> Backend:
    refused = []
    for origin, path in _llvm_candidates():
        version = llvm_version(path)
        if version >= OLDEST_LLVM:
            return Backend("llvm", path, f"LLVM {version} from {origin}: {path}")
        reason = f"LLVM {version}" if version else "LLVM 15 or older"
        if version < 0:
            reason = "cannot be loaded"
            try:
                ctypes.CDLL(path)
            except OSError as error:
                package = ", which the package libatomic1 has" if _LIBATOMIC in str(error) else ""
                reason = f"cannot be loaded: {error}{package}"
        refused.append(f"{path} ({reason})")
    tried = f"refused {', '.join(refused)}" if refused else "found none"
    raise InputError(f"no LLVM library that Dr.Jit can run on: {tried}; {REMEDY}")


def _llvm_candidates() -> Iterator[tuple[str, str]]:
    """Yield (origin, path) of LLVM libraries in the order of preference.

    First the variable, then the wheel, then the system's, newest first, which are looked for only
    if those before are refused.
    """
    variable = os.environ.get(LLVM_VARIABLE)
    if variable:
        yield LLVM_VARIABLE, variable
        return
    for path in _wheel_libraries():
        yield "the wheel karellen-llvm-core", path
    paths = {os.path.realpath(path) for pattern in _SYSTEM for path in Path("/").glob(pattern)}
    for _, path in sorted(((llvm_version(path), path) for path in paths), reverse=True):
        yield "the system", path


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
    """Read a libLLVM's major version: 0 for 15 and older, -1 if it cannot be loaded."""
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
                f"drjit was imported before sabench and loaded LLVM {loaded}, which aborts during "
                f"renders: expected {backend.library}; import sabench.utils.backend and call its "
                f"mitsuba() first, or set {LLVM_VARIABLE}"
            )
    say(f"computing on {backend.why}", "dim")
    return backend


def mitsuba() -> Any:
    """Import mitsuba and set its variant."""
    backend = _prepare()
    import mitsuba as mi

    mi.set_variant(f"{backend.kind}_ad_mono")
    return mi


def drjit() -> tuple[Any, Any]:
    """Import drjit and its array types for this backend (drjit.llvm or drjit.cuda)."""
    backend = _prepare()
    import drjit as dr

    return dr, importlib.import_module(f"drjit.{backend.kind}")


def limit_threads(threads: int) -> None:
    """Set the number of threads that Dr.Jit uses in this process."""
    drjit()[0].set_thread_count(threads)


@contextlib.contextmanager
def limit_libraries(threads: int | None) -> Iterator[None]:
    """Limit the threads of compiled kernels and of linear algebra; None: no limit."""
    if threads is None:
        yield
        return
    from threadpoolctl import threadpool_limits

    with limit_kernels(threads), threadpool_limits(threads):
        yield


@contextlib.contextmanager
def limit_kernels(threads: int) -> Iterator[None]:
    """Limit the threads of compiled kernels alone: a thousand times as quick."""
    from sabench.utils.compiled import numba

    before = numba.get_num_threads()
    numba.set_num_threads(min(threads, before))
    try:
        yield
    finally:
        numba.set_num_threads(before)


def choose_renderer(asked: Renderer) -> str:
    """Choose mitsuba or splat; "auto" takes splat where nothing runs Mitsuba."""
    if asked not in ("auto", "mitsuba", "splat"):
        raise InputError(f"backend: expected auto, mitsuba or splat, got {asked!r}")
    if asked == "splat":
        return asked
    try:
        choose()
    except InputError:
        if asked == "mitsuba":
            raise
        return "splat"
    return "mitsuba"
