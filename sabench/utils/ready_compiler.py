"""The tables of numba's compiler, filled in when this module is imported.

Every process fills them in before it compiles or loads its first kernel, which takes a fifth of a
second. A server that imports this module does it once for all processes that it forks.
"""

from numba.core.registry import cpu_target

cpu_target.typing_context.refresh()
cpu_target.target_context.refresh()
