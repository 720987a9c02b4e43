"""The workbench around the tabs: images, undo, errors, long work, export."""

import re
import shutil
import threading
import time
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest

from opnav_workbench.errors import SessionError
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench import bodies_tab
from opnav_workbench.workbench.controller import WorkbenchController
from opnav_workbench.workbench.image_queue import ImageQueue, QueueItem
from opnav_workbench.workbench.overlays import BodyMarks
from opnav_workbench.workbench.status_line import LOG_FILE, Status, plain_words

VOID = {"input", "img", "path", "circle", "rect", "polyline", "br", "option"}


class Balanced(HTMLParser):
    """Fails on a tag that is closed without having been opened."""

    def __init__(self):
        super().__init__()
        self.open = []

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open, tag
            assert self.open.pop() == tag


def balanced(html):
    parser = Balanced()
    parser.feed(html)
    return parser.open == []


@pytest.mark.slow
def test_every_page_is_well_formed_at_every_stage(star_hands):
    for stage in ((), ("p",), ("r",), ("1",)):
        star_hands.press(*stage)
        for tab in "1234":
            if star_hands.controller.runner.menu:
                break
            star_hands.press(tab)
            assert all(balanced(html) for html in star_hands.controller.regions().values())
        star_hands.press("1") if not star_hands.controller.runner.menu else None
    star_hands.press("?")
    assert balanced(star_hands.panel)
    assert "Take back the last step" in star_hands.panel


@pytest.mark.slow
def test_images_keep_their_own_state(hands_on, demo_truths, tmp_path):
    hands = hands_on(*(truth.picture for truth in demo_truths), out=tmp_path)
    hands.press("f", "a")
    assert hands.session.context.picture.path.name == "lorri_4x4.fit"
    hands.press("PageDown", "f")
    assert hands.session.context.picture.path.name == "mvic_framing.fit"
    assert hands.session.state.decisions == {}
    hands.press("PageDown")  # beyond the end it stays
    hands.press("PageUp")
    assert len(hands.session.state.decisions) == 1
    words = re.findall(r'class="words">([^<]*)', hands.controller.regions()["queue"])
    assert words == ["stars found", "stars found"]
    assert hands.viewer.shown[-1] is hands.session


def test_an_image_that_cannot_be_opened_says_why(hands_on, demo_truths, tmp_path):
    broken = tmp_path / "broken.fit"
    broken.write_bytes(b"no picture")
    queue = ImageQueue.of_images([demo_truths[0].picture, broken], "new_horizons", tmp_path / "run")
    hands = hands_on(demo_truths[0].picture)
    controller = WorkbenchController(queue, hands.viewer)
    controller.runner.wait()
    controller.handle({"act": "key", "arg": "PageDown"})
    controller.runner.wait()
    assert controller.runner.status.kind == "error"
    assert "broken.fit" in controller.runner.status.message
    assert "broken.fit" in controller.regions()["panel"]
    controller.handle({"act": "key", "arg": "PageUp"})
    assert controller.queue.session.context.picture.path == demo_truths[0].picture


@pytest.mark.slow
def test_list_is_resumed_where_it_was_left(hands_on, demo_truths, tmp_path):
    def opened():
        queue = ImageQueue.of_images([demo_truths[1].picture], "new_horizons", tmp_path)
        bench = WorkbenchController(queue, hands_on(demo_truths[0].picture).viewer)
        bench.runner.wait()
        return bench

    first = opened()
    for key in ("f", "a", "a", "Ctrl+z"):
        first.handle({"act": "key", "arg": key})
        first.runner.wait()
    state = first.queue.session.state
    again = opened()
    assert dict(again.queue.session.state.decisions) == dict(state.decisions)
    assert again.stars.focused.id == first.stars.focused.id
    assert again.queue.session.can_redo
    assert again.regions()["panel"] == first.regions()["panel"]


def test_list_of_nothing(tmp_path):
    with pytest.raises(SessionError, match="at least one image"):
        ImageQueue([])
    with pytest.raises(SessionError, match="holds no picture"):
        ImageQueue.of_images([tmp_path], "new_horizons", tmp_path)
    with pytest.raises(SessionError, match="is not there"):
        ImageQueue.of_images([tmp_path / "x.fit"], "new_horizons", tmp_path)


@pytest.mark.slow
def test_pictures_of_one_name_keep_their_decisions_apart(kernels, demo_truths, tmp_path):
    pictures = [tmp_path / place / "a.fit" for place in ("x", "y")]
    for path, truth in zip(pictures, demo_truths[:2], strict=True):
        path.parent.mkdir()
        shutil.copy(truth.picture, path)
    queue = ImageQueue.of_images(pictures, "new_horizons", tmp_path / "run")
    assert [item.folder.name for item in queue.items] == ["x_a", "y_a"]
    named = ImageQueue.of_images(pictures[1:], "new_horizons", tmp_path / "run", folders=["y_a"])
    assert named.session.folder == queue.items[1].folder
    with pytest.raises(SessionError, match="2 folders were given for 1 pictures"):
        ImageQueue.of_images(pictures[1:], "new_horizons", tmp_path / "run", folders=["x_a", "y_a"])
    with pytest.raises(SessionError):
        ImageQueue.of_images(pictures[1:], "new_horizons", tmp_path / "run", folders=["../y_a"])


def test_an_exception_in_a_callback_is_told_and_logged(star_hands, monkeypatch, tmp_path):
    def broken(*_):
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr(star_hands.session, "accept_stars", broken)
    star_hands.press("a")
    assert star_hands.kind == "error"
    assert (
        star_hands.said
        == "unforeseen ZeroDivisionError: division by zero; nothing was changed. Please report it."
    )
    log = star_hands.controller.queue.item.folder / LOG_FILE
    assert "ZeroDivisionError" in log.read_text()
    monkeypatch.undo()
    star_hands.press("a")
    assert star_hands.kind == "done"


def test_expected_errors_are_told_in_their_own_words():
    status = Status()
    with status.reporting("done"):
        raise SessionError("nothing to undo: no step has been taken yet.")
    assert (status.kind, status.message) == ("error", "nothing to undo: no step has been taken yet.")
    assert (
        plain_words(ValueError("a\n b"))
        == "unforeseen ValueError: a b; nothing was changed. Please report it."
    )


@pytest.mark.slow
def test_long_work_shows_progress_and_can_be_cancelled(star_hands, monkeypatch):
    go_on, steps = threading.Event(), star_hands.steps
    original = star_hands.session.repoint

    def slow(*arguments, **options):
        go_on.wait(10.0)
        original(*arguments, **options)

    monkeypatch.setattr(star_hands.session, "repoint", slow)
    star_hands.controller.handle({"act": "key", "arg": "p"})
    assert star_hands.controller.runner.running is not None
    assert "<progress" in star_hands.controller.regions()["status"]
    star_hands.controller.handle({"act": "key", "arg": "n"})  # looking around goes on
    star_hands.controller.handle({"act": "key", "arg": "a"})  # a second step waits
    assert "1 waiting" in star_hands.controller.regions()["status"]
    star_hands.controller.handle({"act": "key", "arg": "Escape"})
    assert "cancelled; nothing was changed" in star_hands.said
    assert star_hands.controller.runner.running is None
    go_on.set()
    monkeypatch.undo()
    deadline = time.monotonic() + 5.0
    while threading.active_count() > 1 and time.monotonic() < deadline:
        time.sleep(0.01)
    assert star_hands.steps == steps  # the abandoned thread recorded nothing, and what waited was dropped
    star_hands.press("p")
    assert star_hands.session.state.pointing is not None


@pytest.mark.slow
def test_page_stays_alive_during_a_long_step_of_the_session_itself(star_hands):
    """A step holds the session's lock through its numerics; the page must be rendered meanwhile."""
    entered, go_on = threading.Event(), threading.Event()

    def held():
        with star_hands.session.lock:
            entered.set()
            go_on.wait(10.0)

    holder = threading.Thread(target=held)
    holder.start()
    entered.wait(5.0)
    rendered = threading.Event()
    threading.Thread(
        target=lambda: (star_hands.controller.handle({"act": "key", "arg": "n"}), rendered.set())
    ).start()
    alive = rendered.wait(3.0)
    go_on.set()
    holder.join()
    assert alive


def test_steps_from_elsewhere_are_shown(star_hands):
    painted = []
    star_hands.controller.on_render = painted.append
    star_hands.session.accept_stars([star_hands.controller.stars.ids[4]])
    assert painted
    assert "14 undecided" in painted[-1]["panel"]


def test_notes_stand_in_the_journal(star_hands):
    star_hands.press("z")
    assert "note_text" in star_hands.panel
    star_hands.send("note_text", value="smear in the <lower> left")
    assert star_hands.session.state.user_notes == ("smear in the <lower> left",)
    star_hands.press("4")
    assert "smear in the &lt;lower&gt; left" in star_hands.panel
    for number in range(20):
        star_hands.session.note(f"later {number}")
    assert "&lt;lower&gt; left" not in star_hands.panel.partition("Journal")[2]
    star_hands.send("older_entries")  # the earlier ones can be opened, and folded away
    assert "predict" in star_hands.panel.partition("Journal")[2]
    star_hands.send("older_entries")
    assert "predict" not in star_hands.panel.partition("Journal")[2]


@pytest.mark.slow
def test_export_writes_everything(star_hands):
    star_hands.press("A", "p", "3")
    star_hands.send("add_body", value="PLUTO")
    star_hands.press("f", "e")
    folder = star_hands.controller.queue.item.folder
    files = {path.name for path in folder.iterdir()}
    assert {"result.json", "observables.ecsv", "session.json", "decisions.yaml", "summary.png"} <= files, (
        star_hands.said
    )
    assert ImageSession.resume(folder).state.pointing is not None
    star_hands.press("4")
    assert "decisions.yaml" in star_hands.panel


def test_without_a_folder_export_says_what_is_missing(hands_on, demo_truths):
    hands = hands_on(demo_truths[0].picture)
    hands.press("e")
    assert hands.said == "there is no folder to export into: workbench(..., out=FOLDER)."


@pytest.mark.slow
def test_whole_pass_takes_at_most_40_keys(hands_on, demo_truths, tmp_path):
    """Find, confirm ten stars and the rest, repoint, both bodies, export."""
    hands = hands_on(demo_truths[1].picture, out=tmp_path)
    for name in ("PLUTO", "CHARON"):
        hands.session.add_target(name)
    keys = ["f", *["a"] * 10, "A", "p", "3", "f", "n", "f", "e"]
    hands.press(*keys)
    assert hands.kind == "done", hands.said
    assert hands.session.result()["status"] == "ok"
    assert len(keys) <= 40


@pytest.mark.slow
def test_items_of_a_queue_open_once(demo_truths, kernels):
    opened = []

    def opener():
        opened.append(1)
        return ImageSession.open(demo_truths[0].picture, "new_horizons")

    queue = ImageQueue([QueueItem("a", opener)])
    assert queue.session is queue.session
    assert len(opened) == 1


def test_a_body_off_the_detector_is_told_and_not_gone_to(star_hands, monkeypatch):
    far = np.array([-500.0, 2000.0])
    mark = BodyMarks("PLUTO", far, 5.0, False, *[np.empty((0, 2))] * 4)
    monkeypatch.setattr(bodies_tab, "body_marks", lambda _: [mark])
    monkeypatch.setattr(
        bodies_tab, "predicted_body", lambda *_: SimpleNamespace(pixel_line=far, diameter_px=10.0)
    )
    star_hands.send("add_body", value="PLUTO")
    star_hands.viewer.looked_at = None
    star_hands.press("3")
    assert star_hands.viewer.looked_at is None
    assert "off the detector" in star_hands.panel
