"""Estimation over many observables: what the pictures say of target and spacecraft, and where the flyby goes.

Its purpose is to close rehearsals and to show what pictures determine, not to replace an orbit determination program.
Enter by `estimate` (then `map_to_b_plane`), by `observability` for what pictures determine, and by `triangulate` for a
position from near stars.

``batch``
    `estimate`: batch least squares with a priori knowledge; outliers; the estimate and its residuals.
``parameters``
    What is solved for, and what is known of it before.
``measurements``
    Residuals, Jacobian and covariance of many observables for any correction.
``directions``
    Which directions among the parameters the pictures determine, in plain words.
``state_transition``
    How a correction at one epoch becomes one at another; unperturbed orbits.
``bplane``
    B.T, B.R and time of flight, and an estimate mapped there.
``triangulation``
    A position from directions to near stars.
``near_stars``
    Where near stars stand in space, and which pairs serve best.
"""

from opnav_workbench.estimation.batch import Estimate, Residual, estimate, observability
from opnav_workbench.estimation.bplane import (
    BPlane,
    BPlaneSolution,
    ErrorEllipse,
    b_plane,
    b_plane_partials,
    error_ellipse,
    map_to_b_plane,
)
from opnav_workbench.estimation.directions import ParameterDirection
from opnav_workbench.estimation.near_stars import StarPositions, best_pairs, nearest_stars, star_positions
from opnav_workbench.estimation.parameters import ParameterGroup
from opnav_workbench.estimation.state_transition import Transition, kepler, propagate_two_body, straight_line
from opnav_workbench.estimation.triangulation import Triangulation, triangulate

__all__ = [
    "BPlane",
    "BPlaneSolution",
    "ErrorEllipse",
    "Estimate",
    "ParameterDirection",
    "ParameterGroup",
    "Residual",
    "StarPositions",
    "Transition",
    "Triangulation",
    "b_plane",
    "b_plane_partials",
    "best_pairs",
    "error_ellipse",
    "estimate",
    "kepler",
    "map_to_b_plane",
    "nearest_stars",
    "observability",
    "propagate_two_body",
    "star_positions",
    "straight_line",
    "triangulate",
]
