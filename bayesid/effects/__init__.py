"""Effects beyond rigid bodies: one class an effect, what it does to a reading, exactly, and its derivatives.

The names stand in ``__init__.pyi``; each is imported when it is first used, so that a library of effects costs nothing until
an effect is asked for.
"""

import copyreg
import importlib
import sys

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# lazy_loader gives this module a class of its own, and functions of a user's script that refer to it are sent to workers with it.
copyreg.pickle(type(sys.modules[__name__]), lambda module: (importlib.import_module, (module.__name__,)))
