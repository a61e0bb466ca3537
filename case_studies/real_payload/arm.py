"""A UR10e's recordings as experiment folders.

Recordings come from a clone of github.com/shamilmamedov/dynamic_calibration, or from folders that were made of them before.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from bayesid.datasets import UR_JOINTS, ur10e_rows

COMMIT = "11af40e7"
#: Below the clone; how a clone is told from ready folders.
RAW = Path("dataset_ur10e") / "identification_data"
EFFECTS = ("viscous_friction", "coulomb_friction", "torque_offset")


@dataclass(frozen=True)
class Recording:
    """One recording: the experiment folder's name, the raw file, the ready table, and whether the payload was on."""

    name: str
    file: str
    ready: str | None = None
    loaded: bool = False


BEFORE = Recording("before", "ur-20_01_31-unload.csv", "before/unload.csv")
AFTER = Recording("after", "ur-20_01_31-load.csv", "after-load/load.csv", loaded=True)
#: In the order in which they were recorded, after BEFORE; names are dates. ur-20_02_19_15harm50secLoad.csv is left out, because
#: rows of it are broken.
SERIES = (
    AFTER,
    Recording("feb05-12", "ur-20_02_05-20sec_12harm.csv", "feb05-20s-12h/motion.csv"),
    Recording("feb05-8", "ur-20_02_05-20sec_8harm.csv", "feb05-20s-8h/motion.csv"),
    Recording("feb06-10", "ur-20_02_06-20sec_10harm.csv", "feb06-20s-10h/motion.csv"),
    Recording("feb06-5", "ur-20_02_06-20sec_5harm.csv", "feb06-20s-5h/motion.csv"),
    Recording("feb10-7", "ur-20_02_10-20sec_7harm.csv"),
    Recording("feb10-12", "ur-20_02_10-30sec_12harm.csv"),
    Recording("feb12-40s", "ur-20_02_12-40sec_12harm.csv"),
    Recording("feb12-50s", "ur-20_02_12-50sec_12harm.csv"),
    Recording("feb19-14", "ur-20_02_19_14harm50sec.csv"),
    Recording("feb19-14-load", "ur-20_02_19_14harm50secLoad.csv", loaded=True),
    Recording("feb19-15", "ur-20_02_19_15harm50sec.csv"),
)
#: Another day's motion, which the unloaded arm's model has to predict.
OTHER_DAY = SERIES[2]


def is_clone(source: Path) -> bool:
    """Whether a folder is the clone, and not one of ready folders."""
    return (source / RAW).is_dir()


def available(source: Path, recording: Recording) -> bool:
    """Whether a source has a recording."""
    if is_clone(source):
        return (source / RAW / recording.file).exists()
    return recording.ready is not None and (source / recording.ready).exists()


def table(source: Path, recording: Recording) -> np.ndarray:
    """Times [s], joint positions [rad] and torques [N m] of a recording, 100 Hz (k, 13).

    As `bayesid.datasets` reads them.
    """
    if not is_clone(source):
        return np.genfromtxt(source / str(recording.ready), delimiter=",", skip_header=1)
    return ur10e_rows(np.loadtxt(source / RAW / recording.file, delimiter=","))


def write_folder(folder: Path, motions: dict[str, tuple[str, np.ndarray]]) -> None:
    """Write an experiment folder: the role and the table of every motion by its name."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_bytes(files("bayesid.robot").joinpath("ur10e.urdf").read_bytes())
    lines = [
        "format = 1", f'name = "{folder.name}"', "", "[robot]", 'urdf = "robot.urdf"',
        f"joints = {_listed(UR_JOINTS)}",
        "position_resolution = 1e-4   # the recording holds four decimals", "",
        "[model]", f"effects = {_listed(EFFECTS)}",
    ]  # fmt: skip
    heads = ["t", *(f"{kind}{j + 1}" for kind in ("q", "tau") for j in range(len(UR_JOINTS)))]
    for name, (role, columns) in motions.items():
        lines += ["", "[[motion]]", f'name = "{name}"', f'role = "{role}"', f'table = "{name}.csv"']
        formats = ["%.3f"] + 6 * ["%.5f"] + 6 * ["%.4f"]
        np.savetxt(folder / f"{name}.csv", columns, fmt=formats, delimiter=",", header=",".join(heads), comments="")
    (folder / "experiment.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _listed(names: Iterable[str]) -> str:
    return json.dumps(list(names))  # TOML writes a list of strings as JSON does


def prepare(source: Path, target: Path) -> list[Recording]:
    """Write a folder for every recording there is; the recordings.

    Two more hold the unloaded recording and one to be predicted: another day's in ``arm``, the loaded one in ``surprise``.

    Raises
    ------
    FileNotFoundError
        Where the source lacks one of the three recordings of the case study's first part.
    """
    needed = (BEFORE, AFTER, OTHER_DAY)
    if missing := [r.file for r in needed if not available(source, r)]:
        raise FileNotFoundError(f"{source}: neither a clone of dynamic_calibration nor ready folders, it lacks {missing[0]}")
    found = [r for r in SERIES if available(source, r)]
    tables = {r.name: table(source, r) for r in (BEFORE, *found)}
    for name, columns in tables.items():
        write_folder(target / name, {"motion": ("identification", columns)})
    first = ("identification", tables[BEFORE.name])
    write_folder(target / "arm", {"jan31": first, "feb05": ("validation", tables[OTHER_DAY.name])})
    write_folder(target / "surprise", {"unloaded": first, "loaded": ("validation", tables[AFTER.name])})
    return found
