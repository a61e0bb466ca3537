"""The file that keeps an unfinished run: whole or not there, and refused if it is not as it was written."""

from __future__ import annotations

import json
from collections.abc import Iterable
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.arguments import argument
from bayesid.errors import InputError


def save_checkpoint(path: Path, mark: str, content: dict[str, Any]) -> None:
    """Write a checkpoint; an interruption, or a full disk, leaves the last one.

    ``mark`` says what run it belongs to; ``content`` holds ``kept``, the draws so far, and whatever else is needed to go on.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(path.name + ".part")
    rest = json.dumps({"mark": mark, **{key: value for key, value in content.items() if key != "kept"}}, default=_encode)
    try:
        with draft.open("wb") as file:
            np.savez(file, kept=content["kept"], rest=rest, digest=_digest(content["kept"], rest))
        draft.replace(path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


def load_checkpoint(path: Path, mark: str) -> dict[str, Any] | None:
    """Read a checkpoint, None where there is none; an `InputError` where it is damaged, changed, or of another run."""
    if not path.exists():
        return None
    try:
        with path.open("rb") as file, np.load(file) as stored:
            kept, rest, digest = stored["kept"], str(stored["rest"]), str(stored["digest"])
        content = {"kept": kept, **json.loads(rest, object_hook=_decode)} if digest == _digest(kept, rest) else None
    except Exception:  # zip, zlib, numpy and JSON each have errors of their own for a damaged file
        content = None
    remedy = f"leave out {argument('resume', True)} or delete it"
    if content is None:
        raise InputError("is damaged or was changed", file=str(path), remedy=remedy)
    if content["mark"] != mark:
        raise InputError("belongs to another run (data, model, draws or seed differ)", file=str(path), remedy=remedy)
    return content


def mark_of(arrays: Iterable[np.ndarray], settings: Any) -> str:
    """What a run depends on, arrays and whatever prints alike if it is the same, as a text to know it by."""
    digest = sha256(repr(settings).encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _digest(kept: np.ndarray, rest: str) -> str:
    return mark_of([kept], (kept.shape, kept.dtype.str, rest))


def _encode(value: Any) -> Any:
    """Arrays and generators as JSON; Python writes floats so that they come back the same."""
    if isinstance(value, np.ndarray):
        return {"array": value.tolist(), "type": value.dtype.str}
    if isinstance(value, np.random.Generator):
        return {"generator": value.bit_generator.state}
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(type(value))


def _decode(value: dict[str, Any]) -> Any:
    if value.keys() == {"array", "type"}:
        return np.array(value["array"], value["type"])
    if value.keys() == {"generator"}:
        generator = np.random.Generator(np.random.PCG64())
        generator.bit_generator.state = value["generator"]
        return generator
    return value
