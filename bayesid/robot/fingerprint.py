"""A digest of what a frozen dataclass holds: a key for caches that says what a result depends on."""

from __future__ import annotations

from dataclasses import fields
from hashlib import blake2b
from typing import Any

import numpy as np


def fingerprint(holder: Any) -> bytes:
    """Digest (16 bytes) of all fields of a dataclass instance: the same for equal arrays and texts, wherever they are kept."""
    digest = blake2b(digest_size=16)
    for item in fields(holder):
        value = getattr(holder, item.name)
        if isinstance(value, np.ndarray):
            digest.update(repr((item.name, value.dtype.str, value.shape)).encode())
            digest.update(np.ascontiguousarray(value).tobytes())
        else:
            digest.update(repr((item.name, value)).encode())
    return digest.digest()
