"""Every number that a verb prints is in its JSON, to the digits printed: in text, ``repr``, notebooks and tables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pandas import DataFrame
from pandas.api.types import is_numeric_dtype

import bayesid
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording
from tests.workflows.numbers import missing, plain, printed, scalars

VERBS = (
    "check", "identify", "identify torque", "compare", "sample", "identifiability", "accuracy", "diagnose", "diagnose reference",
    "bounds", "excite", "tell", "watch",
)  # fmt: skip


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """What every verb finds on a small arm: offsets, friction that the model lacks, and a link that grew heavier."""
    robot, sensor = puma2(tmp_path_factory.mktemp("arm")), Sensor(translation=np.array([0.0, 0.0, -0.1]))
    heavier = robot.nominal.copy()
    heavier[1, 0] += 1.0

    def arm(effects=(), phi=None, friction=0.0):
        motions = []
        for seed, role in ((1, "identification"), (2, "validation")):
            path = fourier(robot, seed, duration=8.0)
            table = recording(
                robot, sensor, path, seed=seed, phi=phi, force_std=0.5, torque_std=0.05, resolution=1e-4,
                offset=np.array([3.0, -2.0, 4.0, 0.1, 0.2, 0.3]),
            )  # fmt: skip
            motions.append(Motion(role, role, replace(table, torques=table.torques + friction * path[2])))
        return experiment(robot, motions, sensor, effects=effects, position_resolution=1e-4, inertia_rel_std=0.1)

    own, later = arm(("sensor_offset",)), arm(("sensor_offset",), heavier.ravel())
    rubbing, effect = arm(friction=2.0), "viscous_friction@joint1"
    found = bayesid.identify(own)
    return dict(
        zip(
            VERBS,
            (
                bayesid.check(own), found,
                bayesid.identify(rubbing, channel="torque", method="sdp", effects=["viscous_friction"]),
                bayesid.compare(own, ["ols", "wls", "ridge"]), bayesid.sample(own, draws=400), bayesid.identifiability(own),
                bayesid.accuracy(found, runs=5), bayesid.diagnose(rubbing, channel="torque"),
                bayesid.diagnose(later, reference=own), bayesid.bounds(found),
                bayesid.excite(own, duration=8, period=4, seconds=0.5),
                bayesid.tell(rubbing, [effect, "coulomb_friction@joint1"], channel="torque"), bayesid.watch(own, [own, later]),
            ),
            strict=True,
        )
    )  # fmt: skip


def shown(result) -> dict[str, str]:
    """The texts of a result."""
    return {"print": str(result), "repr": repr(result), "notebook": plain(result._repr_html_())}


@pytest.mark.parametrize("verb", VERBS)
def test_every_number_printed_is_in_the_json(results, verb):
    result = results[verb]
    document = result.to_dict()
    assert {how: lost for how, text in shown(result).items() if (lost := missing(text, document))} == {}
    assert sum(len(printed(text, document)) for text in shown(result).values()) >= 5


@pytest.mark.parametrize("verb", VERBS)
def test_numbers_that_were_printed_otherwise_would_be_noticed(results, verb):
    """Of numbers with three digits or more, moved by a few per cent, hardly any is in the JSON by chance."""
    document = results[verb].to_dict()
    stored = np.array([x for x in scalars(document) if np.isfinite(x)])
    told = [p for text in shown(results[verb]).values() for p in printed(text, document)]
    precise = [p for p in told if abs(p.value) > 150 * p.half and not p.told_as]
    moved = [p._replace(value=p.value * factor) for p in precise for factor in (0.963, 1.021, 1.057)]
    assert np.mean([p.found_in(stored) for p in moved] or [0.0]) < 0.3


def tables(results) -> dict[str, tuple[DataFrame, dict]]:
    """Tables of results by name, with the JSON that must hold their numbers."""
    out = {name: (r.to_dataframe(), r.to_dict()) for name, r in results.items() if hasattr(r, "to_dataframe")}
    compared = results["compare"]
    return {**out, "scores": (compared.to_dataframe("scores"), compared.to_dict())}


def test_every_number_of_a_table_is_in_the_json(results):
    found = tables(results)
    assert {"identify", "identify torque", "compare", "scores", "sample"} <= set(found)
    for name, (table, document) in found.items():
        stored = np.unique([x for x in scalars(document) if np.isfinite(x)])
        for column in (c for c in table.columns if is_numeric_dtype(table[c])):
            for value in table[column].dropna():
                assert np.isin(value, stored), f"{name}, {column}: {value}"


@pytest.mark.parametrize("verb", VERBS)
def test_every_result_draws_its_figure(results, verb):
    figure = results[verb].plot()
    assert figure._repr_png_().startswith(b"\x89PNG") and figure.axes
