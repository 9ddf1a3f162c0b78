"""Choice of the renderer."""

from __future__ import annotations

from typing import Literal

from sabench.utils import backend as compute
from sabench.utils.errors import InputError

Renderer = Literal["auto", "mitsuba", "splat"]


def choose_renderer(asked: Renderer) -> str:
    """Choose mitsuba or splat; "auto" takes splat where nothing runs Mitsuba."""
    if asked not in ("auto", "mitsuba", "splat"):
        raise InputError(f"backend: expected auto, mitsuba or splat, got {asked!r}")
    if asked == "splat":
        return asked
    try:
        compute.choose()
    except InputError:
        if asked == "mitsuba":
            raise
        return "splat"
    return "mitsuba"
