"""Limb scans as a person names, clicks and boxes them."""

import numpy as np
import pytest

from opnav_workbench.errors import SessionError
from opnav_workbench.workbench.limb_scan_choice import (
    chosen_scans,
    format_scan_numbers,
    parse_scan_numbers,
    scan_at,
    scan_layer,
    scans_crossing,
)

ANGLES = np.radians(np.arange(0.0, 360.0, 30.0))
DISTANCE = np.linspace(0.0, 50.0, 101)
PLACES = (
    np.array([200.0, 100.0]) + DISTANCE[:, None] * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)[:, None]
)


@pytest.mark.parametrize(
    ("typed", "scans"),
    [("3-9,12", [3, 4, 5, 6, 7, 8, 9, 12]), (" 7 ", [7]), ("5, 2-3,2", [2, 3, 5]), ("0-23", list(range(24)))],
)
def test_typed_scans(typed, scans):
    assert parse_scan_numbers(typed, 24) == scans


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("", "no scan is named"),
        ("3-9;12", "'3-9;12' is no scan number"),
        ("9-3", "numbered 0 to 23"),
        ("20-24", "numbered 0 to 23"),
        ("-1", "'-1' is no scan number"),
    ],
)
def test_typed_scans_that_make_no_sense(typed, message):
    with pytest.raises(SessionError, match=message):
        parse_scan_numbers(typed, 24)


@pytest.mark.parametrize("scans", [[0], [1, 2, 3], [0, 2, 4, 5, 6, 20]])
def test_shown_scans_can_be_typed_again(scans):
    assert parse_scan_numbers(format_scan_numbers(scans), 24) == scans


def test_click_means_the_nearest_scan_and_only_a_near_one():
    assert scan_at(PLACES, 240.0, 101.0) == 0
    assert scan_at(PLACES, 200.5, 140.0) == 3
    assert scan_at(PLACES, 300.0, 300.0) is None


def test_box_takes_the_scans_that_cross_it():
    assert scans_crossing(PLACES, 235.0, 140.0, 245.0, 60.0) == [0, 1, 11]  # corners in any order
    assert scans_crossing(PLACES, 0.0, 0.0, 10.0, 10.0) == []


def test_layer_tells_used_rejected_and_focus_apart():
    status = ["used", "rejected", "not_chosen"] * 4
    layer = scan_layer(PLACES, status, focus=2, picture_px=200.0)
    assert layer.styles[:4] == ("used", "rejected", "focus", "used")
    assert layer.segments[0] == pytest.approx(
        (230.0, 100.0, 250.0, 100.0)
    )  # the outer part: the body stays in sight
    assert layer.segments[2][:2] == pytest.approx((200.0, 100.0))  # the whole of the one that is looked at
    assert [label[2] for label in layer.labels] == [str(i) for i in range(12)]
    for (pixel, _, text), side in zip(
        layer.labels, layer.sides, strict=True
    ):  # each grows away from the scans
        across = pixel - PLACES[int(text), 0, 0]
        assert side == ("center" if abs(across) < 20.0 else "left" if across > 0.0 else "right")
    assert chosen_scans(status) == [0, 1, 3, 4, 6, 7, 9, 10]


def test_numbers_leave_room_for_each_other_on_a_small_body():
    """12 scans of 50 px: all numbers on a frame of 200 px, every third on one of 1024 px, and the one looked at."""
    small = scan_layer(PLACES, ["used"] * 12, focus=4, picture_px=1024.0)
    assert [label[2] for label in small.labels] == ["0", "3", "4", "6", "9"]
