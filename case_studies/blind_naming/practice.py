"""Check the plant's conventions against other recordings whose answers are known.

    python case_studies/blind_naming/practice.py PRACTICE_FOLDER

For every case: root mean square of reading minus the true arm's prediction along the recorded positions, over the
stated floor, worst channel; without and with the hidden effects.
"""

from __future__ import annotations

import json
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from arms import Arm, load
from plant import AXES, Effect, Motion, Sensor, respond
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

TRIM = 0.6  # [s] left out at both ends
FREE_SHIFT = 1e-9


def smooth(values: np.ndarray, step: float, cut: float) -> np.ndarray:
    """Zero-phase Butterworth filter of order 4, nothing assumed beyond the ends but their values."""
    sos = butter(4, min(cut, 0.4 / step), fs=1 / step, output="sos")
    return sosfiltfilt(sos, values, axis=0, padtype="constant", padlen=min(200, len(values) - 1))


def motion_of(table: pd.DataFrame, n: int, name: str, role: str, home: np.ndarray | None = None) -> Motion:
    """Smoothed motion of the encoders of a table."""
    t = table["t"].to_numpy()
    q = table[[f"q{j + 1}" for j in range(n)]].to_numpy()
    spline = CubicSpline(t, smooth(q, t[1] - t[0], 25.0))
    return Motion(name, role, t, spline(t), spline(t, 1), spline(t, 2), count=len(t), contact=role == "identification", home=home)


def links_moved(motion: Motion, shift: np.ndarray, still: bool) -> Motion:
    """The motion of the links where the encoders read them with a shift."""
    if np.abs(shift).max() < FREE_SHIFT:
        return motion
    moves = 0.0 if still else 1.0
    spline = CubicSpline(motion.t, shift)
    v, a = motion.v - moves * spline(motion.t, 1), motion.a - moves * spline(motion.t, 2)
    return replace(motion, q=motion.q - shift, v=v, a=a)


def predict(arm: Arm, sensor: Sensor, motion: Motion, effects: tuple[Effect, ...], still: bool) -> tuple[np.ndarray, np.ndarray]:
    """Readings along encoder positions: the links are where the effects put them."""
    links = motion
    for _ in range(4 if any(e.name in ("joint_flexibility", "encoder_offset") for e in effects) else 1):
        response = respond(arm, sensor, links, effects, still=still)
        links = links_moved(motion, response.shift, still)
    return response.wrench, response.torques


def residuals(folder: Path, answer: dict, role: str, hidden: bool) -> dict[str, tuple[float, float]]:
    """Per channel: rms of the residual, filtered at 10 Hz and raw, on the first motion of a role."""
    toml = tomllib.loads((folder / "experiment.toml").read_text(encoding="utf-8"))
    robot = toml["robot"]
    joints = tuple(robot["joints"])
    arm = load((folder / "robot.urdf").read_text(encoding="utf-8"), joints, robot.get("locked", {}))
    links = np.array([answer["true_links"][name] for name in sorted(answer["true_links"])])
    arm = arm.changed({j: links[j] - arm.links[j] for j in range(arm.n)})
    given = toml.get("sensor", {})
    sensor = Sensor(np.array(given.get("translation", [0.0] * 3)), np.array(given.get("rpy", [0.0] * 3)))
    effects = tuple(
        Effect(e["name"], e["where"], {key: value["value"] for key, value in e["parameters"].items()})
        for e in answer["effects"] * hidden
    )
    gears = robot.get("gear_ratio", {})
    effects = tuple(
        replace(e, values=e.values | {"gear_ratio": gears.get(joints[e.joint], 0.0)}) if e.name == "rotor_momentum" else e
        for e in effects
    )
    section = next(motion for motion in toml["motion"] if motion["role"] == role)
    table = pd.read_csv(folder / section["table"])
    # The Fourier motions swing about the pose in which they start.
    start = pd.read_csv(folder / toml["motion"][0]["table"], nrows=1)
    home = start[[f"q{j + 1}" for j in range(arm.n)]].to_numpy()[0]
    motion = motion_of(table, arm.n, section["name"], role, home)
    wrench, torques = predict(arm, sensor, motion, effects, False)
    model = {key: wrench[:, c] for c, key in enumerate(AXES)} | {f"tau{j + 1}": torques[:, j] for j in range(arm.n)}
    rest = None
    if "static" in section:
        rest = pd.read_csv(folder / section["static"])
        wrench, _ = predict(arm, sensor, motion.still(), effects, True)
        model = {key: model[key] - wrench[:, c] for c, key in enumerate(AXES)}
    step = motion.t[1] - motion.t[0]
    keep = (motion.t > TRIM) & (motion.t < motion.t[-1] - TRIM)
    out = {}
    for key, values in model.items():
        if key not in table:
            continue
        left = table[key].to_numpy() - values - (0.0 if rest is None else rest[key].to_numpy())
        out[key] = (float(np.sqrt(np.mean(smooth(left, step, 10.0)[keep] ** 2))), float(np.sqrt(np.mean(left[keep] ** 2))))
    return out


def phased(folder: Path, answer: dict) -> dict:
    """The answer with a ripple's unstated phase found on the identification motion."""
    ripples = [e for e in answer["effects"] if e["name"] == "torque_ripple" and "phase" not in e["parameters"]]
    for ripple in ripples:
        phases = np.linspace(0.0, 2 * np.pi, 73)[:-1]
        sizes = []
        for phase in phases:
            ripple["parameters"]["phase"] = {"value": phase}
            sizes.append(sum(v[0] for v in residuals(folder, answer, "identification", True).values()))
        ripple["parameters"]["phase"] = {"value": float(phases[np.argmin(sizes)])}
    return answer


def check(folder: Path, answer: dict) -> dict[str, float]:
    """Worst channel's filtered residual over the stated floor before and after, on validation and identification."""
    answer, result = phased(folder, answer), {}
    for role, key in (("validation", "floor_filtered"), ("identification", "floor_filtered_noise_only_identification")):
        for hidden in (False, True):
            left = residuals(folder, answer, role, hidden)
            result[f"{role} {'after' if hidden else 'before'}"] = max(
                v[0] / answer.get(key, answer["floor_filtered"])[c] for c, v in left.items()
            )
    return result


def main() -> None:
    root = Path(sys.argv[1])
    for path in sorted((root / "answers").glob("*.json")):
        answer = json.loads(path.read_text(encoding="utf-8"))
        hidden = "+".join(f"{e['name']}@{e['where']}" for e in answer["effects"] + answer["hidden_unlisted"]) or "nothing"
        line = "  ".join(f"{key} {value:6.2f}" for key, value in check(root / answer["case"], answer).items())
        print(f"{answer['case']}  {hidden:50s} {line}")


if __name__ == "__main__":
    main()
