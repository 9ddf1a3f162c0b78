"""Wheels installed in fresh environments, and dependencies resolved for other systems.

`python benchmarks/installs.py PYTHON ...` builds the wheel, installs it with every interpreter that
is given, and runs a smoke test there: list, generate, solve, score, submit and verify. It prints
JSON: the version, the seconds of installation and smoke test, the MB of the environment. `--light`
installs `sabench[score]`, and scores a data set of this environment.

`python benchmarks/installs.py --resolve` resolves all dependencies from wheels for systems that are
not here, with `uv pip compile` (uv must be installed: pip evaluates the markers of dependencies for
the machine on which it runs, whatever --platform says). Nothing is run there.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
_PLATFORMS = (
    "x86_64-unknown-linux-gnu",
    "aarch64-unknown-linux-gnu",
    "aarch64-apple-darwin",
    "x86_64-apple-darwin",
    "x86_64-pc-windows-msvc",
)
_WITHOUT_RENDERER = ("x86_64-apple-darwin",)
_VERSIONS = ("3.11", "3.12", "3.13", "3.14")
_SMOKE = (
    ("list",),
    ("doctor",),
    ("generate", "quick", "-o", "quick", "--seed", "1"),
    ("verify", "quick"),
    ("solve", "asa", "quick", "-o", "asa.h5"),
    ("score", "quick", "asa.h5"),
    ("pack", "quick", "--blind", "-o", "blind.zip"),
    ("submit", "asa.h5", "--name", "smoke", "--data", "."),
    ("new", "solver", "repository"),
)


def main() -> None:
    """Install or resolve, and print what came of it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("pythons", nargs="*", help="interpreters to install with")
    parser.add_argument("--resolve", action="store_true", help="resolve for other systems")
    parser.add_argument("--light", action="store_true", help="what scoring needs alone")
    chosen = parser.parse_args()
    if chosen.resolve:
        resolve_all()
    with tempfile.TemporaryDirectory(prefix="sabench-installs-") as folder:
        wheel = build(Path(folder)) if chosen.pythons else None
        for python in chosen.pythons:
            assert wheel is not None
            print(
                json.dumps(install(python, wheel, Path(folder) / "env", chosen.light)), flush=True
            )


def resolve_all() -> None:
    """Resolve for all systems, and end with exit code 1 if one lacks a wheel."""
    if shutil.which("uv") is None:
        sys.exit("expected the command uv (pip install uv), found none")
    found = [resolve(platform, version) for platform in _PLATFORMS for version in _VERSIONS]
    print(json.dumps(found, indent=1))
    if any(one["fault"] for one in found):
        sys.exit(1)


def build(folder: Path) -> Path:
    """Build the wheel of this checkout."""
    words = ("-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder), str(ROOT))
    run([sys.executable, *words], folder)
    return next(folder.glob("*.whl"))


def install(python: str, wheel: Path, place: Path, light: bool) -> dict[str, Any]:
    """Install the wheel in a fresh environment and run the smoke test there."""
    shutil.rmtree(place, ignore_errors=True)
    start = time.monotonic()
    run([python, "-m", "venv", "--without-pip", str(place)], wheel.parent)
    own = str(place / "bin" / "python")
    pip = [sys.executable, "-m", "pip", "--python", own, "install", "--quiet"]
    package = f"{wheel}[{'score' if light else 'full'}]"
    run([*pip, "--constraint", str(ROOT / "constraints.txt"), package], wheel.parent)
    installed = time.monotonic()
    version = run([own, "-c", "import platform; print(platform.python_version())"], place).strip()
    (place / "smoke").mkdir()
    smoke_light(own, place / "smoke") if light else smoke(own, place / "smoke")
    size = sum(path.stat().st_size for path in place.rglob("*") if not path.is_symlink())
    return {
        "python": version,
        "wheel_mb": round(wheel.stat().st_size / 1e6, 2),
        "install_s": round(installed - start, 1),
        "smoke_s": round(time.monotonic() - installed, 1),
        "environment_mb": round(size / 1e6),
    }


def smoke(python: str, folder: Path) -> None:
    """Run the commands of the smoke test."""
    for words in _SMOKE:
        run([python, "-m", "sabench", *words], folder)


def smoke_light(python: str, folder: Path) -> None:
    """Score a result that this environment makes, and compare all digits."""
    for words in _SMOKE[2:5:2]:
        run([sys.executable, "-m", "sabench", *words], folder)
    words = ("-m", "sabench", "score", "quick", "asa.h5", "--json")
    found, expected = run([python, *words], folder), run([sys.executable, *words], folder)
    assert json.loads(found) == json.loads(expected), (found, expected)


def resolve(platform: str, version: str) -> dict[str, Any]:
    """Resolve all dependencies of a system from wheels, or those of scoring."""
    extra = "score" if platform in _WITHOUT_RENDERER else "full"
    command = ("uv", "pip", "compile", "pyproject.toml", "--quiet", "--no-annotate")
    place = ("--python-platform", platform, "--python-version", version)
    done = subprocess.run(
        [*command, "--extra", extra, *place, "--only-binary", ":all:"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    packages = [line for line in done.stdout.splitlines() if "==" in line]
    reason = " ".join(done.stderr.split())[:300]
    return {
        "platform": platform,
        "extra": extra,
        "python": version,
        "packages": len(packages),
        "fault": reason if done.returncode else None,
    }


def run(words: list[str], folder: Path) -> str:
    """Run a command; if it fails, end with its words and messages."""
    own = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(words, cwd=folder, env=own, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(words)}: exit code {done.returncode}\n{done.stdout}\n{done.stderr}")
    return done.stdout


if __name__ == "__main__":
    main()
