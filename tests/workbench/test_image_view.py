"""The image view's Python side, without a page."""

import json

import numpy as np
import pytest

from opnav_workbench.errors import OpNavError
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench.actions import VIEW_ACTIONS, WORKBENCH_ACTIONS, ActionRegistry
from opnav_workbench.workbench.image_view import ImageView
from opnav_workbench.workbench.overlays import BodyMarks
from opnav_workbench.workbench.plots import FONT_PX
from opnav_workbench.workbench.view_models import THEMES, body_label_columns
from opnav_workbench.workbench.viewer import Layer, Viewer


@pytest.fixture
def view(solved_sessions):
    return ImageView(solved_sessions[0])


def pixels(view, key="data"):
    return view.images.pixels(key)


@pytest.mark.slow
def test_view_serves_the_workbench(view):
    asked: Viewer = view
    assert asked.actions is VIEW_ACTIONS
    ActionRegistry([*WORKBENCH_ACTIONS, *VIEW_ACTIONS])  # no key means two things


def test_pixels_are_exact(view, solved_sessions):
    np.testing.assert_allclose(
        pixels(view), solved_sessions[0].context.picture.image_dn, rtol=1e-7, atol=1e-7
    )


@pytest.mark.slow
def test_what_is_in_sight_stays_and_what_is_not_is_brought_into_the_middle(view):
    size = len(pixels(view))
    view.look((0.4 * size, 0.5 * size), 0.2 * size)
    before = view.models.x_range.start
    view.look((0.45 * size, 0.5 * size), 0.2 * size, unless_seen=True)
    assert view.models.x_range.start == before
    view.look((0.7 * size, 0.5 * size), 0.2 * size, unless_seen=True)
    assert view.models.x_range.start == pytest.approx(0.6 * size)


@pytest.mark.parametrize("step", [(1.0, 1.0), (1.0, 0.0), (-1.0, -1.0), (1.0, -2.0)])
def test_a_poles_letter_stands_beside_its_bodys_name(step):
    """The name is beyond the limb on the other side: of a small body, too, they do not lie on each other."""
    place = np.array([50.0, 50.0])
    limb = np.add(place, [[3.0, 0.0], [0.0, 3.0], [-3.0, 0.0]])
    pole = np.array([place, place + step])
    small = BodyMarks("PLUTO", place, 3.0, True, limb, limb, np.empty((0, 2)), pole)
    columns = body_label_columns([small], (100, 100))
    name, letter = np.add(
        columns["line"], columns["y_offset"]
    )  # lower edges, a pixel of the picture one of the screen
    assert columns["text"] == ["PLUTO", "N"]
    assert abs(name - letter) > FONT_PX - 1.0  # a letter of capitals is lower than its font


@pytest.mark.slow
def test_another_picture_begins_as_pictures_do(view, solved_sessions):
    """How one picture was looked at is not the next one's; a body of 1 px has a mark; a blank view has none."""
    points = view.models.sources["body_point"].data
    assert len(points["pixel"]) == 1
    view.state.update(contrast=3.0, bias=0.2, limits="manual", low=5.0, high=6.0, stretch="log")
    view.show(solved_sessions[1])
    assert (view.state.contrast, view.state.bias, view.state.limits) == (1.0, 0.5, "sky")
    assert view.state.stretch == "log"  # a habit, not of one picture
    view.blank("next.fit cannot be opened")
    assert view.state.message == "next.fit cannot be opened"
    assert not any(len(column) for source in view.models.sources.values() for column in source.data.values())
    assert np.ptp(pixels(view)) == 0
    view.show(solved_sessions[0])
    assert view.state.message == ""
    assert np.ptp(pixels(view)) > 0


@pytest.mark.slow
def test_vectors_are_drawn_long_enough_until_the_analyst_takes_a_scale(view, solved_sessions):
    view.show(solved_sessions[0])
    own = view.state.vector_scale
    assert own > 1.0
    view.refresh()
    assert view.state.vector_scale == own
    view.state.vector_scale = 1000.0
    view.refresh()
    assert view.state.vector_scale == 1000.0


@pytest.mark.slow(keep=["values0-uint16"])
@pytest.mark.parametrize(
    ("values", "dtype"),
    [
        ([0, 65535], "uint16"),
        ([-1, 5], "float32"),
        ([0.5, 5], "float32"),
        ([0, 65536], "float32"),
        ([np.nan, 1], "float32"),
    ],
)
def test_counts_travel_as_uint16(view, values, dtype):
    image = np.zeros(pixels(view).shape)
    image[0, :2] = values
    view.set_image("other", image)
    assert pixels(view, "other").dtype == dtype
    np.testing.assert_array_equal(pixels(view, "other")[0, :2], np.array(values))


def test_picture_of_another_size_is_refused(view):
    with pytest.raises(OpNavError, match=r"shape \(3, 4\); the image has 256 x 256"):
        view.set_image("other", np.zeros((3, 4)))


@pytest.mark.slow
def test_home_shows_the_whole_square_or_all_lines_of_a_strip(view, solved_sessions):
    x, y = view.models.x_range, view.models.y_range
    assert (x.start, x.end, y.start, y.end) == (
        -0.5,
        255.5,
        255.5,
        -0.5,
    )  # lines downwards, pixels as wide as high
    view.show(solved_sessions[1])
    assert y.start - y.end == pytest.approx(1.15 * 128)
    assert x.end - x.start == pytest.approx(3.0 * (y.start - y.end))


def test_model_is_made_when_asked_for_and_again_after_a_step(view, solved_sessions):
    assert not json.loads(view.state.images)["model"]["ready"]
    view.state.image = "model"
    assert json.loads(view.state.images)["model"]["ready"]
    before = pixels(view, "model")
    star = solved_sessions[0].state.a_priori.id[0]
    solved_sessions[0].reject_stars([star], "test")
    view.refresh()
    assert pixels(view, "model") is not before
    solved_sessions[0].undo()
    same = json.loads(view.state.images)
    assert same["model"]["limits"] == same["data"]["limits"]  # blinking then shows what differs


def test_refresh_that_changes_nothing_sends_nothing(view):
    view.refresh()
    sent = []

    def heard(event):
        sent.append(event)

    view.bridge.document.on_change(heard)
    view.refresh()
    assert sent == []


@pytest.mark.slow
def test_another_session_replaces_everything(view, solved_sessions):
    view.circle([10, 10], 5)
    view.layer("scans", Layer([(0, 0, 1, 1)], ["used"]))
    view.show(solved_sessions[1])
    assert pixels(view).shape == (128, 5024)
    assert json.loads(view.state.setup)["strip"]
    assert (
        len(view.models.sources["circle"].data["pixel"])
        == len(view.models.sources["segments"].data["x0"])
        == 0
    )


@pytest.mark.slow
def test_tools_draw_their_layers(view):
    view.layer("a", Layer([(0, 0, 1, 1), (2, 2, 3, 3)], ["used", "rejected"], [(5, 6, "one")]))
    view.layer("b", Layer([(9, 9, 8, 8)], ["focus"]))
    drawn = view.models.sources["segments"].data
    assert drawn["x0"].tolist() == [0, 2, 9]
    assert len(set(drawn["color"])) == 3
    assert len(set(drawn["dash"])) >= 2  # colour is never the only sign
    view.layer("a", Layer())
    assert view.models.sources["segments"].data["x0"].tolist() == [9]
    assert view.models.sources["tool_labels"].data["text"] == []


@pytest.mark.slow
def test_focus_brings_a_place_into_view(view):
    view.models.x_range.update(start=0.0, end=20.0)
    view.models.y_range.update(start=20.0, end=0.0)
    view.focus([100.0, 10.0], 6.0)
    assert (view.models.x_range.start, view.models.x_range.end) == (90.0, 110.0)
    assert (view.models.y_range.start, view.models.y_range.end) == (20.0, 0.0)
    view.focus(None)
    assert len(view.models.sources["focus"].data["pixel"]) == 0


def test_themes_tell_kinds_apart_without_colour():
    for looks in THEMES.values():
        stars = [looks[kind] for kind in ("predicted", "used", "rejected", "missing")]
        assert len({look.shape for look in stars}) == 4
        lines = [looks[kind] for kind in ("body", "body_predicted", "terminator", "pole")]
        assert len({look.dash for look in lines}) == 4


@pytest.mark.slow
def test_theme_can_be_changed(view):
    view.state.theme = "CAVIAR"
    (glyph, *_) = view.models._glyphs["used"]
    assert glyph.line_color == THEMES["CAVIAR"]["used"].color


@pytest.mark.slow
def test_view_without_a_session():
    view = ImageView()
    view.refresh()
    assert view.picture().startswith(b"\x89PNG")
    assert pixels(view).shape == (512, 512)


def test_clicks_and_drags_are_reported(view):
    heard = []
    view.listen(lambda *at: heard.append(at), lambda *ends: heard.append(ends))
    view.bridge.receive({"kind": "event", "page": "p", "name": "tap", "values": [1.5, 2.0]})
    view.bridge.receive({"kind": "event", "page": "p", "name": "drag", "values": [1, 2, 3, 4]})
    assert heard == [(1.5, 2.0), (1, 2, 3, 4)]
    view.drag_mode(True, "circle")
    assert view.state.drag == "circle"
    view.drag_mode(False)
    assert view.state.drag == ""


def test_where_no_attitude_is_known_nothing_is_said_of_the_sky(demo_truths):
    session = ImageSession.open(demo_truths[0].picture, "new_horizons", attitude="unknown")
    session.predict()
    session.describe_body("VULCAN", (100.0, 120.0), 30.0, radii_km=600.0, phase_deg=40.0, sun_deg=90.0)
    view = ImageView(session)
    assert json.loads(view.state.camera) is None
    assert [name for name, *_ in json.loads(view.state.compass)] == ["Sun"]
    assert not view.models.sources["grid_labels"].data["text"]
    # Nor is any of it missing where the stars say it afterwards: a field put there by hand has a sky.
    session.nudge(1.0, 0.0)
    view.refresh()
    assert {name for name, *_ in json.loads(view.state.compass)} == {"N", "E", "Sun"}
