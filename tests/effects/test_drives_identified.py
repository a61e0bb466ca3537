"""What drives do beyond Coulomb and viscous friction, simulated with noise and encoder counts, and identified again."""

from dataclasses import replace

import pytest

import bayesid
from bayesid.workflows.demo import puma_setup

FRICTION = ("viscous_friction", "coulomb_friction")


@pytest.fixture(scope="module")
def puma(tmp_path_factory):
    setup = puma_setup(tmp_path_factory.mktemp("puma"))
    return setup, [bayesid.fourier_trajectory(setup.robot, duration=12.0, seed=1)]


@pytest.mark.parametrize(
    ("spec", "values", "precision"),
    [
        ("directional_friction@joint2", {"difference": 1.4}, {"difference": 0.05}),
        ("posture_friction@joint1", {"cosine": 1.5, "sine": -1.1}, {"cosine": 0.1, "sine": 0.1}),
        ("dahl_friction@joint2", {"level": 9.0, "distance": 0.02}, {"level": 0.01, "distance": 0.05}),
        ("warming_friction@joint2", {"level": 0.3, "coefficient": 0.8, "time": 6.0}, {"level": 0.2, "coefficient": 0.2}),
        ("torque_delay@joint2", {"delay": 0.004}, {"delay": 0.1}),
        ("torque_delay@robot", {"delay": -0.006}, {"delay": 0.1}),
        ("torque_gain@joint2", {"gain": 0.3}, {"gain": 0.2}),
    ],
)
def test_the_truth_lies_in_the_interval(puma, spec, values, precision):
    """99.9 % of it, and the interval is narrow enough to say something."""
    setup, motions = puma
    plant: dict[str, dict[str, float] | None] = {**dict.fromkeys(FRICTION), spec: values}
    recorded = bayesid.simulate(replace(setup, effects=(*FRICTION, spec)), motions, effects=plant, seed=4)
    found = bayesid.identify(recorded, channel="torque").to_dict()["effects"]
    (own,) = [e for e in found if f"{e['name']}@{e['where']}" == spec]
    for key, truth in values.items():
        got = own["parameters"][key]
        assert abs(got["value"] - truth) < 3.3 * got["std"]
    for key, share in precision.items():
        assert own["parameters"][key]["std"] < share * abs(values[key])
