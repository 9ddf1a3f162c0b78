"""Particles in three dimensions.

The package holds triangulation of image peaks, reconstruction of the most probable particles
(Bayesian IPR), tracking (Shake-The-Box), and linking.
"""

import lazy_loader

# names and homes stand in the stub __init__.pyi, for type checkers too
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
