"""How a picture lies against what was expected: turned by a quarter, mirrored, or only far off.

A wrong a priori attitude is off by anything; a picture whose rows and columns are not those of the camera file is turned
by 90, 180 or 270 deg, or mirrored, and as near to its place as ever once that is taken out.  So a twist that is a quarter
turn to within the sigma of the a priori attitude speaks against the picture: its stars fit as well as any, and the
attitude of the camera's frame is wrong by the turn.  That is a contradiction.  Elsewhere the stars are right and the a
priori attitude was not, which is a message.
"""

from typing import TYPE_CHECKING

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import vector_from_rotation
from opnav_workbench.lazy_names import module_on_demand
from opnav_workbench.session.contradictions import ATTITUDE_SIGMAS
from opnav_workbench.stars.pointing import PointingSolution

if TYPE_CHECKING:
    from opnav_workbench.stars import lost_in_space
else:  # for the few pictures that are not where they were expected
    lost_in_space = module_on_demand("opnav_workbench.stars.lost_in_space")

__all__ = ["CAMERA_FILE", "MIRRORS", "far_words", "mirrored_words", "nearest_quarter_deg", "turned_words"]

CAMERA_FILE = "correct the axes in the camera file, or take the one that describes this picture (--mission)"
MIRRORS = {
    0: "along line",
    180: "along pixel",
    90: "with pixel and line exchanged",
    270: "with pixel and line exchanged",
}
QUARTER_TOLERANCE_DEG = 5.0  # an a priori twist is better than this where it is one


def nearest_quarter_deg(twist_rad: float, tolerance_deg: float = QUARTER_TOLERANCE_DEG) -> int | None:
    """Return the nearest quarter turn, 0 to 270 deg; None where none is near.

    Examples
    --------
    >>> nearest_quarter_deg(np.radians(-89.0)), nearest_quarter_deg(np.radians(359.0)), nearest_quarter_deg(1.0)
    (270, 0, None)
    """
    turn = float(np.degrees(twist_rad)) % 360.0
    nearest = round(turn / 90.0) * 90
    return nearest % 360 if abs(turn - nearest) <= tolerance_deg else None


# ---- A solved pointing against the a priori one.


def turned_words(camera: Camera, solution: PointingSolution, source: str) -> str:
    """Return by which quarter a picture is turned against its a priori attitude; empty where by none.

    Parameters
    ----------
    source
        Who told the a priori attitude.
    """
    twist_sigma_deg = camera.attitude_sigma.twist_deg
    quarter = nearest_quarter_deg(solution.delta_twist_rad, ATTITUDE_SIGMAS * twist_sigma_deg)
    if not quarter or not solution.twist_solved:
        return ""
    off_px = float(np.hypot(solution.delta_pixel, solution.delta_line))
    if off_px > ATTITUDE_SIGMAS * camera.attitude_sigma.cross_px + _moved_boresight_px(camera, quarter):
        return ""
    return (
        f"the picture is turned by {quarter} deg against the attitude of the {source}: the stars fit, but its rows and "
        f"columns are not the camera file's, or that attitude is off by as much; turn the picture, {CAMERA_FILE}, or, where "
        "the attitude is wrong, leave it out (--attitude none)"
    )


def _moved_boresight_px(camera: Camera, quarter_deg: int) -> float:
    """Return how far the boresight moves where a picture is turned about its own middle."""
    middle = 0.5 * (np.array([camera.n_pixel, camera.n_line]) - 1.0)
    lever_px = float(np.linalg.norm(camera.project(camera.boresight) - middle))
    return float(2.0 * np.sin(0.5 * np.radians(quarter_deg)) * lever_px)


def far_words(camera: Camera, a_priori: FloatArray, solution: PointingSolution, source: str) -> str:
    """Return how far a pointing is off its a priori attitude (camera from J2000); empty within five sigmas of both."""
    turn = vector_from_rotation(solution.camera_from_j2000 @ a_priori.T)
    covariance = camera.a_priori_covariance_rad2 + solution.covariance_rad2
    sigmas = float(np.sqrt(turn @ np.linalg.solve(covariance, turn)))
    if sigmas <= ATTITUDE_SIGMAS:
        return ""
    return (
        f"the picture lies ({solution.delta_pixel:+.0f}, {solution.delta_line:+.0f}) px and "
        f"{np.degrees(solution.delta_twist_rad):+.2f} deg off the attitude of the {source}: {sigmas:.0f} sigmas of the "
        "camera file's a priori attitude"
    )


# ---- A picture of the other hand.


def mirrored_words(camera: Camera, a_priori: FloatArray, mirrored: FloatArray) -> str:
    """Return along what a picture is mirrored, by the attitude it should have (camera from J2000)."""
    axes = lost_in_space.right_handed_axes(camera)
    between = axes @ mirrored @ a_priori.T @ axes.T
    twist = float(np.arctan2(between[1, 0] - between[0, 1], between[0, 0] + between[1, 1]))
    near = between[2, 2] > np.cos(max(10.0 * camera.half_diagonal_rad, np.radians(5.0)))
    quarter = nearest_quarter_deg(twist) if near else None
    return "(along line, or along pixel and turned by 180 deg)" if quarter is None else MIRRORS[quarter]
