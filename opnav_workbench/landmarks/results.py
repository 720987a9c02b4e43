"""What finding landmarks gives: measured centers, what became of each, and the camera's pose that they agree on.

Frame  J2000; attitudes and their errors in the camera's frame
Units  px, km, rad
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.landmarks.prediction import LandmarkPartials

__all__ = ["LANDMARK_STATUSES", "LandmarkCenters", "LandmarkSolution", "LandmarkStatus", "PoseSolution"]

LandmarkStatus = Literal["accepted", "rejected", "not_found"]
LANDMARK_STATUSES: tuple[LandmarkStatus, ...] = get_args(LandmarkStatus)


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkCenters:
    """Centers of n landmarks that were looked for; arrays are read-only.

    Attributes
    ----------
    body, source
        Body and maplets.
    place_km, place_covariance_km2 : (n, 3), (n, 3, 3) arrays
        Body-fixed, with what the maplets say of them.
    predicted_px : (n, 2) array
        (pixel, line) with the state and attitude that were believed before.
    observed_px : (n, 2) array
        Measured; nan where none was.
    covariance_px2 : (n, 2, 2) array
        Each landmark's own error: the picture's noise, and what the drawn maplet lacks.
    common_covariance_px2 : (2, 2) array
        Error that all landmarks share, beside that.
    correlation : (n,) array
        Normalized, of picture and fitted template; nan where there is none.
    gain : (n,) array
        Picture over template: brightness of the patch over the mean of all.
    emission_deg, incidence_deg, ratio : (n,) arrays
        See `opnav_workbench.landmarks.LandmarkPrediction`.
    failure : (n,) array of str
        Why none was measured; empty where one was.
    partials
        At the prediction.
    not_searched : mapping of str to int
        Landmarks that cannot be seen in this picture, counted by reason.
    window_px
        Side of the patches that were compared.
    laws, law_share
        Scattering laws of the templates, and the share of the second.
    position_sigma_km
        1 sigma of each axis of the spacecraft's place, as the search was told; None: the target's own covariance.
    start_km : (3,) array or None
        Of the body from the spacecraft, J2000, where the search began with its silhouette; None: where the target has it.
    """

    body: str
    source: str
    id: NDArray[np.str_]
    place_km: FloatArray
    place_covariance_km2: FloatArray
    predicted_px: FloatArray
    observed_px: FloatArray
    covariance_px2: FloatArray
    common_covariance_px2: FloatArray
    correlation: FloatArray
    gain: FloatArray
    emission_deg: FloatArray
    incidence_deg: FloatArray
    ratio: FloatArray
    failure: NDArray[np.str_]
    partials: LandmarkPartials
    not_searched: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    window_px: float = 0.0
    laws: tuple[str, str] = ("", "")
    law_share: float = 0.0
    position_sigma_km: float | None = None
    start_km: FloatArray | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.id)

    @property
    def residual_px(self) -> FloatArray:
        """Observed minus predicted (n, 2)."""
        return np.asarray(self.observed_px - self.predicted_px)

    @property
    def measured(self) -> BoolArray:
        """Which have a center (n,)."""
        return np.asarray(self.failure == "")


@dataclass(frozen=True, slots=True, eq=False)
class PoseSolution:
    """Where the camera stood and how it was turned, as landmarks have it; arrays are read-only.

    Attributes
    ----------
    position_km : (3,) array
        Of the spacecraft from the body's center, J2000: minus the target's position.
    position_body_km : (3,) array
        The same, body-fixed.
    camera_from_j2000 : (3, 3) array
    covariance : (6, 6) array
        Of the position, km, and the attitude: small rotation about the camera frame's axes, rad.
    position_shift_km, attitude_shift_rad : (3,) arrays
        Solved minus believed before: position in J2000, attitude as a rotation vector in the camera's frame.
    rms_px
        Of the residuals of accepted landmarks, each coordinate.
    chi2_reduced
        With the stated covariances; the excess not included.
    excess_sigma_px
        Scatter of each coordinate beyond what is stated; included in the covariance.
    n_landmarks
        Accepted ones.
    attitude_held
        Whether stars' (or other) knowledge of the attitude took part.
    post_fit_px : (n, 2) array
        Residuals of all landmarks with this pose; nan where not measured.
    """

    position_km: FloatArray
    position_body_km: FloatArray
    camera_from_j2000: FloatArray
    covariance: FloatArray
    position_shift_km: FloatArray
    attitude_shift_rad: FloatArray
    rms_px: float
    chi2_reduced: float
    excess_sigma_px: float
    n_landmarks: int
    attitude_held: bool
    post_fit_px: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def position_covariance_km2(self) -> FloatArray:
        """Covariance (3, 3) of the position, J2000."""
        return self.covariance[:3, :3]

    @property
    def attitude_covariance_rad2(self) -> FloatArray:
        """Covariance (3, 3) of the attitude, about the camera frame's axes."""
        return self.covariance[3:, 3:]


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkSolution:
    """Landmarks of one body in one picture, judged.

    Attributes
    ----------
    centers
        What was measured.
    status : (n,) tuple of {"accepted", "rejected", "not_found"}
    reason : (n,) tuple of str
        Why one is not accepted, or the analyst's words.
    pose
        None where too few landmarks agree.
    messages
        What must be known of the whole.
    """

    centers: LandmarkCenters
    status: tuple[LandmarkStatus, ...]
    reason: tuple[str, ...]
    pose: PoseSolution | None
    messages: tuple[str, ...] = ()

    @property
    def accepted(self) -> BoolArray:
        """Which are accepted (n,)."""
        return np.array([status == "accepted" for status in self.status], dtype=bool)

    @property
    def covariance_px2(self) -> FloatArray:
        """Each landmark's covariance (n, 2, 2), widened by the scatter that the pose found beyond it."""
        excess = 0.0 if self.pose is None else self.pose.excess_sigma_px
        return np.asarray(self.centers.covariance_px2 + excess**2 * np.eye(2))
