"""The registry that keys, buttons, tooltips and the list under ? come from."""

import pytest

from opnav_workbench.templating import environment
from opnav_workbench.workbench.actions import (
    EVERYWHERE,
    NUDGE,
    PLACES,
    REASON_MENU,
    TABS,
    WORKBENCH_ACTIONS,
    Action,
    ActionRegistry,
)
from opnav_workbench.workbench.markup import TEMPLATES


@pytest.fixture
def registry():
    return ActionRegistry(WORKBENCH_ACTIONS)


def test_no_tab_shadows_a_key_that_means_something_everywhere():
    everywhere = {key for action in WORKBENCH_ACTIONS if action.where == EVERYWHERE for key in action.keys}
    tabs = {name for name, _ in TABS}
    shadowed = [(a.name, k) for a in WORKBENCH_ACTIONS if a.where in tabs for k in a.keys if k in everywhere]
    assert not shadowed


def test_menu_comes_before_tool_before_tab_before_everywhere(registry):
    assert registry.for_key("1", REASON_MENU, "stars").name == "reason_1"
    assert registry.for_key("1", "stars").name == "tab_stars"
    assert registry.for_key("ArrowLeft", NUDGE, "pointing").name == "nudge_left"
    assert registry.for_key("ArrowLeft", "stars").name == "previous"
    assert registry.for_key("ArrowLeft", "observables") is None


def test_every_action_is_explained_and_every_key_is_listed(registry):
    assert all(action.label and action.tooltip.endswith(".") for action in registry)
    listed = {key for _, actions in registry.groups(PLACES) for action in actions for key in action.keys}
    assert listed == set(registry.keys)


def test_one_key_cannot_mean_two_things_in_one_place():
    with pytest.raises(ValueError, match="'a' means 'accept' already, so not 'other'"):
        ActionRegistry(
            [Action("accept", ("a",), "A", "A.", "stars"), Action("other", ("a",), "B", "B.", "stars")]
        )
    with pytest.raises(ValueError, match="two actions are named 'accept'"):
        ActionRegistry([Action("accept", (), "A", "A."), Action("accept", (), "A", "A.")])


def test_button_carries_action_key_and_tooltip(registry):
    shown = (
        environment(TEMPLATES)
        .get_template("macros.html")
        .module.button(registry["redo"], on=True, enabled=False)
    )
    assert 'data-act="redo"' in shown
    assert "<kbd>Ctrl+Y</kbd>" in shown
    assert "Key: Ctrl+Y or Ctrl+Shift+Z" in shown
    assert 'aria-pressed="true"' in shown
    assert "disabled" in shown
