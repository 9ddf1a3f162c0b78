"""Metrics: functions of an estimate and the truth, usable without a data set.

A name is imported from its module when it is first used, so that `import sabench.metrics` needs no
heavy library.
"""

import lazy_loader

# names and homes stand in the stub __init__.pyi, for type checkers too
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
