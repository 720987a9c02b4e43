"""What an analyst does at the stars: nudge the field, place a star, fit again, look at boxes; gates and listeners."""

import json

import numpy as np
import pytest

from opnav_workbench.errors import SelectionPending, SessionError
from opnav_workbench.session import ImageSession, Settings
from opnav_workbench.session.star_field import nudged_attitude

# A field that is not identified by itself: nothing may be off, and no wide search mends it.
BLIND = Settings(max_shift_px=0.5, wider_shift_px=0.0, widest_shift_px=0.0)
SAME_PX = 1e-6  # two fits of the same pixels from different starts
EDGE_PX = 0.2  # distortion bends a shift of 10 px by less over the strip's center


def _rows(session):
    return {star["id"]: star for star in json.loads(session.to_json())["stars"]}


def _used(session):
    return [star for star, row in _rows(session).items() if row["status"] == "used"]


# -- nudge ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow(keep=["shift1-0.0", "shift2-0.5"])
@pytest.mark.parametrize(("shift", "twist_deg"), [((10.0, 0.0), 0.0), ((0.0, -7.5), 0.0), ((3.0, 4.0), 0.5)])
def test_a_nudge_moves_the_predicted_field_by_so_many_pixels(opened, shift, twist_deg):
    camera = opened.context.camera
    opened.predict()
    before = opened.state.a_priori.places(camera, opened.camera_from_j2000)
    ids = opened.state.a_priori.id.tolist()
    opened.nudge(*shift, twist_deg)
    assert opened.state.star_field.search == "by hand"
    after = opened.state.a_priori
    rows = [after.id.tolist().index(star) for star in ids if star in after.id]
    moved = after.places(camera, opened.camera_from_j2000)[rows]
    old = before[[ids.index(str(star)) for star in after.id[rows]]]
    angle = np.radians(twist_deg)  # from +pixel toward +line, about the boresight
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    center = camera.center_pixel_line
    near = np.hypot(*(old - center).T) < 500.0
    expected = center + (old - center) @ turn.T + shift
    assert near.sum() >= 3
    np.testing.assert_allclose(moved[near], expected[near], atol=EDGE_PX)
    np.testing.assert_allclose(opened.state.star_field.shift_px, shift, atol=EDGE_PX)
    assert np.degrees(opened.state.star_field.twist_rad) == pytest.approx(twist_deg, abs=1e-6)


def test_nudges_add_up_and_can_be_taken_back(opened):
    opened.predict()
    a_priori = opened.camera_from_j2000
    for _ in range(4):
        opened.nudge(2.5, -1.0)
    np.testing.assert_allclose(opened.state.star_field.shift_px, (10.0, -4.0), atol=EDGE_PX)
    once = nudged_attitude(opened.context.camera, a_priori, np.array([10.0, -4.0]), 0.0)
    np.testing.assert_allclose(opened.camera_from_j2000, once, atol=1e-8)
    for _ in range(4):
        opened.undo()
    np.testing.assert_array_equal(opened.camera_from_j2000, a_priori)


def test_a_field_moved_by_hand_is_found_there(truth, kernels):
    """With identification blind beyond half a pixel, the analyst's arrow keys bring the field to its stars."""
    session = ImageSession.open(truth.picture, "new_horizons", settings=BLIND)
    session.predict()
    session.find_stars()
    assert session.state.centers is None
    camera = session.context.camera
    true = camera.project(
        (truth.camera_from_j2000 @ session.inputs.a_priori_camera_from_j2000.T @ camera.boresight)[None]
    )[0]
    session.nudge(*np.rint(true - camera.center_pixel_line))
    session.find_stars()
    session.repoint()
    assert session.state.pointing.n_stars >= 14
    assert session.state.pointing.rms_px < 0.2
    assert session.state.star_field.sure
    result = json.loads(session.to_json())
    assert (result["status"], result["identification"]["search"]) == ("ok", "by hand")


def test_a_nudge_drops_what_was_found_with_the_older_pointing(opened):
    opened.predict()
    opened.find_stars()
    opened.repoint()
    star = _used(opened)[0]
    opened.reject_stars([star], "odd")
    opened.nudge(1.0, 0.0)
    assert opened.state.pointing is None
    assert opened.state.centers is None
    assert opened.state.decisions[star] == ("rejected", "odd")
    assert opened.can_undo


def test_a_nudge_needs_predicted_stars_and_a_field_in_sight(opened):
    with pytest.raises(SessionError, match=r"predict\(\)"):
        opened.nudge(1.0, 1.0)
    opened.predict()
    with pytest.raises(SessionError, match="smaller steps") as caught:
        opened.nudge(1e7, 0.0)
    assert "\n" not in str(caught.value)


# -- place and fit again -------------------------------------------------------------------------------------------


def test_a_star_placed_where_it_is_gets_the_center_of_the_search(opened):
    opened.predict()
    opened.find_stars()
    star = _used(opened)[0]
    before = _rows(opened)[star]["observed"]
    opened.reject_stars([star], "by mistake")
    opened.place_star(star, np.round(before))
    row = _rows(opened)[star]
    assert (row["status"], row["reason"]) == ("used", "placed by the analyst")
    np.testing.assert_allclose(row["observed"], before, atol=1e-3)
    assert opened.result()["provenance"]["placed_stars"][0]["star"] == star


def test_stars_placed_by_hand_alone_give_a_pointing(truth, kernels):
    """A frame in which nothing is identified: two stars by hand, then the pointing, then the whole field."""
    session = ImageSession.open(truth.picture, "new_horizons", settings=BLIND)
    session.predict()
    session.find_stars()
    camera = session.context.camera
    stars = session.state.a_priori
    places = stars.places(camera, truth.camera_from_j2000)
    inside = np.flatnonzero(camera.on_detector(places, -10.0))
    bright = inside[np.argsort(stars.mag[inside])[:4]]
    for row in bright:
        session.place_star(str(stars.id[row]), np.round(places[row]))
    assert _used(session)
    session.repoint()
    session.find_stars()
    session.repoint()
    assert session.state.pointing.n_stars >= 14
    assert session.state.pointing.rms_px < 0.2


def test_a_star_placed_where_nothing_is_stays_undetected(opened):
    opened.predict()
    opened.find_stars()
    star = _used(opened)[0]
    opened.place_star(star, _empty_place(opened))
    row = _rows(opened)[star]
    assert (row["status"], row["observed"]) == ("not_detected", None)


def _empty_place(session):
    """A pixel far from everything bright."""
    signal = np.abs(session.context.signal_dn)
    blocks = signal[4:124, :5000].reshape(8, 15, 250, 20).max(axis=(1, 3))
    line, pixel = np.unravel_index(np.argmin(blocks), blocks.shape)
    return 20.0 * pixel + 10.0, 4.0 + 15.0 * line + 7.0


@pytest.mark.parametrize(
    ("star", "place", "said"),
    [
        ("HIP 0", (10.0, 10.0), "no star HIP 0"),
        (None, (-5.0, 10.0), "off the detector"),
        (None, (1.0,), "a place is"),
    ],
)
def test_a_star_that_cannot_be_placed(opened, star, place, said):
    opened.predict()
    with pytest.raises(SessionError, match=said) as caught:
        opened.place_star(star or str(opened.state.a_priori.id[0]), place)
    assert "\n" not in str(caught.value)
    assert [entry.step for entry in opened.journal] == ["predict"]


def test_a_catalog_star_that_was_too_faint_to_be_predicted_can_be_placed(truth, kernels):
    session = ImageSession.open(truth.picture, "new_horizons", settings=Settings(max_stars=10))
    session.predict()
    session.find_stars()
    session.repoint()
    left_out = [star for star in session.known_stars() if star not in session.state.a_priori.id.tolist()]
    full = ImageSession.open(truth.picture, "new_horizons")
    full.predict()
    full.find_stars()
    full.repoint()
    star, row = next((s, r) for s, r in _rows(full).items() if s in left_out and r["status"] == "used")
    session.place_star(star, row["observed"])
    placed = _rows(session)[star]
    assert placed["status"] == "used"
    np.testing.assert_allclose(placed["observed"], row["observed"], atol=0.02)
    session.repoint()
    assert session.state.pointing.used[session.state.a_priori.id.tolist().index(star)]


def test_fitting_all_again_gives_the_same_centers(opened):
    opened.predict()
    opened.find_stars()
    opened.repoint()
    opened.find_stars()
    before = {star: row["observed"] for star, row in _rows(opened).items() if row["observed"]}
    opened.refit_stars()
    for star, place in before.items():
        np.testing.assert_allclose(_rows(opened)[star]["observed"], place, atol=1e-3)


def test_fitting_some_again_leaves_the_others_as_they_are(opened):
    opened.predict()
    opened.find_stars()
    first, second = _used(opened)[:2]
    before = _rows(opened)
    opened.refit_stars([first], final="cross_correlation", search_radius_px=3.0)
    after = _rows(opened)
    assert after[first]["method"] == "cross_correlation"
    assert after[first]["observed"] != before[first]["observed"]
    np.testing.assert_allclose(after[first]["observed"], before[first]["observed"], atol=0.3)
    assert {star: row for star, row in after.items() if star != first} == {
        star: row for star, row in before.items() if star != first
    }
    opened.refit_stars([first, second])  # and back, with the PSF of the frame
    back = _rows(opened)
    assert back[first]["method"] == "least_squares"
    np.testing.assert_allclose(back[first]["observed"], before[first]["observed"], atol=1e-3)


def test_the_template_may_be_a_star_of_the_analysts_choice(opened):
    opened.predict()
    opened.find_stars()
    stars = _used(opened)
    bright = max(stars, key=lambda star: _rows(opened)[star]["snr"])
    opened.refit_stars([stars[0]], final="matched_filter", template=bright)
    assert _rows(opened)[stars[0]]["method"] == "matched_filter"
    assert opened.journal[-1].parameters["template"] == bright


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"ids": ["HIP 0"]}, "no star HIP 0"),
        ({"final": "eye"}, "unknown method"),
        ({"template": "HIP 0"}, "no star HIP 0"),
    ],
)
def test_what_cannot_be_fitted_again(opened, options, said):
    opened.predict()
    with pytest.raises(SessionError, match=r"find_stars\(\)"):
        opened.refit_stars()
    opened.find_stars()
    state = opened.state
    with pytest.raises(SessionError, match=said):
        opened.refit_stars(**options)
    assert opened.state is state


@pytest.mark.parametrize("step", ["two_star_pointing", "nudge"])
def test_a_new_field_drops_what_was_said_of_the_older_one(opened, step):
    """Also what a repoint without stars said, and by which method single stars were fitted."""
    opened.predict()
    opened.find_stars()
    rows, (first, second) = _rows(opened), _used(opened)[:2]
    opened.refit_stars([first], final="cross_correlation")
    opened.reject_stars(_used(opened), "none is to be trusted")
    opened.repoint()
    assert any("no usable star" in message for message in opened.state.messages)
    if step == "nudge":
        opened.nudge(1.0, 0.0)
    else:
        opened.two_star_pointing([rows[star]["observed"] for star in (first, second)], [first, second])
    assert not any("no usable star" in message for message in opened.state.messages)
    assert not opened.state.star_methods
    assert opened.state.pointing is None
    assert opened.state.centers is None


# -- boxes ---------------------------------------------------------------------------------------------------------


def test_boxes_show_data_model_and_residual_at_the_star(finished):
    rows = {star["id"]: star for star in json.loads(finished.to_json())["stars"]}
    boxes = finished.star_boxes()
    assert {box.id for box in boxes} >= {star for star, row in rows.items() if row["status"] == "used"}
    signal = finished.context.signal_dn
    for box in boxes:
        row = rows[box.id]
        assert (box.status, box.reason) == (row["status"], row["reason"])
        if row["status"] != "used":
            continue
        np.testing.assert_allclose(box.observed_px, row["observed"])
        np.testing.assert_allclose(box.predicted_px, row["predicted"], atol=SAME_PX)
        np.testing.assert_allclose(box.sigma_px, row["sigma_px"])
        assert box.snr == pytest.approx(row["snr"])
        pixel, line = box.first_px
        inside = np.isfinite(box.data_dn)
        at_line, at_pixel = np.nonzero(inside)
        np.testing.assert_allclose(box.data_dn[inside], signal[line + at_line, pixel + at_pixel])
        assert np.nanstd(box.residual_dn) < 0.5 * np.nanstd(box.data_dn)
        brightest = np.unravel_index(np.nanargmax(box.model_dn), box.model_dn.shape)
        center = np.array(box.observed_px) - box.first_px
        assert np.hypot(*(center - brightest[::-1])) < 1.0


def test_boxes_exist_before_anything_was_fitted(opened):
    with pytest.raises(SessionError, match=r"predict\(\)"):
        opened.star_boxes()
    opened.predict()
    box = opened.star_boxes()[0]
    assert np.isfinite(box.data_dn).any()
    assert not np.isfinite(box.model_dn).any()
    assert (box.observed_px, box.method, box.flags) == (None, "", "")
    with pytest.raises(SessionError, match="no star HIP 0"):
        opened.star_boxes(["HIP 0"])


# -- gates, notes, listeners ---------------------------------------------------------------------------------------


def test_gates_open_one_after_the_other(opened):
    for need, said in (("stars_confirmed", "no stars are found yet"), ("pointing", "not solved")):
        with pytest.raises(SelectionPending, match=said) as caught:
            opened.require(need)
        assert "\n" not in str(caught.value)
    opened.predict()
    opened.find_stars()
    with pytest.raises(SelectionPending, match="15 stars wait to be accepted or rejected"):
        opened.require("stars_confirmed")
    used = _used(opened)
    opened.accept_stars(used[1:])
    opened.reject_stars(used[:1], "faint")
    opened.require("stars_confirmed")
    opened.repoint()
    opened.add_target("PLUTO")
    opened.require("stars_confirmed", "pointing")
    with pytest.raises(SelectionPending, match="PLUTO not looked for yet"):
        opened.require("pointing", "bodies")
    opened.find_body("PLUTO")
    with pytest.raises(SelectionPending, match=r"observables\(\)"):
        opened.require("bodies", "observables")
    opened.observables()
    opened.require("stars_confirmed", "pointing", "bodies", "observables")


def test_an_unknown_gate_is_answered_with_the_known(opened):
    with pytest.raises(SessionError, match="stars_confirmed, pointing, bodies, observables"):
        opened.require("coffee")


def test_notes_stand_in_the_result(opened):
    opened.note("  stray light in the corner ")
    opened.predict()
    assert opened.result()["provenance"]["notes"] == ["stray light in the corner"]
    with pytest.raises(SessionError, match="empty note"):
        opened.note(" ")


def test_listeners_hear_of_every_step_until_they_are_forgotten(opened):
    heard = []
    forget = opened.on_change(lambda session: heard.append(session.journal[-1].step))
    opened.predict()
    opened.undo()
    opened.redo()
    forget()
    forget()
    opened.note("unheard")
    assert heard == ["predict", "undo", "redo"]


def test_a_checkpoint_that_raises_cancels_the_step(opened):
    class Cancelled(Exception):
        pass

    def cancel() -> None:
        raise Cancelled

    opened.predict()
    state, journal = opened.state, opened.journal
    opened.checkpoint = cancel
    with pytest.raises(Cancelled):
        opened.find_stars()
    assert (opened.state is state, opened.journal) == (True, journal)
    opened.checkpoint = None
    opened.find_stars()
