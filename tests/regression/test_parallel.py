import os
import threading
import time
from collections.abc import Generator

import pytest

from bayesid.regression.parallel import both, in_order


def test_two_jobs_run_at_once():
    met = threading.Barrier(2, timeout=10.0)

    def job(value):
        met.wait()
        return value

    assert both(lambda: job(1), lambda: job("two")) == (1, "two")


def test_the_first_jobs_error_comes_first_and_none_is_lost():
    def fails(error, after=0.0):
        time.sleep(after)
        raise error

    with pytest.raises(KeyError):
        both(lambda: fails(KeyError("one"), 0.05), lambda: fails(ValueError("other")))
    with pytest.raises(ValueError, match="other"):
        both(lambda: 1, lambda: fails(ValueError("other")))


def test_no_more_threads_work_than_there_are_cores(monkeypatch):
    """Jobs of jobs are done by the thread that has them while all cores are busy; results come in order all the same."""
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    lock, working, most = threading.Lock(), [0], [0]

    def counted(value):
        with lock:
            working[0] += 1
            most[0] = max(most[0], working[0])
        time.sleep(0.003)
        with lock:
            working[0] -= 1
        return value

    def nested(k):
        return list(in_order(lambda j: counted(10 * k + j), range(3)))

    assert list(in_order(nested, range(4))) == [[10 * k + j for j in range(3)] for k in range(4)]
    assert both(lambda: nested(1), lambda: list(map(nested, range(2)))) == ([10, 11, 12], [[0, 1, 2], [10, 11, 12]])
    assert most[0] <= 2


def test_a_core_that_becomes_free_is_used(monkeypatch):
    """While another job works beside, jobs are done by the thread that asks; once that has ended, by two."""
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    ended, met = threading.Event(), threading.Barrier(2, timeout=10.0)

    def job(k):
        if k < 2:
            return threading.get_ident()
        if k == 2:
            ended.set()
            time.sleep(0.1)
            return threading.get_ident()
        met.wait()  # only two threads can pass
        return threading.get_ident()

    threads, _ = both(lambda: list(in_order(job, range(7))), lambda: ended.wait(10.0))
    assert set(threads[:3]) == {threading.get_ident()} and len(set(threads[3:])) == 2


def test_errors_of_jobs_leave_the_cores_free(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 2)

    def fails(_):
        raise ValueError("bad")

    for _ in range(3):
        with pytest.raises(ValueError, match="bad"):
            list(in_order(fails, range(5)))
        with pytest.raises(ValueError, match="bad"):
            both(lambda: fails(0), lambda: fails(1))
    test_two_jobs_run_at_once()


def test_the_last_job_of_jobs_has_all_cores(monkeypatch):
    """Two jobs of the only job that is left run at once, and the thread that has it is counted once."""
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    met = threading.Barrier(2, timeout=10.0)

    def last(k):
        if k == 0:
            return 0
        time.sleep(0.05)
        both(met.wait, met.wait)
        return both(lambda: list(in_order(lambda j: met.wait() >= 0, range(2))), lambda: None)[0]

    assert list(in_order(last, range(2))) == [0, [True, True]]


def test_results_that_nobody_asks_for_leave_the_cores_free(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    taken = in_order(lambda k: k, range(100))
    assert isinstance(taken, Generator) and next(taken) == 0
    taken.close()
    test_two_jobs_run_at_once()
