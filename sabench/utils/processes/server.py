"""Preparation of the server of child processes, which imports this last."""

import atexit
import os
import sys

if "numba" in sys.modules:
    from sabench.utils.compiled import load_registries

    load_registries()

# Children die with the server. An interpreter that has loaded numba and Mitsuba would take down
# what it holds first, for a second and more, while they go on computing for nobody.
atexit.register(os._exit, 0)
