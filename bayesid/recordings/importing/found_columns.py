"""Which columns hold what: by what the user states, else by names that can only mean one thing."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

from bayesid.arguments import argument, call
from bayesid.errors import InputError
from bayesid.recordings.complaints import cut, listed, suggest
from bayesid.recordings.importing.column_map import (
    AXES,
    JOINT_QUANTITIES,
    NUMBERED,
    QUANTITY_OF_WORD,
    UNIT_OF_NAME,
    ColumnMap,
    known_unit,
    quantity_of,
    without_unit,
)
from bayesid.recordings.importing.stream import Stream
from bayesid.recordings.table import WRENCH_COLUMNS

#: Parts of a name that say that a position is a command.
_COMMAND = {"desired", "reference", "command", "commanded", "target", "setpoint", "action"}
_TIME = re.compile(r"[%_\s]*(?:t|times?|time_?stamps?|stamps?)(?:[\s_]*(s|ms|us|ns|sec|seconds))?", re.IGNORECASE)
_AXIS = re.compile(r"(?:(?P<force>f|force)|(?P<moment>m|t|moment|torque))[\s/._]?(?P<axis>[xyz])", re.IGNORECASE)
_CURRENT = {"current", "currents", "cur", "amps"}
_SEPARATORS = " /._-:[]()"


@dataclass(frozen=True)
class FoundColumn:
    """A column that holds one of ours."""

    ours: str  # ``q1``, ``tau3``, ``fx``
    #: Where it stands.
    stream: Stream
    column: str
    #: As its name states, in the spelling of `UNITS`; None where it states none.
    unit: str | None = None


@dataclass(frozen=True)
class Layout:
    """Where everything is in a recording."""

    joints: tuple[str, ...]  # names of the joints that have positions, in the order of q1 ... qn
    found: tuple[FoundColumn, ...]  # columns of positions, velocities, commands, torques and the wrench


def find_columns(
    streams: Sequence[Stream],
    stated: ColumnMap,
    moving: Sequence[str],
    joints: Sequence[str] | None,
    source: str,
    locked: Collection[str] = (),
) -> Layout:
    """Find the columns of a recording.

    ``moving`` is every moving joint of the robot, in the URDF's order, ``joints`` those that the user wants, in the order of q1
    ... qn (None: all that have positions), and ``locked`` those that are not used, whatever positions they have. An
    `InputError` where a stated column is not there, positions are not found, or columns could be read in more than one way.
    """
    finder = _Finder(streams, stated, source)
    wanted = tuple(joints or moving)
    stated.check_numbers(len(wanted))
    free = tuple(joint for joint in wanted if joint not in locked)
    try:
        positions = finder.of_joints("q", wanted, must=True)
    except InputError:
        if free in ((), wanted):
            raise
        positions, wanted = finder.of_joints("q", free, must=True), free  # there are columns of those that are used only
    if not positions:
        raise InputError(f"no positions of {listed(wanted, 6)} are found", file=source, remedy=finder.what_to_name(wanted))
    if joints is not None and (missing := [name for k, name in enumerate(joints) if k not in positions]):
        remedy = f"name their columns; {_shown(streams, len(wanted), 'q')}"
        raise InputError(f"no positions of {listed(missing)} are found", file=source, remedy=remedy)
    present = [k for k in range(len(wanted)) if k in positions]
    names = tuple(wanted[k] for k in present)
    place = {k: at for at, k in enumerate(k for k, name in enumerate(names) if name not in locked)}  # of those that are used
    if not place:
        raise InputError(f"{listed(names)} are locked, all that have positions", file=source, remedy="leave one free")
    found = [_found(f"q{at + 1}", *positions[present[k]]) for k, at in place.items()]
    for quantity in JOINT_QUANTITIES[1:]:
        columns = {place[k]: column for k, column in finder.of_joints(quantity, names).items() if k in place}
        if len(columns) == len(place) or quantity == "tau":  # each torque says something of the links that its joint moves
            found += [_found(f"{quantity}{at + 1}", *columns[at]) for at in sorted(columns)]
    wrench = finder.stated_wrench() or finder.wrench_by_name()
    found += [_found(name, *column) for name, column in wrench.items()]
    return Layout(tuple(names[k] for k in place), tuple(found))


def positions_of(streams: Sequence[Stream], stated: ColumnMap, joints: Sequence[str], source: str) -> dict[str, FoundColumn]:
    """Columns of the positions of joints that are not used, where their names say so."""
    columns = _Finder(streams, stated, source).by_name("q", joints)
    return {joints[k]: _found(f"q{k + 1}", *place) for k, place in columns.items()}


def times_of(stream: Stream, given: Sequence[str] = (), file: str = "") -> list[str]:
    """Columns of a table that could be its times: those ``given``, with or without its file before; none: by their names."""
    if given:
        return [c for c in stream.columns if {c, stream.full_name(c), f"{file}/{c}"} & set(given)]
    names = [column for column in stream.columns if _TIME.fullmatch(without_unit(column))]
    names = names or [column for column in stream.columns if _TIME.fullmatch(re.split(r"[/.]", without_unit(column))[-1])]
    return [column for column in names if column == "t"] or names


def stated_times(stated: ColumnMap) -> list[str]:
    """The columns of times that the user states, of one file or of several; none where none is stated."""
    given = stated.columns.get("t", [])
    wanted = [given] if isinstance(given, str) else list(given)
    return [*wanted, *(part.strip() for name in wanted for part in name.split(",") if "," in name)]


def time_column(stream: Stream, stated: ColumnMap, source: str, must: bool = True) -> tuple[str, str | None] | None:
    """The column of a table's times, the only one that could be it, and its unit where the user or its name states it.

    None where there is none, and none ``must`` be.
    """
    given = stated_times(stated)
    names = times_of(stream, given)
    if given and not names:
        what = listed([f'"{cut(name)}"' for name in given])
        raise InputError(f"no column {what}", file=source, key="columns t", value=given, remedy=_near(given[0], [stream]))
    if not names and not must:
        return None
    if len(names) != 1:
        what = f"times could be {listed(names)}" if names else "no column of times is found"
        remedy = f"name it ({argument('columns')} t=NAME)"
        if not names:
            remedy += f", or state how many samples a second there are ({argument('rate', 500)} of {call('import')})"
        raise InputError(what, file=source, remedy=f"{remedy}; {_shown([stream], 1, 't')}")
    matched = _TIME.fullmatch(without_unit(names[0]))
    by_name = _stated_unit(names[0], "t") or (known_unit("t", matched[1]) if matched and matched[1] else None)
    return names[0], stated.unit("t") or by_name


class _Finder:
    """Looks columns up in all streams of a recording."""

    def __init__(self, streams: Sequence[Stream], stated: ColumnMap, source: str) -> None:
        self.streams, self.stated, self.source = streams, stated, source
        self.places = [(stream, column) for stream in streams for column in stream.columns]
        self._misstated = partial(InputError, file=stated.file or source)

    def of_joints(self, quantity: str, joints: Sequence[str], must: bool = False) -> dict[int, tuple[Stream, str]]:
        """Columns of a quantity by the index of the joint, as stated or found; ``must`` as for `by_number`."""
        return self.stated_joints(quantity, joints) or self.by_name(quantity, joints) or self.by_number(quantity, joints, must)

    def stated_joints(self, quantity: str, joints: Sequence[str]) -> dict[int, tuple[Stream, str]]:
        """Columns that the user names for a quantity, by the index of the joint."""
        columns = self.stated.columns
        found: dict[int, tuple[Stream, str]] = {}
        given = columns.get(quantity)
        if isinstance(given, str) and re.search(r"\{(joint|0|1)\}", given):
            for k, joint in enumerate(self.stated.names_of(joints)):
                name = given.replace("{joint}", joint).replace("{0}", str(k)).replace("{1}", str(k + 1))
                if (there := self._lookup(name)) is not None:
                    found[k] = there
            if not found:
                raise self._absent(given.replace("{joint}", joints[0]).replace("{0}", "0").replace("{1}", "1"), quantity)
        elif given is not None:
            names = self._entries(given, quantity)
            if len(names) != len(joints):
                problem = f"{len(names)} columns for {len(joints)} joints ({listed(joints, 8)})"
                remedy = f"name one column a joint, or the joints that these are of ({argument('joints')})"
                raise self._misstated(problem, key=f"columns {quantity}", value=given, remedy=remedy)
            found = {k: self._must(name, quantity) for k, name in enumerate(names)}
        ours = [f"{quantity}{k + 1}" for k in range(len(joints))]
        found |= {k: self._must(columns[key], key) for k, key in enumerate(ours) if key in columns}
        if found and given is None:  # some, one by one: others may have our names
            found |= {k: there for k, key in enumerate(ours) if k not in found and (there := self._lookup(key)) is not None}
        return found

    def by_name(self, quantity: str, joints: Sequence[str]) -> dict[int, tuple[Stream, str]]:
        """Columns that hold a joint's name and a word of the quantity."""
        found: dict[int, list[tuple[Stream, str]]] = defaultdict(list)
        names = self.stated.names_of(joints)
        for stream, column in self.places:
            kind, k = _classified(without_unit(column), names)
            if kind == quantity:
                found[k].append((stream, column))
        for k, places in found.items():
            if len(places) > 1:
                raise self._ambiguous(f"{quantity} of {joints[k]}", [s.full_name(c) for s, c in places])
        return {k: places[0] for k, places in found.items()}

    def by_number(self, quantity: str, joints: Sequence[str], must: bool) -> dict[int, tuple[Stream, str]]:
        """Columns of a word of the quantity with a number, from zero or from one, in the order of the joints.

        Of a single joint the word needs no number. ``must``: whether another count than that of the joints is refused. Torques
        may be of some joints, under our own names.
        """
        groups: dict[tuple[int, str], dict[int, tuple[Stream, str]]] = defaultdict(dict)
        for stream, column in self.places:
            name = without_unit(column)
            match = NUMBERED.fullmatch(name)
            # A word alone is of a single joint; what stands before it may be another one's name.
            alone = name if len(joints) == 1 and name.lower() in QUANTITY_OF_WORD else ""
            stem, number = (match[1], int(match[2])) if match else (alone, 0)
            word = re.split(r"[/.\s]", stem.lower())[-1]
            if QUANTITY_OF_WORD.get(word) == quantity and not (quantity == "q" and _tokens(stem) & _COMMAND):
                groups[id(stream), stem][number] = (stream, column)
        whole = [g for g in groups.values() if sorted(g) in (list(range(len(g))), list(range(1, len(g) + 1)))]
        fitting = [g for g in whole if len(g) == len(joints)]
        if len(fitting) > 1:
            exact = [g for (_, word), g in groups.items() if g in fitting and word == quantity]
            if len(exact) != 1:
                raise self._ambiguous(quantity, [s.full_name(c) for g in fitting for s, c in list(g.values())[:1]])
            fitting = exact
        if not fitting and must and whole:
            columns = [column for _, column in whole[0].values()]
            theirs, ours = f"({columns[0]} ... {columns[-1]})", f"({listed(joints, 10)})"
            remedy = f"name those of all these columns, in their order ({argument('joints')}); {argument('locked')} leaves out "
            problem = f"{len(columns)} positions {theirs} but {len(joints)} joints {ours}"
            raise InputError(problem, file=self.source, remedy=f"{remedy}what is not to be used")
        if fitting:
            return {k: place for k, (_, place) in enumerate(sorted(fitting[0].items()))}
        own = [f"tau{k + 1}" for k in range(len(joints))] if quantity == "tau" else []
        some = [g for g in groups.values() if all(without_unit(column) in own for _, column in g.values())]
        return {number - 1: place for number, place in some[0].items()} if len(some) == 1 else {}

    def stated_wrench(self) -> dict[str, tuple[Stream, str]]:
        """Columns that the user names for the wrench."""
        found: dict[str, tuple[Stream, str]] = {}
        columns = self.stated.columns
        for key, axes in AXES.items():
            if (given := columns.get(key)) is None:
                continue
            if isinstance(given, str) and re.search(r"\{[01]\}", given):
                given = [given.replace("{0}", str(k)).replace("{1}", str(k + 1)) for k in range(len(axes))]
            names = self._entries(given, key)
            if len(names) != len(axes):
                remedy = f"name those of {', '.join(axes)}"
                raise self._misstated(f"{len(names)} columns for {len(axes)}", key=f"columns {key}", value=given, remedy=remedy)
            found |= {axis: self._must(name, key) for axis, name in zip(axes, names, strict=True)}
        found |= {axis: self._must(columns[axis], axis) for axis in WRENCH_COLUMNS if axis in columns}
        if found and (missing := [axis for axis in WRENCH_COLUMNS if axis not in found]):
            problem = f"{', '.join(missing)} are missing although {', '.join(found)} are named"
            raise self._misstated(problem, key="columns", remedy="name all six, or none")
        return {axis: found[axis] for axis in WRENCH_COLUMNS if axis in found}

    def wrench_by_name(self) -> dict[str, tuple[Stream, str]]:
        """Six columns whose names end as those of forces and moments do, with one beginning."""
        groups: dict[tuple[int, str], dict[str, tuple[Stream, str]]] = defaultdict(dict)
        for stream, column in self.places:
            bare = without_unit(column)
            match = re.search(rf"(?:^|[\s/._]){_AXIS.pattern}$", bare, re.IGNORECASE)
            if match:
                axis = ("f" if match["force"] else "m") + match["axis"].lower()
                groups[id(stream), bare[: match.start()]].setdefault(axis, (stream, column))
            elif (match := re.fullmatch(r"(.*?)(?:wrench|(?<![^\W_])ft)\[([0-5])\]", bare, re.IGNORECASE)) is not None:
                groups[id(stream), match[1]].setdefault(WRENCH_COLUMNS[int(match[2])], (stream, column))
        whole = [group for group in groups.values() if len(group) == len(WRENCH_COLUMNS)]
        if len(whole) > 1:
            raise self._ambiguous("the wrench", [s.full_name(c) for group in whole for s, c in [group["fx"]]])
        return {axis: whole[0][axis] for axis in WRENCH_COLUMNS} if whole else {}

    def what_to_name(self, joints: Sequence[str]) -> str:
        """What would tell where positions are, by what there is."""
        columns = [s.full_name(column) for s, column in self.places]
        endings = [re.split(r"[/.]", column.lower()) for column in columns]
        names = [re.split(r"[/.]", c)[-2] for c, e in zip(columns, endings, strict=True) if len(e) > 1 and e[-1] == "position"]
        if names:
            option = argument("joint_names", f"{joints[0]}={names[0]},...") if joints else argument("joint_names")
            return f"the log's joints are {listed(names, 8)}: say which is which ({option})"
        groups = _groups(self.streams)
        sized = [name for name, size in groups.items() if size == len(joints) > 1]
        likely = [name for name in sized if _is_called(name, "q")] or [name for name in sized if name[-1] != "]"]
        likely = likely or _a_joint(groups, self.stated.names_of(joints)) or sized
        part = f"{columns[0].removesuffix('[0]')}[0:{len(joints)}]"  # of an array whose entries have no names
        alone = len(groups) == 1 and len(columns) >= len(joints) and columns[0].endswith("[0]")
        example = f"q={likely[0] if likely else part if alone else '{joint}/position' if len(columns) > 1 else '...'}"
        there = _shown(self.streams, len(joints), "q")
        return f"name their columns ({argument('columns')}, such as {example}); {there}"

    def _entries(self, name: str | Sequence[str], key: str) -> list[str]:
        """Names of columns as they are listed, commas between or not, or of an array's, or of a part of it (``state[0:6]``)."""
        if not isinstance(name, str):
            return list(name)
        match = re.fullmatch(r"(.+)\[(\d+):(\d+)\]", name)
        if match:
            return [f"{match[1]}[{k}]" for k in range(int(match[2]), min(int(match[3]), int(match[2]) + 1000))]
        arrays = [(s, c, c[: c.rfind("[")]) for s, c in self.places if re.fullmatch(r".+\[\d+\]", c)]
        entries = [s.full_name(c) for s, c, array in arrays if s.full_name(array) == name]
        entries = entries or [c for _, c, array in arrays if array == name]
        entries = entries or [c for _, c in self.places if c.startswith(f"{name}/")]
        if not entries and self._lookup(name) is None:
            if "," in name:
                return [part.strip() for part in name.split(",")]
            raise self._absent(name, key, whole=True)
        return entries or [name]

    def _lookup(self, name: str) -> tuple[Stream, str] | None:
        places = [(s, c) for s, c in self.places if s.full_name(c) == name]
        places = places or [(s, c) for s, c in self.places if c == name]
        array = re.fullmatch(r"(.+)\[(\d+)\]", name)
        if not places and array:  # an entry of an array whose entries have names of their own
            entries = [(s, c) for s, c in self.places if s.full_name(c).startswith(f"{array[1]}/")]
            places = entries[int(array[2]) : int(array[2]) + 1]
        if len(places) > 1:
            raise self._ambiguous(name, [s.full_name(c) for s, c in places])
        return places[0] if places else None

    def _must(self, given: str | Sequence[str], key: str) -> tuple[Stream, str]:
        """The one column that is given for one of ours."""
        if not isinstance(given, str):
            remedy = "name one column"
            raise InputError("several columns for one", file=self.stated.file, key=f"columns {key}", value=given, remedy=remedy)
        if (place := self._lookup(given)) is None:
            raise self._absent(given, key)
        return place

    def _absent(self, name: str, key: str, whole: bool = False) -> InputError:
        remedy = _near(name, self.streams, whole)
        return InputError(f'no column "{cut(name, 80)}"', file=self.source, key=f"columns {key}", value=name, remedy=remedy)

    def _ambiguous(self, what: str, names: Sequence[str]) -> InputError:
        return InputError(
            f"{what} could be {listed(names, 4)}", file=self.source,
            remedy=f"say which: name the columns ({argument('columns')}), or the topics to be read ({argument('topics')})",
        )  # fmt: skip


def _found(ours: str, stream: Stream, column: str) -> FoundColumn:
    return FoundColumn(ours, stream, column, _stated_unit(column, quantity_of(ours)))


def _classified(name: str, joints: Sequence[str]) -> tuple[str, int]:
    """The quantity and the joint's index that a column's name states; ``""`` where it states none."""
    low, tokens = name.lower(), _tokens(name)
    for k, joint in enumerate(joints):
        j = joint.lower()
        if j in tokens:
            rest = [part for part in tokens if part != j]
        elif low.startswith(j) and low[len(j) : len(j) + 1] in tuple(_SEPARATORS):
            rest = [low[len(j) :].strip(_SEPARATORS)]
        elif low.endswith(j) and low[-len(j) - 1 : -len(j)] in tuple(_SEPARATORS):
            rest = [re.split(r"[/.\s]", low[: -len(j)].strip(_SEPARATORS))[-1], *tokens]
        else:
            continue
        kinds = {QUANTITY_OF_WORD[part] for part in rest if part in QUANTITY_OF_WORD}
        if len(kinds) == 1:
            (kind,) = kinds
            if tokens & _COMMAND:
                return ("qr" if kind == "q" else "", k)
            return kind, k
    return "", -1


def _tokens(name: str) -> set[str]:
    return {part for part in re.split(r"[/.\[\]()\s:]+", name.lower()) if part}


def _stated_unit(column: str, quantity: str) -> str | None:
    """The unit in brackets at the end of a column's name, where it is one of the quantity."""
    match = UNIT_OF_NAME.search(column)
    return known_unit(quantity, match[1]) if match and not match[1].isdigit() else None


def _near(name: str, streams: Sequence[Stream], whole: bool = False) -> str:
    """What may be meant: a column, or for a ``whole`` quantity an array of them as `_groups` names it."""
    columns = (s.full_name(c) for s in streams for c in s.columns if not whole)
    return suggest(name, dict.fromkeys([*_groups(streams), *columns]), "its columns are")


def _shown(streams: Sequence[Stream], count: int, quantity: str) -> str:
    """What there is, for messages: first what has so many columns, and of that what is called as the quantity is."""
    groups = _groups(streams)
    order = sorted(groups, key=lambda name: (groups[name] != count, not _is_called(name, quantity)))
    return f"its columns are: {listed([cut(name, 60) for name in order], 14)}" if order else "nothing was read of it"


def _is_called(name: str, quantity: str) -> bool:
    """Whether a name has a word of a quantity, ``t`` included, in it."""
    parts = _words_of(name)
    return any(_TIME.fullmatch(part) if quantity == "t" else QUANTITY_OF_WORD.get(part) == quantity for part in parts)


def _a_joint(groups: Iterable[str], joints: Sequence[str]) -> list[str]:
    """What is there of every joint under its name, as a pattern; the first number of arrays."""
    first = [re.sub(r"\[0:\d+\]$", "[0]", name) for name in groups]
    patterns = [name.replace(joints[0], "{joint}") for name in first if joints[0] in name] if joints else []
    return [one for one in patterns if all(one.replace("{joint}", joint) in first for joint in joints)]


def currents(streams: Sequence[Stream], count: int) -> list[str]:
    """What is called a measured current and has so many columns, as `_groups` names it."""
    named = ((name, _words_of(name)) for name, size in _groups(streams).items() if size == count)
    return [name for name, words in named if words & _CURRENT and not words & _COMMAND]


def where_torques_are(streams: Sequence[Stream], count: int) -> str:
    """What would tell where the torques of so many joints are, by what there is."""
    called = [name for name, size in _groups(streams).items() if size == count and _is_called(name, "tau")]
    measured = [name for name in called if not _words_of(name) & _COMMAND]
    example = f", such as tau={measured[0]}" if measured else ""
    return f"name their columns ({argument('columns')}{example}), or record them; {_shown(streams, count, 'tau')}"


def _words_of(name: str) -> set[str]:
    return set(re.split(r"[^a-z]+", name.lower()))


def _groups(streams: Sequence[Stream]) -> dict[str, int]:
    """Columns as a user may name them together, an array ``state[0:6]`` or numbers ``J{1} Angle``, and how many each stands for.

    What stands in longer streams comes first, then in the order of the recording.
    """
    numbers: dict[tuple[str, str, str], list[int]] = defaultdict(list)
    for stream in sorted(streams, key=lambda s: -max(map(len, s.columns.values()), default=0)):
        for column in stream.columns:
            match = re.fullmatch(r"(.*?)(\[?)(\d+)(\]?)", name := stream.full_name(column))
            if match and bool(match[2]) == bool(match[4]):
                numbers[match[1], match[2], ""].append(int(match[3]))
            elif match := re.fullmatch(r"(\D*)(0|[1-9]\d*)(\D+)", name):
                numbers[match[1], "", match[3]].append(int(match[2]))
            else:
                numbers[name, "-", ""].append(0)
    out: dict[str, int] = {}
    for (name, kind, end), found in numbers.items():
        first = min(found)
        if kind == "[" and found == list(range(len(found))):
            out[f"{name}[0:{len(found)}]"] = len(found)
        elif not kind and len(found) > 1 and first < 2 and sorted(found) == list(range(first, first + len(found))):
            out[f"{name}{{{first}}}{end}"] = len(found)
        else:
            out |= dict.fromkeys((name if kind == "-" else f"{name}[{k}]" if kind else f"{name}{k}{end}" for k in found), 1)
    return out
