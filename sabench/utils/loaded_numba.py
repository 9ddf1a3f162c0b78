"""Import of numba's registries, once for all child processes of a server."""

from sabench.utils.compile_clock import load_registries

load_registries()
