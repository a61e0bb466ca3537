"""Which effects there are: those that come with the package, those of installed packages, and the user's own.

Names, places and signs are those of the experiment format.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property, lru_cache
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesid.argument_types import explains_types
from bayesid.arguments import argument
from bayesid.dynamics.channels import WRENCH_NAMES
from bayesid.errors import InputError
from bayesid.robot.robot import joint_index

if TYPE_CHECKING:
    from bayesid.effects.effect import Effect

#: Other packages register a class of theirs under this group.
ENTRY_POINTS = "bayesid.effects"
#: As many joints as a formula can number.
ANY_JOINTS = 9999
#: The name of the module of a file of effects is this and the path of its file as hexadecimal digits.
MODULE = "_bayesid_effects_"
_PLACES = ("sensor", "axis", "axis->axis", "base", "joint", "joint->joint", "robot", "joint|robot")


class _EffectFiles(MetaPathFinder):
    """Finds the files of effects by the names of their modules, so that a pickled effect finds its class in another process."""

    def find_spec(self, fullname, path=None, target=None):
        if not fullname.startswith(MODULE):
            return None
        return spec_from_file_location(fullname, bytes.fromhex(fullname.removeprefix(MODULE)).decode())


sys.meta_path.append(_EffectFiles())


@dataclass(frozen=True)
class EffectLibrary:
    """Effects by name. An experiment holds one; nothing is registered anywhere else.

    Attributes
    ----------
    own
        The user's classes, beside those of the package and of installed packages.
    sliding
        Indices of the robot's joints that slide.
    """

    own: tuple[type[Effect], ...] = ()
    sliding: tuple[int, ...] = ()

    @cached_property
    def classes(self) -> dict[str, type[Effect]]:
        """Every class by name: the package's in their order, then others."""
        return {c.name: c for c in (*_installed(), *self.own)}

    def with_classes(self, classes: Iterable[type[Effect]], source: str) -> EffectLibrary:
        """A library with more classes.

        Parameters
        ----------
        classes
            Subclasses of `bayesid.effects.Effect`.
        source
            Where they come from, for messages.

        Raises
        ------
        InputError
            A class is incomplete, or its name is taken.
        """
        added = tuple(classes)
        for c in added:
            _check(c, source)
        names = [*self.classes, *(c.name for c in added)]
        for c in added:
            if names.count(c.name) > 1:
                raise InputError(f"{source}: an effect is called '{c.name}' already; give it another name")
        return replace(self, own=(*self.own, *added))

    @property
    def expressions(self) -> dict[str, dict[str, Any]]:
        """The user's formulas, ``[model.expressions]``, by the effect's name."""
        return {c.name: table for c in self.own if (table := getattr(c, "table", None)) is not None}

    def with_expressions(self, tables: Mapping[str, Mapping[str, Any]], joints: int | None, source: str) -> EffectLibrary:
        """A library with the effects of ``[model.expressions]``; they take the place of formulas of the same name.

        Tables are by the effect's name, see `bayesid.effects.expressions.expression_effect`; ``joints`` is how many the robot has
        (None: not known yet, see `for_robot`), and ``source`` the file, for messages. An `InputError` where a formula, reading or
        parameter cannot be, or a name is taken.
        """
        if not tables:
            return self
        from bayesid.effects.expressions import expression_effect

        known = ANY_JOINTS if joints is None else joints
        classes = [expression_effect(name, table, known, source) for name, table in tables.items()]
        others = tuple(c for c in self.own if not (c.name in tables and hasattr(c, "table")))
        return replace(self, own=others).with_classes(classes, source)

    def for_robot(self, joints: int, sliding: Iterable[int] = ()) -> EffectLibrary:
        """The library with all formulas checked against a robot with so many joints, some of which slide (their indices).

        An `InputError` where a formula names a joint that the robot does not have.
        """
        out = replace(self, sliding=tuple(sliding))
        for name, table in self.expressions.items():
            out = out.with_expressions({name: table}, joints, self.classes[name].source.strip("`"))
        return out

    def named(self, name: str, spec: str | None = None, fault: str = "no effect is called '{}'") -> type[Effect]:
        """The class of this name; an `InputError` that names the nearest one where there is none."""
        if name in self.classes:
            return self.classes[name]
        words = {word: c for c in reversed(list(self.classes)) for word in c.split("_")}
        close = get_close_matches(name, self.classes, 1) or [words[w] for w in get_close_matches(name, words, 1)]
        hint = f"did you mean '{close[0]}'?" if close else f"known: {', '.join(self.classes)}"
        raise InputError(f"effect '{spec or name}': {fault.format(name)}; {hint}")

    def places(
        self, name: str, joint_names: Sequence[str], channels: Sequence[str], gear_ratio: Mapping[str, float] | None = None
    ) -> tuple[Effect, ...]:
        """All effects of the class of a name that can change one of the channels, by their names, and be predicted in them.

        Joints have the URDF's names, in the order of q1 ... qn; gear ratios are by these.
        """
        acting = self._acting(name, joint_names, channels, gear_ratio)
        return tuple(e for e in acting if e.predictable(channels))

    def _acting(
        self, name: str, joint_names: Sequence[str], channels: Sequence[str], gear_ratio: Mapping[str, float] | None
    ) -> tuple[Effect, ...]:
        """All effects of the class of a name that can change one of the channels."""
        c = self.classes[name]
        if not any(c.acts_on(channel) for channel in channels):
            return ()
        ratios = gear_ratio or {}
        out: list[Effect] = []
        if c.at == "axis":
            out = [c(axis, axes=(k,)) for k, axis in enumerate(WRENCH_NAMES)]
        elif c.at == "axis->axis":
            pairs = [(i, k) for i in range(6) for k in range(6) if i != k]
            out = [c(f"{WRENCH_NAMES[i]}->{WRENCH_NAMES[k]}", axes=(i, k)) for i, k in pairs]
        elif c.at == "joint->joint":
            # A motor sits nearer to the base than its joint; what moves between the two are joints before it.
            pairs = [(i, k) for k in range(len(joint_names)) for i in range(k)]
            out = [c(f"joint{i + 1}->joint{k + 1}", k, driver=i, slides=k in self.sliding) for i, k in pairs]
        elif c.at.startswith("joint"):
            for i, joint in enumerate(joint_names):
                if c.channels == ("torque",) and f"tau{i + 1}" not in channels:
                    continue
                if c.only_joint is not None and c.only_joint != i:
                    continue
                by_place = None if f"joint{i + 1}" in joint_names else ratios.get(f"joint{i + 1}")
                ratio = ratios.get(joint, by_place) if c.needs_gear_ratio else None
                out.append(c(f"joint{i + 1}", i, ratio=ratio, slides=i in self.sliding))
            if c.at == "joint|robot":
                out.append(c("robot"))
        else:
            out = [c(c.at)]
        return tuple(out)

    def parse(
        self,
        specs: Sequence[str],
        joint_names: Sequence[str],
        channels: Sequence[str],
        gear_ratio: Mapping[str, float] | None = None,
    ) -> tuple[Effect, ...]:
        """Effects from their specifications, those that act on the given channels; the rest is as for `places`.

        Each is ``name``, which means everywhere, or ``name@where``, where ``joint1`` ... ``jointn`` are understood beside the
        URDF's names. An `InputError` where a name or place is unknown.
        """
        effects: dict[str, Effect] = {}
        for spec in specs:
            name, _, where = spec.partition("@")
            c = self.named(name, spec)
            everything = (*WRENCH_NAMES, *(f"tau{i + 1}" for i in range(len(joint_names))))
            everywhere = self._acting(name, joint_names, everything, gear_ratio)
            found = [e for e in everywhere if where in ("", e.where)]
            found = found or [e for e in everywhere if e.spec == by_number(spec, joint_names)]
            if not found:
                raise InputError(f"effect '{spec}': {_where_else(c, where, len(joint_names))}")
            if not where and c.at == "joint|robot":
                found = [e for e in found if e.joint is not None]
            seen = {e.spec for e in self._acting(name, joint_names, channels, gear_ratio)}
            effects |= {e.spec: e for e in found if e.spec in seen and e.spec not in effects}
        return tuple(effects.values())

    def parse_rivals(
        self, specs: Sequence[str], known: Collection[str], joint_names: Sequence[str], channels: Sequence[str],
        gear_ratio: Mapping[str, float], channel: str,
    ) -> tuple[Effect, ...]:  # fmt: skip
        """Effects to be told apart from their specifications, as in `parse`: ``name@where``, or ``name`` of one place.

        ``known`` are specifications of the model's effects, and ``channel`` is what the channels are called together, for
        messages. An `InputError` where there are fewer than two, a name or place is unknown, there are several places, or an
        effect is in the model or acts on no reading.
        """
        rivals: dict[str, Effect] = {}
        for spec in specs:
            try:
                found = self.parse([spec], joint_names, channels, gear_ratio)
            except InputError as error:
                raise InputError(f"{argument('tell')}: {error}") from None
            if not found:
                raise InputError(
                    f"{argument('tell', spec)}: acts on no reading of {argument('channel', channel)}; name another or choose "
                    "its channel"
                )
            if len(found) > 1:
                places = ", ".join([e.spec for e in found][:3])
                raise InputError(f"{argument('tell', spec)}: could be at {len(found)} places; name one, as in {places}")
            effect = next(iter(found))
            if effect.spec in known:
                raise InputError(
                    f"{argument('tell', spec)}: is in the model already; take it out of [model] effects to tell it from others"
                )
            rivals.setdefault(effect.spec, effect)
        if len(rivals) < 2:
            raise InputError(
                f"{argument('tell', specs)}: give at least two different effects, as in "
                f"{argument('tell', ('sensor_delay', 'base_tilt'))}"
            )
        return tuple(rivals.values())


def by_number(spec: str, joints: Sequence[str]) -> str:
    """``tether@joint3`` for ``tether@elbow``, where that is the third joint."""
    name, at, where = spec.partition("@")
    places = ((w, joint_index(w, joints)) for w in where.split("->"))
    return name + at + "->".join(w if k is None else f"joint{k + 1}" for w, k in places)


@lru_cache(maxsize=1)
def _installed() -> tuple[type[Effect], ...]:
    """The package's classes and those that installed packages register; constant as long as the interpreter runs."""
    classes = import_module("bayesid.effects.built_in").CLASSES
    taken = {c.name for c in classes}
    for point in sorted(entry_points(group=ENTRY_POINTS), key=lambda p: p.name):
        source = f"entry point {ENTRY_POINTS}:{point.name}"
        try:
            found = point.load()
        except Exception as error:
            raise InputError(f"{source}: {type(error).__name__}: {error}; mend or uninstall {point.value}") from error
        _check(found, source)
        if found.name in taken:
            raise InputError(f"{source}: an effect is called '{found.name}' already; give it another name")
        taken.add(found.name)
        classes = (*classes, found)
    return classes


def _check(c: type[Effect], source: str) -> None:
    """Refuse a class that others could not ask what they need to know."""
    from bayesid.effects.effect import Effect

    if not (isinstance(c, type) and issubclass(c, Effect)):
        raise InputError(f"{source}: {c!r} is no effect; derive a class from one of bayesid.effects, such as JointTorqueEffect")
    who = f"{source}: effect '{c.name or c.__name__}'"
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", c.name):
        raise InputError(f"{who}: name = {c.name!r}; write a name of letters, digits and underscores")
    if c.at not in _PLACES:
        raise InputError(f"{who}: at = {c.at!r}; write one of {', '.join(_PLACES)}")
    if missing := _missing(c):
        raise InputError(f"{who}: has no method {', '.join(missing)}; write it, as the docstring of its base class says")
    if not c.channels or not set(c.channels) <= {"wrench", "torque"}:
        raise InputError(f"{who}: channels = {c.channels!r}; write ('wrench',), ('torque',) or both")
    if not c.quantities or len(set(c.parameters)) < len(c.parameters):
        raise InputError(f"{who}: give it at least one Parameter in `quantities`, each with its own name")
    for p in c.quantities:
        if p.name == "fixed" or not p.name.isidentifier():
            raise InputError(f"{who}: a parameter is called {p.name!r}; write an identifier, and not 'fixed'")
        if not p.lower <= p.start <= p.upper:
            raise InputError(f"{who}: {p.name} starts at {p.start:g}, outside {p.lower:g} ... {p.upper:g}; give a start inside")


def _missing(c: type[Effect]) -> list[str]:
    """Methods that a class must have and has not: its family's, and those that what it says of itself asks for."""
    from bayesid.effects.effect import Effect

    out = sorted(c.__abstractmethods__)
    if c.harmonics and c.from_harmonic is Effect.from_harmonic:
        out.append("from_harmonic")
    if c.from_motion_alone is not Effect.from_motion_alone and c.motion_columns is Effect.motion_columns:
        out.append("motion_columns")
    return out


def _where_else(c: type[Effect], where: str, joints: int) -> str:
    known = f"joint1 to joint{joints} or a URDF joint name"
    if c.only_joint is not None and (not where or where.startswith("joint")):
        return f"'{c.name}' is at joint{c.only_joint + 1} only; write '{c.name}'"
    return {
        "sensor": f"'{c.name}' acts at the sensor; write '{c.name}'",
        "base": f"'{c.name}' acts at the base; write '{c.name}'",
        "robot": f"'{c.name}' acts on the whole robot; write '{c.name}'",
        "axis": f"no axis '{where}'; write one of {', '.join(WRENCH_NAMES)}",
        "axis->axis": f"no pair of axes '{where}'; write the source and the axis that reads it, as in fx->mz",
        "joint->joint": f"no pair of joints '{where}'; write the joint that moves and, after it in the chain, that whose motor "
        "turns with it, as in joint5->joint6",
        "joint": f"no joint '{where}'; write {known}",
        "joint|robot": f"no joint '{where}'; write {known}, or robot",
    }[c.at]


@explains_types
def load_effects(path: str | Path, library: EffectLibrary | None = None) -> EffectLibrary:
    """The effects that there are, and those of a Python file.

    The file is run. Every class in it that derives from `bayesid.effects.Effect` and has a ``name`` is an effect; see
    ``docs/howto/own-effect.md``.

    Parameters
    ----------
    path
        The file.
    library
        Effects to add to; default those of the package.

    Returns
    -------
    library
        For `bayesid.load_experiment` or an `bayesid.Experiment`; nothing else knows of these effects.

    Raises
    ------
    InputError
        The file cannot be read or run, holds no effect, or one that is incomplete or whose name is taken.
    """
    from bayesid.effects.effect import Effect

    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the Python file that holds your effects")
    name = MODULE + str(path.resolve()).encode().hex()
    spec = spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: is no Python file; give one whose name ends in .py")
    module = module_from_spec(spec)
    before = sys.modules.get(name)
    sys.modules[name] = module  # dataclasses look their module up there while it runs, pickle later
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        if before is not None:
            sys.modules[name] = before
        raise InputError(f"{path}: {type(error).__name__}: {' '.join(str(error).split())}; mend the file") from error
    found = [
        c for c in vars(module).values() if isinstance(c, type) and issubclass(c, Effect) and c.__module__ == name and c.name
    ]  # fmt: skip
    if not found:
        raise InputError(f"{path}: holds no effect; derive a class with a name from bayesid.effects.JointTorqueEffect or another")
    return (library or EffectLibrary()).with_classes(found, path.name)
