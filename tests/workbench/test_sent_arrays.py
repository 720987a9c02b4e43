"""Pixels on their way to the pages: exact, coarse ones first, and gone when nobody needs them."""

import gc
import json

import numpy as np
import pytest

from opnav_workbench.workbench import image_view
from opnav_workbench.workbench.image_view import ImageView
from opnav_workbench.workbench.sent_arrays import ArrayStore, block_means


def put_together(array, count):
    """Return an array's values from pieces, as a page does it."""
    n = array.values.nbytes
    data = b"".join(bytes(array.piece(first, count)) for first in range(0, n, count))
    return np.frombuffer(data, array.as_page_values()["dtype"]).reshape(array.as_page_values()["shape"])


@pytest.mark.parametrize("image", [np.arange(35.0).reshape(5, 7), np.array([[0.5, np.nan], [-3.0, 70000.0]])])
def test_pieces_make_the_picture(image):
    sent = ArrayStore().put(image)
    assert sent.coarse is None
    np.testing.assert_array_equal(put_together(sent.full, 6), image.astype(np.float32))


def test_counts_travel_as_such():
    store = ArrayStore()
    counts = store.put(np.array([[0.0, 65535.0]]))
    beyond = store.put(np.array([[0.0, 65536.0]]))
    assert (counts.full.values.dtype, beyond.full.values.dtype) == (np.uint16, np.float32)


def test_a_large_picture_has_a_coarse_one():
    image = np.random.default_rng(1).normal(size=(1500, 3000))
    sent = ArrayStore().put(image)
    assert sent.block == 3
    assert sent.coarse.values.shape == (500, 1000)
    np.testing.assert_allclose(sent.coarse.values[7, 11], image[21:24, 33:36].mean(), rtol=1e-6)


def test_what_is_no_number_does_not_count():
    means = block_means(np.array([[1.0, np.nan, np.nan], [3.0, np.inf, np.nan]]), 2)
    np.testing.assert_array_equal(means, [[2.0, np.nan]])


@pytest.mark.slow
def test_an_array_lives_as_long_as_it_is_needed():
    store = ArrayStore()
    sent = store.put(np.zeros((4, 4)))
    token = sent.full.token
    assert store.get(token) is sent.full
    del sent
    gc.collect()
    assert store.get(token) is None


@pytest.mark.slow
def test_a_page_is_given_what_it_lacks_and_told_what_is_gone(solved_sessions):
    view, sent = ImageView(solved_sessions[0]), []

    class Page:
        def send_message(self, content, buffers):
            sent.append((content, [bytes(one) for one in buffers]))

    view.bridge.attach(Page())
    view.bridge.receive({"kind": "open", "page": "one"})
    token = json.loads(view.state.images)["data"]["pixels"]["full"]["token"]
    sent.clear()
    view.bridge.receive({"kind": "pull", "page": "one", "token": token, "first": 8, "count": 4})
    ((head, pieces),) = sent
    assert (head["kind"], head["token"], head["first"]) == ("piece", token, 8)
    assert pieces == [view.images.pixels("data").tobytes()[8:12]]
    sent.clear()
    view.bridge.receive({"kind": "pull", "page": "one", "token": "none", "first": 0, "count": 4})
    assert sent[0][0]["gone"]
    assert sent[0][1] == []


@pytest.mark.slow
def test_neighbors_go_ahead_as_far_as_a_page_may_hold_them(solved_sessions, monkeypatch):
    first, second = solved_sessions
    view = ImageView(first)
    view.prepare(second)
    view.send_ahead([second, first])
    tokens = [one["full"]["token"] for one in json.loads(view.state.ahead)]
    assert len(tokens) == 2
    assert tokens[1] == json.loads(view.state.images)["data"]["pixels"]["full"]["token"]
    monkeypatch.setattr(image_view, "AHEAD_BYTES", 10)
    view.send_ahead([second])
    assert json.loads(view.state.ahead) == []
