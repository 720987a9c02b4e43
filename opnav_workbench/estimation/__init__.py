"""Estimation over many observables: what the pictures say of target and spacecraft, and where the flyby goes.

Its purpose is to close rehearsals and to show what pictures determine, not to replace an orbit determination program.

parameters     what is solved for, and what is known of it before
transition     how a correction at one epoch becomes one at another (two_body: unperturbed orbits)
measurements   residuals, Jacobian and covariance of many observables for any correction
batch          batch least squares with a priori knowledge; editing finds outliers
observability  what the pictures determine, in plain words
results        the estimate
bplane         B.T, B.R and time of flight; targeting maps an estimate there
triangulation  a position from directions to near stars; triangulation_pairs ranks the stars for it
"""

from opnav_workbench.estimation.batch import estimate, observability
from opnav_workbench.estimation.bplane import BPlane, b_plane, b_plane_partials
from opnav_workbench.estimation.observability import Direction
from opnav_workbench.estimation.parameters import Group
from opnav_workbench.estimation.results import Estimate, Residual
from opnav_workbench.estimation.targeting import BPlaneSolution, ErrorEllipse, error_ellipse, map_to_b_plane
from opnav_workbench.estimation.transition import Transition, kepler, straight_line
from opnav_workbench.estimation.triangulation import Triangulation, triangulate
from opnav_workbench.estimation.triangulation_pairs import best_pairs, nearest_stars
from opnav_workbench.estimation.triangulation_stars import StarPositions, star_positions
from opnav_workbench.estimation.two_body import propagate_two_body

__all__ = [
    "BPlane",
    "BPlaneSolution",
    "Direction",
    "ErrorEllipse",
    "Estimate",
    "Group",
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
