"""The bridge without a browser: a list takes what would go to the pages, and messages are given by hand."""

import json

import pytest
from bokeh.models import Column, ColumnDataSource, Div, Range1d, Slider
from bokeh.plotting import figure

from opnav_workbench.errors import SessionError
from opnav_workbench.workbench import Bridge
from opnav_workbench.workbench.status_line import Status


class Pages:
    """Remembers messages; `kinds` are those since the last look."""

    def __init__(self, bridge: Bridge) -> None:
        self.sent: list[tuple[dict, list[bytes]]] = []
        bridge.attach(self)

    def send_message(self, content, buffers) -> None:
        self.sent.append((dict(content), [bytes(b) for b in buffers]))

    def take(self) -> list[tuple[dict, list[bytes]]]:
        sent, self.sent = self.sent, []
        return sent

    def patches(self) -> list[tuple[str | None, list[dict]]]:
        found = [(c["origin"], json.loads(b[0])["events"]) for c, b in self.take() if c["kind"] == "patch"]
        return [(origin, events) for origin, events in found if events]


def change(model, attr, new, page="one", sequence=1):
    event = {"kind": "ModelChanged", "model": {"id": model.id}, "attr": attr, "new": new}
    return {"kind": "patch", "page": page, "sequence": sequence, "patch": {"events": [event]}}


@pytest.fixture
def slider() -> Slider:
    return Slider(start=0, end=10, value=1)


@pytest.fixture
def bridge(slider) -> Bridge:
    return Bridge(Column(slider, Div(text="a", name="div")))


@pytest.fixture
def pages(bridge) -> Pages:
    pages = Pages(bridge)
    for page in ("one", "two"):
        bridge.receive({"kind": "open", "page": page})
    pages.take()
    return pages


def test_nothing_is_sent_before_a_page_is_open(bridge, slider):
    pages = Pages(bridge)
    slider.value = 5
    bridge.status.say("hello")
    assert pages.take() == []


def test_page_that_opens_gets_the_document_of_now(bridge, slider):
    pages = Pages(bridge)
    slider.value = 7
    bridge.status.say("seven")
    bridge.receive({"kind": "open", "page": "new"})
    (document, buffers), (status, _) = pages.take()
    assert document["kind"] == "document"
    assert document["page"] == "new"
    assert json.loads(buffers[0])["roots"][0]["attributes"]["children"][0]["attributes"]["value"] == 7
    assert (status["kind"], status["text"]) == ("status", "seven")


def test_change_of_python_goes_to_all_pages_once(pages, slider):
    slider.value = 3
    ((origin, events),) = pages.patches()
    assert origin is None
    assert [(e["kind"], e["attr"], e["new"]) for e in events] == [("ModelChanged", "value", 3)]


def test_change_of_a_page_calls_python_and_is_told_to_the_others(bridge, pages, slider):
    seen = []
    slider.on_change("value", lambda attr, old, new: seen.append((old, new)))
    bridge.receive(change(slider, "value", 4))
    assert seen == [(1, 4)]
    kinds = [(c["kind"], c.get("origin"), c.get("page")) for c, _ in pages.take()]
    assert kinds == [("patch", "one", None), ("done", None, "one")]  # "one" ignores what it made itself


def test_callback_that_corrects_a_page_wins_everywhere(bridge, pages, slider):
    """The correction happens before the page's own change is announced, and must still be the last word."""

    def correct(attr, old, new):
        slider.value = min(new, 5)

    slider.on_change("value", correct)
    bridge.receive(change(slider, "value", 9))
    assert slider.value == 5
    assert [(origin, e["new"]) for origin, events in pages.patches() for e in events] == [(None, 5)]


def test_batch_is_one_patch_with_the_last_values(bridge, pages, slider):
    with bridge.batch():
        for value in (2, 3, 4):
            slider.value = value
        with bridge.batch():
            bridge.document.get_model_by_name("div").text = "b"
        assert pages.take() == []
    ((_, events),) = pages.patches()
    assert [(e["attr"], e["new"]) for e in events] == [("value", 4), ("text", "b")]


def test_new_models_and_arrays_travel_in_a_patch(bridge, pages):
    import numpy as np

    source = ColumnDataSource({"image": [np.arange(6, dtype=np.uint16).reshape(2, 3)]})
    plot = figure(x_range=Range1d(0, 1), y_range=Range1d(1, 0))
    plot.image_rgba("image", 0, 0, 1, 1, source=source)
    bridge.document.roots[0].children = [plot]
    ((content, buffers),) = pages.take()
    assert content["kind"] == "patch"
    assert len(buffers) == 1 + len(content["buffer_ids"])
    assert np.arange(6, dtype=np.uint16).tobytes() in buffers


def test_change_of_a_removed_model_is_forgotten(bridge, pages, slider):
    bridge.document.roots[0].children = []
    bridge.receive(change(slider, "value", 4))
    assert slider.value == 1
    assert bridge.status.kind == "info"


def test_change_of_an_unknown_model_makes_all_pages_ask_again(bridge, pages):
    bridge.receive(change(Slider(start=0, end=1, value=0), "value", 1))
    assert "refresh" in [c["kind"] for c, _ in pages.take()]
    assert bridge.status.kind == "error"


def test_failing_callback_is_told_and_logged(bridge, pages, slider, tmp_path):
    bridge.status.log_folder = tmp_path

    def fail(attr, old, new):
        raise ZeroDivisionError("no stars")

    slider.on_change("value", fail)
    bridge.receive(change(slider, "value", 4))
    told = [c for c, _ in pages.take() if c["kind"] == "status"]
    assert "ZeroDivisionError: no stars" in told[-1]["text"]
    (log,) = tmp_path.iterdir()
    assert "Traceback" in log.read_text()


def test_keys(bridge, pages):
    pressed = []
    bridge.bind_key("a", lambda: pressed.append("a"))
    bridge.bind_key("s", page="stretch")
    table = pages.take()[-1][0]
    assert (table["keys"], table["page_keys"]) == (["a"], {"s": "stretch"})
    bridge.receive({"kind": "key", "page": "one", "key": "a", "sequence": 5})
    bridge.receive({"kind": "key", "page": "one", "key": "d", "sequence": 6})
    assert pressed == ["a"]
    assert [c["sequence"] for c, _ in pages.take() if c["kind"] == "done"] == [5, 6]
    bridge.bind_key("a")
    assert pages.take()[-1][0]["keys"] == []


def test_known_error_of_a_key_is_one_line(bridge, pages):
    def refuse():
        raise SessionError("no stars are predicted yet: call predict() first.")

    bridge.bind_key("f", refuse)
    bridge.press("f")
    assert bridge.status.message == "no stars are predicted yet: call predict() first."


def test_events_and_actions_of_a_page(bridge, pages):
    taps = []
    bridge.on_event("tap", lambda pixel, line: taps.append((pixel, line)))
    bridge.receive({"kind": "event", "page": "two", "name": "tap", "values": [3.5, 4.0]})
    assert taps == [(3.5, 4.0)]
    bridge.do("home")
    told = pages.take()[-1][0]
    assert (told["kind"], told["page"], told["name"]) == ("do", "two", "home")  # where the analyst is


def test_error_of_the_page_is_told_with_its_stack_in_the_log(bridge, pages, tmp_path):
    bridge.status.log_folder = tmp_path
    bridge.receive({"kind": "error", "page": "one", "text": "x is undefined", "stack": "at image_view.js:7"})
    assert "x is undefined" in bridge.status.message
    assert "image_view.js:7" in next(tmp_path.iterdir()).read_text()


def test_status_can_be_another_owners():
    status = Status()
    bridge = Bridge(Div(), status=status)
    bridge.bind_key("x", lambda: 1 / 0)
    bridge.press("x")
    assert "ZeroDivisionError" in status.message


def test_redraw_replaces_a_large_patch(bridge, pages, slider):
    with bridge.batch():
        slider.value = 8
        bridge.redraw()
    assert [c["kind"] for c, _ in pages.take()] == ["refresh"]
    bridge.receive({"kind": "open", "page": "one"})
    assert b'"value":8' in pages.take()[0][1][0]
