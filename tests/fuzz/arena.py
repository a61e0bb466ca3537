"""A small experiment to be damaged, the process that runs the verbs on it, and what must hold however a run ends."""

from __future__ import annotations

import json
import os
import selectors
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import bayesid
from bayesid.robot.robot import load_robot
from bayesid.simulation.simulation import Recorder, simulate, write_simulation
from bayesid.simulation.trajectories import new_trajectories
from tests.malformed import URDF

ROOT = Path(__file__).parents[2]
#: No run may take more of the processor's time [s], nor hang for longer than that.
LONGEST, HANGING = 60.0, 600.0


def write_arm(folder: Path) -> Path:
    """Write an experiment of the two-joint arm: wrench, torques and velocities, a static run, 3 s at 50 Hz."""
    (folder / "robot.urdf").write_text(URDF, encoding="utf-8")
    robot = load_robot(folder / "robot.urdf", ["shoulder", "elbow"], {"wrist": 0.1})
    motions = new_trajectories(robot, 3.0, 50.0, static=True, seed=5)
    setup = bayesid.Experiment(
        "arm", robot, (), bayesid.Sensor(translation=(0.0, 0.0, -0.1)), inertia_rel_std=0.2, position_resolution=1e-4,
        locked={"wrist": 0.1},
    )  # fmt: skip
    made = simulate(setup, motions, perturb=0.1, recorder=Recorder(velocity_std=1e-3, drive_std=1e-3), seed=7)
    write_simulation(made, folder / "arm")
    (folder / "robot.urdf").unlink()
    (folder / "arm" / "truth.json").unlink()
    return folder / "arm"


@dataclass
class Run:
    """How a command line ended.

    Attributes
    ----------
    status
        Exit status; a text where there is none: how the process died.
    out, err
        What was printed.
    """

    status: int | str
    out: str
    err: str


class Worker:
    """A process that runs command lines, started anew when one of them kills it."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[str] | None = None

    def run(self, arguments: list[str], folder: Path) -> Run:
        """Run one command line in a folder."""
        if self.process is None:
            environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
            self.process = subprocess.Popen(
                [sys.executable, str(Path(__file__).with_name("worker.py"))], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                cwd=ROOT, env=environment, text=True,
            )  # fmt: skip
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(json.dumps({"arguments": arguments, "folder": str(folder), "longest": LONGEST}) + "\n")
        self.process.stdin.flush()
        with selectors.DefaultSelector() as ready:
            ready.register(self.process.stdout, selectors.EVENT_READ)
            answered = ready.select(HANGING)
        reply = self.process.stdout.readline() if answered else ""
        if reply:
            status: int | str = json.loads(reply)
        else:
            self.process.kill()
            code = self.process.wait()
            slow = not answered or code == -signal.SIGPROF
            status = f"ran for more than {LONGEST:g} s" if slow else f"died with {code}"
            self.close()
        printed = [(folder / name).read_text(encoding="utf-8", errors="replace") for name in ("stdout", "stderr")]
        for name in ("stdout", "stderr"):
            (folder / name).unlink()
        return Run(status, *printed)

    def close(self) -> None:
        """End the process."""
        if self.process is not None:
            self.process.kill()
            self.process.communicate()
            self.process = None


def complaints(run: Run, before: set[Path], folder: Path) -> list[str]:
    """What does not hold of a run, none if all is well.

    Parameters
    ----------
    run
        How it ended.
    before
        Paths in the folder when it began.
    folder
        Where it ran.
    """
    out = []
    if run.status not in (0, 1, 2):
        return [f"status {run.status}"]
    told = [line for line in run.err.splitlines() if not line.startswith("warning: ")]
    if "Traceback" in run.err + run.out:
        out.append("a traceback")
    if "failed on these data" in run.err or "cannot start" in run.err:
        out.append("a failure without a cause that a user can use")
    if run.status == 0 and told or run.status != 0 and (len(told) != 1 or not told[0].startswith("bayesid: ")):
        out.append(f"{len(told)} lines on standard error")
    if run.err and max(map(len, run.err.splitlines())) > 1000:
        out.append("a line of more than 1000 characters")
    after = {path for path in folder.rglob("*")}
    new = {path.relative_to(folder).as_posix() for path in after - before}
    # A run that has not converged may be gone on with.
    left = {name for name in new if run.status != 0 and not name.endswith("-checkpoint.npz")}
    if left or any(name.partition("/")[0].startswith(".bayesid-") or "/.bayesid-" in name for name in new):
        out.append(f"left behind: {sorted(new)}")
    if before - after:
        out.append(f"removed: {sorted(map(str, before - after))}")
    for path in after - before:
        if path.suffix == ".json":
            try:
                json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse)
            except ValueError as error:
                out.append(f"{path.name}: {error}")
    return out


def _refuse(constant: str) -> None:
    raise ValueError(f"holds {constant}")


def fresh(original: Path, place: Path) -> Path:
    """A copy of the experiment to damage, alone in a folder."""
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    shutil.copytree(original, place / "arm")
    return place / "arm"
