"""Camera attitude from the stars in a picture.

solve     `solve_pointing`: checks the input, calls the parts below, words the outcome
models    the two characterizations of an attitude step: Euler angles, and a shift and rotation of the picture
fit       iterated weighted least squares, the twist's a priori, the covariance
excess    is the scatter what the centers' covariances say? If not, how much is missing
robust    which stars are outliers
shift     what a change of attitude does to the picture
results   what comes out
"""

from opnav_workbench.pointing.models import Model
from opnav_workbench.pointing.results import Iteration, PointingSolution
from opnav_workbench.pointing.shift import attitude_shift
from opnav_workbench.pointing.solve import solve_pointing

__all__ = ["Iteration", "Model", "PointingSolution", "attitude_shift", "solve_pointing"]
