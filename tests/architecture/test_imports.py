"""Imports go down the seven floors, and in no circle."""

from __future__ import annotations

import ast

from tests.architecture.plan import FLOORS, ROOT, arrows, circles, rooms


def test_every_room_has_a_floor() -> None:
    assert rooms(ROOT / "sabench") == set().union(*FLOORS)


def test_imports_go_down() -> None:
    floor = {room: number for number, names in enumerate(FLOORS, 1) for room in names}
    up = [
        f"{one} (floor {floor[one.split('.')[1]]}) imports "
        f"{other} (floor {floor[other.split('.')[1]]})"
        for one, other in sorted(arrows(ROOT / "sabench", files=True))
        if floor[other.split(".")[1]] > floor[one.split(".")[1]]
    ]
    assert not up, "\n".join(up)


def test_no_circle_of_rooms() -> None:
    assert not circles(arrows(ROOT / "sabench"))


def test_no_circle_of_files() -> None:
    assert not circles(arrows(ROOT / "sabench", files=True))


def test_nothing_imports_what_is_mounted_by_its_dotted_name() -> None:
    mounted = {"solvers", "generators", "reproduction"}
    found = []
    for file in sorted((ROOT / "sabench").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and not node.level:
                names = [str(node.module)]
            found += [f"{file}: {name}" for name in names if name.split(".")[0] in mounted]
    assert not found
