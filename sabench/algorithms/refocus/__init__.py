"""Synthetic aperture refocusing: images joined on planes and other surfaces."""

import lazy_loader

# names and homes stand in the stub __init__.pyi, for type checkers too
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
