import threading
import time

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


def test_jobs_of_a_helping_thread_start_no_threads_of_their_own():
    """Every core has work already; results come in order all the same."""

    def nested(k):
        return threading.get_ident(), list(in_order(lambda j: (threading.get_ident(), 10 * k + j), range(3)))

    found = list(in_order(nested, range(4)))
    assert [[value for _, value in inner] for _, inner in found] == [[10 * k + j for j in range(3)] for k in range(4)]
    assert all(ident == here for here, inner in found for ident, _ in inner)
    here, (beside, inner) = both(
        threading.get_ident, lambda: (threading.get_ident(), both(threading.get_ident, threading.get_ident))
    )
    assert here == threading.get_ident() != beside and inner == (beside, beside)
