import threading
import time

import pytest

from bayesid.regression.parallel import both


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
