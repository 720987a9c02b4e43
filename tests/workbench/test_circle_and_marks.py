"""Click-to-circle, two stars by hand, nudges: shapes half drawn, and the session steps they become."""

import numpy as np
import pytest

from opnav_workbench.errors import SessionError
from opnav_workbench.scene import phase_at_terminator
from opnav_workbench.session.decisions import Decisions
from opnav_workbench.workbench.circle_tool import CircleTool, DrawnCircle, typed_circle
from opnav_workbench.workbench.overlays import body_marks
from opnav_workbench.workbench.pointing_tab import TwoStarMarks


def test_two_clicks_on_one_place_make_no_circle():
    tool = CircleTool()
    assert tool.clicked(10.0, 20.0) is None
    with pytest.raises(SessionError, match=r"radius is 0\.0 px; click the center, then a place on the limb"):
        tool.clicked(10.0, 20.0)
    assert tool.clicked(10.0, 60.0) == DrawnCircle(10.0, 20.0, 40.0)


def test_typed_numbers_adjust_the_circle():
    circle = DrawnCircle(10.0, 20.0, 5.0)
    assert typed_circle(circle, "line", "21.5") == DrawnCircle(10.0, 21.5, 5.0)
    with pytest.raises(SessionError, match="radius must be a number of pixels, not '0'"):
        typed_circle(circle, "radius", "0")
    with pytest.raises(SessionError, match="pixel must be a number of pixels, not 'nan'"):
        typed_circle(circle, "pixel", "nan")
    assert circle.grown(-10.0).radius_px == 1.0


@pytest.fixture
def body_hands(star_hands):
    star_hands.press("3")
    star_hands.send("add_body", value="pluto")
    return star_hands


@pytest.mark.slow
def test_circle_by_two_clicks_is_a_step_and_arrows_move_it(body_hands):
    body_hands.press("k")
    assert body_hands.viewer.dragging
    body_hands.tap(480.0, 50.0)
    body_hands.tap(480.0, 63.0)
    circle = body_hands.session.state.circles["PLUTO"]
    np.testing.assert_allclose([*circle.center_px, circle.radius_px], [480.0, 50.0, 13.0])
    assert body_hands.viewer.circled == (480.0, 50.0, 13.0)
    assert not body_hands.viewer.dragging
    body_hands.press("ArrowRight", "Shift+ArrowUp", ">")
    circle = body_hands.session.state.circles["PLUTO"]
    np.testing.assert_allclose([*circle.center_px, circle.radius_px], [481.0, 49.9, 14.0])
    body_hands.send("circle_field", arg="radius", value="20")
    assert body_hands.session.state.circles["PLUTO"].radius_px == 20.0
    body_hands.press("w")
    assert "PLUTO" not in body_hands.session.state.circles
    body_hands.press("Ctrl+z")
    assert body_hands.session.state.circles["PLUTO"].radius_px == 20.0


def test_circle_by_drag(body_hands):
    body_hands.press("k")
    body_hands.drag(300.0, 40.0, 330.0, 80.0)
    assert body_hands.session.state.circles["PLUTO"].radius_px == 50.0


@pytest.mark.slow
def test_a_body_that_no_kernel_knows_is_described_by_its_circle(star_hands):
    star_hands.press("3")
    star_hands.send("add_body", value="vulcan 30, 20, 20")
    assert "VULCAN 30, 20, 20" in star_hands.said  # no unit: a name
    star_hands.send("add_body", value="vulcan 600 km")
    assert star_hands.viewer.dragging
    star_hands.press("f")
    assert star_hands.said == "VULCAN is described by its circle: K, then two clicks."
    steps = star_hands.steps
    star_hands.drag(300.0, 40.0, 330.0, 80.0)
    body = star_hands.session.state.assisted["VULCAN"]
    np.testing.assert_allclose([*body.center_px, body.radius_px], [300.0, 40.0, 50.0])
    assert body.radii_km.tolist() == [600.0, 600.0, 600.0]
    assert "range" in star_hands.said
    assert star_hands.viewer.circled == (300.0, 40.0, 50.0)
    assert 'data-arg="phase_deg"' in star_hands.panel
    star_hands.press("ArrowRight", ">")
    body = star_hands.session.state.assisted["VULCAN"]
    np.testing.assert_allclose([*body.center_px, body.radius_px], [301.0, 40.0, 51.0])
    star_hands.press("Ctrl+z", "Ctrl+z", "Ctrl+z")
    assert star_hands.steps == steps
    assert not star_hands.session.state.assisted


@pytest.mark.slow
def test_three_places_on_a_limb_make_its_circle(body_hands):
    places = [(80.0 + 25.0 * np.cos(turn), 60.0 + 25.0 * np.sin(turn)) for turn in (0.1, 1.3, 2.9)]
    steps = body_hands.steps
    body_hands.press("i")
    assert not body_hands.viewer.dragging
    body_hands.tap(*places[0])
    body_hands.tap(*places[1])
    assert len(body_hands.viewer.layers["limb points"].segments) == 4  # two crosses
    assert body_hands.steps == steps
    body_hands.tap(*(np.mean(places[:2], axis=0)))
    assert body_hands.said == "the three places lie on a line; click places far apart on the limb."
    body_hands.tap(*places[2])
    circle = body_hands.session.state.circles["PLUTO"]
    np.testing.assert_allclose([*circle.center_px, circle.radius_px], [80.0, 60.0, 25.0], atol=1e-3)
    assert not body_hands.viewer.layers["limb points"].segments
    body_hands.press("Ctrl+z")
    assert body_hands.steps == steps


@pytest.mark.slow
def test_sun_phase_and_range_of_a_described_body_by_hand(star_hands):
    """By click, drag and field: each one step, one undo, and the words of a file of decisions."""
    star_hands.press("3")
    star_hands.send("add_body", value="vulcan 600 km")
    star_hands.press("a")
    assert star_hands.said.startswith("how VULCAN is lit, and how far it is, its ephemeris tells")
    star_hands.drag(300.0, 60.0, 340.0, 60.0)
    steps, by_eye = star_hands.steps, star_hands.session.state.assisted["VULCAN"]
    star_hands.press("a")
    assert star_hands.viewer.dragging
    star_hands.tap(300.5, 60.0)
    assert "tell no direction" in star_hands.said
    star_hands.tap(300.0, 20.0)  # straight up
    body = star_hands.session.state.assisted["VULCAN"]
    assert np.degrees(body.sun_angle_rad) == pytest.approx(270.0)
    assert body.phase_rad == pytest.approx(by_eye.phase_rad)  # as the disk tells still
    star_hands.press("a")
    star_hands.drag(10.0, 10.0, 40.0, 40.0)
    star_hands.press("p")
    assert not star_hands.viewer.dragging
    star_hands.tap(400.0, 60.0)
    assert "beside the disk, or at a horn" in star_hands.said
    # 20 px from the center toward the Sun, of 40: a crescent of 120 deg.
    star_hands.tap(300.0 + 20.0 * np.sqrt(0.5), 60.0 + 20.0 * np.sqrt(0.5))
    body = star_hands.session.state.assisted["VULCAN"]
    np.testing.assert_allclose(np.degrees([body.sun_angle_rad, body.phase_rad]), [45.0, 120.0], atol=0.01)
    (mark,) = [m for m in body_marks(star_hands.session) if m.name == "VULCAN"]
    drawn = np.asarray(mark.terminator_px)[len(mark.terminator_px) // 3]
    told = phase_at_terminator(np.array([300.0, 60.0]), 40.0, body.sun_angle_rad, drawn)
    assert np.degrees(told) == pytest.approx(120.0, abs=0.5)  # drawn from the model, by another route
    far = 2.0 * star_hands.session.inputs.targets["VULCAN"].range_km
    star_hands.send("description_field", arg="range_km", value=f"{far:.3f}")
    assert star_hands.session.inputs.targets["VULCAN"].range_km == pytest.approx(far, rel=1e-9)
    assert star_hands.viewer.circled[2] == pytest.approx(20.0, abs=0.01)
    star_hands.press("ArrowDown")  # a circle that moves keeps its range
    assert star_hands.session.inputs.targets["VULCAN"].range_km == pytest.approx(far, rel=1e-9)
    assert star_hands.viewer.circled[:2] == (300.0, 61.0)
    star_hands.press(">")  # a larger one has another
    assert star_hands.session.inputs.targets["VULCAN"].range_km == pytest.approx(far * 20 / 21, rel=1e-3)
    star_hands.send("description_field", arg="phase_deg", value="dark")
    assert star_hands.said == "phase must be a number, not 'dark'."
    star_hands.send("description_field", arg="phase_deg", value="200")
    assert "give 0 (full) to 180 (dark)" in star_hands.said
    said = star_hands.session.standing[-1].parameters
    kept = {key: said[key] for key in ("center_px", "phase_deg", "sun_deg", "range_km")}
    assert kept == {"center_px": [300.0, 61.0], "phase_deg": 120.0, "sun_deg": 45.0, "range_km": None}
    added = star_hands.steps[len(steps) :]
    assert added == ["describe_body"] * 6
    (item,) = next(iter(Decisions.from_session(star_hands.session).images.values())).bodies[-1:]
    assert (item.body, item.phase_deg, item.sun_deg) == ("VULCAN", 120.0, 45.0)
    star_hands.press(*["Ctrl+z"] * len(added))
    assert star_hands.steps == steps
    assert star_hands.session.state.assisted["VULCAN"].phase_rad == by_eye.phase_rad


@pytest.mark.slow
def test_the_sun_of_a_body_that_kernels_know_is_not_said_by_hand(body_hands):
    for key in ("a", "p"):
        body_hands.press(key)
        assert "its ephemeris tells" in body_hands.said
    assert body_hands.controller.runner.tool == ""
    assert 'data-act="sun"' not in body_hands.panel


def test_undo_drops_a_center_without_radius_before_any_step(body_hands):
    steps = body_hands.steps
    body_hands.press("k")
    body_hands.tap(480.0, 50.0)
    body_hands.press("Ctrl+z")
    assert body_hands.steps == steps
    assert "dropped" in body_hands.said


def test_circle_needs_a_body(hands_on, demo_truths):
    hands = hands_on(demo_truths[0].picture)
    hands.press("3", "k")
    assert hands.said == "no body is expected in this picture; add one by its name."


@pytest.mark.slow
def test_center_is_found_and_shown(body_hands):
    body_hands.press("2", "p", "3", "f")
    assert body_hands.session.state.bodies[-1].status == "ok"
    assert body_hands.session.state.observables
    assert "1 sigma, frame ±" in body_hands.panel
    assert body_hands.viewer.looked_at[:2] == tuple(body_hands.session.state.bodies[-1].pixel_line)
    body_hands.viewer.looked_at, body_hands.viewer.in_sight = None, lambda _: True
    body_hands.press("f")
    assert body_hands.viewer.looked_at is None  # what is in sight stays where it is
    method = body_hands.session.state.bodies[-1].method
    assert body_hands.said.startswith(f"PLUTO, {method.replace('_', ' ')}: pixel")
    body_hands.press("4")
    how = f'<span class="how">{method.replace("_", " ")}</span>'
    assert f"<td>PLUTO{how}</td><td>ok</td>" in body_hands.panel


def test_marks_and_names():
    marks = TwoStarMarks().marked(1.0, 2.0)
    assert not marks.complete
    assert "second star" in marks.prompt
    marks = marks.marked(30.0, 40.0)
    assert marks.complete
    assert marks.names() is None
    with pytest.raises(SessionError, match="only HIP 1 is named; name both stars, or neither"):
        marks.named(0, " HIP 1 ").names()
    assert marks.named(0, "HIP 1").named(1, "HIP 2").names() == ["HIP 1", "HIP 2"]
    assert marks.back().places == ((1.0, 2.0),)
    assert marks.marked(5.0, 6.0).places == ((5.0, 6.0),)  # a third begins again
    assert [label[2] for label in marks.layer().labels] == ["star 1", "star 2"]


def test_two_stars_by_hand_solve_the_field(star_hands):
    boxes = sorted(star_hands.session.star_boxes(), key=lambda b: b.mag)[:2]
    star_hands.press("2", "w")
    for box in boxes:
        star_hands.tap(*box.observed_px)
    for which, box in enumerate(boxes):
        star_hands.send("two_star_name", arg=str(which), value=box.id)
    star_hands.send("two_star_solve")
    assert star_hands.steps[-2:] == ["two_star_pointing", "find_stars"]
    assert star_hands.session.state.mask("used").sum() == 15
    assert star_hands.controller.runner.tool == ""


def test_undo_takes_back_a_mark_before_any_step(star_hands):
    steps = star_hands.steps
    star_hands.press("2", "w")
    star_hands.tap(100.0, 50.0)
    star_hands.press("Ctrl+z")
    assert star_hands.controller.current_tab.marks.places == ()
    assert star_hands.steps == steps


@pytest.mark.slow
def test_arrow_keys_nudge_the_field_only_with_the_tool(star_hands):
    star_hands.press("2", "ArrowLeft")
    assert star_hands.steps[-1] == "find_stars"
    star_hands.press("j", "ArrowLeft", "Shift+ArrowDown", ">")
    entries = [e for e in star_hands.session.standing if e.step == "nudge"]
    assert [tuple(e.parameters.values()) for e in entries] == [
        (-1.0, 0.0, 0.0),
        (0.0, 10.0, 0.0),
        (0.0, 0.0, 0.05),
    ]
    assert "field moved" in star_hands.panel
    star_hands.press("Ctrl+z", "Ctrl+z", "Ctrl+z")
    assert star_hands.steps[-1] == "find_stars"
