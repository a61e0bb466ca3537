"""The paper of Liu, Iagnemma, Dubowsky and Morel (ICRA 1998) done again, on a simulated PUMA.

    python case_studies/liu1998/run.py [--out DIR]

writes results.json and the figures, and fills the tables of README.md.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from present import figures, fill, plain, tables
from scipy.interpolate import make_interp_spline

import bayesid
from bayesid.dynamics.base_parameters import nearest_links, structural_base
from bayesid.dynamics.channels import torque_channels
from bayesid.dynamics.regressors import Kernel
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare
from bayesid.regression.readings import make_channels
from bayesid.robot import inertia
from bayesid.signals.filters import LowPass, low_pass
from bayesid.workflows.demo import puma_friction, puma_setup
from tests.example_robots import PAPER_ESTIMATE, PAPER_LABELS, paper_base_map

HERE = Path(__file__).parent
STEP = 0.008  # the paper's sampling
FILTERS = LowPass(1.0, 50.0)  # and its filters
GEAR = np.array([62.6111, 107.815])
ENCODER = 2 * np.pi / (1000 * GEAR)  # 1000 counts a turn of the motor
ROTOR = 2e-4 * GEAR**2  # rotor inertia seen at the joint, Corke and Armstrong-Helouvry 1994
OFFSET = {"sensor_offset": {"fx": 23.0, "fy": -17.0, "fz": 41.0, "mx": 3.1, "my": -4.4, "mz": 1.2}}
DRIVES = {
    "friction": puma_friction(),
    "friction and rotors": puma_friction() | {f"rotor_inertia@joint{j + 1}": {"inertia": ROTOR[j]} for j in range(2)},
}
WAYS = {
    "torques, no friction model": ("torque", []),
    "torques, viscous and Coulomb friction": ("torque", ["viscous_friction", "coulomb_friction"]),
    "the same and an offset": ("torque", ["viscous_friction", "coulomb_friction", "torque_offset"]),
    "base wrench": ("wrench", []),
}


def trajectory(name: str, role, times: np.ndarray, path: np.ndarray) -> bayesid.Trajectory:
    """The smooth motion through these positions, with a stop-and-go run; the spline is the truth."""
    spline = make_interp_spline(times, path, k=7)
    q, v, a = spline(times), spline(times, 1), spline(times, 2)
    return bayesid.Trajectory(name, role, times, q, v, a, static_positions=q)


def motions(seconds: float = 24.0) -> list[bayesid.Trajectory]:
    """Sines for identification and, totally different, moves from point to point for verification.

    Both start and end at rest. The paper's figures 3 and 4 cannot be read off; these are assumed.
    """
    t = np.arange(int(seconds / STEP) + 1) * STEP
    ramp = _step(np.minimum(t, t[-1] - t) / 2.0)
    one = 0.9 * np.sin(2 * np.pi * 0.15 * t) + 0.22 * np.sin(2 * np.pi * 0.45 * t + 0.5)
    two = 0.6 * np.sin(2 * np.pi * 0.22 * t + 1.0) + 0.18 * np.sin(2 * np.pi * 0.5 * t)
    first = np.stack([0.2 + ramp * one, 0.9 + ramp * two], axis=1)
    stops = np.array([[0.0, 0.4], [1.1, 1.3], [-0.3, 1.7], [-1.2, 0.6], [0.5, 0.1], [0.5, 1.4], [0.0, 0.4]])
    move, pause = 1.9, 0.4
    t2 = np.arange(int(len(stops[1:]) * (move + pause) / STEP) + 1) * STEP
    second = stops[0] + sum(
        _step((t2 - k * (move + pause)) / move)[:, None] * leg for k, leg in enumerate(np.diff(stops, axis=0))
    )  # fmt: skip
    return [trajectory("identification", "identification", t, first), trajectory("verification", "validation", t2, second)]


def _step(x: np.ndarray) -> np.ndarray:
    """From 0 to 1 without a jump in the first three derivatives."""
    x = np.clip(x, 0.0, 1.0)
    return x**4 * (35 - 84 * x + 70 * x**2 - 20 * x**3)


@dataclass(frozen=True)
class Setting:
    """The robot on its sensor, its motions, and maps between the parameter sets."""

    setup: bayesid.Experiment
    motions: list[bayesid.Trajectory]

    def record(self, drives: str, seed: int, links: np.ndarray | None = None, *, noise: bool = True) -> bayesid.Simulation:
        """Simulate both motions and their stop-and-go runs."""
        recorder = bayesid.Recorder(resolution=tuple(ENCODER), force_std=0.5, torque_std=0.05)
        if not noise:
            recorder = bayesid.Recorder(resolution=0.0, position_std=0.0, force_std=0.0, torque_std=0.0, drive_std=0.0)
        return bayesid.simulate(
            self.setup, self.motions, effects=DRIVES[drives] | OFFSET, links=links, recorder=recorder, seed=seed
        )  # fmt: skip

    @property
    def channels(self):
        """The six channels of the base sensor."""
        return make_channels(replace(self.setup, motions=()), "wrench")

    @property
    def wrench_base(self):
        """The base parameters of a wrench without gravity: the paper's twelve, in another order."""
        return structural_base(self.setup.robot, self.channels, gravity=False)

    @property
    def torque_base(self):
        """The base parameters that the joint torques depend on."""
        return structural_base(self.setup.robot, torque_channels(self.setup.robot))

    @property
    def to_paper(self) -> np.ndarray:
        """(12, 12): from the library's base parameters to the paper's."""
        return _relation(self.wrench_base.matrix, paper_base_map())

    @property
    def to_torque(self) -> np.ndarray:
        """(8, 12): from the wrench's base parameters to the torques'."""
        return _relation(self.wrench_base.matrix, self.torque_base.matrix)

    def torque(self, base_values: np.ndarray) -> np.ndarray:
        """Frictionless joint torques of the verification motion (N, 2)."""
        m = self.motions[1]
        kernel = Kernel.of(self.setup.robot, torque_channels(self.setup.robot), self.torque_base.independent)
        y = kernel.dynamics(m.positions, m.velocities, m.accelerations)
        return y @ base_values

    def wrench(self, base_values: np.ndarray) -> np.ndarray:
        """Motion wrench of the verification motion without noise (N, 6)."""
        m = self.motions[1]
        kernel = Kernel.of(self.setup.robot, self.channels, self.wrench_base.independent)
        y = kernel.dynamics(m.positions, m.velocities, m.accelerations, gravity=False)
        return y @ base_values


def _relation(known: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    relation = np.linalg.lstsq(known.T, wanted.T, rcond=None)[0].T
    if not np.allclose(relation @ known, wanted, atol=1e-9):
        raise RuntimeError("the wanted parameters are no combinations of the known ones")
    return relation


def _relative(error: np.ndarray, signal: np.ndarray) -> float:
    return float(np.linalg.norm(error) / np.linalg.norm(signal))


def twelve(setting: Setting, result: bayesid.Identification, links: np.ndarray) -> list[dict]:
    """The paper's table: twelve parameters, with intervals, beside the truth and the printed estimate."""
    relation = setting.to_paper
    values = relation @ result.values
    std = np.sqrt(np.diag(relation @ result.covariance @ relation.T))
    truth = paper_base_map() @ links.ravel()
    return [
        {"label": label, "truth": t, "value": v, "low": v - 1.96 * s, "high": v + 1.96 * s, "sigmas": (v - t) / s, "paper": p}
        for label, t, v, s, p in zip(PAPER_LABELS, truth, values, std, PAPER_ESTIMATE, strict=True)
    ]


def claim(setting: Setting, experiment: bayesid.Simulation) -> dict[str, dict]:
    """How wrong the torques' base parameters are, from the torques and from the wrench."""
    truth = setting.torque_base.matrix @ experiment.truth.links.ravel()
    rigid = setting.torque(truth)
    out = {}
    for name, (channel, effects) in WAYS.items():
        estimate = bayesid.fit(prepare(experiment, FitOptions(channel, effects=effects)).regression)
        relation = setting.to_torque if channel == "wrench" else np.eye(len(truth))
        values, covariance = relation @ estimate.values, relation @ estimate.covariance @ relation.T
        z = (values - truth) / np.sqrt(np.diag(covariance))
        out[name] = {
            "values": values, "sigmas": z, "rms_sigmas": float(np.sqrt(np.mean(z**2))), "worst_sigmas": float(np.abs(z).max()),
            "relative_error": _relative(values - truth, truth), "torque_error": _relative(setting.torque(values) - rigid, rigid),
        }  # fmt: skip
    return out


def paper_recipe(setting: Setting, experiment: bayesid.Simulation, velocity: str) -> tuple[np.ndarray, np.ndarray]:
    """Ordinary least squares through the two filters, with the usual textbook standard deviations.

    ``forward``: the paper's forward difference; ``central``; ``middle``: the forward difference again, but used at
    the time that it belongs to, half a sample later.
    """
    motion = experiment.motions[0]
    t, q = motion.table.times, motion.table.positions
    wrench = motion.table.wrench - motion.static.wrench
    if velocity == "central":
        t, q, v, wrench = t[1:-1], q[1:-1], (q[2:] - q[:-2]) / (2 * STEP), wrench[1:-1]
    else:
        v = np.diff(q, axis=0) / STEP
        if velocity == "middle":
            q, wrench = 0.5 * (q[1:] + q[:-1]), 0.5 * (wrench[1:] + wrench[:-1])
        t, q, wrench = t[:-1], q[: len(v)], wrench[: len(v)]
    momentum, rest = Kernel.of(setting.setup.robot, setting.channels, setting.wrench_base.independent).momentum(
        q, v, gravity=False
    )
    count = len(t)
    x = low_pass(FILTERS, t, rest.reshape(count, -1), momentum.reshape(count, -1))[0].reshape(6 * count, -1)
    y = low_pass(FILTERS, t, -wrench)[0].ravel()
    values, rss = np.linalg.lstsq(x, y, rcond=None)[:2]
    variance = rss[0] / (len(y) - x.shape[1])
    return values, np.sqrt(np.diag(np.linalg.inv(x.T @ x)) * variance)


def answers(setting: Setting, experiment: bayesid.Simulation) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Estimates and standard deviations of the paper's row_model and bayesid's."""
    default = bayesid.fit(prepare(experiment).regression)
    filtered = bayesid.fit(prepare(experiment, FitOptions(low_pass=FILTERS)).regression, "ols")
    return {
        "paper: forward difference": paper_recipe(setting, experiment, "forward"),
        "the same, difference used half a sample later": paper_recipe(setting, experiment, "middle"),
        "the same, central difference": paper_recipe(setting, experiment, "central"),
        "bayesid, the paper's filters and ols": (filtered.values, filtered.std),
        "bayesid, default": (default.values, default.std),
    }


def recipes(setting: Setting, experiment: bayesid.Simulation) -> dict[str, dict]:
    """How wrong each row_model is, with the recording's noise and without any."""
    with_noise, without = answers(setting, experiment), answers(setting, setting.record("friction", 0, noise=False))
    std_default = with_noise["bayesid, default"][1]
    truth = setting.wrench_base.matrix @ experiment.truth.links.ravel()
    signal = setting.wrench(truth)
    out = {}
    for name, (values, std) in with_noise.items():
        error = setting.wrench(values) - signal
        bias = setting.wrench(without[name][0]) - signal
        z = (values - truth) / std_default
        out[name] = {
            "values": values, "rms_sigmas": float(np.sqrt(np.mean(z**2))), "worst_sigmas": float(np.abs(z).max()),
            "own_std": std, "covered": int(np.sum(np.abs(values - truth) <= 1.96 * std)),
            "force_error": _relative(error[:, :3], signal[:, :3]), "moment_error": _relative(error[:, 3:], signal[:, 3:]),
            "bias": _relative(bias[:, 3:], signal[:, 3:]),
        }  # fmt: skip
    return out


def printed_links(setting: Setting, tries: int = 20) -> tuple[np.ndarray | None, int]:
    """Bodies whose base parameters are those the paper printed, and after how many projections they were found.

    Those nearest to the PUMA 560's links need not be able to exist; then they are projected onto bodies that can,
    and the nearest to these are taken. None if that does not end.
    """
    values = np.linalg.solve(setting.to_paper, np.array(PAPER_ESTIMATE))
    robot = setting.setup.robot
    for k in range(tries):
        links = nearest_links(robot, setting.wrench_base, values).reshape(-1, 10)
        if inertia.is_physically_consistent(links).all():
            return links, k
        robot = replace(robot, nominal=np.array([_possible(body) for body in links]))
    return None, tries


def _possible(body: np.ndarray, smallest: float = 0.01) -> np.ndarray:
    """The body with the eigenvalues of its pseudo-inertia raised to at least `smallest`."""
    values, vectors = np.linalg.eigh(inertia.pseudo_inertia(body))
    return inertia.from_pseudo_inertia((vectors * np.maximum(values, smallest)) @ vectors.T)


def run(seconds: float = 24.0, repeats: int = 20, seed: int = 1) -> tuple[dict, dict]:
    """All results, and what the figures are drawn from."""
    with tempfile.TemporaryDirectory() as temporary:
        setting = Setting(puma_setup(Path(temporary)), motions(seconds))
        nominal = setting.setup.robot.nominal
        experiment = setting.record("friction", seed)
        result = bayesid.identify(experiment)
        verification = result.validation[0]
        results = {
            "machine": {
                "encoder_count_rad": ENCODER, "step_s": STEP, "seconds": [m.times[-1] for m in setting.motions],
                "offset": OFFSET["sensor_offset"], "drives": DRIVES["friction and rotors"],
            },
            "twelve": twelve(setting, result, nominal),
            "verification": {
                "nrmse": dict(zip(verification.channel_names, verification.nrmse, strict=True)),
                "rmse": dict(zip(verification.channel_names, verification.rmse, strict=True)),
                "whitened_rms": verification.whitened_rms,
            },
            "claim": {drives: claim(setting, setting.record(drives, seed)) for drives in DRIVES},
            "recipes": recipes(setting, experiment),
        }  # fmt: skip
        links, tries = printed_links(setting)
        results["printed"] = {"found": links is not None, "projections": tries}
        if links is not None:
            again = bayesid.identify(setting.record("friction", seed + 100, links))
            results["printed"] |= {"masses": links[:, 0], "twelve": twelve(setting, again, links)}
        results["repeats"] = _repeat(setting, repeats, seed) if repeats else None
        return results, {"setting": setting, "experiment": experiment, "prediction": verification}


def _repeat(setting: Setting, repeats: int, seed: int) -> dict:
    """The same again with fresh noise."""
    covered, errors = [], {name: [] for name in WAYS}
    recipe_rows = {}
    for k in range(repeats):
        experiment = setting.record("friction", seed + 1 + k)
        truth = setting.wrench_base.matrix @ experiment.truth.links.ravel()
        estimate = bayesid.fit(prepare(experiment).regression)
        covered.append(np.mean(np.abs(estimate.values - truth) <= 1.96 * estimate.std))
        for name, row in claim(setting, experiment).items():
            errors[name].append((row["torque_error"], row["worst_sigmas"]))
        both = answers(setting, experiment)
        for name, (values, std) in both.items():
            z = (values - truth) / both["bayesid, default"][1]
            recipe_rows.setdefault(name, []).append((z, np.abs(values - truth) <= 1.96 * std))
    return {
        "count": repeats, "coverage": float(np.mean(covered)),
        "torque_error": {name: float(np.median([e for e, _ in rows])) for name, rows in errors.items()},
        "worst_sigmas": {name: float(np.max([z for _, z in rows])) for name, rows in errors.items()},
        "recipes": {
            name: {
                "rms_sigmas": float(np.sqrt(np.mean([z**2 for z, _ in rows]))),
                "coverage": float(np.mean([inside for _, inside in rows])),
            }
            for name, rows in recipe_rows.items()
        },
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=HERE, help="folder for results.json, figures and the filled README.md")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    results, parts = run()
    filled = fill((HERE / "README.md").read_text(encoding="utf-8"), tables(results))
    (out / "results.json").write_text(json.dumps(plain(results), indent=1) + "\n", encoding="utf-8")
    (out / "README.md").write_text(filled, encoding="utf-8")
    figures(results, parts, out)
    print(filled)


if __name__ == "__main__":
    main()
