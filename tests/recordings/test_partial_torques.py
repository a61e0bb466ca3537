"""Torques of some joints only: used as far as they go, by every verb, as numpy does it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest

import bayesid
from bayesid.errors import InputError
from bayesid.recordings.experiment import Experiment, Motion, load_experiment
from bayesid.recordings.table import Table
from bayesid.recordings.writer import write_experiment
from bayesid.workflows.demo import PAPER_LOCKED
from tests.simulated import experiment, fourier, puma2, recording

FRICTION = ["viscous_friction", "torque_offset"]
KNOWN = {"viscous_friction@joint1": {"coefficient": 4.0}, "torque_offset@joint1": {"offset": 1.5}}


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    """Two recordings of the two-joint robot; the torque of the first joint holds friction and an offset."""
    robot = puma2(tmp_path_factory.mktemp("partial"))
    motions = []
    for name, role, seed in (("identification", "identification", 1), ("validation", "validation", 2)):
        motion = fourier(robot, seed, duration=20.0)
        table = recording(robot, None, motion, seed=seed, torque_std=0.1, resolution=1e-5)
        assert table.torques is not None
        torques = table.torques + np.outer(4.0 * motion[2][:, 0] + 1.5, [1.0, 0.0])
        motions.append(Motion(name, role, replace(table, torques=torques)))
    return experiment(robot, motions, None, position_resolution=1e-5, locked=dict(PAPER_LOCKED))


def without(given: Experiment, joint: int) -> Experiment:
    """The experiment without the torques of one joint."""

    def of(table: Table) -> Table:
        assert table.torques is not None
        torques = np.array(table.torques)
        torques[:, joint] = np.nan
        return replace(table, torques=torques)

    motions = tuple(replace(m, table=of(m.table), examined=False) for m in given.motions)
    return replace(given, motions=motions, warnings=(), findings=())


@pytest.mark.parametrize("joint", [0, 1])
def test_the_estimate_is_that_of_pinocchio_s_rows_of_the_other_joint(joint: int, arm: Experiment) -> None:
    """Rank and predictions beside the regressor of the joint that has torques, exact motion, plain least squares."""
    kept, partial = 1 - joint, without(arm, joint)
    result = bayesid.identify(partial, method="ols", effects=FRICTION)
    model = pin.buildModelFromUrdf(str(arm.robot.urdf))
    locked = [i for i in range(1, model.njoints) if model.names[i] not in arm.robot.joint_names]
    pose = pin.neutral(model)
    for name, angle in PAPER_LOCKED.items():
        pose[model.joints[model.getJointId(name)].idx_q] = angle
    model = pin.buildReducedModel(model, locked, pose)
    data, rows, read = model.createData(), [], []
    motion = fourier(arm.robot, 1, duration=20.0)
    torques = arm.motions[0].table.torques
    assert torques is not None
    for k in range(0, len(motion[0]), 5):
        q, v, a = (part[k] for part in motion[1:])
        rows.append(np.append(pin.computeJointTorqueRegressor(model, data, q, v, a)[kept], [v[kept], 1.0]))
        read.append(torques[k, kept])
    matrix = np.array(rows)
    rank = np.linalg.matrix_rank(matrix[:, :-2], tol=1e-5 * np.linalg.norm(matrix))  # angles of the URDF have six digits
    assert result.base.rank == rank < bayesid.identify(arm, method="ols").base.rank
    links = np.linalg.lstsq(matrix, np.array(read), rcond=1e-10)[0]
    found = {(e["name"], e["where"]): e["parameters"] for e in result.to_dict()["effects"]}
    assert {where for _, where in found} == {f"joint{kept + 1}"}
    truth = {name.partition("@")[0]: value for name, value in KNOWN.items()} if kept == 0 else {}
    for (name, _), parameters in found.items():
        for key, entry in parameters.items():
            expected = truth.get(name, {}).get(key, 0.0)
            assert abs(entry["value"] - expected) < 4.0 * entry["std"]
    assert abs(links[-2] - (4.0 if kept == 0 else 0.0)) < 0.2
    (prediction,) = result.validation
    assert prediction.channel_names == (f"tau{kept + 1}",) and prediction.whitened_rms == pytest.approx(1.0, abs=0.1)


def test_it_is_told_once_and_first(arm: Experiment) -> None:
    partial = without(arm, 1)
    (finding,) = partial.findings
    assert finding.text.startswith("column tau2: no torques of joint2")
    for result in (bayesid.check(partial), bayesid.identify(partial), bayesid.compare(partial, methods=["ols", "huber"])):
        # Without friction in the model a fit is of no use, which alone comes before it.
        certain = [w for w in result.warnings if "no usable model" not in w]
        assert certain[0] == finding.text and sum("tau2" in w for w in result.warnings) == 1
        if not isinstance(result, bayesid.Inspection):
            assert "no usable model" in result.warnings[0] and "viscous_friction" in result.warnings[0]
    entries = [m.to_dict() for m in bayesid.check(partial).motions]
    assert json.loads(json.dumps(entries, allow_nan=False)) == entries  # plain data, as they are written


def test_it_goes_through_a_folder(arm: Experiment, tmp_path: Path) -> None:
    partial = without(arm, 1)
    write_experiment(partial, tmp_path / "arm")
    assert list(pd.read_csv(tmp_path / "arm" / "identification.csv")) == ["t", "q1", "q2", "tau1"]
    again = load_experiment(tmp_path / "arm")
    assert again.torque_joints == (0,) and [f.text for f in again.findings] == [f.text for f in partial.findings]
    np.testing.assert_allclose(bayesid.identify(again).values, bayesid.identify(partial).values, rtol=1e-12)


@pytest.mark.parametrize("name", ["torque2", "Tau_2", "effort 2"])
def test_a_torque_of_another_name_is_not_left_out(name: str, arm: Experiment, tmp_path: Path) -> None:
    write_experiment(arm, tmp_path / "arm")
    table = tmp_path / "arm" / "identification.csv"
    pd.read_csv(table).rename(columns={"tau2": name}).to_csv(table, index=False)
    with pytest.raises(InputError, match=f'identification.csv: column tau2 is missing.*did you mean "{name}"'):
        load_experiment(tmp_path / "arm")


def test_joints_are_those_of_every_recording(arm: Experiment) -> None:
    one = replace(arm, motions=(without(arm, 1).motions[0], arm.motions[1]))
    assert one.torque_joints == (0,)
    named = tuple(replace(m, table=replace(m.table, source=f"{m.name}.csv"), examined=False) for m in one.motions)
    (finding,) = replace(one, motions=named, warnings=(), findings=()).findings
    assert "identification.csv" in finding.text and "validation.csv" not in finding.text
    with pytest.raises(InputError, match="no joint has torques in every recording"):
        motions = (without(arm, 1).motions[0], replace(without(arm, 0).motions[1], examined=False))
        replace(arm, motions=motions, warnings=(), findings=())


def test_a_posterior_takes_it(arm: Experiment) -> None:
    partial = without(arm, 1)
    posterior = bayesid.sample(partial, draws=200, effects=FRICTION, seed=0)
    estimate = bayesid.identify(partial, effects=FRICTION)
    means = np.array([entry["value"] for entry in posterior.to_dict()["base_parameters"]])
    np.testing.assert_allclose(means, estimate.values, atol=5.0 * float(np.max(estimate.std)))


def test_a_diagnosis_names_what_the_other_joint_shows(arm: Experiment) -> None:
    diagnosis = bayesid.diagnose(without(arm, 1), effects=["torque_offset"])
    assert diagnosis.verdict == "named"
    assert [f.term.effect.spec for f in diagnosis.found] == ["viscous_friction@joint1"]
    np.testing.assert_allclose(diagnosis.found[0].term.values, [4.0], atol=0.2)
