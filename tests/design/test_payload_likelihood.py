"""A payload's mass beside a cable: ends of its interval against a model of weight, offset and one spring written out here."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import least_squares

import bayesid
from bayesid.recordings.experiment import Sensor
from bayesid.robot import inertia
from bayesid.simulation.trajectories import Trajectory
from tests.robots import wrist_sensor_arm, write
from tests.simulated import experiment

CABLE = {"stiffness": 0.8, "rest_length": 0.2, "anchor_x": 0.3, "anchor_y": -0.4, "anchor_z": 1.2,
         "point_x": 0.02, "point_y": 0.08, "point_z": 0.05}  # fmt: skip
OFFSET = dict(zip(("fx", "fy", "fz", "mx", "my", "mz"), (3.0, -2.0, 5.0, 0.2, -0.1, 0.05), strict=True))
STD = np.repeat([0.05, 0.003], 3)
MASS, CENTRE = 1.4, np.array([0.01, -0.02, 0.08])


def recorded(folder, count: int, seed: int) -> bayesid.Simulation:
    """Poses of a wrist that carries 1.4 kg with a cable at it."""
    arm = experiment(bayesid.load_robot(write(folder, wrist_sensor_arm()), sensor_joint="wrist_ft"), [], Sensor("wrist_ft"))
    q = np.random.default_rng(seed).uniform(-2.5, 2.5, (count, arm.robot.n))
    path = Trajectory("poses", "identification", np.arange(float(count)), q, 0.0 * q, 0.0 * q, kind="poses")
    links = arm.robot.nominal.copy()
    links[6] = inertia.from_mass_com_inertia(MASS, CENTRE, 0.003 * np.eye(3))
    noise = bayesid.Recorder(force_std=STD[0], torque_std=STD[3], resolution=1e-5)
    effects = {"sensor_offset": OFFSET, "tether@joint6": CABLE}
    return bayesid.simulate(arm, [path], effects=effects, links=links, recorder=noise, seed=seed)


class Spring:
    """Readings of weight, offset and a spring from a fixed anchor to a point of the sensor's link."""

    def __init__(self, made: bayesid.Simulation):
        model = pin.buildModelFromUrdf(str(made.robot.urdf))
        data, self.read = model.createData(), made.motions[0].table.wrench
        wrist, link = model.getFrameId("sensor_plate"), model.getJointId(made.robot.joint_names[5])
        self.turns, self.places = [], []
        for q in made.motions[0].table.positions:
            pin.framesForwardKinematics(model, data, q)
            self.turns.append(data.oMf[wrist].rotation.T.copy())
            self.places.append((data.oMi[link].rotation.copy(), data.oMi[link].translation.copy()))
        self.own = data.oMf[wrist].inverse() * data.oMi[link]  # points of the cable are told in the joint's frame

    def left(self, x: np.ndarray, mass: float) -> np.ndarray:
        first, offset, (k, length), anchor, point = x[:3], x[3:9], x[9:11], x[11:14], x[14:17]
        out = []
        for turn, (rotation, place), read in zip(self.turns, self.places, self.read, strict=True):
            line = anchor - place - rotation @ point
            distance = np.linalg.norm(line)
            pull = turn @ (k * max(distance - length, 0.0) * line / distance)
            up = turn @ np.array([0.0, 0.0, 9.81])
            at = self.own.rotation @ point + self.own.translation
            force = mass * up - pull
            moment = np.cross(first, up) - np.cross(at, pull)
            out.append((np.concatenate([force, moment]) + offset - read) / STD)
        return np.ravel(out)

    def least(self, mass: float, start: np.ndarray) -> np.ndarray:
        low, high = np.full(17, -np.inf), np.full(17, np.inf)
        low[9:11], low[11:14], high[11:14] = 0.0, -10.0, 10.0
        start = np.clip(start, low + 1e-6, high - 1e-6)
        return least_squares(self.left, start, bounds=(low, high), x_scale="jac", args=(mass,), max_nfev=200).x


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_ends_of_the_interval_are_where_an_independent_model_contradicts(tmp_path, seed: int) -> None:
    made = recorded(tmp_path, 24, seed)
    result = bayesid.payload(made)
    assert [e.name for e in result.effects] == ["tether"] and result.mass.low < MASS < result.mass.high
    assert all(q.low < c < q.high for q, c in zip(result.centre, CENTRE, strict=True))
    model, x = Spring(made), np.array([*(MASS * CENTRE), *OFFSET.values(), *CABLE.values()])
    found: dict[float, float] = {}
    for way in (result.mass.low, result.mass.high):  # from the truth outwards, in small steps
        at = x
        for mass in np.linspace(MASS, way, 12):
            at = model.least(mass, at)
            found[mass] = float(np.sum(model.left(at, mass) ** 2))
    # The noise is not stated: its size is that of what the model leaves.
    freedom = 6 * 24 - 18
    rises = [(found[end] - min(found.values())) / (min(found.values()) / freedom) for end in (result.mass.low, result.mass.high)]
    student = (result.mass.high - result.mass.value) / result.mass.std
    assert all(0.7 < rise / student**2 < 1.5 for rise in rises)


def test_few_poses_show_a_cable_as_a_cable(tmp_path) -> None:
    """Twelve poses whose noise nobody states: a model of each axis alone would take the pull for noise."""
    result = bayesid.payload(recorded(tmp_path, 12, 5))
    assert [e.name for e in result.effects] == ["tether"]
    assert result.mass.low < MASS < result.mass.high
