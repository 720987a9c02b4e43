"""Slow work of the workbench: opening with a page of its own, keys that wait in line, neighbors opened ahead, one undo."""

import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from opnav_workbench.errors import ImageError, SelectionPending
from opnav_workbench.kernels import KernelSet
from opnav_workbench.session import ImageSession
from opnav_workbench.session import context as session_context
from opnav_workbench.simulation import PictureScenario, simulate
from opnav_workbench.workbench.app import Workbench
from opnav_workbench.workbench.controller import WorkbenchController
from opnav_workbench.workbench.image_queue import ImageQueue, QueueItem
from opnav_workbench.workbench.image_view import ImageView
from opnav_workbench.workbench.tabs import GIVE_WAY_S, giving_way

CAUSE = "third.fit: the header gives no time; add one."


@pytest.fixture
def slow_queue(hands_on, demo_truths):
    """Three images: the first opens at once, the second when told, the third never."""
    go_on, opened = threading.Event(), []

    def second():
        opened.append("second")
        assert go_on.wait(10.0)
        return ImageSession.open(demo_truths[0].picture, "new_horizons")

    def third():
        opened.append("third")
        raise ImageError(CAUSE)

    hands = hands_on(demo_truths[0].picture)
    first = hands.session
    items = [QueueItem("first", lambda: first), QueueItem("second", second), QueueItem("third", third)]
    yield SimpleNamespace(queue=ImageQueue(items), viewer=hands.viewer, go_on=go_on, opened=opened)
    go_on.set()


def workbench_on(slow, *, ahead=False):
    bench = WorkbenchController(slow.queue, slow.viewer, ahead=ahead)
    bench.runner.wait()
    return bench


def press(bench, *keys):
    for key in keys:
        bench.handle({"act": "key", "arg": key})


def until(true):
    end = time.monotonic() + 5.0
    while not true():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_slow_opening_shows_its_name_and_blocks_nothing(slow_queue):
    bench = workbench_on(slow_queue)
    began = time.monotonic()
    press(bench, "PageDown")
    assert time.monotonic() - began < 2.0
    assert slow_queue.viewer.message == "opening second"  # not the picture before
    assert "second" in bench.regions()["panel"]
    assert "<progress" in bench.regions()["status"]
    assert slow_queue.queue.items[1].status == "opening"
    with pytest.raises(SelectionPending, match="second is being opened"):
        slow_queue.queue.require("pointing")
    press(bench, "f")  # waits for the picture
    assert "1 waiting" in bench.regions()["status"]
    press(bench, "PageUp")  # it is not waited for any more
    assert slow_queue.viewer.message == ""
    assert slow_queue.viewer.shown[-1] is slow_queue.queue.items[0].session
    slow_queue.go_on.set()
    until(lambda: slow_queue.queue.items[1].session is not None)
    assert slow_queue.viewer.shown[-1] is slow_queue.queue.items[0].session
    press(bench, "PageDown")
    bench.runner.wait()
    assert slow_queue.opened == ["second"]


def test_failed_image_has_a_page_of_its_own(slow_queue):
    slow_queue.go_on.set()
    bench = workbench_on(slow_queue)
    press(bench, "PageDown")
    bench.runner.wait()
    press(bench, "PageDown")
    bench.runner.wait()
    regions = bench.regions()
    assert slow_queue.viewer.message == "third cannot be opened"
    page = "".join(regions[name] for name in ("panel", "status", "header"))
    assert page.count(CAUSE) == 1
    assert 'data-act="open_again"' in regions["panel"]
    press(bench, "f", "3", "a", "1")
    assert slow_queue.opened == ["second", "third"]  # no key tries by itself
    bench.handle({"act": "open_again"})
    bench.runner.wait()
    assert slow_queue.opened == ["second", "third", "third"]
    session = slow_queue.queue.items[0].session
    slow_queue.queue.items[2].open = lambda: session
    bench.handle({"act": "open_again"})
    bench.runner.wait()
    assert slow_queue.viewer.shown[-1] is session


def test_neighbors_are_opened_ahead(slow_queue):
    slow_queue.go_on.set()
    bench = workbench_on(slow_queue, ahead=True)
    until(lambda: slow_queue.queue.items[1].status == "open")
    assert slow_queue.opened == ["second"]
    began = time.monotonic()
    press(bench, "PageDown")
    assert bench.runner.running is None
    assert slow_queue.viewer.shown[-1] is slow_queue.queue.items[1].session
    assert time.monotonic() - began < 0.2
    until(lambda: slow_queue.queue.items[2].status == "failed")  # told only when its turn comes
    assert bench.runner.status.kind != "error"


def test_showing_what_is_ready_starts_and_finds_nothing(slow_queue, monkeypatch):
    runs, work, show, medians = [], WorkbenchController._work_ahead, slow_queue.viewer.show, []
    monkeypatch.setattr(WorkbenchController, "_work_ahead", lambda bench: (runs.append(bench), work(bench)))
    known = session_context._TYPICAL_NOISE_DN
    slow_queue.viewer.show = lambda session: (medians.append(session.context in known), show(session))
    slow_queue.go_on.set()
    bench = workbench_on(slow_queue, ahead=True)
    until(lambda: slow_queue.queue.items[1].session is not None and not bench._works_ahead)
    press(bench, "PageDown")
    until(lambda: slow_queue.queue.items[2].status == "failed" and not bench._works_ahead)
    n_runs = len(runs)
    assert n_runs == 2  # the second picture, then the third
    press(bench, "PageUp", "PageDown", "PageUp")
    assert len(runs) == n_runs
    assert slow_queue.viewer.ahead == [slow_queue.queue.items[1].session]
    assert len(medians) == 5
    assert all(medians)  # the noise of all pixels was found while the pictures were opened


@pytest.mark.slow
def test_keys_pressed_during_a_step_are_carried_out_in_order(star_hands, monkeypatch):
    go_on, original = threading.Event(), star_hands.session.repoint

    def slow(*arguments, **options):
        go_on.wait(10.0)
        original(*arguments, **options)

    monkeypatch.setattr(star_hands.session, "repoint", slow)
    bench = star_hands.controller
    press(bench, "p", "a", "a", "r", "1")
    assert bench.runner.line
    assert not star_hands.session.state.decisions
    go_on.set()
    bench.runner.wait()
    decided = [verdict for verdict, _ in star_hands.session.state.decisions.values()]
    assert decided == ["accepted", "accepted", "rejected"]


@pytest.mark.slow
def test_a_body_found_is_one_undo(star_hands):
    star_hands.press("A", "p", "3")
    star_hands.send("add_body", value="PLUTO")
    before = star_hands.steps
    star_hands.press("f")
    assert star_hands.session.state.observables
    star_hands.press("Ctrl+z")
    assert star_hands.steps == before
    star_hands.press("Ctrl+y")
    assert star_hands.session.state.observables
    star_hands.press("Ctrl+z")
    assert star_hands.steps == before


@pytest.mark.slow
def test_a_choice_of_scans_is_one_undo(hands_on, tmp_path):
    picture = {"name": "near", "utc": "2015-07-12T08:46:57", "camera": "lorri_4x4", "exposure_s": 0.02}
    scenario = PictureScenario.model_validate(
        {
            "mission": "new_horizons",
            "kernels": "new_horizons/pluto_approach",
            "bodies": [{"name": "PLUTO"}],
            "pictures": [picture],
        }
    )
    simulate(scenario, tmp_path)
    with KernelSet("new_horizons/pluto_approach"):
        hands = hands_on(tmp_path / "near.fit")
        hands.press("A", "p", "3")
        hands.send("add_body", value="PLUTO")
        hands.send("method", value="limb_scan")
        hands.press("f")
        before, found = hands.steps, hands.session.state.bodies[-1].pixel_line
        hands.send("scans", value="0-60")
        assert not np.array_equal(hands.session.state.bodies[-1].pixel_line, found)
        hands.press("Ctrl+z")
        assert hands.steps == before
        np.testing.assert_array_equal(hands.session.state.bodies[-1].pixel_line, found)
        hands.press("Ctrl+y")
        assert hands.session.state.scan_choices["PLUTO"].numbers[-1] == 60
        assert hands.session.state.observables


def test_a_decision_to_come_is_one_line_in_a_notebook():
    pending = SelectionPending("a.fit: 4 stars wait.")
    assert pending._render_traceback_() == ["SelectionPending: a.fit: 4 stars wait."]


def test_a_decision_is_painted_before_the_pointing_follows_it(star_hands):
    star_hands.press("p")
    painted = []
    star_hands.controller.on_render = lambda html: "panel" in html and painted.append(star_hands.steps[-1])
    star_hands.press("a")
    assert painted == ["accept_stars", "repoint"]
    assert "accepted; " in star_hands.said
    assert "pointing: " in star_hands.said  # both are told in the end
    star_hands.press("Ctrl+z")
    assert "accept_stars" not in star_hands.steps  # one undo takes both back


def test_an_undo_of_several_steps_is_painted_once(star_hands):
    """A decision and the pointing that followed it are taken back together: nobody sees what lies between."""
    star_hands.press("p", "r", "1")
    painted = []
    star_hands.controller.on_render = painted.append
    star_hands.press("Ctrl+z")
    assert star_hands.steps[-1] == "repoint"  # two steps went
    assert len([regions for regions in painted if "panel" in regions]) == 1


def test_threads_that_work_give_way_until_the_last_has_ended():
    usual_s = sys.getswitchinterval()
    with giving_way:
        with giving_way:
            pass
        assert sys.getswitchinterval() == pytest.approx(GIVE_WAY_S)
    assert sys.getswitchinterval() == usual_s


def test_a_step_gives_way_to_keys(star_hands, monkeypatch):
    seen = []
    monkeypatch.setattr(ImageSession, "repoint", lambda *_, **__: seen.append(sys.getswitchinterval()))
    star_hands.press("p")
    assert seen == [pytest.approx(GIVE_WAY_S)]


@pytest.mark.slow
def test_a_click_while_an_outcome_is_drawn_locks_nothing(solved_sessions, kernels):
    """A click waits for what a step's end changes, and that for no click."""
    view = ImageView()
    bench = WorkbenchController(ImageQueue.of_sessions(solved_sessions[:1]), view)
    bench.runner.wait()
    drawing, clicked = threading.Event(), threading.Event()
    tapped = bench.current_tab.tapped
    bench.current_tab.tapped = lambda *place: (clicked.set(), tapped(*place))

    def step_ends():
        with bench.runner.handling():
            drawing.set()
            assert not clicked.wait(0.2)  # the click is on its way meanwhile
            view.circle((5.0, 5.0), 2.0)

    def click():
        assert drawing.wait(5.0)
        view.bridge.receive({"kind": "event", "page": "one", "name": "tap", "values": [5.0, 5.0]})

    threads = [threading.Thread(target=task, daemon=True) for task in (step_ends, click)]
    for one in threads:
        one.start()
    for one in threads:
        one.join(5.0)
    assert clicked.is_set()


@pytest.mark.slow
def test_the_next_picture_is_one_message_and_then_told(solved_sessions, kernels):
    bench = Workbench(ImageQueue.of_sessions(solved_sessions))
    bench.controller.runner.wait()
    until(lambda: not bench.controller._works_ahead)
    sent = []
    bench.view.bridge.attach(SimpleNamespace(send_message=lambda message, _: sent.append(message["kind"])))
    bench.view.bridge.receive({"kind": "open", "page": "one"})
    bench.regions["header"].observe(lambda _: sent.append("header"), "html")
    sent.clear()
    press(bench.controller, "PageDown")
    assert sent == ["refresh", "header"]  # a strip after a frame: the page is laid out anew


def test_a_decision_waits_for_no_solution_that_follows_another(star_hands, monkeypatch):
    """It is taken and shown at once; the solution of a state that is none any more is dropped, and begun anew."""
    star_hands.press("p")
    bench, session = star_hands.controller, star_hands.session
    begun, go_on, original = threading.Event(), threading.Event(), session._history.state_after_step

    def slow(step, parameters):
        if step == "repoint":
            begun.set()
            assert go_on.wait(10.0)
        return original(step, parameters)

    monkeypatch.setattr(session._history, "state_after_step", slow)
    press(bench, "a")
    assert begun.wait(10.0)
    press(bench, "r", "1")
    assert [verdict for verdict, _ in session.state.decisions.values()] == ["accepted", "rejected"]
    assert "13 undecided" in star_hands.panel
    go_on.set()
    bench.runner.wait()
    assert star_hands.steps[-4:] == ["repoint", "accept_stars", "reject_stars", "repoint"]
    assert session.state.pointing.n_stars == 14
    press(bench, "Ctrl+z")
    assert star_hands.steps[-1] == "accept_stars"
    assert "P solves it again" in star_hands.said


def test_a_key_that_is_no_decision_waits_for_the_solution(star_hands, monkeypatch):
    star_hands.press("p")
    go_on, original = threading.Event(), star_hands.session._history.state_after_step
    slow = lambda *step: (go_on.wait(10.0), original(*step))[1]  # noqa: E731
    press(star_hands.controller, "a")
    monkeypatch.setattr(star_hands.session._history, "state_after_step", slow)
    press(star_hands.controller, "Ctrl+z")
    assert "accept_stars" in star_hands.steps
    go_on.set()
    star_hands.controller.runner.wait()
    assert "accept_stars" not in star_hands.steps
