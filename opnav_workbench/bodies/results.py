"""What the centerfinders say of a body: center, status, flags, and the details of each method; arrays are read-only.

`BodyCenter` is what every method returns, with or without a center, and `JointCenters` are several with their joint
covariance. Its `detail` is a `DiskReading` (method ``disk``), a `ModelFit`
(full-disk methods), a `LimbEllipse` (method ``ellipse``) or `LimbScans` (method ``limb_scan``).

Frame  (pixel, line) on the detector
Units  px, DN, km, rad
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntFlag
from functools import reduce
from operator import or_
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.geometry import Ellipse

__all__ = [
    "BODY_STATUSES",
    "DOUBTFUL_FLAGS",
    "NOT_CHOSEN",
    "REJECTED",
    "USED",
    "BodyCenter",
    "BodyFlag",
    "BodyResiduals",
    "BodyStatus",
    "DiskReading",
    "FreeEllipse",
    "JointCenters",
    "LimbEllipse",
    "LimbScans",
    "ModelFit",
    "SecondReading",
    "describe_body_flags",
    "flag_messages",
    "flags_where",
]


# ---- What a centerfinder says of a body; arrays are read-only.

BodyStatus = Literal["ok", "uncertain", "not_detected", "off_detector", "saturated", "failed"]
BODY_STATUSES: tuple[str, ...] = get_args(BodyStatus)


@dataclass(frozen=True, slots=True, eq=False)
class BodyResiduals:
    """The sub-array that a center was found in: data, model at the solution, and their difference.

    Attributes
    ----------
    window : (int, int, int, int)
        First pixel, first line, pixels, lines on the detector.
    data_dn, model_dn, difference_dn : (n_line, n_pixel) arrays
        Background removed from the data; difference is data minus model.
    mask : (n_line, n_pixel) array of bool
        True where a pixel was used.
    """

    window: tuple[int, int, int, int]
    data_dn: FloatArray
    model_dn: FloatArray
    difference_dn: FloatArray
    mask: BoolArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class BodyCenter:
    """A body's center of figure, measured with one method.

    Attributes
    ----------
    status
        One of `BODY_STATUSES`.
    pixel_line : (2,) array or None
        Center of figure (pixel, line); None where nothing was measured.
    covariance_px2 : (2, 2) array
        Of the center alone, pointing not included: noise, and what the residuals say beyond it; nan without a
        center.
    flux_dn, snr
        Total flux and its signal-to-noise ratio; nan without a center.
    diameter_px
        Measured diameter; nan where the method gives none.
    messages
        What the analyst must know, and why a status is not ``ok``.
    flags
        Sum of `BodyFlag`.
    noise_covariance_px2 : (2, 2) array or None
        From the noise of the pixels alone.
    chi2_reduced
        Weighted square of the residuals per degree of freedom.
    brightness_scale, brightness_scale_sigma
        Data over model.
    background_dn, background_sigma_dn
        What was left under the body.
    range_km, range_sigma_km
        Where the size was solved for.
    detail
        The method's own arrays.
    second
        Another reading of the same pixels; None where there is none.
    """

    name: str
    method: str
    status: str
    pixel_line: FloatArray | None
    covariance_px2: FloatArray
    flux_dn: float = np.nan
    snr: float = np.nan
    diameter_px: float = np.nan
    messages: tuple[str, ...] = ()
    flags: int = 0
    noise_covariance_px2: FloatArray | None = None
    chi2_reduced: float = np.nan
    diameter_sigma_px: float = np.nan
    brightness_scale: float = np.nan
    brightness_scale_sigma: float = np.nan
    background_dn: float = np.nan
    background_sigma_dn: float = np.nan
    range_km: float = np.nan
    range_sigma_km: float = np.nan
    pictures: BodyResiduals | None = None
    detail: object | None = None
    second: "SecondReading | None" = None

    def __post_init__(self) -> None:
        if self.status not in BODY_STATUSES:
            raise CenterfindingError(
                f"unknown status {self.status!r}; it is one of {', '.join(BODY_STATUSES)}."
            )
        freeze_arrays(self)

    @classmethod
    def without_center(
        cls, name: str, method: str, status: str, *messages: str, flags: int = 0
    ) -> "BodyCenter":
        """Return the answer of a method that found no center."""
        return cls(name, method, status, None, np.full((2, 2), np.nan), messages=messages, flags=flags)


@dataclass(frozen=True, slots=True, eq=False)
class JointCenters:
    """Centers of several bodies found together, and how they are correlated.

    Attributes
    ----------
    covariance_px2 : (2 n, 2 n) array
        In the order of the centers: pixel 0, line 0, pixel 1, ...; nan for a body without a center.
    """

    centers: tuple[BodyCenter, ...]
    covariance_px2: FloatArray

    def __post_init__(self) -> None:
        n = 2 * len(self.centers)
        if np.shape(self.covariance_px2) != (n, n):
            raise CenterfindingError(
                f"joint covariance of {len(self.centers)} centers has shape {np.shape(self.covariance_px2)}, "
                f"expected ({n}, {n})."
            )
        freeze_arrays(self)

    def center(self, name: str) -> BodyCenter:
        """Return the center of one body.

        Raises
        ------
        CenterfindingError
            No such body among them.
        """
        for center in self.centers:
            if center.name == name:
                return center
        raise CenterfindingError(
            f"no center of {name!r} among {', '.join(c.name for c in self.centers) or 'none'}."
        )

    @property
    def correlation(self) -> FloatArray:
        """Correlation coefficients (2 n, 2 n)."""
        sigma = np.sqrt(np.diag(self.covariance_px2))
        return np.asarray(self.covariance_px2 / np.outer(sigma, sigma))


# ---- One table of flags for everything that can befall a body's center.


class BodyFlag(IntFlag):
    """What is known against a body's center; bits add up, and OK is none of them.

    Examples
    --------
    >>> BodyFlag.CUT_BY_EDGE | BodyFlag.THIN_CRESCENT
    <BodyFlag.CUT_BY_EDGE|THIN_CRESCENT: 9>
    """

    OK = 0
    CUT_BY_EDGE = 1
    OVEREXPOSED = 2
    OCCULTED = 4
    THIN_CRESCENT = 8
    CIRCLE_MISFIT = 16
    POOR_FIT = 32
    AT_LIMIT = 64
    WEAK_GEOMETRY = 128
    EMPTY = 256
    BAD_PIXELS = 512
    HIT = 1024
    NOT_CONVERGED = 2048
    UNCONFIRMED = 8192
    ROUGH_LIMB = 16384


_MEANING = {
    BodyFlag.CUT_BY_EDGE: "part of it lies off the detector",
    BodyFlag.OVEREXPOSED: "saturated pixels were left out",
    BodyFlag.OCCULTED: "another body hides part of it",
    BodyFlag.THIN_CRESCENT: "its lit crescent is less than a pixel wide",
    BodyFlag.CIRCLE_MISFIT: "its image does not have the size that was expected",
    BodyFlag.POOR_FIT: "its image is not that of the model",
    BodyFlag.AT_LIMIT: "the center stopped at the limit of its search area",
    BodyFlag.WEAK_GEOMETRY: "one direction is hardly determined",
    BodyFlag.EMPTY: "too few usable pixels",
    BodyFlag.BAD_PIXELS: "bad pixels on it were left out",
    BodyFlag.HIT: "pixels with light that is not the body's (cosmic rays, stars) were left out",
    BodyFlag.NOT_CONVERGED: "the solution did not converge",
    BodyFlag.UNCONFIRMED: "a second reading of the picture does not confirm it",
    BodyFlag.ROUGH_LIMB: "its limb is not the model's",
}


def describe_body_flags(flags: int) -> str:
    """Return the meaning of a flag value in words, ``"ok"`` for none.

    Examples
    --------
    >>> describe_body_flags(9)
    'part of it lies off the detector; its lit crescent is less than a pixel wide'
    """
    return "; ".join(text for flag, text in _MEANING.items() if flags & flag) or "ok"


def flags_where(conditions: Mapping[BodyFlag, object]) -> BodyFlag:
    """Return all flags whose condition is true.

    Examples
    --------
    >>> flags_where({BodyFlag.HIT: True, BodyFlag.EMPTY: False})
    <BodyFlag.HIT: 1024>
    """
    return reduce(or_, (flag for flag, condition in conditions.items() if condition), BodyFlag.OK)


def flag_messages(flags: BodyFlag, notes: Mapping[BodyFlag, str]) -> list[str]:
    """Return one line for each flag that is set, its note with the numbers behind it in parentheses.

    Examples
    --------
    >>> flag_messages(BodyFlag.EMPTY | BodyFlag.HIT, {BodyFlag.EMPTY: "3 px"})[0]
    'too few usable pixels (3 px)'
    """
    notes = {flag: f" ({notes[flag]})" if notes.get(flag) else "" for flag in BodyFlag}
    return [describe_body_flags(flag) + notes[flag] for flag in BodyFlag if flag & flags]


# ---- What a limb scan keeps of every scan.

USED, NOT_CHOSEN, REJECTED = "used", "not_chosen", "rejected"


@dataclass(frozen=True, slots=True, eq=False)
class LimbScans:
    """n scans that radiate from a center, and what each of them says of it; the detail of a limb-scan center.

    Scan k leaves the center at ``360 k / n`` degrees from +pixel toward +line, whatever the picture shows, so that its
    number means the same in every run.

    Attributes
    ----------
    start_px : (2,) array
        Where the scans begin: the center (pixel, line) of the last iteration.
    angle_rad : (n,) array
        From +pixel toward +line.
    distance_px : (m,) array
        Of the points along every scan from its start, uniform.
    places_px : (n, m, 2) array
        The points (pixel, line).
    data_dn, model_dn : (n, m) arrays
        Brightness there: the picture less its background (nan without usable pixels), and the model at the mean
        brightness of the scans used.
    limb_px, edge_px : (n,) arrays
        Distance of the predicted limb, and of the outermost lit point: the limb itself or the terminator; nan where
        the scan meets no light.
    correlation : (n, k) array
        Of data with model at the last iteration, albedo and background taken out; nan where masked.
    lag_px : (k,) array
        Positive where the data lie farther out than the model.
    offset_px : (n,) array
        Of the data from the model along the scan: the maximum of its correlation, sub-sample; nan without one.
    sigma_px : (n,) array
        Its uncertainty from noise and albedo.
    motion : (n, 2) array
        Offset along the scan per px that the center moves along pixel and along line: the limb's normal over its cosine
        with the scan.
    brightness : (n,) array
        Data over model, near the limb.
    unevenness : (n,) array
        Relative scatter of the albedo along and beside the scan, inside of the limb, noise taken out; nan without one.
    residual_px : (n,) array
        Offset less what the solved center explains.
    status : (n,) array of str
        ``used``, ``not_chosen`` or ``rejected``.
    reason : (n,) array of str
        Why.
    roughness
        Relative scatter of the albedo across the limb that the data speak for.
    iterations : tuple of (float, float)
        Steps of the center (pixel, line).
    summary
        How the set of scans was chosen.
    """

    start_px: FloatArray
    angle_rad: FloatArray
    distance_px: FloatArray
    places_px: FloatArray
    data_dn: FloatArray
    model_dn: FloatArray
    limb_px: FloatArray
    edge_px: FloatArray
    correlation: FloatArray
    lag_px: FloatArray
    offset_px: FloatArray
    sigma_px: FloatArray
    motion: FloatArray
    brightness: FloatArray
    unevenness: FloatArray
    residual_px: FloatArray
    status: NDArray[np.str_]
    reason: NDArray[np.str_]
    roughness: float
    iterations: tuple[tuple[float, float], ...]
    summary: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.angle_rad)

    @property
    def used(self) -> NDArray[np.int64]:
        """Numbers of the scans that made the center."""
        return np.flatnonzero(self.status == USED)


# ---- What the likelihood of a disk hands over beside the center.


@dataclass(frozen=True, slots=True, eq=False)
class SecondReading:
    """The same center, read from the same pixels in another way.

    Attributes
    ----------
    method
        In words.
    pixel_line : (2,) array
    covariance_px2 : (2, 2) array
    difference_sigmas
        Mahalanobis length of the difference of both centers, as if their errors were independent.
    """

    method: str
    pixel_line: FloatArray
    covariance_px2: FloatArray
    difference_sigmas: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class DiskReading:
    """What a picture says of a disk beside its center.

    Attributes
    ----------
    outline_px : (m, 2) array
        At the solution, all around.
    size_ratio, size_ratio_sigma
        Of its image over that of its model.
    strain : (2,) array
        Relative change of the outline's radius as cos 2a and sin 2a, a from +pixel toward +line.
    law_shares : (2,) array
        What its light has beside the model's law: share of Lommel-Seeliger's in a mixture with Lambert's, power of mu0 mu.
    albedo_sigma, albedo_length_rad
        Relative scatter of the albedo along the limb, and the arc over which it is correlated.
    limb_roughness_px
        Scatter of the limb about the outline.
    steps_px : (n,) array
        Lengths of the center's steps.
    """

    outline_px: FloatArray
    size_ratio: float
    size_ratio_sigma: float
    strain: FloatArray
    law_shares: FloatArray
    albedo_sigma: float
    albedo_length_rad: float
    limb_roughness_px: float
    steps_px: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


# ---- What the fit of a limb's conic hands over beside the center.


@dataclass(frozen=True, slots=True, eq=False)
class FreeEllipse:
    """An ellipse of any center, size and orientation through the limb points, to check the body's model with.

    Attributes
    ----------
    ellipse, model
        Through the points, and the model's limb; px, distortion removed (pinhole camera of the same focal length).
    axes : (2, 2) array
        Rows: unit vectors (pixel, line) along the model's major and minor axis.
    ratio, ratio_sigma : (2,) arrays
        Radius of the free ellipse over the model's along these axes.
    residual_rms_px
        Of the points used.
    """

    ellipse: Ellipse
    model: Ellipse
    axes: FloatArray
    ratio: FloatArray
    ratio_sigma: FloatArray
    residual_rms_px: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class LimbEllipse:
    """Limb points of a body and what they were fitted with, in order along the limb.

    Attributes
    ----------
    angle_rad : (n,) array
        Of each limb point about the center, from +pixel toward +line.
    points_px : (n, 2) array
        Observed limb (pixel, line); nan where none was found.
    predicted_px : (n, 2) array
        The model's limb at the solution, on the same ray.
    residual_px, sigma_px : (n,) arrays
        Observed minus predicted along the ray, and its uncertainty from noise, albedo and roughness of the limb.
    brightness : (n,) array
        Data over model.
    status : (n,) array of str
        ``used``, ``not_chosen`` (no lit limb there) or ``rejected``.
    reason : (n,) array of str
        Why, in plain words.
    outline_px : (m, 2) array
        The model's limb at the solution, all around.
    rms_px
        Of the residuals used.
    rough_px
        Standard deviation of the limb about its model, as the data speak for it.
    lit_arc_rad
        Angle about the center that the points used cover.
    km_per_px
        At the body's center.
    free
        None where the points do not determine one, and for shape models.
    iterations : tuple of (float, float)
        Steps of the center, px.
    """

    angle_rad: FloatArray
    points_px: FloatArray
    predicted_px: FloatArray
    residual_px: FloatArray
    sigma_px: FloatArray
    brightness: FloatArray
    status: NDArray[np.str_]
    reason: NDArray[np.str_]
    outline_px: FloatArray
    rms_px: float
    rough_px: float
    lit_arc_rad: float
    km_per_px: float
    free: FreeEllipse | None
    iterations: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.angle_rad)


# ---- Verdict over a body's center: flags, status, and what the analyst must know.
DOUBTFUL_FLAGS = (
    BodyFlag.THIN_CRESCENT
    | BodyFlag.CIRCLE_MISFIT
    | BodyFlag.POOR_FIT
    | BodyFlag.AT_LIMIT
    | BodyFlag.WEAK_GEOMETRY
    | BodyFlag.EMPTY
    | BodyFlag.NOT_CONVERGED
    | BodyFlag.UNCONFIRMED
)


# ---- From a fit of rendered bodies to their centers: covariance with what the residuals say, flags, pictures.


@dataclass(frozen=True, slots=True, eq=False)
class ModelFit:
    """How a model was fitted to the data.

    Attributes
    ----------
    values : (p,) array
    covariance : (p, p) array
        From the noise of the pixels.
    iterations : tuple of (float, float)
        Steps of the center, px.
    residual_sigma : (n_line, n_pixel) array
        Data minus model in units of the noise; 0 where a pixel was not used.
    hits : (n_line, n_pixel) array of bool
        Left out as cosmic rays or stars.
    pattern_sigma, pattern_length_px
        Contrast and correlation length of what the model lacks on the body; 0 where nothing.
    """

    parameters: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    iterations: tuple[tuple[float, float], ...]
    residual_sigma: FloatArray
    hits: BoolArray
    pattern_sigma: float
    pattern_length_px: float

    def __post_init__(self) -> None:
        freeze_arrays(self)
