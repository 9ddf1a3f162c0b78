"""Velocimetry: window correlation of volumes, and of images of a light sheet."""

import lazy_loader

# names and homes stand in the stub __init__.pyi, for type checkers too
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
