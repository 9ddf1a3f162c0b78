"""Physically based synthetic data and benchmarks for volumetric velocimetry."""

import lazy_loader

from sabench.utils.installed import lacking

# names and homes stand in the stub __init__.pyi, for type checkers too
_import, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """Import a public name; where a package lacks, say how to install it."""
    try:
        return _import(name)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(lacking(error) or str(error), name=error.name) from error
