"""A user's script, held against its types by mypy, never run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, assert_type

import sabench as sb

if TYPE_CHECKING:
    scene = sb.load_scene("quick")
    assert_type(scene, sb.Scene)
    data = sb.generate(scene, "work/quick", seed=1)
    assert_type(data, sb.Dataset)
    assert_type(sb.solve("msa", data, "work/msa.h5"), sb.Result)
    assert_type(sb.score(data, Path("work/msa.h5")), dict[str, Any])
    assert_type(sb.list_solvers(task="particles"), list[str])
    walls: list[sb.Wall] = []
    solver: type[sb.api.Solver] = sb.api.Solver
    sb.load_scene(1.5)  # type: ignore[arg-type]
    sb.scor  # type: ignore[attr-defined]  # noqa: B018
