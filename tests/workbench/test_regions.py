"""What of a region goes to the page: marked parts that differ, or all of it."""

import json

import pytest

from opnav_workbench.workbench.app import Region
from opnav_workbench.workbench.markup import PART, PART_END, in_parts

SHARE = 0.3  # of a panel, that a step from one star to the next may send


class Sent:
    """A region, and what it has sent since last asked: properties by name, and messages."""

    def __init__(self, monkeypatch):
        self.region = Region("panel", lambda _: None)
        self._kept = []
        monkeypatch.setattr(self.region, "send_state", lambda key=None: self._kept.append(key))
        monkeypatch.setattr(self.region, "send", self._kept.append)

    def show(self, html):
        self._kept.clear()
        self.region.show(html)
        return list(self._kept)


@pytest.fixture
def sent(monkeypatch):
    return Sent(monkeypatch)


def items(*texts, tag="ol"):
    return f"<{tag}>" + "".join(f"{PART}<li>{text}</li>{PART_END}" for text in texts) + f"</{tag}>"


def test_only_the_parts_that_differ_are_sent(sent):
    assert sent.show(items("a", "b", "c")) == ["html"]
    assert sent.show(items("a", "b", "c")) == []
    assert sent.show(items("a", "B", "c")) == [{"parts": {"1": '<li data-part="1">B</li>'}}]


def test_what_is_around_the_parts_is_sent_with_all_of_it(sent):
    sent.show(items("a", "b"))
    assert sent.show(items("a", "b", tag="ul")) == ["html"]
    assert sent.show(items("a", "b", "c", tag="ul")) == ["html"]


def test_a_page_that_comes_later_gets_all_of_it(sent):
    sent.show(items("a", "b"))
    sent.show(items("a", "B"))
    whole = '<ol><li data-part="0">a</li><li data-part="1">B</li></ol>'
    assert sent.region.html == whole
    sent.region._message(None, {"act": "whole"}, None)
    assert sent._kept[-1] == {"whole": whole}


def test_parts_are_numbered_in_the_order_of_the_page():
    parts, around = in_parts(items("a", "b"))
    assert parts == ['<li data-part="0">a</li>', '<li data-part="1">b</li>']
    assert around == ["<ol>", "", "</ol>"]
    assert in_parts("<p>none</p>") == ([], ["<p>none</p>"])


def test_a_step_to_the_next_star_sends_little(star_hands, sent):
    star_hands.press("p")
    sent.show(star_hands.panel)
    star_hands.press("n")
    (message,) = sent.show(star_hands.panel)
    assert 3 <= len(message["parts"]) <= 8  # the star, its card, the one left, and its points in the plots
    assert len(json.dumps(message)) < SHARE * len(sent.region.html)


def test_an_undo_sends_parts(star_hands, sent):
    star_hands.press("p", "a")
    sent.show(star_hands.panel)
    star_hands.press("Ctrl+z")
    (message,) = sent.show(star_hands.panel)
    assert len(json.dumps(message)) < SHARE * len(sent.region.html)
