"""Effects that a user writes as formulas, in ``[model.expressions.NAME]`` of experiment.toml or model.toml.

``tau2 = "c * sin(3 * q2)"`` adds ``c sin(3 q2)`` to what the second joint's torque is read as; ``tau = "c * sin(3 * q)"`` is the
same for whichever joint, each with its own ``c``. Formulas for ``fx`` ... ``mz`` add to the wrench that the sensor reads.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from math import inf
from typing import Any, ClassVar

import numpy as np

from bayesid.arguments import argument
from bayesid.dynamics.channels import WRENCH_NAMES
from bayesid.effects.effect import Parameter
from bayesid.effects.families import ReadingEffect, Readout
from bayesid.effects.formula import CONSTANTS, FUNCTIONS, Formula
from bayesid.effects.segment import direction
from bayesid.errors import InputError

#: What a joint has: position, velocity, acceleration, the torque that moves and carries the links, direction of the motion.
JOINT_VARIABLES = ("q", "v", "a", "tau", "dir")
_OF_JOINT = re.compile(r"(q|v|a|tau|dir)([1-9][0-9]{0,3})?")
_READING = re.compile(r"tau([1-9][0-9]{0,3})?|[fm][xyz]")


class ExpressionEffect(ReadingEffect):
    """Formulas on top of readings; `expression_effect` makes a class of them."""

    #: By the reading that they add to: ``tau`` (of the effect's own joint), ``tau1`` ..., ``fx`` ... ``mz``.
    formulas: ClassVar[dict[str, Formula]] = {}
    table: ClassVar[dict[str, Any]] = {}  # as it stands in the file

    def added(self, readout: Readout, values: Sequence[float]) -> np.ndarray:
        """What the formulas say (N, c)."""
        out = np.zeros((len(readout.segment.times), len(readout.names)))
        for channel, formula in self._read(readout):
            out[:, channel] += formula(self._variables(formula, readout, values), course=not readout.segment.still)
        return out

    def tangent(self, readout: Readout, values: Sequence[float], change: np.ndarray) -> np.ndarray | None:
        """Derivatives by central differences of the formulas that have true readings in them (N, c, k)."""
        out = np.zeros_like(change)
        for channel, formula in self._read(readout):
            given = self._variables(formula, readout, values)
            for name in _true_names(formula):
                own = readout.names.index(self._full(name))
                at = np.asarray(given[name])
                step = 1e-6 * max(float(np.abs(at).max(initial=0.0)), 1.0)
                course = not readout.segment.still
                ends = [formula({**given, name: at + s * step}, course=course) for s in (1.0, -1.0)]
                slope = np.broadcast_to((ends[0] - ends[1]) / (2.0 * step), at.shape)
                out[:, channel] += slope[:, None] * change[:, own]
        return out if any(_true_names(f) for f in self.formulas.values()) else None

    @property
    def from_motion_alone(self) -> bool:
        """Where the formulas are linear in all parameters, have no true reading in them and remember nothing."""
        names, formulas = self.parameters, self.formulas.values()
        return all(f.degrees(names) == (1.0, 1.0) and not _true_names(f) and not f.remembers for f in formulas)

    def reach(self, values, bandwidth, step):
        """All of a recording, where a formula remembers what went before."""
        return 1e9 if any(f.remembers for f in self.formulas.values()) else 0.0

    def motion_columns(self, segment, channels):
        """Derivatives of the readings with respect to the parameters (N, channels, k)."""
        q, v, a = segment.positions, segment.velocities, segment.accelerations
        readout = Readout(tuple(channels), segment, q, v, a, np.zeros((len(segment.times), len(channels))))
        out = np.stack([self.added(readout, tuple(unit)) for unit in np.eye(len(self.parameters))], axis=-1)
        if not np.isfinite(out).all():
            raise InputError(f"effect '{self.name}': the formula has no finite value somewhere in this motion; mend it")
        return out

    def _full(self, name: str) -> str:
        """``tau`` of the effect's own joint as ``tau2``."""
        return f"{name}{(self.joint or 0) + 1}" if name in JOINT_VARIABLES else name

    def _read(self, readout: Readout) -> list[tuple[int, Formula]]:
        """Formulas with the channels that they add to, where these are read."""
        full = {self._full(name): formula for name, formula in self.formulas.items()}
        return [(readout.names.index(name), formula) for name, formula in full.items() if name in readout.names]

    def _variables(self, formula: Formula, readout: Readout, values: Sequence[float]) -> dict[str, np.ndarray | float]:
        out: dict[str, np.ndarray | float] = {}
        for name in formula.names:
            if name in self.parameters:
                out[name] = values[self.parameters.index(name)]
            else:
                full = self._full(name)
                if _is_reading(full) and full not in readout.names:
                    raise InputError(
                        f"effect '{self.name}': {full} is not among the readings used; choose another {argument('channel')}"
                    )
                out[name] = variable(readout, full)
        return out


def variable(readout: Readout, name: str) -> np.ndarray:
    """What a variable of formulas is (N,); joints by number, readings among those that there are."""
    if name == "t":
        return readout.segment.times
    if _is_reading(name):
        return readout.true[:, readout.names.index(name)]
    kind = name.rstrip("0123456789")
    number = name.removeprefix(kind)
    q, v, a = (x[:, int(number) - 1] for x in (readout.positions, readout.velocities, readout.accelerations))
    return {"q": q, "v": v, "a": a}[kind] if kind != "dir" else direction(v, a, readout.segment.cell)


def variables(readout: Readout) -> dict[str, np.ndarray]:
    """All that formulas may name of a readout, each (N,)."""
    joints = range(1, readout.positions.shape[1] + 1)
    names = ["t", *readout.names, *(f"{kind}{j}" for kind in ("q", "v", "a", "dir") for j in joints)]
    return {name: variable(readout, name) for name in names}


def _is_reading(name: str) -> bool:
    return name in WRENCH_NAMES or name.startswith("tau")


def expression_effect(name: str, table: Mapping[str, Any], joints: int, source: str) -> type[ExpressionEffect]:
    """A class from one ``[model.expressions.NAME]``; an `InputError` says which formula, reading or parameter cannot be.

    ``table`` holds formulas by reading, ``parameters`` (each with ``unit``, ``lower``, ``upper``, ``start``, ``typical``,
    ``tried``) and ``summary``; ``source`` is the file, for messages.
    """
    if not name.isidentifier():
        raise InputError(f"{source}: [model.expressions] {name!r}: write a name of letters, digits and underscores")
    place = f"{source}: [model.expressions.{name}]"
    formulas: dict[str, Formula] = {}
    for reading, text in table.items():
        if reading in ("parameters", "summary"):
            continue
        match = _READING.fullmatch(reading)
        if match is None or int(match[1] or 1) > joints:
            raise InputError(f"{place} {reading}: no such reading; write tau, tau1 ... tau{joints}, or fx ... mz")
        try:
            formulas[reading] = Formula.parse(str(text))
        except InputError as error:
            raise InputError(f"{place} {reading}: {error}") from None
    if not formulas:
        raise InputError(f'{place}: has no formula; write one, as in tau2 = "c * sin(3 * q2)"')
    if "tau" in formulas and len(formulas) > 1:
        raise InputError(f"{place}: tau stands for every joint by itself; give the other readings an effect of their own")
    stated = dict(table.get("parameters", {}))
    for key in stated:
        if not key.isidentifier() or key in CONSTANTS or key in FUNCTIONS or _is_variable(key, "tau" in formulas):
            raise InputError(f"{place} parameters: '{key}' means something else in a formula; call the parameter otherwise")
    for reading, formula in formulas.items():
        _check_names(formula, reading, stated, joints, f"{place} {reading}")
    unused = [key for key in stated if not any(key in f.names for f in formulas.values())]
    if unused:
        raise InputError(f"{place} parameters: {unused[0]} stands in no formula; use it or remove it")
    if not stated:
        raise InputError(f'{place}: has no parameters; name the numbers to be estimated, as in parameters.c = {{ unit = "N m" }}')
    linear = _linear(list(stated), formulas.values())
    torque = [r for r in formulas if r.startswith("tau")]
    own_joint = len(formulas) == len(torque) == 1
    number = torque[0].removeprefix("tau") if own_joint else ""
    said = " and ".join(f"{reading} + {f.text.strip()}" for reading, f in formulas.items())
    body = {
        "name": name,
        "__doc__": f"{said}, from {source}.",
        "channels": tuple(c for c, there in (("wrench", len(torque) < len(formulas)), ("torque", torque)) if there),
        "at": "joint" if own_joint else "robot" if torque else "sensor",
        "only_joint": int(number) - 1 if number else None,
        "quantities": tuple(_parameter(key, given, key in linear, place) for key, given in stated.items()),
        "summary": table.get("summary", f"reads {said}"),
        "equation": f"`{said}`",
        "source": f"`{source}`",
        "formulas": formulas,
        "table": {**table},
    }
    return type(name, (ExpressionEffect,), body)


def _parameter(key: str, given: Mapping[str, Any], linear: bool, place: str) -> Parameter:
    tried = tuple(float(v) for v in given.get("tried", ()))
    start = given.get("start", 0.0 if linear else tried[0] if tried else None)
    if start is None:
        raise InputError(f"{place} parameters.{key}: the formula is not linear in it; give a start, or values to be tried")
    lower, upper = float(given.get("lower", -inf)), float(given.get("upper", inf))
    if not lower < upper or not all(lower <= v <= upper for v in (start, *tried)):
        raise InputError(f"{place} parameters.{key}: start and tried have to lie between lower and upper")
    typical = given.get("typical", start or 1.0)
    step = 1e-4 * max(abs(float(start)), 1e-3) if not linear and start else 1e-4
    return Parameter(key, given.get("unit", "1"), lower, upper, float(start), float(typical), linear, step, tried)


def _linear(parameters: Sequence[str], formulas) -> set[str]:
    """Parameters that every formula is linear in, together; of two that are multiplied, the first."""
    out: set[str] = set()
    for key in parameters:
        if all(f.degrees({*out, key})[1] <= 1.0 for f in formulas):
            out.add(key)
    return out


def _true_names(formula: Formula) -> list[str]:
    """True readings in a formula."""
    return sorted(n for n in formula.names if n in WRENCH_NAMES or re.fullmatch(r"tau[0-9]*", n))


def _is_variable(name: str, of_own_joint: bool) -> bool:
    """Whether a name is a variable; ``q``, ``v`` and ``a`` without a number are only where the formula is for each joint."""
    return name == "t" or name in WRENCH_NAMES or (_OF_JOINT.fullmatch(name) is not None and (of_own_joint or name not in "qva"))


def _check_names(formula: Formula, reading: str, parameters: Mapping[str, Any], joints: int, place: str) -> None:
    """Refuse names that mean nothing there."""
    for name in sorted(formula.names - set(parameters)):
        match = _OF_JOINT.fullmatch(name)
        if name == "t" or (name in WRENCH_NAMES and reading in WRENCH_NAMES):
            continue
        if name in WRENCH_NAMES or (match and match[1] == "tau" and reading in WRENCH_NAMES):
            raise InputError(f"{place}: {name} is not known there; a torque's formula may use tau, a wrench's fx ... mz")
        if match and match[2] is None and reading != "tau":
            raise InputError(f"{place}: of which joint is {name}? write {name}1 ... {name}{joints}, or the formula for tau")
        if match and int(match[2] or 1) > joints:
            raise InputError(f"{place}: {name}, but the robot has {joints} joints")
        if not match:
            known = [*parameters, "t", *JOINT_VARIABLES, *(f"{x}1" for x in JOINT_VARIABLES), *FUNCTIONS, *CONSTANTS]
            near = get_close_matches(name, known, 1)
            hint = f"did you mean {near[0]}?" if near else f"if it is a parameter, add parameters.{name} = {{ unit = ... }}"
            raise InputError(f"{place}: '{name}' is not known; {hint}")
