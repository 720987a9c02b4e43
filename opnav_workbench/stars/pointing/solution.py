"""What a pointing solution holds: attitude, covariance, residuals, and its steps as the picture shows them.

Frame  attitudes are ``camera_from_j2000``; deltas of pixel, line and twist are second minus first

Arrays are read-only. `iteration_table` gives the steps as a table, such as the paper's Table 2 (AAS 13-443).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import pointing_angle_arrays

if TYPE_CHECKING:
    from astropy.table import QTable

__all__ = [
    "PictureShift",
    "PointingSolution",
    "attitude_shift",
    "iteration_table",
    "places_even_behind",
    "steps_between",
]


# ---- What a pointing solution holds; arrays are read-only.


@dataclass(frozen=True, slots=True)
class PictureShift:
    """A change of attitude as it shows in the picture (a row of the paper's Table 2).

    Attributes
    ----------
    delta_pixel, delta_line
        How far the sky at the a priori boresight moved on the detector, px.
    delta_twist_rad
        Change of the twist (position angle of increasing line at the boresight, east of north). Near a
        celestial pole most of it is the turn of north itself.
    """

    delta_pixel: float
    delta_line: float
    delta_twist_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class PointingSolution:
    """A camera attitude, its covariance, and how the stars agree with it.

    Attributes
    ----------
    camera_from_j2000 : (3, 3) array
        ``v_camera = camera_from_j2000 @ v_j2000``.
    covariance_rad2 : (3, 3) array
        Covariance of the small rotation vector eps about the camera frame's axes that remains:
        ``camera_from_j2000 (true) = rotation_from_vector(eps) @ camera_from_j2000 (solved)``.
    formal_covariance_rad2 : (3, 3) array
        The same from the given covariances alone, as if these were sure.
    ra_rad, dec_rad, twist_rad
        Boresight and position angle of increasing line, J2000, no aberration removed or added.
    delta_pixel, delta_line, delta_twist_rad
        Solved against a priori (see `PictureShift`): the sum of `iterations`.
    iterations
        The steps from the a priori attitude to the solved one.
    rms_px
        Root mean square of the residuals of the used stars, per coordinate.
    n_stars
        Number of stars used.
    used : (n,) array of bool
    reasons
        Why a star was not used, "" where it was; n entries.
    residual_px : (n, 2) array
        Observed minus predicted with the solved attitude; nan where there is no observation.
    excess_sigma_px
        Centering error (1 sigma, each coordinate) beyond the given covariances that must be expected after these
        residuals; with few stars it is never quite 0, because they cannot exclude it. One or two stars: 0 unless
        the covariances are improbable.
    chi2_reduced
        Chi-squared per degree of freedom with the given covariances, excess not included; nan without
        redundancy.
    model
        "euler" or "image_plane".
    twist_solved
        False where the rotation about the boresight rests on its a priori value.
    messages
        What the analyst should know.
    catalog_turns_rad : (n, 3, 2) array
        How far `eps` is turned by one sigma of each star's catalog errors, along two axes that are the same in every picture
        that shows the star (`attitude_fit.catalog_turns`); 0 for stars not used. Empty: nobody told, or not from stars.
    """

    camera_from_j2000: FloatArray
    covariance_rad2: FloatArray
    formal_covariance_rad2: FloatArray
    ra_rad: float
    dec_rad: float
    twist_rad: float
    delta_pixel: float
    delta_line: float
    delta_twist_rad: float
    iterations: tuple[PictureShift, ...]
    rms_px: float
    n_stars: int
    used: BoolArray
    reasons: tuple[str, ...]
    residual_px: FloatArray
    excess_sigma_px: float
    chi2_reduced: float
    model: str
    twist_solved: bool
    messages: tuple[str, ...]
    catalog_turns_rad: FloatArray = field(default_factory=lambda: np.zeros((0, 3, 2)))

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def rests_on(self) -> str:
        """Return in words what stars it rests on, and how well they fit."""
        if not self.n_stars:
            return "from the stars of other pictures"
        return f"{self.n_stars} star{'s' * (self.n_stars != 1)}, rms {self.rms_px:.3f} px"


# ---- What a change of attitude does to the picture: pixel, line and twist deltas.


def attitude_shift(camera: Camera, first: FloatArray, second: FloatArray) -> PictureShift:
    """Return how the picture moves when the attitude changes from `first` to `second`.

    Parameters
    ----------
    first, second : (3, 3) arrays
        ``camera_from_j2000``.

    Returns
    -------
    Iteration
        The sky at the first boresight moves by (delta_pixel, delta_line) on the detector, distortion
        included, see `places_even_behind`; delta_twist_rad is the second twist minus the first, in [-pi, pi).
    """
    return steps_between(camera, (first, second))[0]


def steps_between(camera: Camera, attitudes: Sequence[FloatArray]) -> tuple[PictureShift, ...]:
    """Return the steps along a sequence of attitudes; they sum up to the shift from first to last."""
    sky = attitudes[0].T @ camera.boresight
    twist = pointing_angle_arrays(np.stack(attitudes), camera.focal_from_camera)[2]
    place = places_even_behind(camera, np.stack([attitude @ sky for attitude in attitudes]))
    # Twist changes are all taken against the first attitude: their sum then needs no unwrapping.
    since_first = (twist - twist[0] + np.pi) % (2.0 * np.pi) - np.pi
    deltas = np.column_stack([np.diff(place, axis=0), np.diff(since_first)])
    return tuple(PictureShift(*map(float, row)) for row in deltas)


def places_even_behind(camera: Camera, directions: FloatArray) -> FloatArray:
    """Return where directions (n, 3) in the camera frame are seen (n, 2), px; out of sight, how far they are.

    No camera sees what is a right angle off its boresight, or behind it, but an attitude can be wrong by as much: the
    place is then the boresight's, moved toward the direction by the angle to it in pixels of the middle.
    """
    place = camera.project(directions)
    unseen = ~np.isfinite(place).all(axis=1)
    across, ahead = np.split(directions[unseen] @ camera.focal_from_camera.T, [2], axis=1)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    toward = np.where(length > 0.0, across / np.where(length > 0.0, length, 1.0), (1.0, 0.0))
    angle_px = np.arctan2(length, ahead) / camera.pixel_scale_rad
    place[unseen] = camera.project(camera.boresight[None])[0] + angle_px * toward
    return place


# ---- The steps of a pointing solution as a table, such as the paper's Table 2.


def iteration_table(solution: PointingSolution) -> "QTable":
    """Return one row an iteration, and their sum as the last row.

    Returns
    -------
    astropy.table.QTable
        iteration (1, 2, ... Total), delta_pixel and delta_line (pix), delta_twist (deg).

    Examples
    --------
    >>> table = iteration_table(solution)  # doctest: +SKIP
    >>> print(table)  # doctest: +SKIP
    iteration delta_pixel delta_line delta_twist
                  pix        pix         deg
    --------- ----------- ---------- -----------
            1     4.55319   12.27090 -1.0542e-02
            2    -0.00216    0.00310 -5.9722e-04
        Total     4.55103   12.27400 -1.1139e-02
    """
    total = PictureShift(solution.delta_pixel, solution.delta_line, solution.delta_twist_rad)
    steps = [*solution.iterations, total]
    from astropy import units as u  # noqa: PLC0415
    from astropy.table import QTable  # noqa: PLC0415 (a fifth of a short command; few need a table)

    table = QTable()
    table["iteration"] = [*(str(i + 1) for i in range(len(solution.iterations))), "Total"]
    table["delta_pixel"] = [step.delta_pixel for step in steps] * u.pix
    table["delta_line"] = [step.delta_line for step in steps] * u.pix
    table["delta_twist"] = np.degrees([step.delta_twist_rad for step in steps]) * u.deg
    for name, text, form in (
        ("iteration", "step of the least squares", ""),
        ("delta_pixel", "motion of the sky at the a priori boresight along pixel", ".5f"),
        ("delta_line", "the same along line", ".5f"),
        ("delta_twist", "change of the twist, solved minus a priori", ".4e"),
    ):
        table[name].info.description = text
        table[name].info.format = form
    return table
