"""Ways to damage the files of an experiment folder, drawn by hypothesis: a name for the report, and what does it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from hypothesis import strategies as st

from bayesid.effects import EffectLibrary

KINDS = EffectLibrary().classes
NUMBERS = [
    "0",
    "-0.0",
    "1",
    "-1",
    "1e-300",
    "1e-15",
    "1e-9",
    "1e9",
    "-1e9",
    "1e12",
    "1e300",
    "-1e308",
    "1.8e308",
    "inf",
    "-inf",
    "nan",
    "90",
    "-1000",
    "0.5",
    "1e-4",
    "12345678901234567890",
    "7" * 5000,
]
WORDS = [
    "",
    " ",
    "x",
    "é",
    "a b",
    "$x_1$",
    "%s",
    "../x",
    "/etc/passwd",
    "\\n",
    "None",
    "true",
    "0x10",
    "1_0",
    "1,5",
    "x" * 300,
    "\x1b[31m",
]
VALUES = [*NUMBERS, *WORDS]
TOML_VALUES = [
    *NUMBERS,
    "true",
    '""',
    '"x"',
    '"$a_b$"',
    "[]",
    "[1, 2]",
    "[[1]]",
    "{}",
    "{ a = 1 }",
    "1979-05-27",
    "[" * 3000,
    '"' + "x" * 300 + '"',
    "[0, 0, 0]",
    "[1e300, 1, 1]",
    "[0.001, 90.0, 1e6]",
    "[[0.5, 1.0]]",
    "[[1.0, 0.5]]",
    '["sensor_offset"]',
    "0x" + "f" * 5000,
]
PLACES = ["", "@shoulder", "@elbow", "@joint1", "@sensor", "@fx", "@fx->mz", "@base", "@robot", "@nowhere", "@"]
COLUMNS = ["t", "q1", "q2", "v1", "v2", "tau1", "tau2", "fx", "fy", "fz", "mx", "my", "mz"]
TABLES = ["identification.csv", "identification_static.csv", "validation.csv", "validation_static.csv"]


def _text(name: str, change: Callable[[str], str]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        path = folder / name
        path.write_text(change(path.read_text(encoding="utf-8", errors="replace")), encoding="utf-8", newline="")

    return damage


@st.composite
def bytes_damage(draw: st.DrawFn) -> tuple[str, Callable[[Path], None]]:
    """Cut, flip or insert bytes of a file, or take it away."""
    name = draw(st.sampled_from(["experiment.toml", "robot.urdf", *TABLES]))
    kind = draw(st.sampled_from(["cut", "flip", "insert", "remove", "empty", "folder"]))
    share, junk = (
        draw(st.floats(0.0, 1.0)),
        draw(st.sampled_from([b"\0", b"\xff", b'"', b"\n", b"\r", b"<", b"[", b",", b"\xef\xbb\xbf"])),
    )

    def damage(folder: Path) -> None:
        path = folder / name
        if not path.is_file():
            return
        data = path.read_bytes()
        at = min(int(share * len(data)), max(len(data) - 1, 0))
        if kind in ("remove", "folder"):
            path.unlink()
            if kind == "folder":
                path.mkdir()
        elif kind == "flip":
            path.write_bytes(data[:at] + bytes(b ^ 8 for b in data[at : at + 1]) + data[at + 1 :])
        else:
            path.write_bytes({"cut": data[:at], "insert": data[:at] + junk + data[at:], "empty": b""}[kind])

    return f"{kind} {name} at {share:.3g} {junk!r}", damage


@st.composite
def toml_damage(draw: st.DrawFn) -> tuple[str, Callable[[Path], None]]:
    """Another value, or a line more, less or twice, in experiment.toml."""
    kind = draw(st.sampled_from(["value", "value", "value", "number", "drop", "twice", "add"]))
    place, value = draw(st.integers(0, 60)), draw(st.sampled_from(TOML_VALUES))
    key = draw(
        st.sampled_from(
            [
                "parked",
                "period",
                "static",
                "kind",
                "role",
                "inertia_rel_std",
                "position_std",
                "position_resolution",
                "rpy",
                "joint",
                "force_std",
                "gear_ratio",
                "table",
                "unknown",
            ]
        )
    )

    def change(text: str) -> str:
        found = list(re.finditer(r"= *(\[[^=]*?\]|[^\n]+)" if kind == "value" else r"-?\d+\.\d+", text))
        if kind in ("value", "number") and found:
            match = found[place % len(found)]
            return text[: match.start()] + ("= " if kind == "value" else "") + value + text[match.end() :]
        lines = text.splitlines()
        at = place % max(len(lines), 1)
        if kind == "add":
            at = next((k for k in range(at, len(lines)) if lines[k].startswith("[")), len(lines) - 1)
            lines.insert(at + 1, f"{key} = {value}")
        elif kind == "drop":
            del lines[at : at + 1]
        else:
            lines[at:at] = lines[at : at + 1]
        return "\n".join(lines) + "\n"

    return f"toml {kind} {place} {key} {value[:40]}", _text("experiment.toml", change)


@st.composite
def effects_damage(draw: st.DrawFn) -> tuple[str, Callable[[Path], None]]:
    """Effects in [model], with starting values of any size."""
    names = draw(st.lists(st.sampled_from(sorted(KINDS)), min_size=0, max_size=3))
    specs = [name + draw(st.sampled_from(PLACES)) for name in names]
    text = f"[model]\neffects = {specs!r}\n".replace("'", '"')
    for name, spec in zip(names, specs, strict=True):
        if draw(st.booleans()):
            keys = [*KINDS[name].parameters, "fixed", "nothing"]
            key = draw(st.sampled_from(keys))
            text += f'[model.values."{spec}"]\n{key} = {draw(st.sampled_from([*NUMBERS[:19], "true"]))}\n'
    return text.replace("\n", " "), _text("experiment.toml", lambda old: old + "\n" + text)


@st.composite
def table_damage(draw: st.DrawFn) -> tuple[str, Callable[[Path], None]]:
    """Cells, rows and columns of a table."""
    name = draw(st.sampled_from(TABLES))
    kind = draw(
        st.sampled_from(
            [
                "cell",
                "cell",
                "cell",
                "drop cell",
                "add cell",
                "drop row",
                "twice row",
                "head",
                "column value",
                "column scaled",
                "drop column",
                "rename column",
                "blanks",
                "quotes",
                "blank lines",
                "swap rows",
                "extra column",
                "line ends",
            ]
        )
    )
    column, row = draw(st.sampled_from(COLUMNS)), draw(st.integers(1, 150))
    value = draw(st.sampled_from(VALUES))
    factor = draw(st.sampled_from([0.0, -1.0, 1e-9, 1e-3, 57.3, 1e3, 1e6, 1e9, 1e11, 1e300]))
    few = draw(st.integers(0, 30))

    def scaled(cell: str) -> str:
        try:
            return repr(float(cell) * factor)
        except ValueError:
            return cell

    def change(text: str) -> str:
        rows = [line.split(",") for line in text.splitlines()]
        if not rows or column not in rows[0]:
            return text
        j, i = rows[0].index(column), min(row, len(rows) - 1)
        if kind == "line ends":
            return text.replace("\n", "\r")
        if kind == "blank lines":
            return text.replace("\n", "\n\n")
        for k, cells in enumerate(rows):
            here = j < len(cells)
            if kind == "cell" and k == i and here:
                cells[j] = value
            elif kind == "drop cell" and k == i and here:
                del cells[j]
            elif kind == "add cell" and k == i:
                cells.insert(j, value)
            elif kind == "column value" and k and here:
                cells[j] = value
            elif kind == "column scaled" and k and here:
                cells[j] = scaled(cells[j])
            elif kind == "drop column" and here:
                del cells[j]
            elif kind == "rename column" and not k:
                cells[j] = value
            elif kind == "blanks":
                cells[:] = [f" {cell} " for cell in cells]
            elif kind == "quotes":
                cells[:] = [f'"{cell}"' for cell in cells]
            elif kind == "extra column":
                cells.append("temp" if not k else value)
        if kind == "drop row":
            del rows[i]
        elif kind == "twice row":
            rows.insert(i, rows[i])
        elif kind == "swap rows" and len(rows) > 3:
            rows[1], rows[i] = rows[i], rows[1]
        elif kind == "head":
            rows = rows[: few + 1]
        return "\n".join(",".join(cells) for cells in rows) + "\n"

    detail = {"head": few, "column scaled": factor}.get(kind, f"{row} {value[:20]!r}")
    return f"{name} {kind} {column} {detail}", _text(name, change)


@st.composite
def urdf_damage(draw: st.DrawFn) -> tuple[str, Callable[[Path], None]]:
    """Attributes and elements of the URDF."""
    kind = draw(st.sampled_from(["value", "value", "value", "scale", "tag", "drop", "twice", "insert", "chain"]))
    place, value = draw(st.integers(0, 200)), draw(st.sampled_from(VALUES)).replace("<", "")
    factor = draw(st.sampled_from([-1.0, 0.0, 1e-6, 1e-3, 1e3, 1e6, 1e9]))
    junk = draw(
        st.sampled_from(
            [
                "<!-- a -- b -->",
                '<!DOCTYPE r [<!ENTITY a "b">]>',
                "<xacro:x/>",
                "<a>" * 500,
                "&a;",
                "<mimic joint='shoulder'/>",
                "]]>",
                "<mass value='1'/>",
                "<link name='lost'/>",
                '<?xml version="1.0"?>',
                "<inertial/>",
                "<joint name='elbow' type='fixed'/>",
            ]
        )
    )

    def change(text: str) -> str:
        pattern = {"value": r'"[^"]*"', "scale": r'(?:value|i[xyz][xyz])="[^"]*"', "tag": r"<\w+"}.get(kind, r"<[^>]*>")
        found = list(re.finditer(pattern, text))
        if kind == "chain":
            length = [20, 400, 1000, 6000][place % 4]
            links = "".join(f'<link name="k{k}"/>' for k in range(length))
            ends = ["flange", *(f"k{k}" for k in range(length))]
            joints = "".join(
                f'<joint name="j{k}" type="fixed"><parent link="{ends[k]}"/><child link="{ends[k + 1]}"/></joint>'
                for k in range(length)
            )
            return text.replace("</robot>", links + joints + "</robot>")
        if not found:
            return text
        if kind == "scale":

            def scaled(m: re.Match[str]) -> str:
                key, _, number = m[0].partition("=")
                try:
                    return f'{key}="{float(number.strip(chr(34))) * factor!r}"'
                except ValueError:
                    return m[0]

            return re.sub(pattern, scaled, text)
        match = found[place % len(found)]
        new = {"value": f'"{value}"', "tag": "<foreign", "drop": "", "twice": match[0] * 2, "insert": junk + match[0]}[kind]
        return text[: match.start()] + new + text[match.end() :]

    return f"urdf {kind} {place} {value[:20]!r} {factor} {junk[:20]}", _text("robot.urdf", change)


@st.composite
def model_file(draw: st.DrawFn) -> tuple[str, Callable[[Path], None]]:
    """A model.toml, mostly a good one."""
    _, damage = draw(effects_damage())

    def write(folder: Path) -> None:
        (folder / "model.toml").write_text(draw_text, encoding="utf-8")

    draw_text = _written(damage)
    cut = draw(st.sampled_from([None, None, None, 10, 30]))
    draw_text = draw_text[:cut]
    return f"model.toml {draw_text[:200]!r}", write


def _written(damage: Callable[[Path], None]) -> str:
    """What a damage would append to an empty experiment.toml."""
    import tempfile

    with tempfile.TemporaryDirectory() as place:
        (Path(place) / "experiment.toml").write_text("")
        damage(Path(place))
        return (Path(place) / "experiment.toml").read_text()
