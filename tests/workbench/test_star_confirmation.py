"""Star-box confirmation with keys and clicks, without a browser: every decision is a session step."""

import numpy as np
import pytest

from opnav_workbench.session import ImageSession
from opnav_workbench.session.star_boxes import star_rows
from opnav_workbench.workbench import plots, pointing_tab, stars_tab
from opnav_workbench.workbench.markup import render
from opnav_workbench.workbench.stars_tab import short_name


def test_accepting_goes_on_to_the_next_undecided(star_hands):
    first, second, third = star_hands.controller.stars.ids[:3]
    star_hands.press("a")
    assert dict(star_hands.session.state.decisions) == {first: ("accepted", "")}
    assert star_hands.controller.stars.focused.id == second
    star_hands.press("ArrowLeft", "u")
    assert star_hands.controller.stars.focused.id == second
    star_hands.press("n")
    assert star_hands.controller.stars.focused.id == third
    assert star_hands.said.startswith(f"{first} accepted; 14 undecided")


def test_rejecting_asks_for_the_reason_by_digit(star_hands):
    star = star_hands.controller.stars.focused.id
    star_hands.press("r")
    assert star_hands.session.state.decisions == {}
    assert "cosmic ray" in star_hands.panel
    star_hands.press("2")
    assert star_hands.session.state.decisions[star] == ("rejected", "blend")
    assert star_hands.session.journal[-1].reason == "blend"


def test_escape_closes_the_menu_and_digits_mean_tabs_again(star_hands):
    star_hands.press("r", "Escape", "2")
    assert star_hands.controller.tab_name == "pointing"
    assert star_hands.session.state.decisions == {}


def test_pointing_follows_the_stars_and_undo_takes_both_back(star_hands):
    star_hands.press("p")
    solved = star_hands.session.state.pointing
    star_hands.press("r", "1")
    assert star_hands.steps[-2:] == ["reject_stars", "repoint"]
    assert star_hands.session.state.pointing.n_stars == solved.n_stars - 1
    star_hands.press("Ctrl+z")
    assert star_hands.session.state.pointing.n_stars == solved.n_stars
    assert star_hands.steps[-1] == "repoint"  # the one asked for by key stands
    star_hands.press("Ctrl+y")
    assert star_hands.session.state.pointing.n_stars == solved.n_stars - 1
    star_hands.press("Ctrl+z", "Ctrl+z")
    assert star_hands.session.state.pointing is None


@pytest.mark.slow
def test_residual_plots_follow_the_stars(star_hands):
    found = star_hands.panel
    assert "from the a priori places" in found
    assert "from the field found" in found
    star_hands.press("p")
    solved = star_hands.panel
    assert "after repointing" in solved
    star_hands.press("r", "1")
    assert (
        star_hands.panel.count('class="pt pixel"') == solved.count('class="pt pixel"') - 2
    )  # one in each plot


def test_a_key_draws_what_it_changes_and_no_more(star_hands, monkeypatch):
    """Cards of stars that stay as they are, and plots of residuals that do, are drawn once."""
    star_hands.press("p")
    before = star_hands.panel
    drawn = []

    def counted(template, **content):
        drawn.append(template)
        return render(template, **content)

    for module in (stars_tab, pointing_tab, plots):
        monkeypatch.setattr(module, "render", counted)
    star_hands.press("n")
    assert drawn.count("star_card.html") == 2  # the one left, and the one come to
    assert "residual_plots.html" not in drawn
    star_hands.press("n", "ArrowLeft", "ArrowLeft")
    assert star_hands.panel == before
    drawn.clear()
    first = star_hands.controller.stars.focused.id
    star_hands.session.accept_stars([first])
    assert drawn.count("star_card.html") == 1
    assert f'class="card accepted here" data-act="star" data-arg="{first}"' in star_hands.panel
    drawn.clear()
    star_hands.press("2", "1", "2")
    assert drawn.count("pointing_plots.html") == 1
    star_hands.press("p")
    assert drawn.count("pointing_plots.html") == 1  # solved again, and the same
    star_hands.press("1", "r", "1", "2")
    assert drawn.count("pointing_plots.html") == 2  # of fewer stars


def test_boxes_know_what_was_decided_on_their_stars(star_hands):
    first, second = star_hands.controller.stars.ids[:2]
    star_hands.press("n", "ArrowLeft", "a")
    boxes = star_hands.controller.stars.boxes([first, second])
    assert [box.verdict for box in boxes] == ["accepted", ""]
    star_hands.press("Ctrl+z")
    assert [box.verdict for box in star_hands.controller.stars.boxes([first, second])] == ["", ""]


def test_long_names_keep_what_tells_them_apart():
    names = ["Gaia DR3 4147052646752393728", "Gaia DR3 4147052646752393729", "HIP 1"]
    assert len({short_name(name) for name in names}) == 3
    assert all(len(short_name(name)) <= 15 for name in names)


@pytest.mark.slow
def test_each_must_be_examined_where_asked(star_hands):
    star_hands.send("examine")
    star_hands.press("p")
    assert star_hands.kind == "error"
    assert "15 stars are undecided, and each must be examined" in star_hands.said
    assert star_hands.session.state.pointing is None
    star_hands.press("A")
    assert "one by one" in star_hands.said
    star_hands.press(*("a",) * 15, "p")
    assert star_hands.session.state.pointing.n_stars == 15


@pytest.mark.slow
def test_radius_and_template_fit_again_at_once(star_hands):
    centers = star_hands.session.state.centers
    star_hands.press("]")
    assert star_hands.session.standing[-1].parameters["search_radius_px"] == pytest.approx(6.0)
    assert star_hands.session.state.centers is not centers
    star_hands.send("radius", value="3.5")
    assert star_hands.session.standing[-1].parameters["search_radius_px"] == 3.5
    star_hands.press("t")
    assert star_hands.session.standing[-1].parameters["template"] == star_hands.controller.stars.focused.id
    star_hands.press("t")
    assert star_hands.session.standing[-1].parameters["initial"] == "cross_correlation"
    assert star_hands.session.state.mask("used").sum() == 15
    steps = len(star_hands.session.standing)
    star_hands.send("radius", value="wide")
    assert "the search radius is a number of pixels, not 'wide'" in star_hands.said
    assert len(star_hands.session.standing) == steps


def test_both_tabs_find_stars_with_the_radius_and_template_chosen(star_hands):
    star_hands.press("]", "t", "t")
    for keys in ("1f", "2f"):
        star_hands.press(*keys)
        found = star_hands.session.standing[-1]
        assert found.step == "find_stars"
        assert found.parameters["initial"] == "cross_correlation"
        assert found.parameters["search_radius_px"] == pytest.approx(6.0)
        assert star_hands.said.startswith("15 of 15 stars found")


def test_click_goes_to_a_star_and_places_one(star_hands):
    box = star_hands.session.star_boxes()[5]
    star_hands.tap(*(box.observed_px + np.array([1.0, -1.0])))
    assert star_hands.controller.stars.focused.id == box.id
    star_hands.press("i")
    star_hands.tap(*(box.observed_px + np.array([0.4, -0.3])))
    assert star_hands.session.standing[-1].step == "place_star"
    assert star_hands.session.state.decisions[box.id][0] == "accepted"
    placed = next(b for b in star_hands.session.star_boxes() if b.id == box.id)
    np.testing.assert_allclose(placed.observed_px, box.observed_px, atol=0.05)


def test_click_far_from_stars_changes_nothing(star_hands):
    focus, steps = star_hands.controller.stars.focused.id, star_hands.steps
    star_hands.tap(-500.0, -500.0)
    assert star_hands.controller.stars.focused.id == focus
    assert star_hands.steps == steps


@pytest.mark.slow
def test_everything_shown_as_decided_is_on_disk(star_hands):
    star_hands.press("a", "r", "3", "a")
    folder = star_hands.controller.queue.item.folder
    resumed = ImageSession.resume(folder)
    assert dict(resumed.state.decisions) == dict(star_hands.session.state.decisions)
    assert len(resumed.state.decisions) == 3


def test_without_stars_the_page_says_what_to_do(hands_on, demo_truths):
    hands = hands_on(demo_truths[0].picture)
    assert "Find stars" in hands.panel
    hands.press("A")
    assert hands.kind == "error"


def test_rows_of_the_stars_say_what_their_boxes_do(star_hands):
    session = star_hands.session
    rows, boxes = star_rows(session.context, session.inputs, session.state), session.star_boxes()
    assert rows.ids == tuple(box.id for box in boxes)
    assert rows.status == tuple(box.status for box in boxes)
    assert np.array_equal(rows.place_px, [box.place_px for box in boxes])
    assert np.array_equal(rows.snr, [box.snr for box in boxes], equal_nan=True)
    turned = rows.taken(np.argsort(-rows.mag))
    assert (np.diff(turned.mag) <= 0.0).all()
    assert turned.ids[0] == rows.ids[int(rows.mag.argmax())]


def test_an_undo_comes_back_to_what_was_drawn(star_hands, monkeypatch):
    """What a decision and the solution after it had changed stands as before: no card and no plot is drawn anew."""
    star_hands.press("p")
    before, drawn = star_hands.panel, []
    star_hands.press("r", "1")

    def counted(template, **content):
        drawn.append(template)
        return render(template, **content)

    for module in (stars_tab, plots):
        monkeypatch.setattr(module, "render", counted)
    star_hands.press("Ctrl+z")
    assert star_hands.panel == before
    assert not {"star_card.html", "residual_plots.html"} & set(drawn)
