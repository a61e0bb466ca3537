"""Derivatives of the exact readings with respect to the links' parameters and to those of effects."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayesid.dynamics.kinematics import P, R, link_columns, project
from bayesid.effects.effect import Effect, Term, sense
from bayesid.effects.forces import LOADS, body_of
from bayesid.effects.model import BODIES, SOFT, Model, split_matrix, tilted
from bayesid.effects.sensor import DRIVE, SENSOR, delayed, inside_joint, sensor_chain

#: Steps of central differences, by parameter; relative to the value where that is larger.
_STEPS = {
    "delay": 1e-4, "angle": 1e-4, "compliance": 1e-6, "resonance": 0.01, "damping": 1e-3, "rest_length": 1e-4, "start": 1e-3,
    "end": 1e-3, "velocity": 1e-3, "periods": 1e-3, "phase": 1e-3,
}  # fmt: skip
_STEP = 1e-4


def tangent(model: Model, change: np.ndarray) -> np.ndarray:
    """Change of the readings with a change of the true wrench and torques, (N, c, k)."""
    if not model.named(*SENSOR, "load_friction", "torque_gain"):
        return change
    out = np.array(change)
    if len(model.wrench) and model.named(*SENSOR):
        out[:, model.wrench] = model.chain.linear(model.scene, change[:, model.wrench])
    for term in model.named("load_friction"):
        if term.effect.joint in model.joints:
            k = model.joints[term.effect.joint]
            joint, scene = term.effect.joint, model.scene
            way = sense(scene.velocities[:, joint], scene.accelerations[:, joint], scene.cell)
            share = term.values[0] * np.sign(model.true[:, k]) * way
            out[:, k] += share[:, None] * change[:, k]
    return out * model.torque_gain[:, None] if model.named("torque_gain") else out


def link_derivatives(model: Model) -> np.ndarray:
    """Derivative of the readings with respect to the links' parameters at the links' motion, (N, c, 10 b)."""
    robot, b = model.robot, len(model.robot.body_names)
    out = link_columns(model.states, model.twists, model.row_of[:b], model.carries[:, :b], model.gravity)
    for body in range(robot.n, b):
        part = slice(10 * body, 10 * body + 10)
        out[:, :, part] = out[:, :, part] @ split_matrix(robot, body)
    return tangent(model, out)


def effect_derivatives(model: Model, effect: Effect) -> np.ndarray:
    """Derivative of the readings with respect to the parameters of one of the terms, (N, c, k)."""
    here = [t for t in model.terms if t.effect == effect]
    name, scene = effect.name, model.scene
    count, channels = len(effect.kind.parameters), len(model.channels)
    out = np.zeros((len(scene.times), channels, count))
    if not any(effect.kind.acts_on(c) for c in model.channels.names):
        return out
    term = here[0]
    if name in SENSOR:
        out[:, model.wrench] = _sensor_columns(model, term)
        return out
    if name in DRIVE:
        if effect.joint in model.joints:
            out[:, model.joints[effect.joint]] = _drive_columns(model, term)
        return out
    if name in BODIES:
        body = body_of(model.robot, effect.joint)
        carried = model.carries[:, body : body + 1]
        return tangent(model, link_columns(model.states, model.twists, model.row_of[body : body + 1], carried, model.gravity))
    if name == "rotor_momentum":
        return tangent(model, model.rotor_reading(model.channels, model.carries, model.states, model.twists, term)[:, :, None])
    if name in LOADS:
        return tangent(model, _difference(term, lambda t: _load_reading(model, t)))
    if name == "base_tilt" and not model.named(*SOFT):
        return tangent(model, _difference(term, lambda t: _tilt_reading(model, t)))
    return _difference(term, lambda t: model.replaced(t).readings)


def _difference(term: Term, reading: Callable[[Term], np.ndarray]) -> np.ndarray:
    """Central differences with respect to the parameters of a term."""
    out = []
    for k, key in enumerate(term.effect.kind.parameters):
        step = max(_STEPS.get(key, _STEP), 1e-4 * abs(term.values[k]))
        ends = []
        for sign in (1.0, -1.0):
            values = list(term.values)
            values[k] += sign * step
            ends.append(reading(Term(term.effect, tuple(values))))
        out.append((ends[0] - ends[1]) / (2.0 * step))
    return np.stack(out, axis=-1)


def _load_reading(model: Model, term: Term) -> np.ndarray:
    out = np.zeros((len(model.scene.times), len(model.channels)))
    for body, force in LOADS[term.effect.name](model.robot, model.scene, model.states, term):
        out -= np.einsum("nck,nk->nc", model.twists, force) * model.carries[:, body]
    return out


def _tilt_reading(model: Model, term: Term) -> np.ndarray:
    """Weight of all bodies under the tilted gravity."""
    others = [t for t in model.named("base_tilt") if t.effect != term.effect]
    gravity = tilted(model.robot, [*others, term])
    x = model.states[:, model.row_of]
    rotation = x[:, :, R : R + 9].reshape(*x.shape[:2], 3, 3)
    mass = model.bodies[:, 0]
    first = mass[:, None] * x[:, :, P : P + 3] + np.einsum("nbij,bj->nbi", rotation, model.bodies[:, 1:4])
    force = np.broadcast_to(-mass[:, None] * gravity, first.shape)
    return project(model.twists, np.concatenate([force, -np.cross(first, gravity)], axis=2), model.carries)


def _sensor_columns(model: Model, term: Term) -> np.ndarray:
    scene, chain, true = model.scene, model.chain, model.true[:, model.wrench]
    name, axes = term.effect.name, term.effect.axes
    if name in ("sensor_offset", "sensor_drift"):
        size = np.ones(len(scene.times)) if name == "sensor_offset" else scene.times
        return size[:, None, None] * np.eye(6)
    if name in ("sensor_gain", "sensor_crosstalk"):
        out = np.zeros((len(scene.times), 6, 1))
        out[:, axes[-1], 0] = chain.sensed(scene, true[:, :, None])[:, axes[0], 0]
        return out
    terms = [t for t in model.named(*SENSOR) if t.effect != term.effect]
    if name == "sensor_translation":
        # Linear, but its slope is wanted at the turned and delayed axes: one step of it, from zero.
        zero = sensor_chain(model.robot, model.channels, model.wrench, [*terms, Term(term.effect, (0.0,) * 3)])
        parts = []
        for unit in np.eye(3):
            shifted = sensor_chain(model.robot, model.channels, model.wrench, [*terms, Term(term.effect, tuple(unit))])
            moved = np.einsum("ij,nj->ni", shifted.pose - zero.pose, true)
            moved = moved if zero.delay == 0.0 or scene.still else delayed(scene.times, moved, zero.delay)
            parts.append(moved @ zero.mix.T)
        return np.stack(parts, axis=-1)
    if name == "sensor_delay" and scene.still:
        return np.zeros((len(scene.times), 6, 1))

    def reading(changed: Term) -> np.ndarray:
        chain = sensor_chain(model.robot, model.channels, model.wrench, [*terms, changed])
        return chain.linear(scene, true[:, :, None])[:, :, 0]

    return _difference(term, reading)


def _drive_columns(model: Model, term: Term) -> np.ndarray:
    joint = term.effect.joint
    assert joint is not None
    k = model.joints[joint]
    true = model.true[:, k]
    if term.effect.name == "torque_gain":
        inside = [inside_joint(model.scene, model.motor, true, t) for t in model.named(*DRIVE) if t.effect.joint == joint]
        return (true + sum(inside))[:, None]
    change = _difference(term, lambda t: inside_joint(model.scene, model.motor, true, t))
    return change * model.torque_gain[k]
