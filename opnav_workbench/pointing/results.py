"""What a pointing solution holds; arrays are read-only."""

from dataclasses import dataclass

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays

__all__ = ["Iteration", "PointingSolution"]


@dataclass(frozen=True, slots=True)
class Iteration:
    """A change of attitude as it shows in the picture (a row of the paper's Table 2).

    Attributes
    ----------
    delta_pixel, delta_line : float
        How far the sky at the a priori boresight moved on the detector, px.
    delta_twist_rad : float
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
    ra_rad, dec_rad, twist_rad : float
        Boresight and position angle of increasing line, J2000, no aberration removed or added.
    delta_pixel, delta_line, delta_twist_rad : float
        Solved against a priori (see `Iteration`): the sum of `iterations`.
    iterations : tuple of Iteration
        The steps from the a priori attitude to the solved one.
    rms_px : float
        Root mean square of the residuals of the used stars, per coordinate.
    n_stars : int
        Number of stars used.
    used : (n,) array of bool
    reasons : tuple of str
        Why a star was not used, "" where it was; n entries.
    residual_px : (n, 2) array
        Observed minus predicted with the solved attitude; nan where there is no observation.
    excess_sigma_px : float
        Centering error (1 sigma, each coordinate) beyond the given covariances that must be expected after these
        residuals; with few stars it is never quite 0, because they cannot exclude it. One or two stars: 0 unless
        the covariances are improbable.
    chi2_reduced : float
        Chi-squared per degree of freedom with the given covariances, excess not included; nan without
        redundancy.
    model : str
        "euler" or "image_plane".
    twist_solved : bool
        False where the rotation about the boresight rests on its a priori value.
    messages : tuple of str
        What the analyst should know.
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
    iterations: tuple[Iteration, ...]
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

    def __post_init__(self) -> None:
        freeze_arrays(self)
