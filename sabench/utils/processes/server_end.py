"""End of the server of child processes, at once when its client has ended.

The server loads this module last. Its children die with it: an interpreter that has loaded numba
and Mitsuba would take down what it holds first, for a second and more, while they go on computing
for nobody.
"""

import atexit
import os

atexit.register(os._exit, 0)
