"""How stars are searched: radius and template, changed on the spot."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from opnav_workbench.errors import SessionError

__all__ = ["TEMPLATES", "StarSearch"]

# Star template of the search: a well-exposed star of the picture, the star under decision, or the camera's Gaussian.
TEMPLATES = ("a bright star", "this star", "Gaussian")
RADIUS_STEP = 1.5  # factor of one key press
MIN_RADIUS_PX, MAX_RADIUS_PX = 1.0, 80.0


@dataclass(slots=True)
class StarSearch:
    """What the analyst chose.

    Attributes
    ----------
    template : str
        One of `TEMPLATES`.
    template_star : str or None
        Catalog id of the star that is the template.
    radius_px : float or None
        None: as the settings say.
    """

    template: str = TEMPLATES[0]
    template_star: str | None = None
    radius_px: float | None = None

    @property
    def initial(self) -> str:
        """Method of the first search."""
        return "cross_correlation" if self.template == "Gaussian" else "matched_filter"

    def next_template(self, star: str) -> str:
        """Take the next template; return what to say.  `star` is the one under decision.

        Examples
        --------
        >>> search = StarSearch()
        >>> search.next_template("HIP 1"), search.next_template("HIP 1"), search.initial
        ('template: HIP 1', 'template: Gaussian', 'cross_correlation')
        """
        self.template = TEMPLATES[(TEMPLATES.index(self.template) + 1) % len(TEMPLATES)]
        self.template_star = star if self.template == "this star" else None
        return f"template: {self.template_star or self.template}"

    def set_radius(self, radius_px: float) -> str:
        """Take another radius, within the limits; return what to say."""
        self.radius_px = round(float(np.clip(radius_px, MIN_RADIUS_PX, MAX_RADIUS_PX)), 2)
        return f"search radius {self.radius_px:g} px"

    def step_radius(self, present_px: float, steps: int) -> str:
        """Take a radius some key presses larger (or smaller) than the present one."""
        return self.set_radius(present_px * RADIUS_STEP**steps)

    def type_radius(self, typed: str) -> str:
        """Take a radius typed by the analyst.

        Raises
        ------
        SessionError
            It is no number.
        """
        try:
            radius = float(typed)
        except ValueError:
            radius = float("nan")
        if not np.isfinite(radius):
            raise SessionError(f"the search radius is a number of pixels, not {typed!r}.")
        return self.set_radius(radius)

    def refit_options(self, present_px: float) -> dict[str, Any]:
        """Return the arguments of `ImageSession.refit_stars`."""
        return {"initial": self.initial, "search_radius_px": present_px, "template": self.template_star}
