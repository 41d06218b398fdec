"""Cinematic depth of field and motion blur by splatting sparse Laplacians of point spread functions.

Everything is loaded when it is first used, so that importing the package is fast and compiles nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
