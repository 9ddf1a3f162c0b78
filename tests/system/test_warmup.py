"""Kernels that were compiled in advance are there for later commands."""

from __future__ import annotations

import pytest

from sabench.tasks.conformance import warm_up
from sabench.utils.errors import InputError
from sabench.utils.kernel_folder import kernel_folder


def test_kernels_of_a_solver_are_stored() -> None:
    """The solver runs in a child process, which may write there."""
    (warmed,) = warm_up(["asa"])
    assert (warmed.solver, warmed.verdict) == ("asa", "obeyed")
    assert list(kernel_folder().rglob("cpu_kernels.*.nbc"))


def test_an_unknown_solver_is_refused_before_anything_is_compiled() -> None:
    with pytest.raises(InputError, match="nobody"):
        next(warm_up(["ray_triangulation", "nobody"]))
