"""Help pages without the types of flags."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand, TyperGroup


def _tidy(params: list[Any]) -> list[Any]:
    """Show nothing for the value of a flag, which has none."""
    for param in params:
        if getattr(param, "is_flag", False):
            param.metavar = ""
    return params


class Command(TyperCommand):
    """A subcommand."""

    def get_params(self, ctx: Any) -> list[Any]:
        """List the arguments and options."""
        return _tidy(super().get_params(ctx))


class Group(TyperGroup):
    """The command itself."""

    def get_params(self, ctx: Any) -> list[Any]:
        """List the options."""
        return _tidy(super().get_params(ctx))
