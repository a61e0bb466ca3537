"""Verbs take an experiment or its folder, and say in one line what they take when given something else."""

import pytest

import bayesid
from tests.simulated import Motion, experiment, fourier, puma2, recording


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("given")
    robot = puma2(place)
    table = recording(robot, None, fourier(robot, 1, duration=10.0), torque_std=0.1)
    bayesid.write_experiment(experiment(robot, [Motion("a", "identification", table)]), place / "arm")
    return place / "arm"


def test_a_folder_is_as_good_as_an_experiment(folder):
    loaded = bayesid.load_experiment(folder)
    for path in (folder, str(folder)):
        assert bayesid.check(path).to_dict() == bayesid.check(loaded).to_dict()
    truths = [bayesid.simulate(given, seed=3).motions[0].table.torques for given in (folder, loaded)]
    assert truths[0] is not None and (truths[0] == truths[1]).all()


@pytest.mark.parametrize("verb", ["check", "identify", "compare", "sample", "diagnose", "simulate", "fit"])
@pytest.mark.parametrize("given", [None, 3, {"motions": ()}])
def test_anything_else_is_refused_in_one_line(verb, given):
    with pytest.raises(bayesid.InputError, match="is given for the") as refusal:
        getattr(bayesid, verb)(given)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("verb", ["check", "identify", "compare", "sample", "diagnose", "simulate"])
def test_a_folder_that_is_not_there_is_named(verb, tmp_path):
    with pytest.raises(bayesid.InputError, match="nowhere"):
        getattr(bayesid, verb)(tmp_path / "nowhere")
