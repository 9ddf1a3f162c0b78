"""A bar counts kernels while they compile, and goes when none does."""

import io
import json
import time
from pathlib import Path
from typing import Any

import pytest
from numba.core import event
from rich.console import Console

from sabench import plugins, tasks
from sabench.utils import progress
from sabench.worlds.library.overlaps import _nearest


def test_a_bar_counts_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    out, listeners = io.StringIO(), []
    monkeypatch.setattr(progress, "console", Console(file=out, force_terminal=True, width=90))
    monkeypatch.setattr(progress, "_PATIENCE_S", 0.0)
    monkeypatch.setattr(event, "register", lambda kind, listener: listeners.append(listener))
    progress.announce_compiling.__wrapped__(7)
    (listener,) = listeners
    compiled: Any = event.Event("numba:compile", "start", {"dispatcher": _nearest})
    listener.on_start(compiled)
    listener.on_start(compiled)  # one that the first one calls
    listener.on_end(compiled)
    for _ in range(200):  # until the timer has shown it
        if "1/7" in out.getvalue():
            break
        time.sleep(0.05)
    assert "compile kernels" in out.getvalue()
    listener.on_end(compiled)
    assert "2/7" in out.getvalue()
    assert not listener.bar.live.is_started


def test_the_kernels_of_each_bundled_solver_are_counted() -> None:
    counts = json.loads(Path(tasks.__file__).with_name("kernels.json").read_text("utf-8"))
    declined = {"openlpt", "optv", "ddpiv", "mte_mart"}  # which have no small example here
    assert set(plugins.list_solvers()) - declined <= set(counts)


def test_shares_of_an_item_move_the_bar_forwards_only(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = progress._progress(refresh=False)
    monkeypatch.setattr(progress, "_progress", lambda **keys: shown)
    seen = []
    with progress.bar("render", 3) as advance:
        for share in (1.0, 0.5, 0.2, 1.0):
            advance() if share == 1.0 else progress.report_share(share)
            seen.append(shown.tasks[0].completed)
    assert seen == [1.0, 1.5, 1.5, 2.0]
    progress.report_share(0.5)  # there is no bar
