"""The picture's own actions, for the workbench's registry: each is carried out in the page (static/image_view.js)."""

from opnav_workbench.widgets.actions import Action

__all__ = ["VIEW_ACTIONS"]

WHERE = "view"

VIEW_ACTIONS = (
    Action("stretch", ("s",), "Stretch", "Take the next stretch: linear, asinh, log, sqrt.", WHERE),
    Action("limits", ("S",), "Limits", "Take the next limits: zscale, min-max, percentiles.", WHERE),
    Action("colormap", ("c",), "Colors", "Take the next colour map.", WHERE),
    Action("invert", ("C",), "Invert", "Turn the colour map around.", WHERE),
    Action("blink", ("b",), "Blink", "Show the other picture: model, difference or another image.", WHERE),
    Action("blink_on", ("B",), "Blink on", "Blink by itself, or stop.", WHERE),
    Action("home", ("h",), "Whole", "Show the whole picture.", WHERE),
    Action("zoom_in", ("+", "="), "Zoom in", "Zoom in about the cursor.", WHERE),
    Action("zoom_out", ("-",), "Zoom out", "Zoom out about the cursor.", WHERE),
    Action("overlays", ("o",), "Overlays", "Show or hide everything that is drawn over the picture.", WHERE),
    Action("grid", ("g",), "Grid", "Show or hide lines of right ascension and declination.", WHERE),
    Action("masks", ("q",), "Masks", "Show or hide bad and saturated pixels.", WHERE),
    Action("residuals", ("v",), "Residuals", "Show or hide the residual vectors.", WHERE),
    Action(
        "longer",
        ("V",),
        "Longer",
        "Draw residual vectors longer; beyond the longest begin short again.",
        WHERE,
    ),
    Action("magnitudes", ("l",), "Magnitudes", "Show or hide the stars' magnitudes.", WHERE),
)
