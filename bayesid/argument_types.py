"""Which argument of a public function is of a wrong type, where that ends in an error somewhere inside."""

from __future__ import annotations

import collections.abc as abc
import functools
import inspect
import os
import sys
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from numbers import Real
from typing import Any, TypeVar

from bayesid.errors import InputError

_T = TypeVar("_T", bound=Callable[..., Any])
#: What such an argument ends in.
_INNER = (TypeError, AttributeError, ValueError, KeyError, IndexError)
_SHOWN = 60  # characters of a value in a message
_LOOKED_AT = 100  # parts of a sequence


def explains_types(public: _T) -> _T:
    """A public function or class that names the argument of a wrong type where one ends in an error inside, as an `InputError`.

    Types are those of the annotations. They are asked only then, so what works although it is of another type goes on working,
    and an error that no argument explains stays what it is.
    """
    if isinstance(public, type):
        # A class is one that is called: only how it is made is wrapped.
        setattr(public, "__init__", _explaining(public.__init__, public.__qualname__))  # noqa: B010
        return typing.cast(_T, public)
    return typing.cast(_T, _explaining(public, public.__qualname__))


def _explaining(function: Callable[..., Any], called: str) -> Callable[..., Any]:
    @functools.wraps(function)
    def explained(*args: Any, **kwargs: Any) -> Any:
        try:
            return function(*args, **kwargs)
        except _INNER as error:
            wrong = _wrong_argument(function, args, kwargs)
            if not wrong:
                raise
            raise InputError(f"{called}: {wrong}") from error

    return explained


def _wrong_argument(function: Callable[..., Any], args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> str:
    """Which argument is not of the type that the function says, and what to give; empty where all are."""
    function = inspect.unwrap(function)
    signature, known = inspect.signature(function), vars(sys.modules[function.__module__])
    try:
        given = signature.bind(*args, **kwargs).arguments
    except TypeError:  # one too many or too few, which Python says
        return ""
    for name, value in given.items():
        if name not in ("self", "cls") and (wrong := _wrong(name, value, _hint(signature.parameters[name].annotation, known))):
            return wrong
    return ""


def _hint(annotation: Any, known: Mapping[str, Any]) -> Any:
    """What an annotation stands for; anything where it is a name that only type checkers know."""
    if not isinstance(annotation, str):
        return Any if annotation is inspect.Parameter.empty else annotation
    try:
        return eval(annotation, dict(known))  # noqa: S307  the package's own text
    except (NameError, AttributeError, TypeError):
        return Any


def _wrong(name: str, value: Any, hint: Any) -> str:
    """What is wrong with an argument, or with a field of one that is made of fields; empty where nothing is."""
    if not _is(value, hint):
        return f"{name} = {_shown(value)}: give {_words(hint)}"
    parts = value if isinstance(value, (list, tuple)) else [value]
    for part in parts[:_LOOKED_AT]:
        if is_dataclass(part) and not isinstance(part, type) and type(part).__module__.startswith("bayesid."):
            known = vars(sys.modules[type(part).__module__])
            for field in fields(part):
                own = getattr(part, field.name, None)
                if not _is(own, _hint(field.type, known)):
                    return f"{type(part).__name__} {field.name} = {_shown(own)}: give {_words(_hint(field.type, known))}"
    return ""


def _is(value: Any, hint: Any) -> bool:
    """Whether a value is of a type, as far as that can be told."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return any(_is(value, one) for one in inner)
    if origin is typing.Literal:
        return isinstance(value, type(inner[0])) and value in inner
    if hint in (None, type(None)):
        return value is None
    if hint is float:
        return isinstance(value, Real) or (hasattr(value, "dtype") and _is_array(value) and not value.ndim)
    if hint is int:
        return hasattr(value, "__index__") and not getattr(value, "ndim", 0)
    if hint is bool:
        return type(value).__name__ in ("bool", "bool_")
    if getattr(hint, "__name__", "") == "Path":
        return isinstance(value, (str, os.PathLike))
    if getattr(hint, "__name__", "") == "ndarray":
        return hasattr(value, "__len__") and _is_array(value)
    kind = origin or hint
    if not isinstance(kind, type) or kind in (object, Any):  # which Python 3.11 makes a class
        return True
    if kind is abc.Callable:
        return callable(value)
    if issubclass(kind, abc.Mapping):
        return isinstance(value, abc.Mapping) and all(_is(part, inner[1]) for part in value.values() if len(inner) == 2)
    if origin is not None and issubclass(kind, abc.Iterable):
        if isinstance(value, (str, bytes, abc.Mapping)) or not isinstance(value, abc.Iterable) or hasattr(value, "columns"):
            return False
        if not isinstance(value, abc.Sized) or not inner:  # an iterator is not used up
            return not issubclass(kind, abc.Sized)
        each = inner if kind is tuple and Ellipsis not in inner else None
        parts = list(value)[: len(each) if each else _LOOKED_AT]
        return (each is None or len(value) == len(each)) and all(map(_is, parts, each or [inner[0]] * len(parts)))
    if getattr(kind, "_is_protocol", False):
        return all(hasattr(value, name) for name in {*vars(kind), *kind.__annotations__} if not name.startswith("_"))
    return isinstance(value, kind)


def _is_array(value: Any) -> bool:
    """Whether a value is, or can be made, an array of numbers."""
    import numpy as np  # most that is imported first needs none

    try:
        return not isinstance(value, (str, bytes)) and np.asarray(value, float) is not None
    except (TypeError, ValueError):
        return False


def _shown(value: Any) -> str:
    """A value in a message: in full where it is short, else what it is."""
    text = repr(value)
    if hasattr(value, "shape"):
        return f"{'a DataFrame' if hasattr(value, 'columns') else 'an array'} of shape {tuple(value.shape)}"
    plain = isinstance(value, (str, int, float, os.PathLike, list, tuple, dict, type(None)))
    return text if plain and len(text) <= _SHOWN and "\n" not in text else _with_article(type(value).__name__)


def _words(hint: Any) -> str:
    """A type in words, as of what to give."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(dict.fromkeys(_words(one) for one in inner if one is not type(None)))
    if origin is typing.Literal:
        return " or ".join(f'"{value}"' if isinstance(value, str) else str(value) for value in inner)
    plain = {str: "a text", float: "a number", int: "a whole number", bool: "True or False", abc.Callable: "a function"}
    if hint in plain or origin in plain:
        return plain[hint if hint in plain else origin]
    name = getattr(origin or hint, "__name__", str(hint))
    if name == "ndarray":
        return "an array of numbers"
    if name == "Path":
        return "a path"
    if inner and isinstance(origin, type) and issubclass(origin, abc.Mapping):
        return f"a dict that holds {_words(inner[-1])} by name"
    if inner and isinstance(origin, type) and issubclass(origin, abc.Iterable):
        count = f"{len(inner)} " if origin is tuple and Ellipsis not in inner else ""
        return f"a list of {count}{' and '.join(dict.fromkeys(_several(one) for one in inner if one is not Ellipsis))}"
    return f"a bayesid.{name}" if getattr(hint, "__module__", "").startswith("bayesid.") else _with_article(name)


def _several(hint: Any) -> str:
    """Values of a type in words."""
    words = _words(hint)
    if words in ("a text", "a number", "a whole number"):
        return f"{words.removeprefix('a ')}s"
    return words.replace("a list", "lists") if words.startswith("a list") else f"{words.removeprefix('a ')} objects"


def _with_article(name: str) -> str:
    return f"{'an' if name[:1].lower() in 'aeiou' else 'a'} {name}"
