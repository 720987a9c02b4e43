"""Estimation over many observables: what the pictures say of target and spacecraft, and where the flyby goes.

Its purpose is to close rehearsals and to show what pictures determine, not to replace an orbit determination program.
Enter by `estimate` (then `map_to_b_plane`), by `filter_estimate` where something changes from picture to picture or is only
considered, by `observability` for what pictures determine, and by `triangulate` for a position from near stars.

``batch``
    `estimate`: batch least squares with a priori knowledge; outliers; the estimate and its residuals.
``sequential``
    `filter_estimate`: square-root information filter and smoother, residuals on their way through it, data editing.
``stochastic``
    Accelerations, pointing and biases that change at random; constants of the model; what they leave in the state.
``body``
    A body from a sequence of pictures: size and axes, pole, spin, center of figure.
``square_root``
    Linear algebra of the square-root information filter and smoother.
``history``
    `b_plane_history`: the flyby as known after each picture.
``common_errors``
    `estimate_with_common_errors`: centers whose errors beyond noise are in part the same in all pictures, of a size
    that their scatter tells.
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
    RelativeState,
    b_plane,
    b_plane_partials,
    error_ellipse,
    map_to_b_plane,
)
from opnav_workbench.estimation.common_errors import CommonErrorEstimate, estimate_with_common_errors
from opnav_workbench.estimation.directions import ParameterDirection
from opnav_workbench.estimation.history import BPlaneCutoff, b_plane_history
from opnav_workbench.estimation.near_stars import StarPositions, best_pairs, nearest_stars, star_positions
from opnav_workbench.estimation.parameters import ParameterGroup
from opnav_workbench.estimation.sequential import (
    Edit,
    FilterEstimate,
    FilterResidual,
    FilterStep,
    filter_estimate,
)
from opnav_workbench.estimation.state_transition import Transition, kepler, propagate_two_body, straight_line
from opnav_workbench.estimation.stochastic import (
    Acceleration,
    CenterBias,
    ModelParameter,
    Pointing,
    focal_length,
    gravity,
)
from opnav_workbench.estimation.triangulation import Triangulation, triangulate

__all__ = [
    "Acceleration",
    "BPlane",
    "BPlaneCutoff",
    "BPlaneSolution",
    "CenterBias",
    "CommonErrorEstimate",
    "Edit",
    "ErrorEllipse",
    "Estimate",
    "FilterEstimate",
    "FilterResidual",
    "FilterStep",
    "ModelParameter",
    "ParameterDirection",
    "ParameterGroup",
    "Pointing",
    "RelativeState",
    "Residual",
    "StarPositions",
    "Transition",
    "Triangulation",
    "b_plane",
    "b_plane_history",
    "b_plane_partials",
    "best_pairs",
    "error_ellipse",
    "estimate",
    "estimate_with_common_errors",
    "filter_estimate",
    "focal_length",
    "gravity",
    "kepler",
    "map_to_b_plane",
    "nearest_stars",
    "observability",
    "propagate_two_body",
    "star_positions",
    "straight_line",
    "triangulate",
]
