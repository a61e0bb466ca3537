"""Exact effects on recordings of another physics engine, whose truth is known."""

import json

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import butter, sosfiltfilt

from bayesid.effects import MotionSegment, Term, readings
from bayesid.recordings.experiment import load_experiment
from bayesid.regression.readings import make_channels
from bayesid.signals.smoothing import smooth
from tests.effects.arms import LIBRARY

#: What the answers do not say is found from the recording: a ripple's phase, a mount's stiffness (its middle).
_UNKNOWN = {"07": 2}


@pytest.mark.parametrize("case", ["03", "04", "05", "06", "07", "09", "10", "11", "12", "13"])
def test_truth_explains_recordings_to_the_floor(shared, case):
    answer = json.loads(shared(f"practice/answers/practice-{case}.json").read_text())
    experiment = load_experiment(shared(f"practice/practice-{case}"))
    robot, channels = experiment.robot, make_channels(experiment, answer["channel"])
    links = np.array([answer["true_links"][f"joint{i + 1}"] for i in range(robot.n)])
    terms = []
    for entry in answer["effects"]:
        (effect,) = LIBRARY.parse([f"{entry['name']}@{entry['where']}"], robot.joint_names, channels.names, experiment.gear_ratio)
        terms.append(Term(effect, tuple(entry["parameters"].get(k, {}).get("value", 0.0) for k in effect.parameters)))
    name = "identification" if case in ("12", "13") else "validation"  # contacts, and no long stop
    (motion,) = [m for m in experiment.motions if m.name == name]
    table = motion.table
    parts = {"wrench": [table.wrench], "torque": [table.torques], "both": [table.wrench, table.torques]}
    measured, gravity = np.hstack(parts[answer["channel"]]), True
    if motion.static is not None:
        measured, gravity = measured - motion.static.wrench, False
    step = float(np.median(np.diff(table.times)))
    trim, low = round(0.6 / step), butter(4, 10.0, fs=1 / step, output="sos")
    segment = MotionSegment(table.times, *smooth(table.times, table.positions, 12.0), bandwidth=12.0)

    def error(terms):
        left = measured - readings(robot, channels, segment, links, terms, gravity=gravity)
        return sosfiltfilt(low, left, axis=0)[trim:-trim]

    if case in _UNKNOWN:
        k = _UNKNOWN[case]

        def changed(x):
            return [Term(terms[0].effect, (*terms[0].values[:k], float(x[0]), *terms[0].values[k + 1 :]))]

        best = min((least_squares(lambda x: error(changed(x)).ravel(), [s]) for s in (0.0, 2.0, 4.0)), key=lambda f: f.cost)
        terms = changed(best.x)
    floor = np.array([answer["floor_filtered"][n] for n in channels.names])
    ratio = np.sqrt(np.mean(error(terms) ** 2, axis=0)) / floor
    without = np.sqrt(np.mean(error([]) ** 2, axis=0)) / floor
    # The smoothing differs from the answers' filter: quantised encoders and contacts leave a little more.
    assert ratio.max() < (1.9 if case == "13" else 1.25)
    assert without.max() > 1.4 and np.sqrt(np.mean(ratio**2)) < 0.9 * np.sqrt(np.mean(without**2))
