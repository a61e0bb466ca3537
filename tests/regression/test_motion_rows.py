import numpy as np

from bayesid.regression import row_cache
from bayesid.regression.problem import prepare, restrict
from bayesid.regression.row_cache import MotionRows
from bayesid.regression.rows import make_blocks
from tests.simulated import Motion, Sensor, experiment, fourier, puma2, recording


def made(tmp_path):
    robot, sensor = puma2(tmp_path), Sensor()
    motions = [
        Motion(name, role, recording(robot, sensor, fourier(robot, seed)))
        for name, role, seed in (("a", "identification", 1), ("b", "identification", 2), ("c", "validation", 3))
    ]
    return prepare(experiment(robot, motions, sensor))


def test_rows_of_a_motion_are_made_once(tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr(row_cache, "make_blocks", lambda *given, **named: calls.append(1) or make_blocks(*given, **named))
    problem = made(tmp_path)
    both = list(problem.regression.rows.blocks())
    alone = list(restrict(problem, ["b"]).regression.rows.blocks())
    assert len(calls) == 2 and alone[-1] is both[-1]
    fresh = list(make_blocks(problem.row_model, problem.segments["b"]))
    for one, other in zip(alone, fresh, strict=True):
        np.testing.assert_array_equal(one.rows, other.rows)


def test_what_does_not_fit_is_made_anew_and_readings_that_stop_early_keep_nothing(tmp_path, monkeypatch):
    problem = made(tmp_path)
    monkeypatch.setattr(row_cache, "CACHE_BYTES", 0)
    rows = MotionRows(problem.row_model, problem.segments)
    one, two = list(rows.blocks(["a"])), list(rows.blocks(["a"]))
    assert one[0] is not two[0]
    np.testing.assert_array_equal(one[0].rows, two[0].rows)
    monkeypatch.undo()
    rows = MotionRows(problem.row_model, problem.segments)
    first = next(rows.blocks(["a"]))
    again = list(rows.blocks(["a"]))
    assert again[0] is not first and next(rows.blocks(["a"])) is again[0]
