"""Public recordings of real robots: what there is, where it is from, what is known of it, and each as an experiment.

Nothing of them comes with this package: files are fetched from where their authors published them, checked, and read as these
say that they are to be read.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
from scipy.interpolate import CubicSpline

from bayesid.argument_types import explains_types
from bayesid.errors import InputError, required
from bayesid.recordings.complaints import suggest
from bayesid.recordings.experiment import Experiment, load_experiment
from bayesid.recordings.table import Table
from bayesid.recordings.writer import write_experiment
from bayesid.workflows.read_recording import read_recording

if TYPE_CHECKING:
    from pandas import DataFrame

__all__ = ["Dataset", "RemoteFile", "about", "fetch", "load", "names", "table"]

#: Names the folder with copies of experiments.
OWN_COPIES = "BAYESID_DATA"
_PATIENCE = 60.0  # s without an answer
_RECIPES = b"1"  # counts changes of what is made of the files


@dataclass(frozen=True)
class RemoteFile:
    """A file of a data set as its authors published it."""

    name: str  # what the recipe calls it; names differ within a data set
    url: str  # where it is, at a state that does not change
    #: Checksum, and length [bytes].
    sha256: str
    size: int


@dataclass(frozen=True)
class Dataset:
    """A public recording.

    Attributes
    ----------
    name
        What it is fetched by.
    summary
        Robot and readings.
    licence
        As its authors state it; "none stated": use it, and do not pass it on.
    page
        Where it is described.
    known
        What is known of the right answer, for comparison.
    files
        What is fetched.
    make
        Makes the experiment of these files by name; None: it is known, and not fetched.
    folder
        Where a copy of the experiment is below the folder that ``BAYESID_DATA`` names.
    """

    name: str
    summary: str
    licence: str
    page: str
    known: str
    files: tuple[RemoteFile, ...]
    make: Callable[[Mapping[str, Path]], Experiment] | None
    folder: str

    @property
    def size(self) -> int:
        """Length of all files [bytes]."""
        return sum(file.size for file in self.files)

    def __str__(self) -> str:
        """All that is known of it."""
        size = (
            f"{self.size / 1e6:.1f} MB in {len(self.files)} file{'s' * (len(self.files) != 1)}" if self.files else "not fetched"
        )
        return f"{self.name}: {self.summary}\n  from {self.page}, {size}; licence: {self.licence}\n  known: {self.known}"


_FRICTION = ("viscous_friction", "coulomb_friction", "torque_offset")
UR_JOINTS = tuple(f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"))
#: Torque over motor current of the UR10e [N m/A]: the controller's own desired torque over its desired current while the arm
#: stands still before it moves, which joints 2 to 4 tell; joint 1 has joint 2's drive, joints 5 and 6 have joint 4's. Perhaps 2 %
#: off each.
UR10E_GAINS = (11.976, 11.976, 9.839, 10.763, 10.763, 10.763)
#: A recording of the UR10e is used while the arm moves [rad/s], and this long [s] before and after, at even steps [s].
UR10E_MOVING, UR10E_MARGIN, UR10E_STEP = 0.005, 0.3, 0.01
#: Gears of the TX40 from its data sheet; its motors' zeros of joints 2 and 3 are a quarter turn off; samples averaged into one.
_TX40_RATIOS, _TX40_ZEROS, _TX40_AVERAGED = (32.0, 32.0, 45.0, -48.0, 45.0, 32.0), (0.0, -0.5, 0.5, 0.0, 0.0, 0.0), 10
_TX40_STEP, _TX40_FITTED = 2e-4, 4.4  # s
_MED7_STEP, _MED7_FITTED = 0.01, 0.7  # s; share of the recording


def kuka_lwr4(files: Mapping[str, Path]) -> Experiment:
    """Positions, velocities and torques of FloBaRoID's arrays as they are."""
    tables = []
    for name in ("measurements_1", "measurements_3"):
        with np.load(files[f"{name}.npz"], allow_pickle=False) as arrays:
            t = arrays["times"].ravel() - arrays["times"].ravel()[0]
            tables.append(Table(t, arrays["positions"], torques=arrays["torques"], velocities=arrays["velocities"], source=name))
    joints = [f"lwr_{k}_joint" for k in range(7)]
    return _experiment("kuka-lwr4", files["robot.urdf"], joints, tables, inertia_rel_std=0.3)


def med7(files: Mapping[str, Path]) -> Experiment:
    """The torques' sign is turned; the file has no times, its authors took 10 ms."""
    rows = np.genfromtxt(files["measurements.csv"], delimiter=",", names=True)
    q, torques = (np.column_stack([rows[f"{kind}_{k}"] for k in range(7)]) for kind in ("q", "tau"))
    t = _MED7_STEP * np.arange(len(q))
    cut = int(_MED7_FITTED * len(q))
    parts = {"identification": slice(cut), "validation": slice(cut, None)}
    tables = [Table(t[part], q[part], torques=-torques[part], source=role) for role, part in parts.items()]
    return _experiment("med7", files["robot.urdf"], [f"A{k}" for k in range(1, 8)], tables)


def tx40(files: Mapping[str, Path]) -> Experiment:
    """Motors over their gears, without the coupling of the wrist, averages of ten samples."""
    motor, torque = (np.loadtxt(files[f"{name}.csv"], delimiter=",", skiprows=1) for name in ("positions", "torques"))
    count = len(motor) // _TX40_AVERAGED * _TX40_AVERAGED
    ratio = np.array(_TX40_RATIOS)
    q = motor / ratio + np.pi * np.array(_TX40_ZEROS)
    t, q, torques = (
        values[:count].reshape(count // _TX40_AVERAGED, _TX40_AVERAGED, -1).mean(axis=1)
        for values in (_TX40_STEP * np.arange(len(motor)), q, torque * ratio)
    )
    t = t.ravel()
    parts = {"identification": t < _TX40_FITTED, "validation": (t > _TX40_FITTED) & (t < _TX40_FITTED + 3.2)}
    tables = [Table(t[part], q[part], torques=torques[part], source=role) for role, part in parts.items()]
    joints = [f"joint_{k}" for k in range(1, 7)]
    return _experiment(
        "tx40", files["robot.urdf"], joints, tables, effects=(*_FRICTION, "rotor_inertia"), position_resolution=3e-6
    )


def ur10(files: Mapping[str, Path]) -> Experiment:
    """Joint states of the bag; efforts are torques already.

    The URDF has the UR10's kinematics and masses; centres of mass and inertias are placeholders, so this is no prior.
    """
    joints = [f"joint{k}" for k in range(1, 7)]
    with tempfile.TemporaryDirectory() as folder:
        urdf = _packaged_urdf(folder, "ur10")
        made = read_recording(
            files["ur10.db3"], urdf, joint_names=dict(zip(joints, UR_JOINTS, strict=True)), hold_out=0.4, name="ur10"
        )
    return replace(made.experiment, inertia_rel_std=1.0)


def ur10e(files: Mapping[str, Path], name: str) -> Experiment:
    """Positions, and motor currents times drive gains, while the arm moves, at even times.

    The URDF is as Universal Robots publishes the UR10e ("DH parameters for calculations of kinematics and dynamics").
    """
    rows = ur10e_rows(np.loadtxt(files["recording.csv"], delimiter=","))
    table = Table(rows[:, 0], rows[:, 1:7], torques=rows[:, 7:], source="motion")
    with tempfile.TemporaryDirectory() as folder:
        urdf = _packaged_urdf(folder, "ur10e")
        return _experiment(name, urdf, UR_JOINTS, [table], effects=_FRICTION, position_resolution=1e-4)


def ur10e_rows(raw: np.ndarray) -> np.ndarray:
    """Times [s], joint positions [rad] and torques [N m] at 100 Hz (k, 13) of a recording's rows (N, 31).

    A raw row is the time, then six each of position, velocity, motor current, and the controller's desired current and torque.
    Samples come every 10 or 12 ms, some later; a cubic spline goes through them. Nothing is filtered.
    """
    times, speeds = raw[:, 0] - raw[0, 0], np.abs(raw[:, 7:13]).max(axis=1)
    moving = times[speeds > UR10E_MOVING]
    start, end = max(times[0], moving[0] - UR10E_MARGIN), min(times[-1], moving[-1] + UR10E_MARGIN)
    grid = np.arange(start, end, UR10E_STEP)
    return np.column_stack([grid, CubicSpline(times, np.hstack([raw[:, 1:7], raw[:, 13:19] * UR10E_GAINS]))(grid)])


def _experiment(name: str, urdf: Path, joints: tuple[str, ...] | list[str], tables: list[Table], **knowledge) -> Experiment:
    """An experiment whose first table is fitted and whose others are predicted; motions are named by the tables' sources."""
    first = tables[0]
    made = Experiment.from_arrays(
        urdf, first.times, first.positions, torques=first.torques, velocities=first.velocities, validation=tables[1:],
        joints=joints, name=name, **knowledge,
    )  # fmt: skip
    return replace(made, motions=tuple(replace(m, name=table.source) for m, table in zip(made.motions, tables, strict=True)))


def _packaged_urdf(folder: str, name: str) -> Path:
    """A URDF of this package, in a folder; written by ``tests/dh_robots.py`` from tables of the maker."""
    path = Path(folder) / "robot.urdf"
    path.write_text(files("bayesid.robot").joinpath(f"{name}.urdf").read_text(encoding="utf-8"), encoding="utf-8")
    return path


def _github(
    repository: str, commit: str, files: Mapping[str, tuple[str, int, str]], *, large: bool = False
) -> tuple[RemoteFile, ...]:
    """Files of a repository at a commit by name: path, length and checksum; ``large``: kept beside it, in Git LFS."""
    host = "media.githubusercontent.com/media" if large else "raw.githubusercontent.com"
    return tuple(
        RemoteFile(name, f"https://{host}/{repository}/{commit}/{path}", sha256, size)
        for name, (path, size, sha256) in files.items()
    )


_FLOBAROID = ("kjyv/FloBaRoID", "9c0680445e874947bac4056cd86ff9e26bdd7fcb")
_SOLVER = ("unisa-acg/inverse-dynamics-solver", "41e196de5ca340f2b48e443484a7c74a77533da4")
_FIGAROH = ("thanhndv212/figaroh-plus", "c3b5172849b744984b7181fd9d517c83fb4242e1")
_UR10E = ("shamilmamedov/dynamic_calibration", "11af40e7deb758ec080a175fed8fcdd6c99aca29")
_MED7 = ("lbr-stack/dynamic_parameter_identification", "58b4d88014db54cdecac66fcc059b2c9fa131e46")

_SETS = [
    Dataset(
        "kuka-lwr4", "KUKA LWR4+, seven joints with torque sensors behind the gears; two motions of 25 s", "LGPL-3.0",
        "https://github.com/kjyv/FloBaRoID",
        "CAD is off by 10 to 12 % in torque; least squares with friction fits motion 1 to 2 % and predicts motion 3 with 12.5 to "
        "14 %",
        (
            *_github(*_FLOBAROID, {
                "measurements_1.npz": ("data/KUKA/HW/measurements_1.npz", 2012328,
                    "55b94c07e86a75311a584cc945c4436e7a5dbeafd5f7378a53225a0dd820c1fd"),
                "measurements_3.npz": ("data/KUKA/HW/measurements_3.npz", 2012328,
                    "4ca527bbac6d6f299e9478451c6b1f059672bf38859e218b0b37fc20bd783acd"),
            }, large=True),
            *_github(*_FLOBAROID, {
                "robot.urdf": ("model/kuka_lwr4.urdf", 15219,
                    "8fd76631f12b38404812bc343e998cc9ca3af18d850856c5b050b39ab6fc62ad"),
            }),
        ),
        kuka_lwr4, "data/kuka-lwr4",
    ),
    Dataset(
        "med7", "KUKA LBR Med 7, joint torques of its interface; one motion of 16 s, its last 30 % held out", "MIT",
        "https://github.com/lbr-stack/dynamic_parameter_identification",
        "torques are recorded with the opposite sign, which is mended here; the nominal URDF predicts them with 23 %, least "
        "squares with friction fits 3.9 % and predicts 16.9 %",
        _github(*_MED7, {
            "measurements.csv": ("src/test/measurements.csv", 630880,
                "a1c7d3fb1c0e0224e938b5d3d0d72042534573072905f661a07f31dfa2addd4d"),
            "robot.urdf": ("urdf/med/med7dock.urdf", 17287,
                "29b19bce6d82a5a991ad3a7d24da87ee19194ad165eaeb63911de824276f43de"),
        }),
        med7, "wild/03-med7-real/flipped",
    ),
    Dataset(
        "tx40", "Staubli TX40, motor positions and torques; one motion of 8 s", "Apache-2.0",
        "https://github.com/thanhndv212/figaroh-plus",
        "the wrist is coupled, and the experiment does not know it: joint 5 turns motor 6, too. Without the coupling 135 % and "
        "67 % error in joints 5 and 6, with it 26 % and 31 %",
        _github(*_FIGAROH, {
            "positions.csv": ("examples/staubli_TX40/data/pos_read_data.csv", 2101824,
                "5cc1cecc1024ef0e331d0caba06f689456ab789ec3f1e904599c0a8be5c27bc8"),
            "torques.csv": ("examples/staubli_TX40/data/curr_data.csv", 2357129,
                "f4592f4ba4db42f5d7625688986be25b575ca34d0504b27979ca6b0276bd3af9"),
            "robot.urdf": ("models/staubli_tx40_description/urdf/tx40_mdh_modified.urdf", 7448,
                "3d00cbd46279c915d594b1bb4610dbac78d1e99ed27f95de70984bde13486074"),
        }),
        tx40, "data/tx40",
    ),
    Dataset(
        "ur10", "Universal Robots UR10, torques from motor currents; a ROS 2 bag of 27.5 s, its last 40 % held out",
        "BSD-3-Clause",
        "https://github.com/unisa-acg/inverse-dynamics-solver",
        "least squares with friction, rank 58, fits 6.5 % and predicts 9.1 %; the robot's centres of mass and inertias are "
        "placeholders",
        _github(*_SOLVER, {
            "ur10.db3": ("ur10_inverse_dynamics_solver/bagfiles/ur10_exciting_trajectory.db3", 1257472,
                "14244fc39e9b42047039824f3c20ab984f9d1b28d5a67e9415cc1b3cc0ac3369"),
        }),
        ur10, "data/ur10",
    ),
]  # fmt: skip

#: By folder: the recording's file, checksum and length.
_UR10E_FILES = {
    "before": ("ur-20_01_31-unload.csv", "513feea3e662364fad89214d5ff49e6ef96e02d56f85b4de57a408fc2563cb1c", 620666),
    "after-load": ("ur-20_01_31-load.csv", "5abab622cdbd53db78fe3ec72485535c55ec5db412a179ae26bb9da6bea5441c", 684549),
    "feb05-20s-12h": ("ur-20_02_05-20sec_12harm.csv", "642b590251f09df3151dc5dcc406748aacc248cba1d39ed80035a806824f159e", 731098),
    "feb05-20s-8h": ("ur-20_02_05-20sec_8harm.csv", "5456696773b5e3e12510640aab6049c65f4259c99880951bd71e1c74f8cb44e5", 593204),
    "feb06-20s-10h": ("ur-20_02_06-20sec_10harm.csv", "8959c47c991221e88a467a584c756a2f0f17c8268a291437709513cc112739c8", 797486),
    "feb06-20s-5h": ("ur-20_02_06-20sec_5harm.csv", "fd4d10b39211a5ad1d2f67b62bd3e66b01a0275d518fd2fd2f0876ea520903a4", 690095),
}
for _label, (_file, _sha256, _size) in _UR10E_FILES.items():
    _load = _label == "after-load"
    _known = "least squares with friction predicts another unloaded motion with 6 %"
    _known = "against ur10e-before the payload is found at 2.76 +- 0.05 kg" if _load else _known
    _SETS.append(Dataset(
        f"ur10e-{_label}",
        f"Universal Robots UR10e, torques from currents, {'2.805 kg at the flange' if _load else 'unloaded'}; one motion of 23 s",
        "none stated", "https://github.com/shamilmamedov/dynamic_calibration",
        f"{_known}; drive gains are perhaps 2 % off each",
        _github(*_UR10E, {"recording.csv": (f"dataset_ur10e/identification_data/{_file}", _size, _sha256)}),
        partial(ur10e, name=f"ur10e-{_label}"), f"data/ur10e/{_label}",
    ))  # fmt: skip
_SETS.append(Dataset(
    "kuka-med-wrist", "a six-axis sensor (ATI Gamma) at a KUKA arm, under a rigid tool; 24 poses, motions of 6 s, hammer taps",
    "none stated", "https://zenodo.org/records/11075230",
    "the poses alone: 0.9323 kg, centre of mass (0.28, 0.05, 43.90) mm; the tool's inertia is practically not excited",
    (), None, "data/kuka-med-wrist",
))  # fmt: skip

#: All, by name.
DATASETS = {dataset.name: dataset for dataset in _SETS}


def names() -> tuple[str, ...]:
    """Names of the data sets."""
    return tuple(DATASETS)


def about(name: str) -> Dataset:
    """What is known of a data set.

    Raises
    ------
    InputError
        There is none of that name.
    """
    if name not in DATASETS:
        raise InputError(f"{name}: no such data set; {suggest(name, DATASETS, 'one of')}")
    return DATASETS[name]


def table() -> DataFrame:
    """The data sets, a row each."""
    from pandas import DataFrame

    return DataFrame(
        {"name": d.name, "summary": d.summary, "licence": d.licence, "megabytes": d.size / 1e6, "page": d.page, "known": d.known}
        for d in DATASETS.values()
    )


def fetch(name: str, cache: str | Path | None = None) -> Path:
    """The experiment folder of a public recording.

    A copy below the folder that the environment variable ``BAYESID_DATA`` names is taken first; else its files are fetched
    once, checked and kept.

    Parameters
    ----------
    name
        One of `bayesid.datasets.names`.
    cache
        Where fetched files and what is made of them are kept; default: the user's folder for such files.

    Raises
    ------
    InputError
        There is no such data set, the package pooch is missing, a file cannot be had, or it is not the one that was published.
    """
    dataset = about(name)
    if OWN_COPIES in os.environ:
        own = Path(os.environ[OWN_COPIES]) / dataset.folder
        if (own / "experiment.toml").is_file():
            return own
    if dataset.make is None:
        raise InputError(
            f"{name}: is not fetched; make an experiment folder of what is at {dataset.page}, and put it into "
            f"{dataset.folder} below the folder that {OWN_COPIES} names"
        )
    by_hand = f"or put the experiment folder into {dataset.folder} below the folder that {OWN_COPIES} names"
    pooch = required("pooch", InputError(f'{name}: fetching it needs pooch; pip install "bayesid[datasets]", {by_hand}'))
    cache = Path(pooch.os_cache("bayesid") if cache is None else cache)
    digest = hashlib.sha256(b"".join([_RECIPES, *(file.sha256.encode() for file in dataset.files)])).hexdigest()
    made = cache / "experiments" / f"{name}-{digest[:12]}"
    if not (made / "experiment.toml").is_file():
        files = {file.name: _fetched(pooch, file, cache / "files", dataset, by_hand) for file in dataset.files}
        write_experiment(dataset.make(files), made)
    return made


@explains_types
def load(name: str, cache: str | Path | None = None) -> Experiment:
    """A public recording as an experiment; parameters and errors as `fetch`."""
    return load_experiment(fetch(name, cache))


def _fetched(pooch: Any, file: RemoteFile, folder: Path, dataset: Dataset, by_hand: str) -> Path:
    """A file as it was published; files are kept by their checksum."""
    pooch.get_logger().setLevel("WARNING")
    try:
        return Path(
            pooch.retrieve(file.url, f"sha256:{file.sha256}", f"{file.sha256[:16]}-{file.name}", folder, downloader=_download)
        )
    except ValueError:  # pooch's word for another checksum
        raise InputError(
            f"{dataset.name}: {file.url} is not what was published: its SHA256 is not {file.sha256[:16]}...; try again, or "
            f"get it from {dataset.page} and tell us"
        ) from None
    except OSError as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{dataset.name}: {file.url} cannot be fetched ({reason}); connect to the network, {by_hand}") from None


def _download(url: str, output: str, _pooch: Any) -> None:
    """Write what is at an address into a file; pooch's own leaves its sockets open."""
    try:
        with urlopen(url, timeout=_PATIENCE) as answer, open(output, "wb") as file:
            shutil.copyfileobj(answer, file)
    except HTTPError as error:
        error.close()
        raise
