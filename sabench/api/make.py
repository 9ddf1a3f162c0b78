"""Construction of plug-ins by name, with checked parameters."""

from typing import Any

from sabench import plugins
from sabench.api.solvers import AnySolver, SequenceSolver, Solver
from sabench.utils.errors import InputError
from sabench.utils.validation import validate


def generator_of(given: dict[str, Any]) -> Any:
    """Make the generator that a table of a scene names.

    Raises InputError for an unknown generator, or parameters that it does not take, as in a data
    set's own scene.
    """
    rest = dict(given)
    name = rest.pop("generator", None)
    if not isinstance(name, str):
        raise InputError(f"generator: expected the name of a generator, got {name!r}")
    plugin = plugins.load("generators", name)
    return plugin(validate(plugin.Parameters, rest, f"generator {name}"))


def make_algorithm(name: str, parameters: dict[str, Any]) -> AnySolver:
    """Make a solver of any task, with checked parameters."""
    plugin = plugins.load("solvers", name)
    solver: AnySolver = plugin(validate(plugin.Parameters, parameters, f"solver {name}"))
    return solver


def make_solver(name: str, parameters: dict[str, Any]) -> Solver:
    """Make a reconstruction solver of single frames with checked parameters."""
    solver = make_reconstruction_solver(name, parameters)
    if isinstance(solver, SequenceSolver):
        raise InputError(
            f"solver {name}: expected a solver of single frames, got one of image sequences"
        )
    return solver


def make_reconstruction_solver(name: str, parameters: dict[str, Any]) -> Solver | SequenceSolver:
    """Make a reconstruction solver, of single frames or of image sequences."""
    solver = make_algorithm(name, parameters)
    if not isinstance(solver, Solver | SequenceSolver):
        raise InputError(
            f"solver {name}: expected a solver of the task reconstruction, got one of {solver.task}"
        )
    return solver
