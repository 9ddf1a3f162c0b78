"""Eight floors, and a reader of the imports that cross them."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
Arrows = set[tuple[str, str]]

# From the ground up: a room imports from its own floor and from those below, and no circle.
FLOORS = (
    {"utils"},
    {"geometry", "images", "plotting", "plugins"},
    {"api", "scenes"},
    {"algorithms", "metrics", "dataset", "worlds"},
    {"tasks", "simulation"},
    {"evaluation", "interop"},
    {"apps"},
    {"cli"},
)


def rooms(package: Path) -> set[str]:
    found = {one.relative_to(package).parts[0].removesuffix(".py") for one in package.rglob("*.py")}
    return found - {"__init__", "__main__", "_plugins"}


@cache
def arrows(package: Path, *, files: bool = False) -> Arrows:
    """Pairs (importer, imported) of rooms, or of files, with imports inside functions."""
    known = {_dotted(file, package.parent) for file in package.rglob("*.py")}
    found = set()
    for file in sorted(package.rglob("*.py")):
        if file.parent == package and file.stem in ("__init__", "__main__"):
            continue  # the public face and the door of the command
        own = _dotted(file, package.parent)
        for target in imports(file, known):
            if target.count("."):
                found.add((own, target) if files else (own.split(".")[1], target.split(".")[1]))
    return {(one, other) for one, other in found if one != other}


def imports(file: Path, known: set[str]) -> set[str]:
    package, found = next(iter(known)).split(".")[0], set()
    for node in ast.walk(syntax(file)):
        if isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] == package:
            whole = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {name if name in known else str(node.module) for name in whole}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name in known}
    return found


def circles(between: Arrows) -> set[frozenset[str]]:
    below: dict[str, set[str]] = {}
    for one, other in between:
        below.setdefault(one, set()).add(other)

    def reach(start: str) -> set[str]:
        seen: set[str] = set()
        left = [start]
        while left:
            for other in below.get(left.pop(), set()) - seen:
                seen.add(other)
                left.append(other)
        return seen

    reached = {room: reach(room) for room in below}
    inside = {room for room in reached if room in reached[room]}
    return {
        frozenset(other for other in reached[one] & inside if one in reached[other])
        for one in inside
    }


@cache
def syntax(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))


def lines(folder: Path) -> int:
    return sum(len(file.read_text(encoding="utf-8").splitlines()) for file in folder.rglob("*.py"))


def _dotted(file: Path, root: Path) -> str:
    return ".".join(file.relative_to(root).with_suffix("").parts).removesuffix(".__init__")
