"""Checklist of a release: every line is checked, or says what a person has to do.

`python benchmarks/release.py [--fast]` prints one line for each point and ends with exit code 1 if
one of them fails. `--fast` leaves out the tests, the gate and the installation.
"""

import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_PLACEHOLDERS = ("TODO", "FIXME", "example.com", "your-name", "10.5281/zenodo.XXXX")
_BY_HAND = (
    "the measured records are those of this version: sabench run standard",
    "screenshots of the page and the site were looked at, wide and narrow, light and dark",
    "the wheel was installed on macOS and Windows, or the notes say that it was not",
)


def main() -> None:
    """Check all points."""
    fast = "--fast" in sys.argv[1:]
    points = QUICK if fast else (*QUICK, *SLOW)
    faults = 0
    for title, check in points:
        fault = check()
        faults += fault is not None
        print(f"{'FAIL' if fault else 'ok':5} {title}{f': {fault}' if fault else ''}", flush=True)
    for title in _BY_HAND:
        print(f"look  {title}")
    sys.exit(1 if faults else 0)


def clean() -> str | None:
    """Check that git knows every change."""
    changed = output("git", "status", "--porcelain").splitlines()
    return f"{len(changed)} changes, the first {changed[0].strip()}" if changed else None


def versions_agree() -> str | None:
    """Check that CITATION.cff has the version of the package."""
    source = (ROOT / "sabench/utils/version.py").read_text(encoding="utf-8")
    own = source.partition('__version__ = "')[2].partition('"')[0]
    cited = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    return None if f"\nversion: {own}\n" in cited else f"expected version {own} in CITATION.cff"


def changelog_is_dated() -> str | None:
    """Check that all entries belong to a version."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    if "## Unreleased" in text:
        return "the newest heading is Unreleased: give it the version and the date"
    return None


def metadata_is_complete() -> str | None:
    """Check classifiers against the versions, and that nothing is a placeholder."""
    files = ("pyproject.toml", "CITATION.cff", "README.md")
    for name in files:
        text = (ROOT / name).read_text(encoding="utf-8")
        if found := [word for word in _PLACEHOLDERS if word in text]:
            return f"{name}: placeholder {found[0]}"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return None if "Typing :: Typed" in project["classifiers"] else "classifier Typing :: Typed"


def records_are_in_the_wheel() -> str | None:
    """Check that the wheel lists every record that git knows."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    listed = tomllib.loads(text)["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    known = output("git", "ls-files", "leaderboard/records").split()
    return next((f"{one} is not in the wheel" for one in known if one not in listed), None)


def command(*words: str) -> Callable[[], str | None]:
    """Make the check that a command ends with exit code 0."""

    def check() -> str | None:
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
        last = (done.stdout + done.stderr).strip().splitlines()[-1:]
        return f"exit code {done.returncode}: {' '.join(last)}" if done.returncode else None

    return check


def output(*words: str) -> str:
    """Return what a command prints."""
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


QUICK: tuple[tuple[str, Callable[[], str | None]], ...] = (
    ("git knows every change", clean),
    ("CITATION.cff has the version", versions_agree),
    ("the changelog has a version and a date", changelog_is_dated),
    ("no placeholders", metadata_is_complete),
    ("the wheel lists all records", records_are_in_the_wheel),
)
SLOW = (
    ("lint", command("make", "lint")),
    ("types", command("make", "types")),
    ("tests", command("make", "test-all")),
    ("gate", command("make", "gate")),
    ("the wheel offers what the checkout offers", command("make", "wheel")),
    ("smoke test of the wheel", command(sys.executable, "benchmarks/installs.py", sys.executable)),
    ("other systems", command(sys.executable, "benchmarks/installs.py", "--resolve")),
)


if __name__ == "__main__":
    main()
