"""The pages' templates: nothing from outside breaks a page, and nothing on a page is without an effect."""

import re
from dataclasses import replace

import numpy as np
import pytest

from opnav_workbench.templating import environment
from opnav_workbench.workbench.actions import Action
from opnav_workbench.workbench.markup import TEMPLATES, page_files, render
from opnav_workbench.workbench.plots import ResidualPage, StarResiduals, residual_plots, vector_plot

HOSTILE = '</title><script>alert("1")</script>'
NAMES = sorted(path.name for path in TEMPLATES.iterdir())


@pytest.mark.parametrize("name", NAMES)
def test_every_template_stands_and_escapes(name):
    templates = environment(TEMPLATES)
    templates.get_template(name)
    assert templates.autoescape is True


def _macro(template, name):
    return getattr(environment(TEMPLATES).get_template(template).module, name)


def test_an_action_from_outside_cannot_break_its_button():
    shown = _macro("macros.html", "button")(Action('"><script>', (), '<script>"', 'a"b.'))
    assert "<script" not in shown


def test_a_star_of_any_name_cannot_break_the_plots():
    two = np.array([[100.0, 50.0], [10.0, 5.0]])
    rows = StarResiduals(
        (HOSTILE, "HIP 1"), np.array([8.0, 9.0]), two, two, two, two / 100.0, True, (512, 512)
    )
    shown = _macro("plots.html", "residual_plots")(residual_plots(rows, (200, 100)))
    shown += _macro("plots.html", "vector_plot")(vector_plot(rows, 400))
    assert "<script" not in shown
    # A point for pixel and line, before and after, each with its tooltip and the star that a click takes; and a vector.
    assert shown.count("&lt;script&gt;") == 9
    moved = replace(rows, reference="")
    assert "not repointed yet" in _macro("plots.html", "residual_plots")(residual_plots(moved, (200, 100)))


def test_the_star_under_decision_stands_out_in_plots_that_are_drawn_once():
    two = np.array([[100.0, 50.0], [10.0, 5.0]])
    rows = StarResiduals(
        ("HIP 1", "HIP 2"), np.array([8.0, 9.0]), two, two, two, two / 100.0, "after", (512, 512)
    )
    page = ResidualPage((200, 100))
    for star in ("HIP 1", "HIP 2"):
        shown = page.html(rows, star)
        assert re.findall(r'class="pt \w+ here" data-act="star" data-arg="([^"]+)"', shown) == [star] * 4
        assert shown.count("<svg") == shown.count("</svg>") == 2
        assert "&lt;" not in shown
    assert "here" not in page.html(rows, "HIP 3")
    assert page.html(rows, "HIP 1") != page.html(replace(rows, before_px=2.0 * two), "HIP 1")
    assert page.html(replace(rows, ids=()), "HIP 1") is None


def test_line_breaks_of_a_template_are_not_part_of_the_page():
    actions = dict.fromkeys(_actions_in("header.html"), Action("undo", (), "Undo", "Take back."))
    flags = dict.fromkeys(("is_first", "is_last", "is_open", "can_undo", "can_redo", "keys_shown"), False)
    shown = render("header.html", actions=actions, name="a > b", facts="", folder=None, **flags)
    assert "\n" not in shown
    assert '<b>a &gt; b</b><span title=""></span></div>' in shown


def _actions_in(name):
    return re.findall(r'actions\["(\w+)"\]', (TEMPLATES / name).read_text(encoding="utf-8"))


def test_what_a_page_offers_is_done(star_hands):
    """Every action that a template names exists, and everything that reports from the page is heard."""
    registry, handlers = star_hands.controller.registry, star_hands.controller._handlers
    texts = [(TEMPLATES / name).read_text(encoding="utf-8") for name in NAMES]
    assert {action for name in NAMES for action in _actions_in(name)} <= {action.name for action in registry}
    acts = {act for text in texts for act in re.findall(r'data-(?:act|box)="(\w+)"', text)}
    assert len(acts) > 10
    assert acts <= set(handlers)


def test_scripts_and_styles_stand_beside_each_other():
    assert "export default" in page_files("keys.js", "region.js")
    assert ".opnav-workbench" in page_files("workbench.css")
