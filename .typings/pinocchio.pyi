# Pinocchio is a compiled module without annotations, found through a .pth file: every name is accepted.
from typing import Any

def __getattr__(name: str) -> Any: ...
