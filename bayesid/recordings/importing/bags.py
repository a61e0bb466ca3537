"""Bags of ROS 1 and ROS 2 and MCAP files, read by the message definitions that they hold."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bayesid.errors import InputError
from bayesid.recordings.complaints import cut, listed, one_line, suggest
from bayesid.recordings.importing.stream import Source, Stream, array_columns, extra

#: Types of topics that are read without being named.
_KNOWN = ("JointState", "Wrench", "WrenchStamped")
_JOINT_STATE = ("position", "velocity", "effort")
_WIDEST = 4096  # entries of an array in a message; longer ones are pictures and clouds


def read_bag(path: Path, topics: Sequence[str] = (), mapped: Iterable[str] = ()) -> Source:
    """Read the topics of a bag that hold joint states and wrenches, or those named; and topics of columns, ``/topic/field``.

    A bag is a ``.bag`` of ROS 1, a folder with ``metadata.yaml``, a ``.db3`` or an ``.mcap`` file. An `InputError` where
    rosbags is not installed, the file is damaged or cut off, a topic is not in it or its messages cannot be read.
    """
    with _opened(path) as reader:
        there = {c.topic: c.msgtype for c in reader.connections}
        for topic in topics:
            if topic not in there:
                raise InputError(f"no topic {cut(topic, 80)}", file=path.name, remedy=suggest(topic, there, "topics"))
        mapped = list(mapped)
        wanted = {
            topic for topic, kind in there.items()
            if (topic in topics if topics else kind.rpartition("/")[2] in _KNOWN)
            or any(name.startswith(f"{topic}/") for name in mapped)
        }  # fmt: skip
        collected = {topic: _Collected(topic) for topic in sorted(wanted)}
        if wanted:
            connections = [c for c in reader.connections if c.topic in wanted]
            for connection, log, raw in reader.messages(connections=connections):
                kind = connection.msgtype
                collected[connection.topic].add(reader.deserialize(raw, kind), kind, log, path.name)
    streams = tuple(stream for each in collected.values() for stream in each.streams())
    unread = tuple(f"{topic} ({kind})" for topic, kind in sorted(there.items()) if topic not in wanted)
    return Source(path.stem or path.name, streams, unread)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """An open reader; whatever a damaged file makes it raise becomes one line."""
    highlevel = extra("rosbags.highlevel", "rosbags", path.name)
    typesys = extra("rosbags.typesys", "rosbags", path.name)
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if path.suffix == ".bag" else typesys.Stores.LATEST)
    files = (
        [path] if not path.is_dir() or (path / "metadata.yaml").is_file() else sorted([*path.glob("*.mcap"), *path.glob("*.db3")])
    )
    if len(files) > 1:
        raise InputError(
            f"holds {listed([file.name for file in files], 3)} but no metadata.yaml", file=path.name,
            remedy="reindex it (ros2 bag reindex), or name one file",
        )  # fmt: skip
    try:
        with highlevel.AnyReader(files, default_typestore=store) as reader:
            yield reader
    except InputError:
        raise
    except Exception as error:  # a damaged file can be wrong in any way: sizes, checksums, texts, definitions
        what = cut(one_line(str(error)), 120) or type(error).__name__
        raise InputError(
            f"cannot be read as a ROS bag or MCAP file ({what})",
            file=path.name,
            remedy="is it cut off? repair it (ros2 bag reindex, rosbag reindex, mcap recover) or record it again",
        ) from None


@dataclass
class _Collected:
    """Messages of one topic, as they come."""

    topic: str
    log: list[int] = field(default_factory=list)
    header: list[int] = field(default_factory=list)
    #: Index of each message and its numbers, by the joints it names and the array they are in.
    joints: dict[tuple[tuple[str, ...], str], tuple[list[int], list[np.ndarray]]] = field(default_factory=dict)
    rows: list[dict[str, Any]] = field(default_factory=list)
    wrenches: list[tuple[float, ...]] = field(default_factory=list)
    frame: str = ""

    def add(self, message: Any, kind: str, log: int, source: str) -> None:
        """Take one message of a type: its stamps, and its numbers by name."""
        row = len(self.log)
        self.log.append(log)
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        if stamp is not None:
            self.header.append(int(stamp.sec) * 10**9 + int(stamp.nanosec))
            self.frame = self.frame or str(message.header.frame_id).lstrip("/")
        names = getattr(message, "name", None)
        if isinstance(names, list) and all(hasattr(message, part) for part in _JOINT_STATE):
            self._add_joints(message, names, row, source)
        elif kind.endswith("/WrenchStamped"):  # the same as below, in a fifth of the time
            f, m = message.wrench.force, message.wrench.torque
            self.wrenches.append((f.x, f.y, f.z, m.x, m.y, m.z))
        else:
            names = getattr(message, "joint_names", None)  # beside arrays of one number a joint
            self.rows.append(dict(_numbers(message, "", [str(name) for name in names] if isinstance(names, list) else [])))

    def _add_joints(self, message: Any, names: list[str], row: int, source: str) -> None:
        """Each joint's numbers under its name: the order may differ from message to message, and parts may be empty."""
        for part in _JOINT_STATE:
            values = getattr(message, part)
            if len(values) not in (0, len(names)):
                raise InputError(
                    f"message {row}: {len(names)} names but {len(values)} in {part}", file=source, key=self.topic,
                    remedy="mend the publisher, or leave the topic out",
                )  # fmt: skip
            if len(values):
                rows, arrays = self.joints.setdefault((tuple(names), part), ([], []))
                rows.append(row)
                arrays.append(values)

    def streams(self) -> list[Stream]:
        """What was collected: joints that come in the same messages are one stream."""
        log, header = np.array(self.log, np.int64), np.array(self.header, np.int64)
        clocks = {"log": log} | ({"header": header} if len(header) == len(log) else {})
        alike: dict[bytes, tuple[np.ndarray, dict[str, np.ndarray]]] = {}
        for column, rows, values in self._joint_columns():
            if not np.isnan(values).all():
                alike.setdefault(rows.tobytes(), (rows, {}))[1][column] = values
        streams = [
            Stream(self.topic, columns, {name: clock[rows] for name, clock in clocks.items()}, self.frame)
            for rows, columns in alike.values()
        ]
        if self.wrenches:
            names = (f"wrench/{part}/{axis}" for part in ("force", "torque") for axis in "xyz")
            columns = dict(zip(names, np.array(self.wrenches, dtype=np.float64).T, strict=True))
            streams.append(Stream(self.topic, columns, clocks, self.frame))
        columns = {}
        for name, value in self.rows[0].items() if self.rows else ():  # what every message has with one shape
            shape = np.shape(value)
            if all(np.shape(row.get(name, ())) == shape for row in self.rows[1:]):
                columns |= array_columns(name, np.array([row[name] for row in self.rows], dtype=np.float64))
        return [*streams, Stream(self.topic, columns, clocks, self.frame)] if columns else streams

    def _joint_columns(self) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """Name of each joint's column, indices of the messages that have it (k,), ascending, and its numbers (k,)."""
        found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
        for (names, part), (rows, arrays) in self.joints.items():
            table = np.array(arrays, dtype=np.float64)
            for k, name in enumerate(names):
                found.setdefault(f"{name}/{part}", []).append((np.array(rows), table[:, k]))
        for column, parts in found.items():
            rows, values = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
            order = np.argsort(rows, kind="stable")
            yield column, rows[order], values[order]


def _numbers(message: Any, path: str, joints: list[str]) -> Iterator[tuple[str, Any]]:
    """Numbers of a message by the path to them; an array of one number a joint under the joints' names."""
    fields = getattr(message, "__dataclass_fields__", None)
    if fields is not None:
        for name in fields:
            if name != "header" and not name.startswith("__"):
                yield from _numbers(getattr(message, name), f"{path}/{name}" if path else name, joints)
    elif isinstance(message, (bool, int, float)):
        yield path, float(message)
    elif isinstance(message, np.ndarray) and message.dtype.kind in "fiub" and 0 < message.size <= _WIDEST:
        if joints and message.shape == (len(joints),):
            yield from ((f"{path}/{joint}", float(value)) for joint, value in zip(joints, message, strict=True))
        else:
            yield path, message.astype(np.float64)
    elif isinstance(message, list) and 0 < len(message) <= _WIDEST:
        if all(hasattr(part, "__dataclass_fields__") for part in message):
            for k, part in enumerate(message):
                label = joints[k] if len(message) == len(joints) else str(k)
                yield from _numbers(part, f"{path}/{label}", [])
        elif all(isinstance(part, (int, float)) for part in message):
            yield path, np.array(message, dtype=np.float64)
