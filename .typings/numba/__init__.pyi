# What this package uses of numba, whose own annotations lose that a compiled function can be called.
from collections.abc import Callable
from typing import Any, TypeVar

_R = TypeVar("_R")

def njit(**options: Any) -> Callable[[Callable[..., _R]], Callable[..., _R]]: ...
