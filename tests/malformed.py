"""Ways to break a good experiment folder, and what the one line of complaint must then say."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from tests.example_robots import Joint, Link, urdf_text

# Real recordings: the folder "shared" beside the repository, or where BAYESID_DATA says.
DATA = Path(os.environ.get("BAYESID_DATA", Path(__file__).resolve().parents[2] / "shared"))
FOLDERS = sorted(path.parent for path in DATA.glob("*/*/experiment.toml"))

URDF = urdf_text(
    "two-joint",
    [
        Link("base"),
        Link("upper", 4.0, (0.2, 0.01, 0.02), (0.05, 0.06, 0.06)),
        Link("lower", 2.0, (0.15, 0.0, 0.01), (0.01, 0.02, 0.02)),
        Link("tool", 0.5, (0.0, 0.0, 0.05), (0.001, 0.001, 0.001)),
        Link("flange"),
    ],
    [
        Joint("shoulder", "base", "upper", (0.0, 0.0, 0.3)),
        Joint("elbow", "upper", "lower", (0.4, 0.0, 0.0), axis=(0.0, 1.0, 0.0), limits=(-2.5, 2.5, 2.0, 80.0)),
        Joint("wrist", "lower", "tool", (0.3, 0.0, 0.0), axis=(1.0, 0.0, 0.0)),
        Joint("flange_joint", "tool", "flange", kind="fixed"),
    ],
)

TOML = """\
format = 1
name = "two-joint"

[robot]
urdf = "robot.urdf"
joints = ["shoulder", "elbow"]
locked = { wrist = 0.1 }
gravity = [0.0, 0.0, -9.81]
inertia_rel_std = 0.1
position_resolution = 1e-5
gear_ratio = { elbow = 100.0 }

[sensor]
translation = [0.0, 0.0, -0.1]
force_std = 0.5
torque_std = 0.05

[model]
effects = ["sensor_offset"]

[[motion]]
name = "identification"
role = "identification"
table = "identification.csv"
static = "static.csv"
parked = [[0.0, 0.5]]

[[motion]]
name = "validation"
role = "validation"
table = "validation.csv"
"""


@cache
def good_files() -> dict[str, str]:
    """Files of a folder with nothing wrong, by name; made once."""
    motion = recording(0)
    static = motion.drop(columns=["v1", "v2"])
    static[["fx", "fy", "fz", "mx", "my", "mz"]] = recording(2)[["fx", "fy", "fz", "mx", "my", "mz"]]
    tables = {"identification": motion, "static": static, "validation": recording(1)}
    return {"robot.urdf": URDF, "experiment.toml": TOML} | {f"{k}.csv": t.to_csv(index=False) for k, t in tables.items()}


def write_good(folder: Path) -> Path:
    """Write a folder with nothing wrong: two joints, a wrench, velocities, a stop-and-go table."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in good_files().items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def recording(seed: int, seconds: float = 4.0) -> pd.DataFrame:
    """Make a motion at 100 Hz that rests for half a second; the wrench is smooth and noisy but no physics."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(100 * seconds) + 1) / 100.0
    # A cubic start, so that speed and acceleration begin at zero.
    s = np.maximum(t - 0.5, 0.0) ** 3 / (1.0 + np.maximum(t - 0.5, 0.0) ** 2)
    slope = np.gradient(s, t)
    rate = np.array([2.0, 3.1 + 0.2 * seed])
    q = np.array([0.8, 0.6]) * np.sin(rate * s[:, None]) + 1e-6 * rng.normal(size=(len(t), 2))
    v = np.array([0.8, 0.6]) * rate * np.cos(rate * s[:, None]) * slope[:, None]
    signal = np.sin(np.outer(s, np.arange(1, 7))) + 0.05 * rng.normal(size=(len(t), 6))
    wrench = np.array([1.0, 1.0, 60.0, 5.0, 5.0, 1.0]) + signal * np.array([9.0, 9.0, 5.0, 3.0, 3.0, 1.0])
    names = ["t", "q1", "q2", "v1", "v2", "fx", "fy", "fz", "mx", "my", "mz"]
    return pd.DataFrame(np.column_stack([t, q, v, wrench]), columns=names)


@dataclass(frozen=True)
class Malformed:
    """One way to be wrong.

    Attributes
    ----------
    name
        What is wrong.
    damage
        Changes the good folder in place.
    says
        Substrings of the complaint: which file, which key or column, which value.
    arguments
        The verb and options for this folder; default ``check FOLDER``.
    """

    name: str
    damage: Callable[[Path], None]
    says: tuple[str, ...]
    arguments: Callable[[Path], list[str]] = lambda folder: ["check", str(folder)]


def toml(old: str, new: str, name: str = "experiment.toml") -> Callable[[Path], None]:
    """Replace text in experiment.toml, or another file."""

    def damage(folder: Path) -> None:
        path = folder / name
        text = path.read_text(encoding="utf-8")
        assert text.count(old) >= 1, old
        path.write_text(text.replace(old, new, 1), encoding="utf-8")

    return damage


def urdf(old: str, new: str) -> Callable[[Path], None]:
    """Replace text in the URDF."""
    return toml(old, new, "robot.urdf")


def table(change: Callable[[pd.DataFrame], pd.DataFrame], name: str = "identification.csv") -> Callable[[Path], None]:
    """Change a table as a data frame."""

    def damage(folder: Path) -> None:
        path = folder / name
        change(pd.read_csv(path)).to_csv(path, index=False)

    return damage


def cell(row: int, column: str, value: object, name: str = "identification.csv") -> Callable[[Path], None]:
    """Set one cell; row 0 is line 2."""

    def change(frame: pd.DataFrame) -> pd.DataFrame:
        frame = frame.astype(object)
        frame.loc[row, column] = value
        return frame

    return table(change, name)


def scaled(factor: float, *columns: str) -> Callable[[Path], None]:
    """Multiply columns."""
    return table(lambda frame: frame.assign(**{c: frame[c] * factor for c in columns}))


def lines(change: Callable[[list[str]], list[str]], name: str = "identification.csv") -> Callable[[Path], None]:
    """Change a file line by line."""

    def damage(folder: Path) -> None:
        path = folder / name
        path.write_text("\n".join(change(path.read_text(encoding="utf-8").splitlines())) + "\n", encoding="utf-8")

    return damage


def content(name: str, data: bytes) -> Callable[[Path], None]:
    """Replace a whole file."""
    return lambda folder: (folder / name).write_bytes(data) and None


def remove(name: str) -> Callable[[Path], None]:
    """Remove a file."""
    return lambda folder: (folder / name).unlink()


def as_folder(name: str) -> Callable[[Path], None]:
    """Put a folder in a file's place."""

    def damage(folder: Path) -> None:
        (folder / name).unlink()
        (folder / name).mkdir()

    return damage


def nothing(folder: Path) -> None:
    """Leave the folder as it is: the options are wrong."""
    del folder


def identify(*options: str) -> Callable[[Path], list[str]]:
    """``identify`` with these options; ``{folder}`` stands for the folder."""
    return lambda folder: ["identify", str(folder), *(option.format(folder=folder) for option in options)]


def simulate(*options: str) -> Callable[[Path], list[str]]:
    """``simulate --new`` with these options."""
    return lambda folder: ["simulate", str(folder), "--new", *options]


def insert_cell(text: list[str]) -> list[str]:
    return [*text[:30], text[30] + ",7.0", *text[31:]]


def restart_clock(frame: pd.DataFrame) -> pd.DataFrame:
    frame.loc[250:, "t"] -= 1.0
    return frame


def poses_in_static(frame: pd.DataFrame) -> pd.DataFrame:
    frame.loc[120:, "q2"] += 0.02
    return frame


DEGREE = 180.0 / math.pi

CASES = [
    # The folder itself.
    Malformed("no such folder", nothing, ("nowhere", "no such folder"), lambda f: ["check", str(f / "nowhere")]),
    Malformed("a file as folder", nothing, ("robot.urdf", "not a folder"), lambda f: ["check", str(f / "robot.urdf")]),
    Malformed("no experiment.toml", remove("experiment.toml"), ("has no experiment.toml",)),
    Malformed("toml is a folder", as_folder("experiment.toml"), ("experiment.toml",)),
    # experiment.toml: syntax and types.
    Malformed("toml syntax", toml("format = 1", "format 1"), ("experiment.toml", "not valid TOML", "line 1")),
    Malformed("toml empty", content("experiment.toml", b"\n"), ("experiment.toml", "format", "missing")),
    Malformed("toml not UTF-8", content("experiment.toml", b'format = 1\nname = "\xe9"\n'), ("line 2", "0xe9", "UTF-8")),
    Malformed("key twice", toml("format = 1", "format = 1\nformat = 1"), ("experiment.toml", "line 2")),
    Malformed("format number", toml("format = 1", "format = 3"), ("experiment.toml", "format", "3", "write 1")),
    Malformed("misspelt key", toml("inertia_rel_std", "inertia_relstd"), ("[robot] inertia_relstd", "inertia_rel_std")),
    Malformed("unknown section", toml("[sensor]", "[sensors]"), ("sensors", 'did you mean "sensor"')),
    Malformed("missing name", toml('name = "two-joint"', ""), ("experiment.toml: name", "missing")),
    Malformed("name with a slash", toml('name = "two-joint"', 'name = "../up"'), ("name", "../up")),
    Malformed("no motion", lambda f: _cut_motions(f), ("experiment.toml: motion", "missing")),
    Malformed("number as text", toml("force_std = 0.5", 'force_std = "0.5"'), ("[sensor] force_std", '"0.5"', "number")),
    Malformed("true as number", toml("force_std = 0.5", "force_std = true"), ("[sensor] force_std", "true", "number")),
    Malformed("negative std", toml("torque_std = 0.05", "torque_std = -0.05"), ("[sensor] torque_std", "-0.05")),
    Malformed("not-a-number std", toml("force_std = 0.5", "force_std = nan"), ("[sensor] force_std", "finite")),
    Malformed("negative trust", toml("inertia_rel_std = 0.1", "inertia_rel_std = -1"), ("inertia_rel_std", "-1")),
    Malformed("two numbers of gravity", toml("[0.0, 0.0, -9.81]", "[0.0, -9.81]"), ("[robot] gravity", "write 3")),
    Malformed("gravity as number", toml("[0.0, 0.0, -9.81]", "-9.81"), ("[robot] gravity", "-9.81", "list")),
    Malformed("four of translation", toml("[0.0, 0.0, -0.1]", "[0, 0, 0, 1]"), ("[sensor] translation", "write 3")),
    Malformed("joints as text", toml('["shoulder", "elbow"]', '"shoulder"'), ("[robot] joints", "list")),
    Malformed("no joints", toml('["shoulder", "elbow"]', "[]"), ("[robot] joints", "empty")),
    Malformed("zero gear ratio", toml("elbow = 100.0", "elbow = 0"), ("gear_ratio", "elbow", "above 0")),
    Malformed("brackets without end", toml("force_std = 0.5", "force_std = " + "[" * 3000), ("experiment.toml", "nested")),
    Malformed("a number of 5000 digits", toml("force_std = 0.5", "force_std = " + "7" * 5000), ("experiment.toml", "digits")),
    Malformed("a role of 5000 digits", toml('role = "validation"', "role = 0x" + "7" * 5000), ("role", "thousands of digits")),
    Malformed("a joint's name of 5000 letters", urdf('name="elbow"', f'name="{"7" * 5000}"'), ("robot.urdf", "777...")),
    Malformed("a hexadecimal of 5000 digits", toml("force_std = 0.5", "force_std = 0x" + "7" * 5000), ("[sensor] force_std",)),
    Malformed("a size beyond all", toml("force_std = 0.5", "force_std = 1e300"), ("[sensor] force_std", "1e+300", "1e+12")),
    Malformed("a size next to nothing", toml("force_std = 0.5", "force_std = 1e-300"), ("[sensor] force_std", "1e-300")),
    Malformed("name of 300 characters", toml('"two-joint"', f'"{"x" * 300}"'), ("experiment.toml: name", "at most 100")),
    # experiment.toml: names.
    Malformed("unknown joint", toml('"elbow"]', '"elbo"]'), ("[robot] joints", "elbo", "did you mean 'elbow'")),
    Malformed("fixed joint", toml('"elbow"]', '"flange_joint"]'), ("[robot] joints", "flange_joint", "fixed")),
    Malformed("joint twice", toml('"elbow"]', '"shoulder"]'), ("[robot] joints", "shoulder", "twice")),
    Malformed("moving and locked", toml("wrist = 0.1", "elbow = 0.1"), ("[robot] locked", "elbow", "joints")),
    Malformed("unknown locked", toml("wrist = 0.1", "wirst = 0.1"), ("[robot] locked", "wirst", "wrist")),
    Malformed("unknown geared", toml("elbow = 100.0", "elbwo = 100.0"), ("gear_ratio", "elbwo", "elbow")),
    Malformed("unknown sensor joint", toml("[sensor]", '[sensor]\njoint = "wist"'), ("[sensor] joint", "wist", "wrist")),
    Malformed("misspelt role", toml('role = "identification"', 'role = "identifcation"'),
              ('[motion.0] role of "identification"', "identifcation", 'did you mean "identification"')),
    Malformed("unknown kind", toml("parked", 'kind = "pose"\nparked'), ("[motion.0] kind", "pose", "poses")),
    Malformed("nothing to identify", toml('role = "identification"', 'role = "validation"'), ("identification", "role")),
    Malformed("motion twice", toml('name = "validation"', 'name = "identification"'), ("[motion.1] name", "taken")),
    Malformed("motion with a comma", toml('name = "validation"', 'name = "a,b"'), ("[motion.1] name", "a,b")),
    # experiment.toml: times.
    Malformed("parked outside", toml("[[0.0, 0.5]]", "[[3.0, 9.0]]"), ("[motion.0] parked", "[3, 9]", "0 to 4 s")),
    Malformed("parked backwards", toml("[[0.0, 0.5]]", "[[0.5, 0.0]]"), ("[motion.0] parked", "[0.5, 0]")),
    Malformed("parked not in pairs", toml("[[0.0, 0.5]]", "[[0.5]]"), ("[motion.0] parked", "write 2")),
    Malformed("parked one pair", toml("[[0.0, 0.5]]", "[0.0, 0.5]"), ("[motion.0] parked", "list")),
    Malformed("period too long", toml("parked", "period = 60.0\nparked"), ("[motion.0] period", "60", "4 s")),
    Malformed("negative period", toml("parked", "period = -1.0\nparked"), ("[motion.0] period", "-1")),
    Malformed("poses with times", toml("parked", 'kind = "poses"\nparked'), ("[motion.0] parked", "poses")),
    # [model].
    Malformed("effect without place", toml("sensor_offset", "tether@"), ("[model] effects", "tether@")),
    Malformed("effect twice", toml('["sensor_offset"]', '["spring", "spring"]'), ("[model] effects", "spring", "twice")),
    Malformed("effects as text", toml('["sensor_offset"]', '"sensor_offset"'), ("[model] effects", "list")),
    Malformed("value as text", toml("[[motion]]", '[model.values."spring@elbow"]\nrest = "0"\n\n[[motion]]'),
              ("spring@elbow", "rest", "number")),
    # The URDF.
    Malformed("no urdf", remove("robot.urdf"), ("[robot] urdf", "robot.urdf")),
    Malformed("urdf is no XML", content("robot.urdf", b"<robot"), ("robot.urdf", "URDF")),
    Malformed("urdf empty", content("robot.urdf", b""), ("robot.urdf",)),
    Malformed("urdf without robot", content("robot.urdf", b"<html></html>"), ("robot.urdf", "URDF")),
    Malformed("urdf link without parent", urdf('<parent link="base"', '<parent link="bas"'), ("robot.urdf", "bas")),
    Malformed("urdf mass as text", urdf('value="4', 'value="four'), ("robot.urdf", "link upper", "four", "number")),
    Malformed("urdf mass negative", urdf('value="4', 'value="-4'), ("robot.urdf", "link upper", "-4 kg")),
    Malformed("urdf without axis", urdf('axis xyz="0.0 1.0 0.0"', 'axis xyz="0 0 0"'), ("robot.urdf", "elbow", "axis")),
    Malformed("urdf of a free body", urdf('type="revolute"', 'type="floating"'), ("robot.urdf", "shoulder", "6 degrees")),
    Malformed("urdf of no kind", urdf('type="revolute"', 'type="revolut"'), ("robot.urdf", "shoulder", "revolut")),
    Malformed("no urdf of that name", toml('"robot.urdf"', '"arm.urdf"'), ("[robot] urdf", "arm.urdf")),
    Malformed("urdf mass with a comma", urdf('value="4.0"', 'value="4,0"'), ("robot.urdf: link upper", "4,0", "decimal point")),
    Malformed("urdf mass not a number", urdf('value="4.0"', 'value="nan"'), ("robot.urdf: link upper", "nan")),
    Malformed("urdf mass beyond all", urdf('value="4.0"', 'value="1e308"'), ("robot.urdf: link upper", "1e+308 kg")),
    Malformed("urdf mass negative behind a locked joint", urdf('value="0.5"', 'value="-0.3"'), ("link tool", "-0.3 kg")),
    Malformed("urdf inertia with a word", urdf('ixx="0.05"', 'ixx="big"'), ("robot.urdf: link upper", "ixx", "big")),
    Malformed("urdf inertia missing", urdf(' ixx="0.05"', ""), ("robot.urdf: link upper", "ixx is missing")),
    Malformed("urdf inertial origin of two", urdf('xyz="0.2 0.01 0.02"', 'xyz="0.2 0.01"'), ("link upper", "three numbers")),
    Malformed("urdf joint origin in nowhere", urdf('xyz="0.4 0.0 0.0"', 'xyz="4e9 0 0"'), ("joint elbow", "4e9", "SI units")),
    Malformed("urdf link is its own parent", urdf('<parent link="upper"', '<parent link="lower"'), ("joint elbow", "loop")),
    Malformed("urdf two parents", urdf('<child link="lower"', '<child link="upper"'), ("shoulder and elbow", "link upper")),
    Malformed("urdf two roots", urdf('<link name="flange" />', '<link name="flange" /><link name="lost" />'), ("base and lost",)),
    Malformed("urdf limits reversed", urdf('lower="-2.5" upper="2.5"', 'lower="2.5" upper="-2.5"'), ("joint elbow", "reversed")),
    Malformed("urdf without limits", urdf("<limit", "<limits"), ("joint shoulder", "no <limit>")),
    Malformed("urdf joint twice", urdf('name="elbow"', 'name="shoulder"'), ("joint shoulder", "twice")),
    Malformed("urdf blank line first", lambda f: _prepend(f, "\n"), ("robot.urdf: ", "line 2", "before <?xml")),
    Malformed("urdf dashes in a comment", urdf("<link", "<!-- a -- b --><link"), ("robot.urdf: ", "line 3", "not well-formed")),
    Malformed("urdf with a default namespace", urdf("<robot", '<robot xmlns="http://ros.org"'), ("default namespace", "remove")),
    Malformed("urdf prefix undeclared", urdf("<link", '<xacro:property name="a" value="1"/><link'),
              ("robot.urdf: ", "line 3", "unbound prefix", "xacro")),
    Malformed("urdf is xacro", lambda f: (urdf("<link", '<xacro:include filename="a"/><link')(f),
                                          urdf("<robot", '<robot xmlns:xacro="http://ros.org/wiki/xacro"')(f)),
              ("robot.urdf: ", "xacro")),
    Malformed("urdf of unknown encoding", urdf('version="1.0"', 'version="1.0" encoding="klingon"'), ("encoding", "UTF-8")),
    Malformed("urdf with an entity bomb", urdf("<robot", '<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]>\n<robot'),
              ("robot.urdf: line 2", "<!DOCTYPE")),
    Malformed("urdf nested deep", urdf("<link", "<a>" * 2000 + "</a>" * 2000 + "<link"), ("robot.urdf: line 3", "nested")),
    Malformed("urdf chain of 1000", lambda f: _chain(f, 1000), ("robot.urdf: ", "1005 of them in one chain")),
    Malformed("urdf chain of 5000", lambda f: _chain(f, 5000), ("robot.urdf: ", "one chain")),
    Malformed("urdf outside the folder", toml('"robot.urdf"', '"../robot.urdf"'), ("[robot] urdf", "no ..")),
    # Tables as files.
    Malformed("table of the system", toml('"validation.csv"', '"/proc/self/environ"'), ("[motion.1] table", "no absolute path")),
    Malformed("table in a folder above", toml('"static.csv"', '"../static.csv"'), ("[motion.0] static", "..")),
    Malformed("static names the motion", toml('"static.csv"', '"identification.csv"'), ("[motion.0] static", "moves")),
    Malformed("static copies the motion", lambda f: _copy(f, "identification.csv", "static.csv"), ("static.csv", "same wrench")),
    Malformed("zero bytes", lines(lambda text: [*text[:9], text[9] + "\0", *text[10:]]), ("identification.csv", "zero bytes")),
    Malformed("missing cell, unused column last", lambda f: _short_row(f, False), ("identification.csv: line 32", "11 cells")),
    Malformed("missing cell, quoted header", lambda f: _short_row(f, True), ("identification.csv: line 32", "11 cells")),
    Malformed("missing cell, last column", lines(lambda text: [*text[:30], text[30].rpartition(",")[0], *text[31:]]),
              ("identification.csv: line 31", "10 cells where the header has 11")),
    Malformed("stray comma, quoted header", lines(lambda text: insert_cell([text[0].replace("fx", '"fx"'), *text[1:]])),
              ("identification.csv: line 31", "12 cells")),
    Malformed("no table", remove("validation.csv"), ("validation.csv", "no such file")),
    Malformed("table is a folder", as_folder("validation.csv"), ("validation.csv",)),
    Malformed("no static table", remove("static.csv"), ("static.csv", "no such file")),
    Malformed("empty table", content("identification.csv", b""), ("identification.csv", "empty")),
    Malformed("header only", lines(lambda text: text[:1]), ("identification.csv", "no rows")),
    Malformed("no header", lines(lambda text: text[1:]), ("identification.csv", "line 1", "header")),
    Malformed("semicolons", lines(lambda text: [line.replace(",", ";") for line in text]), ("identification.csv", "semicol")),
    Malformed("binary table", content("identification.csv", bytes(range(256)) * 9), ("identification.csv", "UTF-8")),
    Malformed("stray comma", lines(insert_cell), ("identification.csv", "line 31", "12 cells")),
    Malformed("parquet without its reader or content", toml("validation.csv", "robot.urdf.parquet"),
              ("robot.urdf.parquet", "no such file")),
    # Columns.
    Malformed("no time", table(lambda d: d.rename(columns={"t": "time"})), ("column t is missing", "time")),
    Malformed("no positions", table(lambda d: d.drop(columns=["q1", "q2"])), ("column q1 is missing",)),
    Malformed("one position missing", table(lambda d: d.drop(columns="q2")), ("column q2 is missing", "q1 is there")),
    Malformed("no moment about z", table(lambda d: d.drop(columns="mz")), ("column mz is missing",)),
    Malformed("no wrench", table(lambda d: d[["t", "q1", "q2"]]), ("identification.csv", "fx ... mz", "[sensor]")),
    Malformed("no channel at all", lambda f: _without_sensor(f), ("tau1", "no [sensor]")),
    Malformed("column twice", lines(lambda text: [text[0].replace("q2", "q1"), *text[1:]]), ("column q1", "2 of it")),
    Malformed("static without wrench", table(lambda d: d[["t", "q1", "q2"]].assign(tau1=1.0, tau2=1.0), "static.csv"),
              ("static.csv", "fx ... mz")),
    # Cells.
    Malformed("text in a cell", cell(40, "q2", "n/a!"), ("identification.csv", "column q2", "line 42", '"n/a!"')),
    Malformed("infinite", cell(55, "v1", "-inf"), ("identification.csv", "column v1", "line 57", "-inf")),
    Malformed("decimal comma in quotes", cell(3, "q1", "0,5"), ("column q1", "line 5", '"0,5"')),
    Malformed("a column of nothing", table(lambda d: d.assign(q2=math.nan)), ("identification.csv", "column q2", "in any row")),
    Malformed("mostly empty", table(lambda d: d.assign(fz=d.fz.where(d.index % 3 == 0))),
              ("column fz, line 3", "no reading (267 of 401 rows)", "interpolate")),
    Malformed("times of few digits", table(lambda d: d.assign(t=d.t.round(1))), ("column t, line 3", "repeated", "more digits")),
    Malformed("torque of one joint, in capitals", table(lambda d: d.assign(tau1=1.0, TAU2=1.0)), ("column tau2", "TAU2")),
    Malformed("infinite, below a blank line", lambda f: cell(55, "mx", "inf")(f) or lines(lambda t: [t[0], "", *t[1:]])(f),
              ("column mx", "line 58")),
    Malformed("beyond all", cell(55, "mz", 1e308), ("identification.csv: column mz, line 57", "1e+308", "no reading")),
    # Time.
    Malformed("time goes back", table(restart_clock), ("column t", "line 252", "goes back", "1.5 after 2.49")),
    Malformed("milliseconds", scaled(1e3, "t"), ("identification.csv", "column t", "milliseconds")),
    Malformed("nanoseconds", scaled(1e9, "t"), ("identification.csv", "column t", "nanoseconds")),
    Malformed("milliseconds without velocities", table(lambda d: d.assign(t=1e4 * d["t"]).drop(columns=["v1", "v2"])),
              ("identification.csv", "column t", "milliseconds")),
    Malformed("microseconds without velocities", table(lambda d: d.assign(t=1e6 * d["t"]).drop(columns=["v1", "v2"])),
              ("identification.csv", "column t", "microseconds, steps of 0.01 s")),
    Malformed("nanoseconds since 1970", table(lambda d: d.assign(t=1.79e18 + 1e9 * d["t"]).drop(columns=["v1", "v2"])),
              ("column t", "nanoseconds since 1970, steps of 0.01 s")),
    Malformed("milliseconds since 1970", table(lambda d: d.assign(t=1.79e12 + 1e4 * d["t"]).drop(columns=["v1", "v2"])),
              ("column t", "milliseconds since 1970, steps of 0.1 s")),
    Malformed("row numbers for times", table(lambda d: d.assign(t=range(len(d))).drop(columns=["v1", "v2"])),
              ("column t", "count the rows")),
    Malformed("ten rows", table(lambda d: d.head(10), "validation.csv"), ("validation.csv", "10 rows")),
    # Units and contradictions.
    Malformed("degrees", scaled(DEGREE, "q1", "q2", "v1", "v2"), ("column q1", "shoulder", "degrees")),
    Malformed("velocity in degrees", scaled(DEGREE, "v2"), ("column v2", "elbow", "degrees")),
    Malformed("velocity reversed", scaled(-1.0, "v1"), ("column v1", "shoulder", "sign")),
    Malformed("velocity all zero", scaled(0.0, "v1"), ("column v1", "0 in every row")),
    Malformed("velocity of nothing", scaled(300.0, "v1"), ("column v1", "300 times")),
    Malformed("far outside the limits", cell(99, "q2", 16.0), ("column q2", "elbow", "16", "0.99 s", "2.5")),
    Malformed("wrench all zero", scaled(0.0, "fx", "fy", "fz", "mx", "my", "mz"), ("fx ... mz", "0 in every row")),
    Malformed("other positions in the static table", table(poses_in_static, "static.csv"),
              ("static.csv", "column q2", "281 of 401")),
    # Options.
    Malformed("channel without torques", nothing, ("torque",), identify("--channel", "torque")),
    Malformed("both channels without torques", nothing, ("tau1",), identify("--channel", "both")),
    Malformed("unknown channel", nothing, ("--channel", "wrist"), identify("--channel", "wrist")),
    Malformed("unknown method", nothing, ("method", "olss", "ols"), identify("--method", "olss")),
    Malformed("unknown effect", toml("sensor_offset", "sensor_ofset"), ("[model] effects", "sensor_ofset", "sensor_offset")),
    Malformed("unknown effect, identify", toml("sensor_offset", "sensor_ofset"), ("sensor_ofset", "sensor_offset"), identify()),
    Malformed("effect on an axis that is none", toml("sensor_offset", "sensor_gain@fq"), ("sensor_gain", "fx, fy"), identify()),
    Malformed("effect at an unknown place", nothing, ("joint99",), identify("--effects", "viscous_friction@joint99")),
    Malformed("unknown motion", nothing, ("validatoin",), identify("--motions", "validatoin")),
    Malformed("no such model", nothing, ("no_model.toml", "no such file"), identify("--model", "{folder}/no_model.toml")),
    Malformed("a model that is none", nothing, ("experiment.toml", "unknown key"),
              identify("--model", "{folder}/experiment.toml")),
    Malformed("out is a file", nothing, ("robot.urdf", "file"), identify("--out", "{folder}/robot.urdf")),
    Malformed("filter as text", nothing, ("--filter-l", "ten"), identify("--filter-l", "ten")),
    Malformed("no motion named", nothing, ("--motions names none", "identification, validation"), identify("--motions", "")),
    Malformed("no motion named, diagnose", nothing, ("--motions names none", "identification, validation"),
              lambda folder: ["diagnose", str(folder), "--motions", ""]),
    Malformed("motion named twice", nothing, ("--motions identification", "twice"),
              identify("--motions", "identification,identification")),
    Malformed("bandwidth without end", nothing, ("--bandwidth inf",), identify("--bandwidth", "inf")),
    Malformed("filter next to nothing", nothing, ("low-pass l = 1e-308",), identify("--filter-l", "1e-308")),
    Malformed("validation too short", table(lambda d: d.iloc[60:82], "validation.csv"), ("validation.csv", "record longer"),
              identify("--bandwidth", "2")),
    Malformed("nothing to show", lambda f: _poses_at_rest(f), ("identification.csv", "no parameter", "static"), identify()),
    Malformed("rate without end", nothing, ("inf samples a second", "10,000,000"), simulate("--rate", "inf")),
    Malformed("duration of years", nothing, ("duration = 1e+09 s", "10,000,000"), simulate("--duration", "1e9")),
    Malformed("noise without end", nothing, ("force_std = 1e+300",), simulate("--force-std", "1e300")),
    Malformed("perturbed beyond all", nothing, ("--perturb 1e+300",), simulate("--perturb", "1e300")),
    Malformed("simulate: mass negative", urdf('value="4', 'value="-4'), ("robot.urdf: link upper", "-4 kg"), simulate()),
    Malformed("simulate: no axis", urdf('axis xyz="0.0 1.0 0.0"', 'axis xyz="0 0 0"'), ("joint elbow", "axis"), simulate()),
    Malformed("simulate: joint listed twice", toml('"elbow"]', '"shoulder"]'), ("[robot] joints", "twice"), simulate()),
    Malformed("out cannot be written", nothing, ("--out /proc/nowhere", "name another"), identify("--out", "/proc/nowhere")),
    Malformed("unknown option", nothing, ("--metod",), identify("--metod", "ols")),
]  # fmt: skip


def _cut_motions(folder: Path) -> None:
    path = folder / "experiment.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text[: text.index("[[motion]]")], encoding="utf-8")


def _without_sensor(folder: Path) -> None:
    path = folder / "experiment.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text[: text.index("[sensor]")] + text[text.index("[model]") :], encoding="utf-8")


def _prepend(folder: Path, text: str) -> None:
    path = folder / "robot.urdf"
    path.write_text(text + path.read_text(encoding="utf-8"), encoding="utf-8")


def _poses_at_rest(folder: Path) -> None:
    """Poses from which static readings of the same poses are subtracted."""
    toml("parked = [[0.0, 0.5]]", 'kind = "poses"')(folder)
    table(lambda frame: frame.drop(columns=["v1", "v2"]))(folder)


def _copy(folder: Path, source: str, target: str) -> None:
    (folder / target).write_bytes((folder / source).read_bytes())


def _chain(folder: Path, length: int) -> None:
    """A chain of links that fixed joints connect, behind the arm."""
    links = "".join(f'<link name="k{i}"/>' for i in range(length))
    ends = ["flange", *(f"k{i}" for i in range(length))]
    joints = "".join(
        f'<joint name="j{i}" type="fixed"><parent link="{ends[i]}"/><child link="{ends[i + 1]}"/></joint>' for i in range(length)
    )
    urdf("</robot>", links + joints + "</robot>")(folder)


def _short_row(folder: Path, quoted: bool) -> None:
    """An unused last column, and a row without its ``fx`` cell: pandas would shift the rest of it."""
    table(lambda frame: frame.assign(temp=21.5))(folder)

    def drop(text: list[str]) -> list[str]:
        cells = text[31].split(",")
        del cells[text[0].split(",").index("fx")]
        header = ",".join(f'"{name}"' for name in text[0].split(",")) if quoted else text[0]
        return [header, *text[1:31], ",".join(cells), *text[32:]]

    lines(drop)(folder)
