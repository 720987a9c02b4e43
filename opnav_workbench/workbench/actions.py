"""What an analyst can do: every action with its keys; buttons, tooltips and the list under ``?`` come from it.

An action belongs to a place (a tab, a tool, a menu, the picture) or to all. A key may mean one thing in each place; menu
and tool come before the tab. The picture's own actions (`VIEW_ACTIONS`) are carried out in the page, by
static/image_actions.js.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

__all__ = [
    "BOX_SCANS",
    "CIRCLE",
    "EVERYWHERE",
    "LANDMARK_MENU",
    "LANDMARK_REASONS",
    "LIMB_POINTS",
    "LOOKING",
    "NOTE_MENU",
    "NUDGE",
    "PICTURE",
    "PLACES",
    "PLACE_STAR",
    "REASON_MENU",
    "REJECT_REASONS",
    "ROOM",
    "SUN",
    "TABS",
    "TERMINATOR",
    "TWO_STARS",
    "VIEW_ACTIONS",
    "WORKBENCH_ACTIONS",
    "Action",
    "ActionRegistry",
    "shown_key",
]


# ---- Actions and their registry.

EVERYWHERE = ""


@dataclass(frozen=True, slots=True)
class Action:
    """Something that the analyst can do.

    Attributes
    ----------
    name
        What the controller is told.
    keys
        As the browser names them, with ``Ctrl+``, ``Alt+`` and ``Shift+`` before; the first is shown.
    label
        On the button.
    tooltip
        One sentence.
    where
        The tab, tool or menu where it belongs; empty: everywhere.
    """

    name: str
    keys: tuple[str, ...]
    label: str
    tooltip: str
    where: str = EVERYWHERE

    @property
    def shown_key(self) -> str:
        """The first key as a person reads it; empty without one.

        Examples
        --------
        >>> Action("undo", ("Ctrl+z",), "Undo", "Take back the last step.").shown_key
        'Ctrl+Z'
        """
        return shown_key(self.keys[0]) if self.keys else ""

    @property
    def shown_keys(self) -> tuple[str, ...]:
        """All keys as a person reads them."""
        return tuple(shown_key(key) for key in self.keys)

    @property
    def hint(self) -> str:
        """Tooltip with the keys that do the same."""
        keys = " or ".join(self.shown_keys)
        return f"{self.tooltip} Key: {keys}" if keys else self.tooltip


_ARROWS = {"ArrowLeft": "←", "ArrowRight": "→", "ArrowUp": "↑", "ArrowDown": "↓", " ": "Space"}
_NAMES = _ARROWS | {"PageDown": "PgDn", "PageUp": "PgUp", "Escape": "Esc"}


def shown_key(key: str) -> str:
    """Return a key as a person reads it.

    Examples
    --------
    >>> shown_key("Shift+ArrowLeft"), shown_key("Ctrl+z"), shown_key("a")
    ('Shift+←', 'Ctrl+Z', 'A')
    """
    *held, last = key.split("+") if key != "+" else ["+"]
    capital = last.isupper() and not held  # the browser reports Shift and a letter as the capital
    name = _NAMES.get(last, last.upper() if len(last) == 1 else last)
    return "+".join([*held, *(["Shift"] if capital else []), name])


class ActionRegistry:
    """All actions by name and by key.

    Raises
    ------
    ValueError
        Two actions share a name, or a key in the same place; a menu or a tool may take a key that means something else
        elsewhere.
    """

    def __init__(self, actions: Iterable[Action]) -> None:
        self._actions: dict[str, Action] = {}
        self._by_key: dict[tuple[str, str], Action] = {}
        for action in actions:
            self._add(action)

    def _add(self, action: Action) -> None:
        if action.name in self._actions:
            raise ValueError(f"two actions are named {action.name!r}.")
        self._actions[action.name] = action
        for key in action.keys:
            other = self._by_key.get((action.where, key))
            if other is not None:
                raise ValueError(f"the key {key!r} means {other.name!r} already, so not {action.name!r}.")
            self._by_key[action.where, key] = action

    def __getitem__(self, name: str) -> Action:
        return self._actions[name]

    def __iter__(self) -> Iterator[Action]:
        return iter(self._actions.values())

    def __contains__(self, name: str) -> bool:
        return name in self._actions

    @property
    def keys(self) -> list[str]:
        """Every key that means something somewhere."""
        return sorted({key for _, key in self._by_key})

    def keys_alone(self, where: str) -> list[str]:
        """Every key that means something in a place, and nowhere else."""
        places: dict[str, set[str]] = {}
        for place, key in self._by_key:
            places.setdefault(key, set()).add(place)
        return sorted(key for key, found in places.items() if found == {where})

    def for_key(self, key: str, *places: str) -> Action | None:
        """Return what a key means at the first of `places` (menu, tool, tab), else everywhere; None: nothing."""
        found = (self._by_key.get((where, key)) for where in (*places, EVERYWHERE))
        return next((action for action in found if action is not None), None)

    def groups(self, titles: Sequence[tuple[str, str]]) -> list[tuple[str, list[Action]]]:
        """Return the actions with a key under their tabs' titles, in the order of `titles` (where, title)."""
        return [
            (title, [action for action in self._actions.values() if action.where == where and action.keys])
            for where, title in titles
        ]


REJECT_REASONS = ("cosmic ray", "blend", "hot pixel", "too faint", "wrong star", "detector edge", "other")
LANDMARK_REASONS = ("wrong place", "shadow", "surface has changed", "blurred", "other")
REASON_MENU, LANDMARK_MENU, NOTE_MENU = "reason menu", "landmark menu", "note"
# What a click, a drag or an arrow key in the picture then means.
NUDGE, CIRCLE, TWO_STARS, PLACE_STAR, BOX_SCANS = "nudge", "circle", "two_star", "place_star", "box_scans"
LIMB_POINTS, SUN, TERMINATOR = "limb_points", "sun", "terminator"
TABS = (
    ("stars", "Stars"),
    ("pointing", "Pointing"),
    ("bodies", "Bodies"),
    ("observables", "Observables"),
    ("landmarks", "Landmarks"),
)
# Headings of the list of keys, in its order.
PLACES = (
    (EVERYWHERE, "Everywhere"),
    *TABS,
    (REASON_MENU, "Reason for a rejection"),
    (LANDMARK_MENU, "Reason for a landmark's rejection"),
    (NUDGE, "While nudging"),
    (CIRCLE, "While a circle is set"),
    ("view", "Picture"),
)


def _everywhere() -> Iterator[Action]:
    yield Action("undo", ("Ctrl+z",), "Undo", "Take back the last step; a shape half drawn goes first.")
    yield Action("redo", ("Ctrl+y", "Ctrl+Shift+z"), "Redo", "Do again what was undone.")
    yield Action("next_image", ("PageDown",), "Next", "Go to the next image of the list.")
    yield Action("previous_image", ("PageUp",), "Previous", "Go to the image before.")
    for number, (name, title) in enumerate(TABS, 1):
        yield Action(f"tab_{name}", (str(number),), title, f"Show the step {title.lower()}.")
    yield Action("export", ("e",), "Export", "Write result, observables, decisions, session and figure.")
    yield Action("note", ("z",), "Note", "Write a note on this image into its journal.")
    yield Action("keys", ("?",), "Keys", "Show or hide this list.")
    yield Action("full", ("F",), "▣", "Give the picture the whole window, or share the window again.")
    yield Action("fold_panel", ("\\",), "◨", "Fold the panel on the right away, or bring it back.")
    yield Action("fold_list", ("|",), "☰", "Fold the list of images away, or bring it back.")
    yield Action(
        "filter", ("/",), "Filter", "Type words that images of the list shall have; Enter keeps them."
    )
    yield Action("window", ("W",), "Notebook", "Fill the browser's window, or stand in the notebook.")
    yield Action("escape", ("Escape",), "Cancel", "Close a menu, leave a tool, or cancel what is running.")


def _stars() -> Iterator[Action]:
    where = "stars"
    yield Action(
        "find_stars", ("f",), "Find stars", "Identify the field and fit every predicted star.", where
    )
    yield Action("accept", ("a",), "Accept", "Accept this star and go on to the next undecided one.", where)
    yield Action("reject", ("r", "x"), "Reject", "Reject this star; a digit then gives the reason.", where)
    yield Action("next", ("n", "ArrowRight"), "Next", "Go to the next star.", where)
    yield Action("previous", ("ArrowLeft",), "Previous", "Go to the star before.", where)
    yield Action("next_undecided", ("u", " "), "Next open", "Go to the next undecided star.", where)
    yield Action("accept_rest", ("A",), "Accept rest", "Accept all undecided stars that are in use.", where)
    yield Action("repoint", ("p",), "Repoint", "Solve the camera's attitude from the stars in use.", where)
    yield Action("place_star", ("i",), "Place star", "Then click in the picture where this star is.", where)
    yield Action("table", ("y",), "Table", "Show the stars as a table, or as boxes.", where)
    yield Action(
        "sort",
        ("k",),
        "Sort",
        "Put the stars in the next order: catalog, magnitude, SNR, O−C, status.",
        where,
    )
    yield Action("smaller_radius", ("[",), "−", "Search nearer to the expected place, and fit again.", where)
    yield Action(
        "larger_radius", ("]",), "+", "Search farther from the expected place, and fit again.", where
    )
    yield Action("template", ("t",), "Template", "Search with the other star template, and fit again.", where)
    yield Action("examine", (), "Examine each", "Repoint and export only once every star is decided.", where)


def _pointing() -> Iterator[Action]:
    where = "pointing"
    yield Action(
        "find_again", ("f",), "Find stars", "Identify the field from where it is predicted now.", where
    )
    yield Action(
        "repoint_here", ("p",), "Repoint", "Solve the camera's attitude from the stars in use.", where
    )
    yield Action("model", ("t",), "Model", "Three angles, or shift and twist in the image plane.", where)
    yield Action("two_star", ("w",), "Two stars", "Lost frame: click two stars in the picture.", where)
    yield Action(
        "search_sky",
        ("L",),
        "Lost in space",
        "Search the whole sky for these stars, whatever the pointing says.",
        where,
    )
    yield Action("nudge", ("j",), "Nudge", "Move the predicted field with the arrow keys.", where)


def _bodies() -> Iterator[Action]:
    where = "bodies"
    yield Action("find_body", ("f",), "Find", "Find this body's center with the chosen method.", where)
    yield Action("next_body", ("n",), "Next body", "Go to the next body.", where)
    yield Action("method", ("t",), "Method", "Take the next method.", where)
    yield Action(
        "solve_range",
        ("r",),
        "Range",
        "Solve for the range (the apparent size) too, where the method can.",
        where,
    )
    yield Action(
        "circle", ("k",), "Circle", "Click the center, then the limb; or drag from center to limb.", where
    )
    yield Action(
        "limb_points", ("i",), "Limb", "Click three places on the limb: the circle goes through them.", where
    )
    yield Action(
        "sun",
        ("a",),
        "Sun",
        "Of a body by hand: click on its Sun's side, or drag toward the Sun.",
        where,
    )
    yield Action(
        "terminator",
        ("p",),
        "Terminator",
        "Of a body by hand: click on its terminator, which tells the phase angle.",
        where,
    )
    yield Action("clear_circle", ("w",), "Clear", "Start from the predicted place and size again.", where)
    yield Action("next_scan", ("ArrowRight",), "Next scan", "Look at the next limb scan.", where)
    yield Action("previous_scan", ("ArrowLeft",), "Previous scan", "Look at the limb scan before.", where)
    yield Action("toggle_scan", ("d", " "), "Use", "Use this limb scan, or leave it out.", where)
    yield Action(
        "box_scans", ("m",), "Box", "Drag a box in the picture: the scans that cross it are used.", where
    )
    yield Action("automatic_scans", ("y",), "Automatic", "Back to the automatic choice of scans.", where)


def _landmarks() -> Iterator[Action]:
    where = "landmarks"
    yield Action(
        "find_landmarks", ("f",), "Find", "Find this body's landmarks, and the camera's pose.", where
    )
    yield Action("landmark_body", ("t",), "Next body", "Go to the next body.", where)
    yield Action(
        "accept_landmark", ("a",), "Accept", "Accept this landmark and go on to the next open one.", where
    )
    yield Action("reject_landmark", ("r", "x"), "Reject", "Reject it; a digit then gives the reason.", where)
    yield Action("next_landmark", ("n", "ArrowRight"), "Next", "Go to the next landmark.", where)
    yield Action("previous_landmark", ("ArrowLeft",), "Previous", "Go to the landmark before.", where)
    yield Action("next_open_landmark", ("u", " "), "Next open", "Go to the next undecided landmark.", where)
    yield Action(
        "sort_landmarks", ("k",), "Sort", "Order: as found, worst correlation, largest residual first.", where
    )


def _tools() -> Iterator[Action]:
    for number, reason in enumerate(REJECT_REASONS, 1):
        yield Action(f"reason_{number}", (str(number),), reason, f"Reject as: {reason}.", REASON_MENU)
    for number, reason in enumerate(LANDMARK_REASONS, 1):
        yield Action(
            f"landmark_reason_{number}", (str(number),), reason, f"Reject as: {reason}.", LANDMARK_MENU
        )
    sides = (("left", "ArrowLeft"), ("right", "ArrowRight"), ("up", "ArrowUp"), ("down", "ArrowDown"))
    for side, key in sides:
        yield Action(f"nudge_{side}", (key,), f"1 px {side}", f"Move the field 1 px {side}.", NUDGE)
        ten = f"Shift+{key}"
        yield Action(f"nudge_far_{side}", (ten,), f"10 px {side}", f"Move the field 10 px {side}.", NUDGE)
    yield Action("turn_left", ("<",), "Turn back", "Turn the field by -0.05 deg.", NUDGE)
    yield Action("turn_right", (">",), "Turn on", "Turn the field by +0.05 deg.", NUDGE)
    for side, key in sides:
        yield Action(f"circle_{side}", (key,), f"1 px {side}", f"Move the circle 1 px {side}.", CIRCLE)
        fine = f"Shift+{key}"
        yield Action(f"circle_fine_{side}", (fine,), f"0.1 px {side}", f"Move it 0.1 px {side}.", CIRCLE)
    yield Action("circle_larger", (">",), "Larger", "Make the radius 1 px larger.", CIRCLE)
    yield Action("circle_smaller", ("<",), "Smaller", "Make the radius 1 px smaller.", CIRCLE)


WORKBENCH_ACTIONS = (*_everywhere(), *_stars(), *_pointing(), *_bodies(), *_landmarks(), *_tools())


# What happens in the page alone: the room that its parts have.
ROOM = ("full", "fold_panel", "fold_list", "filter", "window")
# What only looks around, and so is done at once while a step is running; everything else waits in line.
LOOKING = frozenset(
    {
        *(f"tab_{name}" for name, _ in TABS),
        *(
            "keys",
            "escape",
            "note",
            "next",
            "previous",
            "next_undecided",
            "star",
            "examine",
            "reject",
            "table",
        ),
        *("sort", "sort_by"),
        *("next_body", "body", "method", "solve_range", "next_scan", "previous_scan", "look_scan"),
        *("landmark", "landmark_body", "next_landmark", "previous_landmark", "next_open_landmark"),
        *("sort_landmarks", "reject_landmark"),
        *("two_star", "nudge", "place_star", "circle", "limb_points", "sun", "terminator", "box_scans"),
        *("two_star_name", "older_entries"),
    }
)


# ---- The picture's own actions: each is carried out in the page.

PICTURE = "view"


def _cursor() -> Iterator[Action]:
    for side in ("left", "right", "up", "down"):
        key = f"Arrow{side.capitalize()}"
        yield Action(f"cursor_{side}", (f"Ctrl+{key}",), side, f"Move the cursor a pixel {side}.", PICTURE)
        ten = f"Ctrl+Shift+{key}"
        yield Action(f"cursor_far_{side}", (ten,), f"10 px {side}", f"Move it 10 px {side}.", PICTURE)
    yield Action(
        "press",
        ("Ctrl+Enter",),
        "Press",
        "Click where the cursor is; of a box or a line, begin or end it.",
        PICTURE,
    )


VIEW_ACTIONS = (
    Action("stretch", ("s",), "Stretch", "Take the next stretch: linear, asinh, log, sqrt.", PICTURE),
    Action("limits", ("S",), "Limits", "Take the next limits: zscale, min-max, percentiles.", PICTURE),
    Action("colormap", ("c",), "Colors", "Take the next colour map.", PICTURE),
    Action("invert", ("C",), "Invert", "Turn the colour map around.", PICTURE),
    Action("blink", ("b",), "Blink", "Show the other picture: model, difference or another image.", PICTURE),
    Action("blink_on", ("B",), "Auto-blink", "Blink by itself, or stop.", PICTURE),
    Action("home", ("h",), "Whole", "Show the whole picture.", PICTURE),
    Action("zoom_in", ("+", "="), "Zoom in", "Zoom in about the cursor.", PICTURE),
    Action("zoom_out", ("-",), "Zoom out", "Zoom out about the cursor.", PICTURE),
    Action(
        "overlays", ("o",), "Overlays", "Show or hide everything that is drawn over the picture.", PICTURE
    ),
    Action(
        "histogram", ("H",), "Histogram", "Show how often each value occurs; drag the limits in it.", PICTURE
    ),
    Action("cut", ("T",), "Line cut", "Plot the values along a line drawn in the picture.", PICTURE),
    Action("aperture", ("O",), "Aperture", "Measure sum, center and width of what is in a circle.", PICTURE),
    Action("measure", ("M",), "Distance", "Measure distance and position angle in the picture.", PICTURE),
    Action("crosshair", ("X",), "Crosshair", "Draw lines through the cursor, or none.", PICTURE),
    Action("beside", ("D",), "Side by side", "Show the other picture beside this one, or alone.", PICTURE),
    Action("wipe", ("Y",), "Wipe", "Draw the other picture over this one like a curtain.", PICTURE),
    Action("lock", ("K",), "Lock", "Lay the other image over this one by the sky, or by pixels.", PICTURE),
    Action("compass", ("N",), "Compass", "Show or hide where north, east and the Sun lie.", PICTURE),
    Action("grid", ("g",), "Grid", "Show or hide lines of right ascension and declination.", PICTURE),
    Action("masks", ("q",), "Masks", "Show or hide bad and saturated pixels.", PICTURE),
    Action("residuals", ("v",), "Residuals", "Show or hide the residual vectors.", PICTURE),
    Action(
        "longer",
        ("V",),
        "Longer",
        "Draw residual vectors ten times as long; beyond the longest begin short again.",
        PICTURE,
    ),
    Action("save_view", ("P",), "PNG", "Save the picture as it is shown, with its marks, as a PNG.", PICTURE),
    Action("magnitudes", ("l",), "Magnitudes", "Show or hide the stars' magnitudes.", PICTURE),
    *_cursor(),
)
