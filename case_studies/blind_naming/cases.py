"""One case of the blind set: draw it, size its effects, record it, write its folder and its answer."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pinocchio as pin
from arms import Arm, inverse_dynamics, kinds, load, warped_urdf
from draws import NOT_MAIN, NOT_WITH_STATIC, PARTLY_RIGHT, TORQUE, UNITS, UNLISTED, WRENCH, candidates, draw, plausible, scaled
from motions import BANDWIDTH, chirp, fourier, grid, point_to_point, still_motion, tracked
from plant import AXES, LINK, Effect, Motion, Sensor, averaged, respond
from sizes import MISMATCHED, ONE_MOTION, STATIC_SHARE, Study, filtered, study

LEVELS = {"clear": 10.0, "moderate": 3.0, "small": 1.2}
SWALLOWED = 0.02  # an effect of which a free refit leaves less is sized against the prior
SAME = 10.0  # chi-square within which another effect explains a recording as well as the truth
NESTED = {("torque_offset", "spring")}  # a soft spring with a far rest is an offset: the simpler name holds
SEEN = 25.0  # chi-square that the data must leave unexplained for an effect to show at all


@dataclass(frozen=True)
class Plan:
    """What a case is to hold: kind none, single, pair or unlisted; effects' names; level; arm; channel."""

    case: str
    kind: str
    names: tuple[str, ...]
    level: str | None
    robot: str
    channel: str
    static: bool
    rel_std: float


@dataclass(frozen=True, eq=False)
class Setup:
    """A case without its effects."""

    plan: Plan
    arm: Arm
    nominal: Arm
    urdf: str
    sensor: Sensor
    step: float
    resolution: float
    velocities: bool
    noise: dict[str, Any]
    channels: tuple[str, ...]
    stds: np.ndarray
    references: list[tuple[str, str, np.ndarray, tuple[int, int, int], tuple[np.ndarray, np.ndarray, np.ndarray]]]
    friction: tuple[np.ndarray, np.ndarray]
    home: np.ndarray
    gears: np.ndarray
    seed: int
    motions: list[Motion] = field(default_factory=list)


class ImplausibleError(Exception):
    """The drawn effect cannot have the size that is asked for."""


def set_up(plan: Plan, rng: np.random.Generator) -> Setup:
    """Draw an arm, its nominal model, a sensor, noise and motions."""
    kind = kinds()[plan.robot]
    true_urdf = warped_urdf(kind.urdf, 0.1, rng)
    urdf = warped_urdf(true_urdf, plan.rel_std, rng) if plan.rel_std else true_urdf
    arm, nominal = (load(text, kind.joints, kind.locked) for text in (true_urdf, urdf))
    n, model = arm.n, arm.model
    step = float(rng.choice([0.004, 0.005, 0.006, 0.008]))
    sensor = Sensor(
        np.round(np.array([*rng.uniform(-0.04, 0.04, 2), rng.uniform(-0.07, -0.015)]), 4),
        np.array(
            [[0.0, 0.0, 0.0], [0.0, 0.0, 0.35], [0.0, 0.0, -0.8], [0.0, 0.0, np.pi / 2], [np.pi, 0.0, 0.35]][rng.integers(5)]
        ),
    )
    force, torque = (
        float(np.round(np.exp(rng.uniform(*np.log([0.15, 0.75]))), 2)),
        float(np.round(np.exp(rng.uniform(*np.log([0.012, 0.09]))), 3)),
    )
    effort = model.effortLimit[6:]
    taus = np.maximum(effort * rng.uniform(1.1e-3, 2.2e-3), 0.025)
    channels: tuple[str, ...] = ()
    stds: list[float] = []
    if plan.channel in ("wrench", "both"):
        channels, stds = AXES, [force] * 3 + [torque] * 3
    if plan.channel in ("torque", "both"):
        channels, stds = channels + tuple(f"tau{j + 1}" for j in range(n)), stds + taus.tolist()
    resolution = float(rng.choice([1e-5, 2e-5, 5e-5, 1e-4]))
    single = "external_contact" in plan.names or rng.random() < 0.4
    lengths = [float(rng.choice([20.0, 27.2]))] if single else [float(rng.choice([12.5, 14.0]))] * 2
    names = [("identification" + str(k + 1) * (k > 0), "identification", length) for k, length in enumerate(lengths)]
    names += [("validation", "validation", float(rng.choice([10.0, 12.0])))]
    if rng.random() < 0.25:
        names.append(("validation2", "validation", 12.0))
    low, high = model.lowerPositionLimit[7:], model.upperPositionLimit[7:]
    room = 0.9 * np.minimum(kind.home - low, high - kind.home)
    references = []
    for name, role, length in names:
        length = round(length / step) * step
        t, *layout = grid(length, step)
        reach = np.minimum(rng.uniform(0.6, 1.2, n), room)
        limits = np.array(
            [
                reach,
                rng.uniform(0.5, 0.85) * model.velocityLimit[6:],
                rng.uniform(*((4.0, 10.0) if role == "identification" else (2.5, 5.5)), n),
            ]
        )
        make = fourier if role == "identification" else (point_to_point if rng.random() < 0.6 else chirp)
        references.append((name, role, t, tuple(layout), make(t, length, kind.home, limits, rng)))
    dry = viscous = np.zeros(n)
    if plan.channel == "wrench":  # joint friction shapes the motion and never shows in the wrench
        dry, viscous = rng.uniform(0.1, 0.7, n) * 1e-3 * BANDWIDTH**2, rng.uniform(0.0, 1.0, n)
    noise = {
        "force_std": force, "torque_std": torque,
        "tau_std": None if plan.channel == "wrench" else [float(f"{x:.3g}") for x in taus],
        "encoder_resolution": resolution, "velocity_column": bool(rng.random() < 0.4), "sample_s": step,
    }  # fmt: skip
    gears = np.round(rng.uniform(50.0, 120.0, n), 1)
    setup = Setup(plan, arm, nominal, urdf, sensor, step, resolution, noise["velocity_column"], noise, channels, np.array(stds),
                  references, (dry, viscous), kind.home, gears, int(rng.integers(2**62)))  # fmt: skip
    return replace(setup, motions=move(setup, ()))


def move(setup: Setup, effects: tuple[Effect, ...]) -> list[Motion]:
    """Motions under control; hidden joint friction shapes them, too."""
    rng = np.random.default_rng(setup.seed)
    dry, viscous = (x.copy() for x in setup.friction)
    at_home = pin.crba(setup.arm.model, setup.arm.model.createData(), np.concatenate([[0, 0, 0, 0, 0, 0, 1], setup.home]))
    inertia = np.diag(at_home)[6:]
    for effect in effects:
        if effect.name in ("coulomb_friction", "stribeck_friction", "dahl_friction"):
            dry[effect.joint] += min(effect.values["level"] / inertia[effect.joint], 0.7e-3 * BANDWIDTH**2)
        elif effect.name == "viscous_friction":
            viscous[effect.joint] += min(effect.values["coefficient"] / inertia[effect.joint], 2.0)
    motions = []
    for name, role, t, (first, every, count), reference in setup.references:
        q, v, a = tracked(t, reference, dry, viscous, setup.resolution, rng)
        motions.append(Motion(name, role, t, q, v, a, first, every, count, role == "identification", setup.home))
    return motions


def basis_of(name: str, sizes: dict[str, Any]) -> str:
    """Which size counts for an effect."""
    if name in ONE_MOTION:
        return "after_refit_id"
    if name in MISMATCHED or sizes["after_refit"] < SWALLOWED * sizes["known"]:
        return "against_prior"
    return "after_refit"


def sized(name: str, target: float, work: Study, static: bool, rng: np.random.Generator) -> tuple[Effect, float, str]:
    """An effect at a random place whose ratio is the target; several draws, then `ImplausibleError`."""
    for _ in range(12):
        effect, basis = draw(name, work, static, rng), None
        ratio = 0.0
        for _ in range(7):
            sizes = work.ratios(work.signals((effect,)))
            basis = basis or basis_of(name, sizes)
            ratio = float(sizes[basis])
            if ratio < 1e-9 or not np.isfinite(ratio):
                break
            if abs(ratio / target - 1) < 0.03:
                break
            effect = scaled(effect, float(np.clip(target / ratio, 1e-3, 1e3)))
            if not plausible(effect, work):
                break
        if ratio > 0 and abs(ratio / target - 1) < 0.1 and plausible(effect, work):
            return effect, ratio, str(basis)
    raise ImplausibleError(f"{name}: no draw of ratio {target}")


def alternatives_of(
    effect: Effect, work: Study, static: bool, wrench_only: bool
) -> tuple[list[list[str]], float, dict[str, float]]:
    """Other names and places that explain the effect's signal as well; what the nominal model leaves; the eight best."""
    whole, left = work.unexplained(work.signals((effect,)), candidates(work, static))
    own = left.get((effect.name, effect.where), 0.0)
    own = min(own, whole)
    found = []
    for (name, where), value in sorted(left.items(), key=lambda item: item[1]):
        if (name, where) == (effect.name, effect.where) or (name == "payload" and effect.name != "payload"):
            continue
        if (effect.name, name) in NESTED:
            continue
        if value - own < SAME and value < whole - SEEN / 2:
            found.append([name, where])
    if effect.name == "rotor_momentum" and wrench_only:  # exactly inertia changes of two links
        for j in {effect.joint, max(effect.joint - 1, 0)}:
            found.append(["inertia_error", f"joint{j + 1}"])
    unique = [list(x) for x in dict.fromkeys(map(tuple, found))]
    best = dict(sorted(((f"{a}@{b}", round(v, 2)) for (a, b), v in left.items()), key=lambda item: item[1])[:8])
    return unique, whole, best


def make_case(plan: Plan, seed: list[int], out: Path) -> dict[str, Any]:
    """Draw, size, record and write one case; returns the answer.

    Raises
    ------
    ImplausibleError
        No draw of the effects had the size; ask again with another seed.
    """
    rng = np.random.default_rng(seed)
    setup = set_up(plan, rng)
    work = study(setup.arm, setup.sensor, setup.motions, setup.channels, setup.stds, setup.resolution, setup.nominal.links,
                 plan.rel_std, plan.static, setup.gears, rng)  # fmt: skip
    target = LEVELS[plan.level] if plan.level else 0.0
    effects, each, bases = [], [], []
    for name in plan.names:
        effect, ratio, basis = sized(name, target, work, plan.static, rng)
        effects.append(effect)
        each.append(round(ratio, 3))
        bases.append(basis)
    if len({(effect.name, effect.where) for effect in effects}) < len(effects):
        raise ImplausibleError("the same effect twice")
    hidden = tuple(effects)
    answer = _answer(setup, work, hidden, each, bases)
    if hidden:
        setup = replace(setup, motions=move(setup, hidden))
    answer |= record(setup, hidden, out / plan.case, rng)
    (out / "answers").mkdir(parents=True, exist_ok=True)
    (out / "answers" / f"{plan.case}.json").write_text(json.dumps(answer, indent=1), encoding="utf-8")
    return answer


def _answer(setup: Setup, work: Study, hidden: tuple[Effect, ...], each: list[float], bases: list[str]) -> dict[str, Any]:
    plan = setup.plan
    answer: dict[str, Any] = {
        "case": plan.case, "kind": plan.kind, "level": plan.level, "robot": plan.robot, "channel": plan.channel,
        "static": plan.static,
        "verdict": {"none": "nothing_missing", "unlisted": "unknown"}.get(plan.kind, "named"),
        "effects": [], "hidden_unlisted": [], "alternatives": [],
    }  # fmt: skip
    answer["acceptable_verdicts"] = [answer["verdict"]]
    alternatives = []
    for effect in hidden:
        others, whole, best = alternatives_of(effect, work, plan.static, plan.channel == "wrench")
        entry = {"name": effect.name, "where": effect.where, "parameters": _parameters(effect)}
        if plan.kind == "unlisted":
            answer["hidden_unlisted"].append(entry | {"parameters": effect.values})
            others = []
            answer["partly_right"] = PARTLY_RIGHT[effect.name]
            if best and min(best.values()) < 2 * SEEN:
                raise ImplausibleError(f"{effect.name}: looks the same as {next(iter(best))}")
        else:
            answer["effects"].append(entry)
        alternatives.append(others)
        if len(hidden) == 1:
            answer |= {"chi2_unexplained": round(whole, 2), "chi2_of_alternatives": best}
            if whole < SEEN and "nothing_missing" not in answer["acceptable_verdicts"]:
                answer["acceptable_verdicts"].append("nothing_missing")
    answer["alternatives"] = alternatives
    sizes = work.ratios(work.signals(hidden))
    basis = bases[0] if len(set(bases)) == 1 else "after_refit"
    answer["ratio"] = float(sizes[basis]) if hidden else 0.0
    if len(hidden) > 1:
        answer |= {"ratio_each": each, "ratio_bases": bases}
    answer |= {"ratio_basis": basis if hidden else "none", "ratios": sizes}
    answer["filter"] = (
        "zero-phase Butterworth order 4: positions 25 Hz (or 0.4/dt), residual 10 Hz; 0.6 s trimmed at both ends; "
        "moving minus static where a static table exists"
    )
    answer["floor_filtered"] = {c: float(f"{x:.4g}") for c, x in zip(setup.channels, work.floor, strict=True)}
    answer["noise"] = setup.noise
    names = [f"joint{j + 1}" for j in range(setup.arm.n)]
    changed = setup.arm.links.copy()
    for effect in hidden:
        if effect.name in ("payload", "inertia_error"):
            changed[effect.joint] += effect.vector(*LINK)
    for key, links in (
        ("true_links", setup.arm.links),
        ("true_links_with_effect", changed),
        ("nominal_links", setup.nominal.links),
    ):
        answer[key] = {name: [float(f"{x:.9g}") for x in link] for name, link in zip(names, links, strict=True)}
    answer["joint_friction_in_plant"] = plan.channel == "wrench"
    return answer


def _parameters(effect: Effect) -> dict[str, dict[str, Any]]:
    out = {}
    for key, value in effect.values.items():
        if key == "gear_ratio":  # no parameter of the effect: experiment.toml states it
            continue
        unit = UNITS.get(key)
        if effect.name.startswith("sensor_") and key in AXES:
            unit = ("N" if key[0] == "f" else "N m") + ("/s" if effect.name == "sensor_drift" else "")
        elif key in ("fx", "fy", "fz"):
            unit = "N"
        elif key.startswith("mc"):
            unit = "kg m"
        elif key[0] == "I" or key == "inertia":
            unit = "kg m^2"
        elif key == "coefficient":
            own = {"viscous_friction": "N m s/rad", "load_friction": "1", "warming_friction": "N m/rad"}
            unit = own.get(effect.name, "reading per source")
        elif unit is None:
            unit = "m" if effect.name in ("sensor_translation", "tether", "external_contact") else "rad"
        if effect.name == "warming_friction" and key == "level":
            unit = "N m/s"
        if effect.name == "spring" and key == "stiffness":
            unit = "N m/rad"
        out[key] = {"value": float(value), "unit": unit, "main": key not in NOT_MAIN}
    return out


def record(setup: Setup, hidden: tuple[Effect, ...], folder: Path, rng: np.random.Generator) -> dict[str, Any]:
    """Write the folder of one case: robot, experiment.toml and the tables that noisy instruments record.

    Parameters
    ----------
    setup
        Arm, sensor, motions, and how they are recorded.
    hidden
        Effects that the arm has.
    folder
        To be made; the experiment's name is the plan's.
    rng
        Of noise, offset, and of what experiment.toml tells.

    Returns
    -------
    floors
        Noise of the validation motions by channel, as it is and behind the judge's filter.
    """
    plan, arm, sensor = setup.plan, setup.arm, setup.sensor
    folder.mkdir(parents=True)
    (folder / "robot.urdf").write_text(setup.urdf, encoding="utf-8")
    kind = kinds()[plan.robot]
    locked = ", ".join(f"{name} = {angle!r}" for name, angle in kind.locked.items())
    lines = ["format = 1", f'name = "{plan.case}"', "", "[robot]", 'urdf = "robot.urdf"', f"joints = {json.dumps(kind.joints)}"]
    lines += [f"locked = {{ {locked} }}"] if locked else []
    lines += ["gravity = [0.0, 0.0, -9.81]", f"inertia_rel_std = {plan.rel_std:g}"]
    if plan.channel == "both" and (rng.random() < 0.5 or any(effect.name == "rotor_momentum" for effect in hidden)):
        gears = ", ".join(f"{name} = {ratio:g}" for name, ratio in zip(kind.joints, setup.gears, strict=True))
        lines += [f"gear_ratio = {{ {gears} }}"]
    if plan.channel != "torque":
        lines += ["", "[sensor]", f"translation = {sensor.translation.tolist()}", f"rpy = {sensor.rpy.tolist()}"]
        if rng.random() < 0.5:
            lines += [f"force_std = {setup.noise['force_std']}", f"torque_std = {setup.noise['torque_std']}"]
    offset = np.zeros(6)
    if plan.static:
        offset = rng.normal(size=6) * np.array([20.0, 20.0, 20.0, 1.0, 1.0, 1.0])
    raw: dict[str, list[np.ndarray]] = {c: [] for c in setup.channels}
    for motion in setup.motions:
        rigid = None if not hidden else inverse_dynamics(arm, motion.q, motion.v, motion.a)
        response = respond(arm, sensor, motion, hidden, rigid)
        rows = motion.first + motion.every * np.arange(motion.count)
        seen = (motion.q + response.shift)[rows]
        counts = np.round(seen / setup.resolution) * setup.resolution
        table = {"t": motion.t[rows]} | {f"q{j + 1}": counts[:, j] for j in range(arm.n)}
        if setup.velocities:
            rate = motion.v[rows] + np.gradient(response.shift, motion.t, axis=0)[rows] + 1e-3 * rng.normal(size=seen.shape)
            table |= {f"v{j + 1}": np.round(rate[:, j], 5) for j in range(arm.n)}
        truth = _columns(setup.channels, averaged(response.wrench, motion) + offset, averaged(response.torques, motion))
        errors = {c: std * rng.normal(size=motion.count) for c, std in zip(setup.channels, setup.stds, strict=True)}
        _write(folder / f"{motion.name}.csv", table | {c: truth[c] + errors[c] for c in setup.channels}, setup.resolution)
        lines += ["", "[[motion]]", f'name = "{motion.name}"', f'role = "{motion.role}"', f'table = "{motion.name}.csv"']
        if plan.static:
            poses = motion.q[rows]
            for _ in range(4):  # the encoders show the same positions at rest
                rest = respond(arm, sensor, still_motion(motion, poses), hidden, still=True)
                poses = seen - rest.shift
            still = {"t": motion.t[rows]} | {f"q{j + 1}": counts[:, j] for j in range(arm.n)}
            noise = {
                c: STATIC_SHARE * std * rng.normal(size=motion.count) for c, std in zip(setup.channels, setup.stds, strict=True)
            }
            truth = _columns(setup.channels, rest.wrench + offset, rest.torques)
            _write(
                folder / f"{motion.name}_static.csv", still | {c: truth[c] + noise[c] for c in setup.channels}, setup.resolution
            )
            lines += [f'static = "{motion.name}_static.csv"']
            errors = {c: errors[c] - noise[c] for c in setup.channels}
        if motion.role == "validation":
            for c in setup.channels:
                raw[c].append(errors[c])
    (folder / "experiment.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    noise_only = {
        c: float(f"{np.sqrt(np.mean(np.concatenate([filtered(x, setup.step) for x in raw[c]]) ** 2)):.4g}")
        for c in setup.channels
    }
    return {
        "floor_filtered_noise_only": noise_only,
        "floor_raw": {c: float(f"{np.sqrt(np.mean(np.concatenate(raw[c]) ** 2)):.4g}") for c in setup.channels},
    }


def _columns(channels: tuple[str, ...], wrench: np.ndarray, torques: np.ndarray) -> dict[str, np.ndarray]:
    names = [*AXES, *(f"tau{j + 1}" for j in range(torques.shape[1]))]
    return {name: column for name, column in zip(names, np.hstack([wrench, torques]).T, strict=True) if name in channels}


def _write(path: Path, table: dict[str, np.ndarray], resolution: float) -> None:
    rounded = {key: np.round(values, 4 if key[0] in "fm" or key.startswith("tau") else 6) for key, values in table.items()}
    pd.DataFrame(rounded).to_csv(path, index=False, lineterminator="\n")


def allowed(name: str, channel: str, static: bool) -> bool:
    """Whether an effect can be hidden in recordings of a channel."""
    if name in UNLISTED["wrench"] or name in UNLISTED["torque"]:
        fits = name in UNLISTED["torque" if channel == "torque" else "wrench"] or (
            channel == "both" and name in UNLISTED["torque"]
        )
    else:
        fits = (channel != "torque" and name in WRENCH) or (channel != "wrench" and name in TORQUE)
    return fits and not (static and name in NOT_WITH_STATIC)
