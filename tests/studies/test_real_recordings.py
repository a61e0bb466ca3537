"""What identify says about real robots, beside the figures that others published for the same logs."""

from functools import cache

import numpy as np
import pytest

import bayesid
from bayesid.regression.options import FitOptions
from bayesid.regression.problem import prepare, restrict
from bayesid.validation.agreement import compare_estimates
from bayesid.workflows.sample import as_estimate
from tests.studies.real_robots import Case, apart, estimate, halves

FRICTION = ["viscous_friction", "coulomb_friction", "torque_offset"]


@pytest.fixture(scope="module")
def rubbing(shared):
    """What is identified of a real arm by name, friction included; of each once."""
    return cache(lambda name: bayesid.identify(shared(name), effects=FRICTION))


@pytest.fixture(scope="module")
def wrist(shared):
    return bayesid.identify(shared("data/kuka-med-wrist"))


def test_wrist_poses_give_the_published_mass_and_offsets(wrist):
    low, high = wrist.estimate.low, wrist.estimate.high
    assert wrist.estimate.base.labels[0] == "m3" and low[0] < 0.932 < high[0]
    com = np.array([0.28, 0.05, 43.90]) * 1e-3 * 0.9323
    assert (low[1:] < com).all() and (com < high[1:]).all()
    offsets = -np.array([9.0765, -1.0181, 9.9848, 0.43250, -0.69155, -0.15703])
    value, std = wrist.offset
    assert (np.abs(value - offsets) < 1.96 * std).all()


def test_wrist_says_what_is_not_excited_and_that_poses_and_motion_disagree(wrist):
    assert {label[:2] for label in wrist.unexcited} == {"I3"} and len(wrist.unexcited) == 6
    text = " ".join(wrist.warnings)
    assert "Not excited" in text and "Do not average" in text and "baseline" in text
    apart = {a.first: a for a in wrist.agreements}
    # Intervals of both motions count their own scatter, that of the one with hammer taps more.
    assert apart["motion baseline"].contradiction and apart["motion vibrations"].rms > 1.5


def test_repeats_of_a_wrist_motion_agree_within_their_intervals(shared):
    """The same slow turn recorded twice, once with hammer taps on the arm: 1 sigma rms apart.

    By `tls`: intervals of `wls` count the bias that encoder errors cause, which repeats of one motion share.
    """
    problem = prepare(bayesid.load_experiment(shared("data/kuka-med-wrist")), FitOptions(motions=["baseline", "vibrations"]))
    one, two = (bayesid.fit(restrict(problem, [name]).regression, "tls") for name in problem.fitted)
    agreement = compare_estimates("baseline", one, "vibrations", two)
    assert 0.5 < agreement.rms < 1.6 and not agreement.contradiction


@pytest.mark.parametrize(
    "name, published_fit, published_validation", [("data/ur10", 0.065, 0.091), ("data/kuka-lwr4", 0.022, 0.144)]
)
def test_joint_torques_are_predicted_as_well_as_published(rubbing, name, published_fit, published_validation):
    result = rubbing(name)
    assert result.fitted[0].relative_error_raw < published_fit
    assert result.validation[0].relative_error_raw < published_validation
    # The published validations are no proof that the model is complete, and neither is this one.
    assert any("is predicted with an error of" in w for w in result.warnings)
    assert not result.estimate.details.model_complete


def test_posterior_of_a_model_without_friction_is_the_estimate(shared):
    """Unknown scales of channels made it trust the quietest joints: two motions were 4.7 standard deviations rms apart."""
    experiment = bayesid.load_experiment(shared("data/kuka-lwr4"))
    regression = prepare(experiment, FitOptions(motions=["measurements_1"])).regression
    estimate = bayesid.fit(regression, "wls")
    options = dict(prior="flat", draws=1000, keep_going=True, sampler=bayesid.Sampler(longest=8))
    posterior = bayesid.sample(experiment, motions=["measurements_1"], **options)
    found = as_estimate(posterior)
    assert np.sqrt(np.mean(((found.values - estimate.values) / estimate.std) ** 2)) < 0.1
    # Student's t with seven degrees of freedom has a standard deviation of sqrt(7/5) of its scale.
    assert np.all(np.abs(np.log(found.std / estimate.std / np.sqrt(7 / 5))) < 0.15)


@pytest.mark.parametrize("method", ["wls", "huber", "student", "tls", "iv", "sdp"])
def test_halves_of_a_real_motion_agree_within_their_intervals(shared, method):
    """Where the model lacks something: tls and student were 1.6 and 1.8 standard deviations apart here."""
    experiment = bayesid.load_experiment(shared("data/ur10e/feb05-20s-8h"))
    case = Case("ur10e", experiment, tuple(experiment.effects))
    bandwidth = prepare(experiment, FitOptions()).smoother.bandwidth
    distance = apart(*(estimate(case, half, method, bandwidth) for half in halves(case.fitted)))
    assert distance is not None and 0.4 < distance[0] < 1.3


@pytest.mark.parametrize("method", ["wls", "huber"])
def test_a_wrist_that_wanders_more_than_the_arm_is_counted_by_itself(shared, method):
    """One factor for all channels left the halves of this motion 1.6 standard deviations apart."""
    case = Case("ur10", bayesid.load_experiment(shared("data/ur10")), FRICTION)
    bandwidth = prepare(case.experiment, FitOptions(effects=FRICTION)).smoother.bandwidth
    distance = apart(*(estimate(case, half, method, bandwidth) for half in halves(case.fitted)))
    assert distance is not None and distance[0] < 1.3


def test_what_scatters_is_told_by_channel(rubbing):
    result = rubbing("data/ur10")
    by_channel = result.estimate.details.dispersion_by_channel
    assert by_channel is not None and set(by_channel) == {f"tau{k}" for k in range(1, 7)}
    assert result.to_dict()["details"]["dispersion_by_channel"] == by_channel
    largest = max(by_channel, key=lambda name: by_channel[name])
    assert any("Something is missing" in w and f"most in {largest}" in w for w in result.warnings)


def test_a_repeated_motion_is_not_called_a_validation(shared, rubbing):
    from dataclasses import replace

    experiment = bayesid.load_experiment(shared("data/kuka-lwr4"))
    first = experiment.motions[0]
    again = replace(first, name="again", role="validation")
    result = bayesid.identify(replace(experiment, motions=(first, again)), effects=FRICTION)
    assert result.validation[0].repeats == "measurements_1"
    assert any("repeats the fitted motion" in w for w in result.warnings)
    assert rubbing("data/kuka-lwr4").validation[0].repeats is None
