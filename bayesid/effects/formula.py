"""A formula in one line of text: checked against a list of what may stand in it, then evaluated, for arrays of samples.

Nothing of it is handed to the interpreter: the text is parsed, and only numbers, names, arithmetic and the functions listed
here are evaluated.

One function remembers: ``hysteresis(x, w)`` is the bristle of [Dahl1968]_, ``dz = (sign(dx) - z) |dx| / w``. It starts at zero,
goes to 1 as x has risen by a few widths w and to -1 as it has fallen. Poses of a static run do not follow one another: there
summands with the time or with what went before are zero.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bayesid.effects.friction import bent
from bayesid.errors import InputError


def hysteresis(x: np.ndarray | float, width: np.ndarray | float) -> np.ndarray:
    """Bristle that x (N,) drags along (N,), between -1 and 1; see the module."""
    return bent(np.diff(np.atleast_1d(np.asarray(x, float))), float(np.max(width)))


FUNCTIONS: dict[str, Callable] = {
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2,
    "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "exp": np.exp, "log": np.log, "sqrt": np.sqrt, "abs": np.abs,
    "sign": np.sign, "min": np.minimum, "max": np.maximum, "hysteresis": hysteresis,
}  # fmt: skip
#: Functions of what went before.
MEMORY = ("hysteresis",)
CONSTANTS = {"pi": math.pi, "e": math.e}
_PAIRS = ("atan2", "min", "max", "hysteresis")
_OPERATIONS: dict[type[ast.operator], Callable] = {
    ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide, ast.Pow: np.power,
}  # fmt: skip
_LONGEST, _DEEPEST = 1000, 40


@dataclass(frozen=True)
class Formula:
    """A formula that has been checked."""

    text: str  # as it was written
    tree: ast.expr  # its syntax tree
    names: frozenset[str]  # variables and parameters in it

    @classmethod
    @lru_cache(maxsize=4096)
    def parse(cls, text: str) -> Formula:
        """Check a text; an `InputError` where it is no formula, or has something in it that may not stand there."""
        if len(text) > _LONGEST:
            raise InputError(f"a formula of {len(text)} characters; write at most {_LONGEST}")
        try:
            tree = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise InputError(f"'{_shown(text)}' is no formula; write one like c * sin(3 * q2)") from None
        names: set[str] = set()
        _check(tree, names, 0)
        return cls(text, tree, frozenset(names))

    def __call__(self, values: Mapping[str, np.ndarray | float], *, course: bool = True) -> np.ndarray:
        """Its value with arrays (N,) or numbers for names; nan where it has none (a root of a negative number).

        Unless samples follow one another in a ``course`` of time, as in a static run they do not, summands with the time or
        with functions that remember are zero.
        """
        with np.errstate(all="ignore"):
            if course:
                return np.asarray(_value(self.tree, values), float)
            kept = [s * np.asarray(_value(node, values), float) for s, node in _summands(self.tree) if not _of_course(node)]
            return sum(kept, np.zeros(()))

    @property
    def remembers(self) -> bool:
        """Whether its value depends on what went before."""
        return any(_remembers(node) for node in ast.walk(self.tree))

    def degrees(self, names: Collection[str]) -> tuple[float, float]:
        """Least and largest degree in these names together: (1, 1) is linear, (0, 1) linear with a constant, inf neither."""
        return _degrees(self.tree, names)


def _shown(text: str) -> str:
    flat = " ".join(text.split())
    return flat if len(flat) <= 60 else flat[:57] + "..."


def _check(node: ast.expr, names: set[str], depth: int) -> None:
    if depth > _DEEPEST:
        raise InputError(f"a formula nested more than {_DEEPEST} deep; write it more simply")
    match node:
        case ast.Constant(value=bool() | complex() | str() | bytes() | None):
            raise InputError(f"{ast.unparse(node)} stands in a formula; only numbers can")
        case ast.Constant(value=value):
            if not isinstance(value, int | float) or abs(value) > 1e300:
                raise InputError("a number in a formula is too large, or none; write a finite one")
        case ast.Name(id=name):
            if name not in CONSTANTS:
                names.add(name)
        case ast.UnaryOp(op=ast.UAdd() | ast.USub(), operand=inner):
            _check(inner, names, depth + 1)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATIONS:
            _check(left, names, depth + 1)
            _check(right, names, depth + 1)
        case ast.Call(func=ast.Name(id=name), args=given, keywords=[]) if name in FUNCTIONS:
            wanted = 2 if name in _PAIRS else 1
            if len(given) != wanted:
                raise InputError(f"{name}(...) has {len(given)} arguments; give {wanted}")
            for each in given:
                _check(each, names, depth + 1)
        case ast.Call(func=ast.Name(id=name)):
            raise InputError(f"'{name}' is no function of formulas; known: {', '.join(FUNCTIONS)}")
        case _:
            raise InputError(
                f"'{_shown(ast.unparse(node))}' cannot stand in a formula; use numbers, names, + - * / ** and functions"
            )


def _value(node: ast.expr, values: Mapping[str, np.ndarray | float]) -> np.ndarray | float:
    match node:
        case ast.Constant(value=int() | float() as value):
            return float(value)
        case ast.Name(id=name):
            return CONSTANTS[name] if name in CONSTANTS else values[name]
        case ast.UnaryOp(op=op, operand=inner):
            return -_value(inner, values) if isinstance(op, ast.USub) else _value(inner, values)
        case ast.BinOp(left=left, op=op, right=right):
            return _OPERATIONS[type(op)](_value(left, values), _value(right, values))
        case ast.Call(func=ast.Name(id=name), args=given):
            return FUNCTIONS[name](*(_value(each, values) for each in given))
    raise AssertionError(ast.dump(node))


def _remembers(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in MEMORY


def _of_course(tree: ast.expr) -> bool:
    """Whether the time, or a function of what went before, stands in it."""
    return any(_remembers(node) or (isinstance(node, ast.Name) and node.id == "t") for node in ast.walk(tree))


def _summands(node: ast.expr) -> list[tuple[float, ast.expr]]:
    """Signs and what is added."""
    match node:
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as op, right=right):
            sign = -1.0 if isinstance(op, ast.Sub) else 1.0
            return [*_summands(left), *((sign * s, each) for s, each in _summands(right))]
        case ast.UnaryOp(op=op, operand=inner):
            sign = -1.0 if isinstance(op, ast.USub) else 1.0
            return [(sign * s, each) for s, each in _summands(inner)]
    return [(1.0, node)]


def _degrees(node: ast.expr, names: Collection[str]) -> tuple[float, float]:
    match node:
        case ast.Name(id=name):
            return (1.0, 1.0) if name in names else (0.0, 0.0)
        case ast.UnaryOp(operand=inner):
            return _degrees(inner, names)
        case ast.BinOp(left=left, op=op, right=right):
            (a, b), (c, d) = _degrees(left, names), _degrees(right, names)
            if isinstance(op, ast.Add | ast.Sub):
                return min(a, c), max(b, d)
            if isinstance(op, ast.Mult):
                return a + c, b + d
            if isinstance(op, ast.Div) and d == 0.0:
                return a, b
            return (0.0, 0.0) if b == d == 0.0 else (0.0, math.inf)
        case ast.Call(args=given):
            return (0.0, 0.0) if all(_degrees(each, names)[1] == 0.0 for each in given) else (0.0, math.inf)
    return (0.0, 0.0)
