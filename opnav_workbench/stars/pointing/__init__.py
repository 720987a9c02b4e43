"""Camera attitude from the stars in a picture: `solve_pointing` checks the input, solves, and words the outcome.

``attitude_fit``
    Iterated weighted least squares, its covariance, and the a priori attitude as a measurement.
``attitude_steps``
    Two characterizations of an attitude step: Euler angles, and a shift and rotation of the picture.
``carried``
    An attitude carried from pictures with stars to one without.
``closed_form``
    Wahba's problem (SVD, q-method): an attitude to start from.
``motion_tails``
    Stars whose motion nobody measured: what each is worth beside the others.
``residuals``
    What the residuals tell: the excess over the centers' covariances, and outliers.
``solution``
    What comes out: `PointingSolution`, its steps, and what a change of attitude does to the picture.
``solver``
    `solve_pointing` itself.
"""

from opnav_workbench.stars.pointing.attitude_steps import PointingModel
from opnav_workbench.stars.pointing.carried import (
    AttitudeMotion,
    CarriedAttitude,
    SolvedAttitude,
    carry_attitude,
)
from opnav_workbench.stars.pointing.closed_form import wahba
from opnav_workbench.stars.pointing.motion_tails import MotionTails
from opnav_workbench.stars.pointing.solution import (
    PictureShift,
    PointingSolution,
    attitude_shift,
    iteration_table,
    places_even_behind,
)
from opnav_workbench.stars.pointing.solver import PointingStart, solve_pointing

__all__ = [
    "AttitudeMotion",
    "CarriedAttitude",
    "MotionTails",
    "PictureShift",
    "PointingModel",
    "PointingSolution",
    "PointingStart",
    "SolvedAttitude",
    "attitude_shift",
    "carry_attitude",
    "iteration_table",
    "places_even_behind",
    "solve_pointing",
    "wahba",
]
