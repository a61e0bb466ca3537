"""Inertial parameters of a robot from a force/torque sensor under its base and from its joint torques.

The public names stand in ``__init__.pyi``; each is imported when it is first used, so that ``import bayesid`` is quick.
"""

import lazy_loader

from bayesid.signals.numba_cache import find_place

find_place()  # before anything imports numba
del find_place

_found, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """A public name, imported now; the version is that of the installed package, from its tag."""
    if name == "__version__":
        from importlib.metadata import version

        return version("bayesid")
    return _found(name)
