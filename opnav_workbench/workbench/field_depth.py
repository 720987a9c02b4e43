"""How deep the catalog of a field is against what the picture shows, and the command that fetches what is missing."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.geometry import radec_from_unit
from opnav_workbench.session import ImageSession
from opnav_workbench.session.context import faintest_magnitude
from opnav_workbench.workbench.overlays import expected_attitude

__all__ = ["FieldDepth", "field_depth"]

DEEP_CATALOG = "gaia-dr3"  # complete far below what any navigation camera shows, fetched by the cone
MARGIN_MAG = 0.75  # a catalog that ends so little above the picture's faintest stars lacks few of them
STARS_ENOUGH = 10  # in a solution: more of them would tell little more
MOST_MAG = 20.0  # of what is fetched: the deep catalog ends there
WIDER = 1.3  # than the field: a pointing error of a third of it still finds its stars


@dataclass(frozen=True, slots=True)
class FieldDepth:
    """What is known of a field's depth.

    Attributes
    ----------
    line
        In words.
    catalog, command
        What has the missing stars, and what fetches them; empty where none is missing.
    """

    line: str
    catalog: str = ""
    command: str = ""


def field_depth(session: ImageSession) -> FieldDepth:
    """Return how deep the catalog is against the picture."""
    spec, stars = session.source.catalog, session.inputs.stars
    known = float(np.max(stars.mag)) if len(stars) else -np.inf
    shown = faintest_magnitude(session.context)
    here = f"catalog {spec}: {len(stars)} stars around the field" + (
        f", to {known:.1f} mag" if len(stars) else ""
    )
    if not np.isfinite(shown):
        return FieldDepth(f"{here}; how faint the picture goes is not known (no zero point)")
    line = f"{here}; the picture shows stars to about {shown:.1f} mag"
    solved = session.state.pointing
    if solved is not None and solved.n_stars >= STARS_ENOUGH:
        return FieldDepth(line)
    if known + MARGIN_MAG >= min(shown, session.context.settings.mag_limit, MOST_MAG):
        return FieldDepth(line)
    return FieldDepth(line, DEEP_CATALOG, _command(session, min(shown, MOST_MAG)))


def _command(session: ImageSession, mag: float) -> str:
    camera = session.context.camera
    ra, dec = np.degrees(radec_from_unit((camera.boresight @ expected_attitude(session))[None]))
    radius, limit = np.degrees(WIDER * camera.half_diagonal_rad), np.ceil(2.0 * mag) / 2.0
    return f"opnav catalog fetch {DEEP_CATALOG} --cone {ra[0]:.3f} {dec[0]:.3f} {radius:.3f} --mag {limit:g}"
