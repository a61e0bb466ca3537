"""The main job on an embedded example: the two-joint PUMA of [Liu1998]_, simulated, identified, compared with truth."""

from __future__ import annotations

import json
import math
import shutil
import tempfile
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from bayesid.argument_types import explains_types
from bayesid.arguments import argument
from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment, Sensor
from bayesid.results.files import check_output
from bayesid.results.identification import Identification, summary
from bayesid.robot.robot import load_robot
from bayesid.simulation.simulation import Recorder, Simulation, simulate, write_simulation
from bayesid.simulation.trajectories import fourier_trajectory
from bayesid.workflows.identify import identify
from bayesid.workflows.progress import Progress, quiet

NAME = "two-joint-puma"
#: Angles of the joints that the paper's experiment held still [rad]; q3 = -142.1 degrees is a full turn below 217.9 degrees,
#: which is within the joint's range.
PAPER_LOCKED = {"joint3": math.radians(-142.1), "joint4": 0.0, "joint5": 0.0, "joint6": 0.0}

_GEAR = (62.6111, 107.815)
_VISCOUS = (1.48e-3, 8.17e-4)  # at the motor [N m s/rad]
_COULOMB = ((0.395, 0.435), (0.126, 0.071))  # at the motor, forwards and backwards [N m]


def puma_two_joint_urdf() -> str:
    """URDF text of a PUMA 560 in link frames that give the paper's base parameters; written by ``tests/example_robots.py``.

    Joints ``joint1`` and ``joint2`` move; hold the others at `PAPER_LOCKED`, so their links belong to link 2.
    """
    return files("bayesid.robot").joinpath("puma_two_joint.urdf").read_text(encoding="utf-8")


def puma_friction() -> dict[str, dict[str, float]]:
    """Friction of the PUMA 560's joints 1 and 2, as effects of a plant.

    Viscous and Coulomb friction as measured at the motors, at the joint multiplied by the gear ratio squared and
    the gear ratio: P. Corke, B. Armstrong-Helouvry, "A search for consensus among model parameters reported for
    the PUMA 560 robot", IEEE ICRA 1994. Half the difference of the two senses is an offset. Stribeck friction
    (30 % of the Coulomb level below about 0.05 rad/s) and friction growing with load (5 %) are assumed.
    """
    out: dict[str, dict[str, float]] = {}
    for j, (gear, viscous, (forwards, backwards)) in enumerate(zip(_GEAR, _VISCOUS, _COULOMB, strict=True), 1):
        level = 0.5 * (forwards + backwards) * gear
        out |= {
            f"viscous_friction@joint{j}": {"coefficient": viscous * gear**2},
            f"coulomb_friction@joint{j}": {"level": level},
            f"torque_offset@joint{j}": {"offset": 0.5 * (forwards - backwards) * gear},
            f"stribeck_friction@joint{j}": {"level": 0.3 * level, "velocity": 0.05},
            f"load_friction@joint{j}": {"coefficient": 0.05},
        }
    return out


def puma_setup(folder: Path) -> Experiment:
    """The two-joint PUMA on a strain-gauge platform, nothing recorded yet; writes its URDF into the folder."""
    urdf = folder / "robot.urdf"
    urdf.write_text(puma_two_joint_urdf(), encoding="utf-8")
    return Experiment(
        name=NAME, robot=load_robot(urdf, ["joint1", "joint2"], PAPER_LOCKED), motions=(),
        sensor=Sensor(translation=np.array([0.0, 0.0, -0.08])), locked=dict(PAPER_LOCKED),
        gear_ratio={"joint1": _GEAR[0], "joint2": _GEAR[1]},
    )  # fmt: skip


def demo_experiment(folder: Path, seed: int = 0) -> Simulation:
    """Simulate the demo's recordings: links 10 % off the nominal model, offsets, friction, encoder counts, static runs."""
    setup = puma_setup(folder)
    motions = [
        fourier_trajectory(setup.robot, duration=20.0, static=True, seed=seed),
        fourier_trajectory(setup.robot, "validation", "validation", duration=12.0, fundamental=0.17, static=True, seed=seed + 1),
    ]
    plant = puma_friction() | {"sensor_offset": {"fx": 14.0, "fy": -9.0, "fz": 26.0, "mx": 1.6, "my": -2.1, "mz": 0.7}}
    recorder = Recorder(resolution=1e-4, force_std=0.5, torque_std=0.05)
    return simulate(setup, motions, effects=plant, perturb=0.1, recorder=recorder, seed=seed)


@dataclass(frozen=True)
class Demo:
    """What the demo found.

    Attributes
    ----------
    result
        The identification.
    truth
        True base parameters (r,).
    report
        Path of the report.
    """

    result: Identification
    truth: np.ndarray
    report: Path

    def __repr__(self) -> str:
        return f"<Demo of {self.result!r}>"

    @property
    def inside(self) -> np.ndarray:
        """Which true values lie inside their 95 % intervals (r,)."""
        return (self.result.estimate.low <= self.truth) & (self.truth <= self.result.estimate.high)

    def __str__(self) -> str:
        """Summary, and every estimate beside the truth."""
        estimate = self.result.estimate
        width = max(map(len, estimate.base.labels))
        lines = [summary(self.result), "", f"  {'base parameter':<{width}}  {'truth':>9} {'estimate':>9}  95 % interval"]
        rows = zip(estimate.base.labels, self.truth, self.result.values, estimate.low, estimate.high, self.inside, strict=True)
        for label, truth, value, low, high, inside in rows:
            missed = "" if inside else "  misses the truth"
            lines.append(f"  {label:<{width}}  {truth:9.4f} {value:9.4f}  {low:.4f} to {high:.4f}{missed}")
        lines.append(f"  {int(self.inside.sum())} of {len(self.truth)} intervals hold the truth; 95 % of them should")
        return "\n".join(lines)


@explains_types
def demo(out: str | Path, seed: int = 0, progress: Progress = quiet) -> Demo:
    """Simulate, identify, compare with the truth; write the results and the experiment folder.

    Parameters
    ----------
    out
        Folder for the results; ``experiment`` in it is replaced if it is an earlier demo's.
    seed
        Of everything random.
    progress
        Called with the name of every stage.

    Raises
    ------
    InputError
        The folder holds an experiment of someone else's.
    """
    out = check_output(out)
    folder = out / "experiment"
    if folder.exists() and not _ours(folder):
        raise InputError(f"{folder}: is there already and no earlier demo's; name another {argument('folder')}")
    with tempfile.TemporaryDirectory() as temporary:
        progress("simulating")
        experiment = demo_experiment(Path(temporary), seed)
        result = identify(experiment, progress=progress)
        progress("report")
        report = result.write(out)
        if folder.exists():
            shutil.rmtree(folder)
        write_simulation(experiment, folder)
    truth = result.base.matrix @ experiment.truth.links.ravel()
    return Demo(result, truth, report)


def _ours(folder: Path) -> bool:
    """Whether the folder holds what a demo wrote and nothing else."""
    names = {"experiment.toml", "robot.urdf", "truth.json"} | {
        f"{motion}{kind}.csv" for motion in ("identification", "validation") for kind in ("", "_static")
    }
    if not folder.is_dir() or {path.name for path in folder.iterdir()} - names:
        return False
    truth = folder / "truth.json"
    return truth.is_file() and "true_links" in json.loads(truth.read_text(encoding="utf-8"))
