"""Tests with numba's bounds checks: an index beyond an array is an error.

    python benchmarks/bounds_check.py [arguments of pytest]

Without arguments, the unit tests of the kernels run; `tests` runs the whole suite. Kernels are
compiled into a cache of their own, which takes minutes. numba ignores errors in parallel loops
(they go on with the next index), so all loops are made serial, also in child processes. An index
from -n to -1 counts from the end of an axis and is not found.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
KERNELS = (
    "tests/unit/algorithms",
    "tests/unit/geometry",
    "tests/unit/images",
    "tests/unit/metrics",
    "tests/unit/simulation",
)
# Python imports a module of this name when it starts; numba is changed when it is first imported
_CUSTOMISED = """\
import importlib.abc
import importlib.util
import sys


class Finder(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name != "numba":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        load = spec.loader.exec_module

        def load_serial(module):
            load(module)
            compiled = module.njit

            def njit(*arguments, **options):
                options.pop("parallel", None)
                return compiled(*arguments, **options)

            module.njit = njit

        spec.loader.exec_module = load_serial
        return spec


sys.meta_path.insert(0, Finder())
"""


def checked_environment(folder: Path) -> dict[str, str]:
    """Make environment variables for Python processes with bounds checks.

    `folder` receives a module that makes kernels serial, and the cache of the kernels.
    """
    (folder / "sitecustomize.py").write_text(_CUSTOMISED, encoding="utf-8")
    paths = [str(folder), str(ROOT), os.environ.get("PYTHONPATH", "")]
    return os.environ | {
        "NUMBA_BOUNDSCHECK": "1",
        "NUMBA_CACHE_DIR": str(folder / "kernels"),
        "PYTHONPATH": os.pathsep.join(path for path in paths if path),
    }


def main() -> int:
    """Run pytest; its exit code."""
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", *(sys.argv[1:] or KERNELS)]
    with tempfile.TemporaryDirectory(prefix="sabench-bounds-") as folder:
        return subprocess.run(
            command, cwd=ROOT, env=checked_environment(Path(folder)), check=False
        ).returncode


if __name__ == "__main__":
    sys.exit(main())
