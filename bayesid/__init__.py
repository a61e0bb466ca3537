"""Inertial parameters of a robot from a force/torque sensor under its base and from its joint torques.

The public names stand in ``__init__.pyi``; each is imported when it is first used, so that ``import bayesid`` is quick.
"""

import lazy_loader

from bayesid.signals.numba_cache import find_place

find_place()  # before anything imports numba
del find_place

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
