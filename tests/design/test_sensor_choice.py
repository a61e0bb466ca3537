"""Candidate sensors against closed forms and dense algebra, ranges against weights, files that will not do."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayesid.design.accuracy.bench import own_setting, twin
from bayesid.design.accuracy.fits import fit_twin
from bayesid.design.accuracy.sensor_choice import CandidateSensor, Outlook, choose_sensor, read_sensors
from bayesid.effects import Term
from bayesid.errors import InputError
from bayesid.recordings.experiment import Motion
from bayesid.regression.rows import make_blocks
from bayesid.simulation.simulation import plant_readings
from tests.design.test_accuracy import bench

A = 0.25  # half the distance of the cells [m]
CELLS = f"[[{A}, {A}, -0.1], [{A}, -{A}, -0.1], [-{A}, {A}, -0.1], [-{A}, -{A}, -0.1]]"

PLATFORM = '[[sensor]]\nname = "p"\nkind = "base"\ntranslation = [0.0, 0.0, -0.1]\nnoise = [0.5, 0.05]\n'


def listed(folder: Path, text: str) -> tuple[CandidateSensor, ...]:
    path = folder / "sensors.toml"
    path.write_text(text, encoding="utf-8")
    return read_sensors(path, bench("ur5").experiment.robot)


def outlooks(folder: Path, text: str) -> list[Outlook]:
    return list(choose_sensor(bench("ur5"), listed(folder, text)).outlooks)


def test_a_base_sensor_tells_what_the_fit_of_its_readings_knows(tmp_path):
    (found,) = outlooks(tmp_path, PLATFORM)
    assert found.determined.base.rank == 40
    b = bench("ur5")
    perfect = replace(own_setting(b), encoder=0.0)  # encoders are no part of a force sensor
    _, estimate = fit_twin(b, perfect, twin(b, perfect, 1))
    np.testing.assert_allclose(found.determined.std, estimate.std, rtol=0.1)
    assert np.all(found.link_std <= found.prior_std * (1 + 1e-9)) and all(0.0 < v < 1.0 for v in found.left.values())


def test_cells_with_three_axes_are_a_sensor_of_the_noise_of_their_sums(tmp_path):
    # Forces are sums of four readings, moments are sums with arms: a, and for mz the distance from the middle.
    noise = [2 * 0.3] * 3 + [2 * A * 0.3] * 2 + [2 * 2**0.5 * A * 0.3]
    cells, base = outlooks(
        tmp_path,
        f'[[sensor]]\nname = "c"\nkind = "plate"\ncells = {CELLS}\naxes = "xyz"\nnoise = [0.3]\n'
        f'[[sensor]]\nname = "b"\nkind = "base"\ntranslation = [0.0, 0.0, -0.1]\nnoise = {noise}\n',
    )
    np.testing.assert_allclose(cells.determined.std, base.determined.std, rtol=1e-6)
    assert cells.effects["base_tilt@base"] == pytest.approx(base.effects["base_tilt@base"], rel=1e-6)


def test_vertical_cells_share_the_weight_and_tell_less(tmp_path):
    text = f'[[sensor]]\nname = "c"\nkind = "plate"\ncells = {CELLS}\nnoise = [0.3]\nrange = [10]\n'
    vertical, whole = outlooks(tmp_path, text + text.replace('"c"', '"w"').replace("noise", 'axes = "xyz"\nnoise'))
    assert vertical.determined.base.rank < whole.determined.base.rank
    assert np.all(vertical.link_std >= whole.link_std * (1 - 1e-9))
    robot = bench("ur5").experiment.robot
    weight = 9.81 * (robot.nominal[:, 0].sum() + robot.static_nominal[0])
    # At no time do four cells read less together than the weight less what the motion lifts.
    assert vertical.peak.sum() > 0.9 * weight
    assert vertical.load == pytest.approx(vertical.peak.max() / 10.0) and vertical.load > 1.0


def test_a_wrist_sensor_tells_of_the_links_beyond_it_alone(tmp_path):
    joint = bench("ur5").experiment.robot.joint_names[-1]
    (found,) = outlooks(tmp_path, f'[[sensor]]\nname = "w"\nkind = "wrist"\njoint = "{joint}"\nnoise = [0.1, 0.01]\n')
    assert found.determined.base.rank == 10
    for body, left in found.left.items():
        assert left < 0.9 if body == joint else left == pytest.approx(1.0)


def test_torque_sensors_in_some_joints_and_faster_readings(tmp_path):
    names = bench("ur5").experiment.robot.joint_names
    every, some, fast = outlooks(
        tmp_path,
        '[[sensor]]\nname = "t"\nkind = "torque"\nnoise = [0.2]\n'
        f'[[sensor]]\nname = "two"\nkind = "torque"\njoints = ["{names[1]}", "{names[2]}"]\nnoise = [0.2]\n'
        '[[sensor]]\nname = "fast"\nkind = "torque"\nnoise = [0.2]\nrate = 500.0\n',
    )
    assert every.determined.base.rank == 36 and some.determined.base.rank < 36 and len(some.peak) == 2
    np.testing.assert_allclose(fast.determined.std, 0.5 * every.determined.std, rtol=1e-6)  # 125 Hz: four samples in one
    assert fast.effects["viscous_friction@joint1"] == pytest.approx(0.5 * every.effects["viscous_friction@joint1"], rel=1e-6)


def test_the_smallest_effect_is_five_standard_deviations_of_what_the_columns_leave(tmp_path):
    (found,) = outlooks(tmp_path, PLATFORM)
    b = bench("ur5")
    model, (segment,) = b.problem.row_model, b.problem.segments["identification"]
    effect = next(e for e in b.experiment.library.places("sensor_delay", b.experiment.robot.joint_names, model.channels.names))
    trajectory = replace(model.state(segment, 0, len(segment.times)), bandwidth=model.bandwidth, middle=b.middle)
    read = [
        plant_readings(b.experiment.robot, model.channels, trajectory, b.links, (*b.terms, *more))
        for more in ((), (Term(effect, (0.004,)),))
    ]
    rows = [np.concatenate([k.rows for k in make_blocks(model, [replace(segment, readings=r)])]) for r in read]
    std = np.repeat([0.5, 0.05], 3)[:, None]
    x = (rows[0][:, :, :-1] / std).reshape(-1, rows[0].shape[2] - 1)
    z = ((rows[1] - rows[0])[:, :, -1:] / std).ravel()
    left = z - x @ np.linalg.lstsq(x, z, rcond=None)[0]
    assert found.effects["sensor_delay@sensor"] == pytest.approx(5.0 / np.linalg.norm(left), rel=1e-3)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('[[sensor]]\nname = "a"\nkind = "base"\nnoise = [0.5, 0.1, 0.1]\n', "noise has 3 numbers; give one number for forces"),
        ('[[sensor]]\nname = "a"\nkind = "scale"\nnoise = [0.5]\n', "kind"),
        ('[[sensor]]\nname = "a"\nkind = "base"\nnoize = [0.5]\nnoise = [1, 1]\n', "noize"),
        ('[[sensor]]\nname = "a"\nkind = "wrist"\nnoise = [0.5, 0.1]\n', "joint is missing"),
        ('[[sensor]]\nname = "a"\nkind = "plate"\nnoise = [0.5]\n', "at least three"),
        ('[[sensor]]\nname = "a"\nkind = "plate"\ncells = [[0,0,0],[1,0,0],[2,0,0]]\nnoise = [0.5]\n', "stand in one line"),
        ('[[sensor]]\nname = "a"\nkind = "torque"\njoints = ["x"]\nnoise = [0.5]\n', "joint 'x' is none of"),
        ('[[sensor]]\nname = "a"\nkind = "torque"\njoint = "x"\nnoise = [0.5]\n', "joint is not for kind torque"),
        ('[[sensor]]\nname = "a"\nkind = "torque"\nnoise = [0.5]\n' * 2, "two sensors are named"),
        ("format = 1\n", "sensor"),
    ],
)
def test_lists_that_will_not_do_are_refused_in_one_line(text, says, tmp_path):
    with pytest.raises(InputError) as refused:
        listed(tmp_path, text)
    assert says in str(refused.value) and "\n" not in str(refused.value) and "sensors.toml" in str(refused.value)


def test_a_list_that_is_not_there_and_a_joint_that_does_not_exist(tmp_path):
    with pytest.raises(InputError, match="no such file; give the path of a sensors.toml"):
        read_sensors(tmp_path / "no.toml", bench("ur5").experiment.robot)
    with pytest.raises(InputError, match='sensor "w"'):
        outlooks(tmp_path, '[[sensor]]\nname = "w"\nkind = "wrist"\njoint = "nowhere"\nnoise = [0.1, 0.01]\n')


def test_the_list_in_the_documentation_can_be_read(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "howto" / "accuracy.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"^```toml\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    (tmp_path / "sensors.toml").write_text(text, encoding="utf-8")
    found = read_sensors(tmp_path / "sensors.toml", bench("puma").experiment.robot)
    assert [c.kind for c in found] == ["base", "plate", "wrist", "torque"]


def test_torque_sensors_are_compared_where_the_torques_of_some_joints_were_recorded(tmp_path):
    def partly(motion: Motion) -> Motion:
        torques = np.where(np.arange(6) == 0, np.nan, motion.table.torques)
        return replace(motion, table=replace(motion.table, torques=torques))

    text = '[[sensor]]\nname = "t"\nkind = "torque"\nnoise = [0.2]\n'
    own = bench("ur5")
    some = replace(own, experiment=replace(own.experiment, motions=tuple(map(partly, own.experiment.motions))))
    assert some.experiment.torque_joints == (1, 2, 3, 4, 5)
    (found,) = choose_sensor(some, listed(tmp_path, text)).outlooks
    np.testing.assert_allclose(found.determined.std, outlooks(tmp_path, text)[0].determined.std)
