"""One thread for matrices while a picture is worked on, and the user's own number afterwards."""

import os
import subprocess
import sys
import threading

import pytest
from threadpoolctl import ThreadpoolController, threadpool_limits

from opnav_workbench.bodies import BodyCenter
from opnav_workbench.bodies.disk import measurement
from opnav_workbench.constants import ONE_THREAD
from opnav_workbench.session import history
from opnav_workbench.threads import one_thread


def threads_of_blas():
    return {library["num_threads"] for library in ThreadpoolController().select(user_api="blas").info()}


@pytest.fixture
def _two_threads():
    with threadpool_limits(2, user_api="blas"):
        if threads_of_blas() != {2}:
            pytest.skip("this machine's library of linear algebra has one thread only")
        yield


@pytest.mark.usefixtures("_two_threads")
def test_one_thread_within_and_as_before_after_it():
    with one_thread():
        assert threads_of_blas() == {1}
        with one_thread():
            assert threads_of_blas() == {1}
        assert threads_of_blas() == {1}
    assert threads_of_blas() == {2}


@pytest.mark.usefixtures("_two_threads")
def test_the_limit_is_lifted_after_an_error():
    @one_thread()
    def fails():
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fails()
    assert threads_of_blas() == {2}


@pytest.mark.usefixtures("_two_threads")
def test_several_workers_leave_the_number_as_it_was():
    inside, leave = threading.Event(), threading.Event()

    def works():
        with one_thread():
            inside.set()
            leave.wait(10.0)

    worker = threading.Thread(target=works)
    with one_thread():
        worker.start()
        assert inside.wait(10.0)
        assert threads_of_blas() == {1}
    leave.set()
    worker.join()
    assert threads_of_blas() == {2}


@pytest.mark.usefixtures("_two_threads")
def test_a_step_of_a_session_and_a_disk_compute_with_one_thread(monkeypatch):
    seen = []
    monkeypatch.setattr(measurement, "with_true_sky", lambda picture: seen.append(threads_of_blas()))
    monkeypatch.setattr(
        measurement, "placed_body", lambda _, name, *a: BodyCenter.without_center(name, "disk", "failed")
    )
    assert measurement.measure_disk(None, "BODY", "disk", None, None).status == "failed"
    monkeypatch.setitem(history.STEPS, "looked", (lambda *a: seen.append(threads_of_blas()), None))
    history.History.state_after_step(
        type("Bare", (), {"_context": None, "seen_inputs": None, "state": None})(), "looked", {}
    )
    assert seen == [{1}, {1}]
    assert threads_of_blas() == {2}


@pytest.mark.parametrize("given", [{}, {"OMP_NUM_THREADS": "2"}])
def test_a_program_that_begins_with_one_thread_limits_none(given):
    """A number that its user has set is kept, and then limited while a picture is worked on."""
    code = (
        "from opnav_workbench.threads import begin_with_one, one_thread\nbegin_with_one()\n"
        "import sys, numpy\nfrom threadpoolctl import threadpool_info as told\n"
        "def most(): return max(l['num_threads'] for l in told() if l['user_api'] == 'blas')\n"
        "outside = most()\nwith one_thread():\n    print(outside, most())"
    )
    known = {name: value for name, value in os.environ.items() if name not in ONE_THREAD}
    found = subprocess.run(
        [sys.executable, "-c", code], env=known | given, capture_output=True, text=True, check=True
    )
    outside, within = map(int, found.stdout.split())
    assert within == 1
    assert outside == 1 or given
