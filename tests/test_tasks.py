"""Tasks on other processes: the same results, in order, whatever happens to a worker."""

import os
import pickle
import signal
import subprocess
import sys
import time
from functools import partial

import numpy as np
import pytest

import bayesid
from bayesid import effects, tasks
from bayesid.errors import EstimationError, InputError
from bayesid.recordings.experiment import Experiment, Motion, Sensor
from bayesid.recordings.writer import write_experiment
from bayesid.regression import rows
from bayesid.tasks import cluster, fold, in_task, map_tasks
from tests.simulated import fourier, puma2, recording

pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def address():
    """A scheduler with two local workers that somebody else has started."""
    with tasks.local_cluster(2) as address:
        yield address


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Experiment:
    robot = puma2(tmp_path_factory.mktemp("arm"))
    noise = dict(force_std=0.3, torque_std=0.1, resolution=1e-5, offset=0.5)
    made = [recording(robot, Sensor(), fourier(robot, k, 12.0), seed=k, **noise) for k in (1, 2)]
    motions = Motion("fitted", "identification", made[0]), Motion("unseen", "validation", made[1])
    return Experiment("arm", robot, motions, Sensor(), position_resolution=1e-5, inertia_rel_std=0.3)


def test_a_fold_adds_in_order_whatever_the_number():
    for count in (1, 2, 7, 8, 9, 63, 64, 65, 600):
        assert fold(map(str, range(count)), "{} {}".format).split() == [str(k) for k in range(count)]


def test_a_fold_holds_few_sums():
    held = []
    fold(iter(range(4096)), lambda a, b: held.append(1) or a + b)
    assert len(held) == 4095 and fold(range(4096), int.__add__) == 4095 * 2048


def test_without_a_cluster_items_are_done_here_one_after_the_other():
    seen = []
    results = map_tasks(lambda k: seen.append(k) or k * k, range(5))
    assert next(results) == 0 and seen == [0]
    assert list(results) == [1, 4, 9, 16]


def _told(k: int) -> tuple[int, int, bool, list[int]]:
    import numba
    from threadpoolctl import threadpool_info

    threads = [library["num_threads"] for library in threadpool_info()]
    return k, os.getpid(), in_task(), [numba.get_num_threads(), *threads]


def test_tasks_are_done_elsewhere_in_order_and_in_one_thread(address):
    with cluster(scheduler=address):
        found = list(map_tasks(_told, range(12)))
    assert [k for k, *_ in found] == list(range(12))
    assert os.getpid() not in {process for _, process, *_ in found}
    assert all(inside and set(threads) == {1} for *_, inside, threads in found)
    assert not tasks.on_cluster()


def test_a_function_of_a_users_script_may_use_the_package(address):
    # Sent by value, as those of ``__main__`` are, with the module that it refers to.
    script: dict = {"bayesid": bayesid, "effects": effects}
    exec("def both(k):\n    return k, bayesid.__version__, effects.Term.__name__", script)
    with cluster(scheduler=address):
        assert list(map_tasks(script["both"], range(3))) == [(k, bayesid.__version__, "Term") for k in range(3)]
    assert pickle.loads(pickle.dumps(effects)) is effects


def _fails_at(number: int, k: int) -> int:
    if k == number:
        raise InputError(f"item {k} cannot be done", file="a.csv")
    return k


def test_an_error_of_a_task_is_raised_as_it_is_here(address):
    with cluster(scheduler=address):
        results = map_tasks(partial(_fails_at, 3), range(10))
        assert [next(results) for _ in range(3)] == [0, 1, 2]
        with pytest.raises(InputError, match="item 3") as caught:
            next(results)
        assert caught.value.file == "a.csv"
        assert list(map_tasks(abs, [-1, -2])) == [1, 2]


def _killed_once(mark: str, k: int) -> np.ndarray:
    if k == 5 and not os.path.exists(mark):
        with open(mark, "w"):
            os.kill(os.getpid(), signal.SIGKILL)
    return np.random.default_rng(k).normal(size=4)


def test_a_killed_worker_changes_no_digit(tmp_path):
    expected = [_killed_once(os.devnull, k) for k in range(12)]
    with cluster(2):
        found = list(map_tasks(partial(_killed_once, str(tmp_path / "mark")), range(12)))
    assert (tmp_path / "mark").exists()
    np.testing.assert_array_equal(found, expected)


def _always_killed(_: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_task_that_kills_every_worker_is_told(monkeypatch):
    monkeypatch.setattr(tasks, "_LOST", 0)
    with cluster(2), pytest.raises(EstimationError, match="give each more memory"):
        list(map_tasks(_always_killed, range(2)))


def test_what_cannot_be_is_refused(monkeypatch, address):
    with pytest.raises(InputError, match="workers"), cluster(0):
        pass
    with pytest.raises(InputError, match="both given"), cluster(2, address):
        pass
    monkeypatch.setattr(tasks, "_PATIENCE", 0.2)
    for wrong in ("tcp://127.0.0.1:1", "nonsense://x", "127.0.0.1"):
        with pytest.raises(InputError, match="no scheduler answers"), cluster(scheduler=wrong):
            pass
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"bayesid\[dask\]"), cluster(2):
        pass


def test_a_recording_in_chunks_is_identified_alike_here_and_elsewhere(arm, address, tmp_path, monkeypatch):
    pytest.importorskip("pyarrow")
    write_experiment(arm, tmp_path / "e")
    arm.motions[0].table.to_dataframe().to_parquet(tmp_path / "e" / "fitted.parquet", row_group_size=400)
    toml = (tmp_path / "e" / "experiment.toml").read_text()
    (tmp_path / "e" / "experiment.toml").write_text(toml.replace('"fitted.csv"', '"fitted.parquet", chunked = true'))
    monkeypatch.setattr(rows, "_TASK_SAMPLES", 1)
    monkeypatch.setattr(rows, "_BLOCK_ROWS", 64)
    here = bayesid.identify(tmp_path / "e", "wrench")
    monkeypatch.undo()  # workers have settings of their own: what a task does is sent with it
    there = bayesid.identify(tmp_path / "e", "wrench", scheduler=address)
    std = here.estimate.full_std
    assert np.max(np.abs(there.estimate.solution - here.estimate.solution) / std) < 1e-6


@pytest.mark.parametrize(
    "verb", ["sample", "watch", *(pytest.param(name, marks=pytest.mark.slow) for name in ("accuracy", "excite"))]
)
def test_verbs_give_the_same_wherever_they_run(verb, arm, address):
    def run(**where):
        if verb == "sample":
            return bayesid.sample(arm, 200, seed=3, keep_going=True, sampler=bayesid.Sampler(longest=1), **where).chains.draws
        if verb == "accuracy":
            found = bayesid.accuracy(arm, runs=0, certificate=20, seed=3, **where)
            return np.concatenate([found.certificate.coverage, *(s.bias for s in found.susceptibility)])
        if verb == "watch":
            found = bayesid.watch(arm, [arm, arm], seed=3, **where)
            recordings = found.to_dict()["recordings"]
            assert all(r["verdict"] == "nothing_missing" for r in recordings)
            # What is left beside effects that are not there depends on the last digit: where their fits stop.
            return np.array([r["gap"] for r in recordings])
        found = bayesid.excite(arm, starts=2, randoms=4, seconds=600.0, duration=5.0, harmonics=2, rate=25.0, **where)
        return found.trajectory.positions

    here, there = run(), run(scheduler=address)
    np.testing.assert_allclose(there, here, rtol=1e-9, atol=1e-12 * np.abs(here).max())


_SCRIPT = """
import time
from bayesid.tasks import cluster, map_tasks

def slow(k):
    time.sleep(0.3)
    return k

if __name__ == "__main__":
    with cluster(2):
        for k in map_tasks(slow, range(1000)):
            print(k, flush=True)
"""


def test_an_interrupt_ends_it_with_all_its_processes(tmp_path):
    (tmp_path / "script.py").write_text(_SCRIPT)
    process = subprocess.Popen(
        [sys.executable, "script.py"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    assert process.stdout is not None and process.stdout.readline() == "0\n"
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, errors = process.communicate(timeout=60)
    assert process.returncode == -signal.SIGINT and errors.count("Traceback") == 1
    for _ in range(100):
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            break
        time.sleep(0.1)
    else:
        pytest.fail("processes are left over")
