"""Effects beyond rigid bodies: one class an effect, what it does to a reading, exactly, and its derivatives.

The names stand in ``__init__.pyi``; each is imported when it is first used, so that a library of effects costs nothing until
an effect is asked for.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
