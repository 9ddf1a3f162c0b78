"""Laws of the two tiers: functions that test, and those of them that are slow in all cases.

Run `python -m tests.architecture.tiers` for a table of folders and the names of the slow ones.
"""

import ast
from pathlib import Path

from tests.architecture.plan import ROOT, syntax


def laws(file: Path) -> dict[str, bool]:
    """Return the tests of a file, and whether each has a case in the daily tier."""
    tests = [node for node in syntax(file).body if isinstance(node, ast.FunctionDef)]
    return {
        node.name: "pytest.mark.slow" not in map(ast.unparse, node.decorator_list)
        for node in tests
        if node.name.startswith("test_")
    }


def main() -> None:
    folder = ROOT / "tests"
    rows: dict[str, dict[Path, dict[str, bool]]] = {}
    for file in sorted(folder.rglob("test_*.py")):
        room = "/".join(file.relative_to(folder).parts[:-1][:2])
        rows.setdefault(room, {})[file] = laws(file)
    print("| folder | laws | daily |\n|---|---|---|")
    for room, files in rows.items():
        daily = [is_daily for tests in files.values() for is_daily in tests.values()]
        print(f"| {room} | {len(daily)} | {sum(daily)} |")
    for files in rows.values():
        for file, tests in files.items():
            for name in (name for name, is_daily in tests.items() if not is_daily):
                print(f"slow: {file.relative_to(folder)}::{name}")


if __name__ == "__main__":
    main()
