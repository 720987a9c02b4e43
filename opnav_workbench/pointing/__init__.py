"""Camera attitude from the stars in a picture.

solve     `solve_pointing`: checks the input, calls the parts below, words the outcome
models    the two characterizations of an attitude step: Euler angles, and a shift and rotation of the picture
fit       iterated weighted least squares, the covariance
prior     the a priori attitude as a measurement: its twist, or all of it
wahba     closed forms (SVD, q-method) to start from
excess    is the scatter what the centers' covariances say? If not, how much is missing
robust    which stars are outliers
shift     what a change of attitude does to the picture
results   what comes out
table     the iterations as a table
"""

from opnav_workbench.pointing.inputs import Start
from opnav_workbench.pointing.models import Model
from opnav_workbench.pointing.results import Iteration, PointingSolution
from opnav_workbench.pointing.shift import attitude_shift
from opnav_workbench.pointing.solve import solve_pointing
from opnav_workbench.pointing.table import iteration_table
from opnav_workbench.pointing.wahba import wahba

__all__ = [
    "Iteration",
    "Model",
    "PointingSolution",
    "Start",
    "attitude_shift",
    "iteration_table",
    "solve_pointing",
    "wahba",
]
