"""Figures of a checkout: rooms, arrows, circles and weight.

Run `python -m tests.architecture [CHECKOUT]`.
"""

import sys
from pathlib import Path

from tests.architecture.plan import ROOT, arrows, circles, lines, rooms
from tests.architecture.weight import figures


def main() -> None:
    root = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT
    package = root / "sabench"
    found = arrows(package)
    between = {(one, other) for one, other in found if one != other}
    print(f"rooms in sabench/ {len(rooms(package))}")
    print(
        f"arrows            {len(between)} between rooms, {len(arrows(package, files=True))} "
        "between files"
    )
    print(f"circles           {[sorted(one) for one in circles(between)]}")
    for part in ("sabench", "generators", "solvers", "reproduction", "tests", "benchmarks"):
        print(f"lines of {part:10} {lines(root / part)}")
    for name, value in figures(root).items():
        print(f"{name:35} {value:g}")


if __name__ == "__main__":
    main()
