"""What a change of attitude does to the picture: pixel, line and twist deltas.

Frame  attitudes are ``camera_from_j2000``; deltas are second minus first
"""

from collections.abc import Sequence

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.errors import PointingError
from opnav_workbench.geometry import pointing_angles
from opnav_workbench.pointing.results import Iteration

__all__ = ["attitude_shift", "steps_between"]


def attitude_shift(camera: Camera, first: FloatArray, second: FloatArray) -> Iteration:
    """Return how the picture moves when the attitude changes from `first` to `second`.

    Parameters
    ----------
    camera : Camera
    first, second : (3, 3) arrays
        ``camera_from_j2000``.

    Returns
    -------
    Iteration
        The sky at the first boresight moves by (delta_pixel, delta_line) on the detector, distortion
        included; delta_twist_rad is the second twist minus the first, in [-pi, pi).

    Raises
    ------
    PointingError
        The first boresight is out of the camera's sight in the second attitude.
    """
    return steps_between(camera, (first, second))[0]


def steps_between(camera: Camera, attitudes: Sequence[FloatArray]) -> tuple[Iteration, ...]:
    """Return the steps along a sequence of attitudes; they sum up to the shift from first to last."""
    sky = attitudes[0].T @ camera.boresight
    twist = [pointing_angles(attitude, camera.focal_from_camera)[2] for attitude in attitudes]
    place = camera.project(np.stack([attitude @ sky for attitude in attitudes]))
    if not np.all(np.isfinite(place)):
        raise PointingError(
            "the attitudes differ so much that the boresight of one is out of the other's sight; "
            "give an a priori attitude within the field of view"
        )
    # Twist changes are all taken against the first attitude: their sum then needs no unwrapping.
    since_first = (np.array(twist) - twist[0] + np.pi) % (2.0 * np.pi) - np.pi
    deltas = np.column_stack([np.diff(place, axis=0), np.diff(since_first)])
    return tuple(Iteration(*map(float, row)) for row in deltas)
