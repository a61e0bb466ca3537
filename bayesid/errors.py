"""Exceptions and warnings; each says what is wrong, where, and what to do about it."""

from __future__ import annotations

import importlib
from collections.abc import Collection, Iterable
from difflib import get_close_matches
from typing import Any


class BayesidError(Exception):
    """Root of every exception that bayesid raises on purpose."""


class InputError(BayesidError):
    """Bad input or usage; the message is one line: which file, which key or column, which value, what to do.

    Parameters
    ----------
    problem
        What is wrong, with the value; the whole message where nothing else is given.
    file, key
        Where: the file's name, and the key, column, element or option in it.
    value
        What stands there.
    remedy
        What to do about it.
    """

    def __init__(self, problem: str, *, file: str = "", key: str = "", value: object = None, remedy: str = ""):
        place = "".join(f"{part}: " for part in (file, key) if part)
        text = place + problem + (f"; {remedy}" if remedy else "")
        super().__init__(" ".join(text.split()) if "\n" in text else text)  # a value of several lines, such as an array
        self.file, self.key, self.value, self.remedy = file, key, value, remedy


def did_you_mean(word: str, known: Iterable[str], otherwise: str = "") -> str:
    """What to write instead of an unknown word: the nearest known one; where none is near, the list of them, or ``otherwise``."""
    known = list(known)
    close = get_close_matches(word, known, 1)
    return f"did you mean '{close[0]}'?" if close else otherwise or f"choose one of {', '.join(known)}"


def require_one_of(value: str, known: Collection[str], place: str) -> None:
    """Refuse what is none of the known words with an `InputError` that lists them, for ``place`` such as ``--channel x``."""
    if value not in known:
        raise InputError(f"{place}: choose one of {', '.join(known)}")


def required(module: str, missing: InputError) -> Any:
    """Import a module of an optional package, or raise what is to be said where it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise missing from None


class EstimationError(BayesidError):
    """The input was fine but the computation failed; the message says what usually causes that."""


class BayesidWarning(UserWarning):
    """Something in the data or the result that the user should know, but that stops nothing."""


def require_seed(seed: Any) -> None:
    """Refuse a seed that is no whole number of at least 0, with an `InputError`."""
    if not (hasattr(seed, "__index__") and not getattr(seed, "ndim", 0) and seed >= 0):
        raise InputError(f"seed = {seed}: give a whole number of at least 0")
