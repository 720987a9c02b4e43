"""The layouts of the JSON files that the program writes: result, session, a night's status, observables, a body.

A file may hold more than its layout names: within a version fields may be added (`opnav_workbench.format_versions`).
Residuals are observed minus computed; null stands for what is not known.
"""

from collections.abc import Mapping
from dataclasses import fields
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, create_model, model_validator
from pydantic.config import JsonDict

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.results import BodyStatus
from opnav_workbench.landmarks.results import LandmarkStatus
from opnav_workbench.observables.columns import FIELDS
from opnav_workbench.session.inputs import AttitudeOrigin, AttitudeSource
from opnav_workbench.session.settings import Settings

__all__ = [
    "BodyFile",
    "ObservablesFile",
    "ResultFile",
    "SessionFile",
    "StatusFile",
    "has_negative_variance",
    "residual_off_px",
]

ROUNDING = 1e-6  # px, and of the trace of a covariance: what a file's digits may leave


class Layout(BaseModel):
    """Values of a file; fields that are not known are passed over."""

    model_config = ConfigDict(extra="allow", strict=True, allow_inf_nan=False, protected_namespaces=())


def has_negative_variance(covariance: FloatArray) -> bool:
    """Tell whether a finite matrix (n, n) has a negative variance along a direction, beyond its digits."""
    return bool(np.linalg.eigvalsh(covariance).min() < -_rounding(covariance))


def residual_off_px(residual: ArrayLike, observed: ArrayLike, computed: ArrayLike) -> float:
    """Return by how much a residual (2,) is not observed minus computed; 0 where it is, to the digits."""
    seen = np.asarray(observed)
    left = float(np.abs(np.asarray(residual) - (seen - np.asarray(computed))).max())
    return left if left > ROUNDING * max(1.0, float(np.abs(seen).max())) else 0.0


def _rounding(covariance: FloatArray) -> float:
    return ROUNDING * max(float(np.trace(covariance)), 0.0)


def _sound_covariance(matrix: list[list[float | None]]) -> list[list[float | None]]:
    values = np.array([[np.nan if v is None else v for v in row] for row in matrix], dtype=float)
    if np.isnan(values).any():
        return matrix
    if np.abs(values - values.T).max() > _rounding(values):
        raise ValueError("a covariance is symmetric")
    if has_negative_variance(values):
        raise ValueError("a covariance has no negative variance along any direction")
    return matrix


def _sound_scaled_covariance(matrix: list[list[float]]) -> list[list[float]]:
    """Check a covariance of quantities with units of their own: by its correlations."""
    values = np.array(matrix, dtype=float)
    variance = np.diag(values)
    if (variance < 0.0).any():
        raise ValueError("a covariance has no negative variance")
    sigma = np.sqrt(np.maximum(variance, 1e-300))
    _sound_covariance((values / np.outer(sigma, sigma)).tolist())
    return matrix


def _unit_quaternion(values: list[float]) -> list[float]:
    if abs(float(np.linalg.norm(values)) - 1.0) > ROUNDING:
        raise ValueError("the quaternion of a rotation has the length 1")
    return values


Number = float | None
Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]
Triple = Annotated[list[float], Field(min_length=3, max_length=3)]
Matrix2 = Annotated[list[Pair], Field(min_length=2, max_length=2)]
Covariance2 = Annotated[Matrix2, AfterValidator(_sound_covariance)]
Covariance3 = Annotated[list[Triple], Field(min_length=3, max_length=3), AfterValidator(_sound_covariance)]
Covariance6 = Annotated[
    list[Annotated[list[float], Field(min_length=6, max_length=6)]], Field(min_length=6, max_length=6)
]
Partials23 = Annotated[
    list[Annotated[list[Number], Field(min_length=3, max_length=3)]], Field(min_length=2, max_length=2)
]
Turns32 = Annotated[
    list[Annotated[list[Number], Field(min_length=2, max_length=2)]], Field(min_length=3, max_length=3)
]
Quaternion = Annotated[list[float], Field(min_length=4, max_length=4), AfterValidator(_unit_quaternion)]
Rotation = Annotated[list[Triple], Field(min_length=3, max_length=3)]
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
PictureStatus = Literal["ok", "partial", "failed"]
StarStatus = Literal["used", "rejected", "not_detected", "saturated", "off_detector", "blended"]


def _same_residual(residual: Any, observed: Any, predicted: Any) -> None:
    """Check that a residual is observed minus predicted, where all three are known."""
    known = [value for value in (residual, observed, predicted) if value is not None and None not in value]
    if len(known) == 3 and residual_off_px(*known):
        raise ValueError("residual is not observed minus predicted")


# ---- result.json


class Step(Layout):
    """One step of the pointing's solution."""

    delta_pixel: Number = Field(description="pixel; the steps' sum is the pointing's.")
    delta_line: Number = Field(description="line.")
    delta_twist_deg: Number = Field(description="deg.")


class Pointing(Layout):
    """The camera's attitude from stars."""

    ra_deg: float = Field(
        ge=0.0, le=360.0, description="Right ascension of the boresight, J2000, as in a CK; deg."
    )
    dec_deg: float = Field(ge=-90.0, le=90.0, description="Declination of the boresight; deg.")
    twist_deg: float = Field(
        ge=0.0,
        le=360.0,
        description="Position angle, east of J2000 north, of increasing line at the boresight; deg.",
    )
    quaternion_camera_from_j2000: Quaternion = Field(
        description="v_camera = R(q) v_j2000, SPICE style (m2q), scalar first."
    )
    covariance_rad2: Covariance3 = Field(
        description="Of a small rotation about the camera frame's axes, catalog errors included; rad^2."
    )
    delta_pixel: float = Field(
        description="Where the boresight's sky moved: observed minus a priori; pixels."
    )
    delta_line: float = Field(description="The same along line.")
    delta_twist_deg: float = Field(description="Solved minus a priori twist; deg.")
    iterations: list[Step] = Field(description="Steps of the solution.")
    rms_px: Number = Field(description="Root mean square of the used stars' residuals; pixels.")
    n_stars: int = Field(ge=0, description="Stars in use.")
    model: str = Field(description="euler or image_plane; carried: from other pictures' stars.")
    excess_sigma_px: Number = Field(description="Scatter beyond the stars' covariances; pixels.")
    chi2_reduced: Number = Field(description="Of the star residuals.")
    twist_solved: bool = Field(description="Whether the stars determine the twist.")


class Star(Layout):
    """A catalog star expected in the picture."""

    id: str = Field(description="Designation in its catalog; row:N (from 0) where it has none.")
    mag: Number = Field(description="Magnitude in the camera's band.")
    a_priori: Pair | None = Field(description="[pixel, line] computed with the a priori pointing.")
    predicted: Pair | None = Field(description="[pixel, line] computed with the solved pointing.")
    observed: Pair | None = Field(description="[pixel, line] measured; null without a center.")
    sigma_px: Pair | None = Field(description="1 sigma of the center along pixel and line.")
    residual_px: Pair | None = Field(description="Observed minus predicted.")
    snr: Number = Field(description="Fitted flux over its sigma.")
    status: StarStatus = Field(description="used, or why not.")
    reason: str = Field(description="Why, in words.")
    turn_by_catalog_rad: Turns32 | None = Field(
        default=None,
        description="Turn of the attitude about the camera frame's axes by one sigma of the star's catalog errors, "
        "along two axes that are the same in all pictures of the star; rad; null where it is not used.",
    )
    method: str | None = Field(description="Centerfinder.")

    @model_validator(mode="after")
    def _residual(self) -> "Star":
        _same_residual(self.residual_px, self.observed, self.predicted)
        return self


class Reading(Layout):
    """The same center read in another way."""

    method: str = Field(description="The other way.")
    observed: Pair = Field(description="[pixel, line].")
    covariance_px2: Covariance2 = Field(description="Of it; pixels^2.")
    difference_sigmas: Number = Field(description="How far it lies from the center; sigmas.")


class Body(Layout):
    """A body's center by one method."""

    name: str = Field(description="Target.")
    method: str = Field(description="Centerfinder.")
    a_priori: Pair | None = Field(description="[pixel, line] of the center of figure, a priori pointing.")
    predicted: Pair | None = Field(description="The same, solved pointing.")
    observed: Pair | None = Field(description="Measured center of figure; null without one.")
    residual_px: Pair | None = Field(description="Observed minus predicted.")
    covariance_px2: Covariance2 | None = Field(description="Of the observed center; pixels^2.")
    noise_covariance_px2: Covariance2 | None = Field(
        description="The part of the picture's noise in it; pixels^2."
    )
    covariance_with_pointing_px2: Covariance2 | None = Field(
        description="Of observed minus predicted: the pointing's share included; pixels^2."
    )
    joint_covariance_px2: dict[str, Matrix2] | None = Field(
        description="With the centers of bodies found jointly, by name; pixels^2."
    )
    diameter_px: Number = Field(description="Predicted; pixels.")
    measured_diameter_px: Number = Field(description="As the method measured it; pixels.")
    diameter_sigma_px: Number = Field(description="1 sigma of it.")
    range_km: Number = Field(description="Predicted distance from the spacecraft; km.")
    measured_range_km: Number = Field(description="From the measured size, the radius taken as known; km.")
    range_sigma_km: Number = Field(description="1 sigma of it.")
    brightness_scale: Number = Field(description="Measured over predicted brightness.")
    partials_px_per_km: Partials23 | None = Field(
        description="d(predicted pixel, line)/d(spacecraft position relative to the reference body, J2000); pixels/km."
    )
    ra_deg: Number = Field(
        description="Observed right ascension, J2000, astrometric: from the spacecraft at mid-exposure to where the body "
        "was one light time before, stellar aberration removed; deg."
    )
    dec_deg: Number = Field(description="Observed declination, astrometric; deg.")
    apparent_ra_deg: Number = Field(
        description="Observed right ascension, apparent: stellar aberration in it; deg."
    )
    apparent_dec_deg: Number = Field(description="Observed declination, apparent; deg.")
    residual_arcsec: Pair | None = Field(
        description="Observed minus computed (RA cos(Dec), Dec), astrometric; arcsec."
    )
    snr: Number = Field(description="Flux over its sigma.")
    chi2_reduced: Number = Field(description="Of the fit.")
    second_reading: Reading | None = Field(description="The same center read in another way.")
    scans_used: int | None = Field(description="Limb scans in use.")
    flags: str = Field(description="What is to be known of the center, in words.")
    status: BodyStatus = Field(description="ok, or why not.")
    messages: list[str] = Field(description="What the analyst must know.")

    @model_validator(mode="after")
    def _residual(self) -> "Body":
        _same_residual(self.residual_px, self.observed, self.predicted)
        return self


class Pose(Layout):
    """The camera's position and attitude, as landmarks have it."""

    position_km: Triple = Field(description="Of the spacecraft from the body's center, J2000; km.")
    position_body_km: Triple = Field(description="The same, body-fixed; km.")
    quaternion_camera_from_j2000: Quaternion = Field(
        description="v_camera = R(q) v_j2000, SPICE style (m2q), scalar first."
    )
    covariance: Covariance6 = Field(
        description="Of position (km, J2000) and a small rotation about the camera frame's axes (rad)."
    )
    position_shift_km: Triple = Field(description="Solved minus believed before, J2000; km.")
    attitude_shift_rad: Triple = Field(
        description="Rotation from the attitude believed before to the solved one, camera frame; rad."
    )
    rms_px: Number = Field(description="Root mean square of the accepted landmarks' residuals; pixels.")
    chi2_reduced: Number = Field(description="Of those residuals.")
    excess_sigma_px: Number = Field(description="Scatter beyond the landmarks' covariances; pixels.")
    n_landmarks: int = Field(ge=0, description="Landmarks in use.")


class Landmark(Layout):
    """A landmark that was looked for."""

    id: str = Field(description="Name among the body's maplets.")
    place_km: Triple = Field(description="Body-fixed; km.")
    predicted: Pair | None = Field(description="[pixel, line] computed with the attitude in use.")
    observed: Pair | None = Field(description="[pixel, line] measured; null without one.")
    residual_px: Pair | None = Field(description="Observed minus predicted.")
    covariance_px2: Covariance2 | None = Field(
        description="Of its own error, what all landmarks share not included; pixels^2."
    )
    correlation: Number = Field(description="Normalized, of picture and drawn maplet.")
    emission_deg: Number = Field(description="Of its plane; deg.")
    incidence_deg: Number = Field(description="Of its plane; deg.")
    sample_over_pixel: Number = Field(description="Size of a maplet's sample over that of a pixel.")
    partials_px_per_km: Partials23 | None = Field(
        description="d(predicted pixel, line)/d(spacecraft position relative to the body, J2000); pixels/km."
    )
    attitude_partials_px_per_rad: Partials23 | None = Field(
        description="With a small rotation of the attitude about the camera frame's axes; pixels/rad."
    )
    body_partials_px_per_rad: Partials23 | None = Field(
        description="With a small rotation of the body about its own axes; pixels/rad."
    )
    place_partials_px_per_km: Partials23 | None = Field(
        description="With the landmark's place, body-fixed; pixels/km."
    )
    status: LandmarkStatus = Field(description="accepted, or not.")
    reason: str = Field(description="Why not, or the analyst's words.")

    @model_validator(mode="after")
    def _residual(self) -> "Landmark":
        _same_residual(self.residual_px, self.observed, self.predicted)
        return self


class Landmarks(Layout):
    """Landmarks of one body."""

    body: str = Field(description="Body.")
    maplets: str = Field(description="What its maplets were made from.")
    common_covariance_px2: Covariance2 = Field(description="Of the error that all landmarks share; pixels^2.")
    laws: list[str] = Field(description="Scattering laws that maplets were drawn with.")
    law_share: Number = Field(description="Share of the second, as the picture has it.")
    position_sigma_km: Number = Field(
        default=None, description="1 sigma of the spacecraft's place, as the search was told; km."
    )
    start_km: Triple | None = Field(
        default=None,
        description="Of the body from the spacecraft, J2000, where the search began with its silhouette; km.",
    )
    not_searched: dict[str, int] = Field(
        description="Landmarks that this picture cannot show, counted by reason."
    )
    pose: Pose | None = Field(description="Null where too few agree.")
    messages: list[str] = Field(description="What the analyst must know.")
    points: list[Landmark] = Field(description="Those that were looked for.")


class Identification(Layout):
    """How the star field was found."""

    search: str = Field(description="Around the a priori place, wider, or over the whole sky.")
    confidence: float = Field(ge=0.0, le=1.0, description="Probability that it is the field.")
    sure: bool = Field(description="Whether that is enough.")
    shift_px: Pair | None = Field(description="Where the field was found, observed minus a priori; pixels.")
    twist_deg: Number = Field(description="The same in twist; deg.")


class KernelEntry(Layout):
    """A kernel that was loaded."""

    file: str = Field(description="Name.")
    sha256: Digest = Field(description="Of its bytes.")


THRESHOLDS: dict[str, Any] = {field.name: (field.type, field.default) for field in fields(Settings)}
SettingsEntry = create_model("Settings", __base__=Layout, __doc__=Settings.__doc__, **THRESHOLDS)


class Provenance(Layout):
    """By what the result came about."""

    version: str = Field(description="Of opnav_workbench.")
    kernels: list[KernelEntry] = Field(description="In the order of loading.")
    catalog: str = Field(default="", description="Spec of the star catalog.")
    catalog_found: str = Field(
        default="", description="What it was when opened: bundled with what the machine has beside it."
    )
    attitude_source: AttitudeOrigin | None = Field(
        default=None, description="What told the a priori attitude."
    )
    observer_source: str | None = Field(default=None, description="What told the spacecraft's state.")
    image_notes: list[str] = Field(default=[], description="What the reader said of the picture.")
    contradictions: list[str] = Field(
        default=[],
        description="Which facts of the header contradict each other, the kernels or the stars, or cannot be.",
    )
    settings: SettingsEntry | None = Field(  # type: ignore[valid-type]  # made of the dataclass
        default=None, description="Limits of searches and other thresholds."
    )
    decisions: list[dict[str, Any]] = Field(default=[], description="Verdicts of analysts on stars.")
    placed_stars: list[dict[str, Any]] = Field(default=[], description="Stars placed by hand.")
    described_bodies: list[dict[str, Any]] = Field(
        default=[], description="Bodies that analysts described in the picture."
    )
    circles: list[dict[str, Any]] = Field(default=[], description="Circles that start bodies.")
    limb_scans: list[dict[str, Any]] = Field(default=[], description="Limb scans chosen by hand.")
    landmark_decisions: list[dict[str, Any]] = Field(
        default=[], description="Verdicts of analysts on landmarks."
    )
    notes: list[str] = Field(default=[], description="Notes of analysts.")


Pixels = Annotated[list[int], Field(min_length=2, max_length=2)]


class ReadoutEntry(Layout):
    """What of the detector a picture shows: a window, in pixels of the detector, binned."""

    binning: Pixels = Field(description="Pixels of the detector in one, along pixel and line.")
    first: Pixels = Field(description="Pixel and line, counted from 0, at which the window begins.")
    size: Pixels | None = Field(description="Pixels and lines of the picture; null: to the end.")


SOLVED = ("sha256", "utc", "et", "exposure_s", "camera", "pointing", "stars", "bodies", "provenance")
UNLESS_FAILED: JsonDict = {
    "if": {"properties": {"status": {"const": "failed"}}},
    "else": {"required": list(SOLVED)},
}


class ResultFile(Layout):
    """What was found in one picture.

    A picture that could not be processed has name, mission, status ``failed`` and messages only.
    """

    model_config = ConfigDict(json_schema_extra=UNLESS_FAILED)

    format_version: Literal[1] = Field(description="Version of this layout.")
    image: str = Field(min_length=1, description="Name of the picture's file.")
    sha256: Digest | None = Field(default=None, description="Of the picture's file.")
    utc: str | None = Field(default=None, description="Middle of the exposure, UTC.")
    et: Number = Field(default=None, description="Middle of the exposure, TDB seconds past J2000.")
    exposure_s: Number = Field(default=None, description="Exposure time; s.")
    mission: str | None = Field(description="Mission.")
    camera: str | None = Field(default=None, description="Camera.")
    readout: ReadoutEntry | None = Field(
        default=None, description="Window and binning, where the camera has several."
    )
    status: PictureStatus = Field(
        description="ok: pointing in all three angles and every requested target in the field; partial: less; failed."
    )
    messages: list[str] = Field(description="What is missing or in doubt.")
    identification: Identification | None = Field(default=None, description="How the star field was found.")
    pointing: Pointing | None = Field(default=None, description="Null where it was not solved.")
    stars: list[Star] = Field(default=[], description="Stars expected in the picture.")
    bodies: list[Body] = Field(default=[], description="One entry a body and method.")
    landmarks: list[Landmarks] = Field(
        default=[], description="One entry a body whose landmarks were looked for."
    )
    stack: dict[str, Any] | None = Field(default=None, description="Of a stack: its pictures and weights.")
    provenance: Provenance | None = Field(default=None, description="By what it came about.")

    @model_validator(mode="before")
    @classmethod
    def _whole(cls, values: Any) -> Any:
        missing = [n for n in SOLVED if isinstance(values, Mapping) and n not in values]
        if missing and values.get("status") in ("ok", "partial"):
            raise ValueError(f"a picture with status {values['status']} has also {', '.join(missing)}")
        return values


# ---- session.json


class Entry(Layout):
    """One step of a session."""

    step: str = Field(description="Method of ImageSession.")
    parameters: dict[str, Any] = Field(description="Its arguments; taken again they give the same state.")
    reason: str = Field(default="", description="Why, in the analyst's words.")
    outcome: str = Field(default="", description="What came out, in one line.")
    time_utc: str = Field(default="", description="When.")


class ObserverState(Layout):
    """The spacecraft with respect to the solar-system barycenter, J2000."""

    position_km: Triple | None = Field(description="km.")
    velocity_km_s: Triple | None = Field(description="km/s.")
    source: str = Field(description="kernels, header or unknown.")
    velocity_sigma_km_s: Number = Field(
        default=None, description="1 sigma of each component of the velocity; km/s."
    )


class SessionInputs(Layout):
    """What kernels, header and catalog gave: with it a session is continued without them."""

    et: float = Field(description="Middle of the exposure, TDB seconds past J2000.")
    utc: str = Field(description="The same in UTC.")
    observer: ObserverState = Field(description="The spacecraft.")
    a_priori_camera_from_j2000: Rotation = Field(description="A priori attitude.")
    attitude_source: AttitudeOrigin = Field(description="What told it.")
    stars: dict[str, Any] = Field(description="Columns of the catalog's stars around the field.")
    catalog_found: str = Field(default="", description="Which catalogs they are from.")
    wide_stars: dict[str, Any] | None = Field(default=None, description="The same for wide searches.")
    targets: dict[str, dict[str, Any]] = Field(description="Bodies as the spacecraft sees them.")
    shapes: dict[str, Any] = Field(default={}, description="Shape models by target.")
    lost: dict[str, Any] | None = Field(
        default=None, description="Where the whole sky was searched: the finding."
    )


class SessionFile(Layout):
    """Everything needed to continue a session, except the picture itself."""

    format_version: Literal[1] = Field(description="Version of this layout.")
    version: str = Field(description="Of opnav_workbench.")
    session: str = Field(description="Its id.")
    image: str = Field(min_length=1, description="Path of the picture's file.")
    sha256: Digest = Field(description="Of the picture's file.")
    mission: str = Field(min_length=1, description="Name, or path of the mission file.")
    settings: SettingsEntry = Field(  # type: ignore[valid-type]  # made of the dataclass
        description="Limits of searches and other thresholds."
    )
    catalog: str = Field(description="Spec of the star catalog.")
    target_stars: str | None = Field(description="List of stars that are targets.")
    attitude: AttitudeSource = Field(description="Where the a priori attitude was to come from.")
    inputs: SessionInputs = Field(description="What kernels, header and catalog gave.")
    journal: list[Entry] = Field(description="Every step, in order.")


# ---- A night's status.json


class Counts(Layout):
    """Pictures of a night."""

    total: int = Field(ge=0, description="All.")
    to_process: int = Field(ge=0, description="That this night was to process.")
    processed: int = Field(ge=0, description="Processed so far.")
    left: int = Field(ge=0, description="Still to process.")
    failed: int = Field(ge=0, description="Failed so far.")
    by_status: dict[str, int] = Field(description="Count by status.")
    by_fault: dict[str, int] = Field(description="Count by fault of machine or program.")
    retries: int = Field(
        default=0, ge=0, description="Further tries after faults of the machine, of all pictures together."
    )


class StatusFile(Layout):
    """How a night goes."""

    format_version: Literal[1] = Field(description="Version of this layout.")
    version: str = Field(description="Of opnav_workbench.")
    state: Literal["running", "finished", "stopped", "failed"] = Field(description="Of the night.")
    running: Literal[0, 1] = Field(description="1 while it runs.")
    pid: int = Field(description="Of its process.")
    host: str = Field(description="Where it runs.")
    started_utc: str = Field(description="UTC.")
    updated_utc: str = Field(description="When this was written, UTC.")
    updated_s: float = Field(description="The same, Unix seconds.")
    pictures: Counts = Field(description="How many.")
    pictures_per_minute: float = Field(ge=0.0, description="Rate of this night.")
    ready_utc: str | None = Field(description="When it will be ready at this rate.")
    last: dict[str, Any] = Field(description="What became of the last picture.")
    disk_free_mb: int | None = Field(description="Space left for results.")


# ---- Observables as JSON


def _type_of(shape: tuple[int, ...], text: bool) -> Any:
    if text:
        return str
    inner: Any = Number
    for length in reversed(shape):
        inner = Annotated[list[inner], Field(min_length=length, max_length=length)]
    return inner | None


SPECIAL = {"messages": list[str], "center_cross_px2": dict[str, Matrix2]}
ObservableEntry = create_model(
    "ObservableEntry",
    __base__=Layout,
    __doc__="One body's observable.",
    **{
        field.name: (
            SPECIAL.get(field.name, _type_of(field.shape, field.unit is None)),
            Field(
                description=field.description
                + ("" if field.unit is None else f"; {field.unit or 'no unit'}.")
            ),
        )
        for field in FIELDS
    },
)  # type: ignore[call-overload]


class OriginEntry(Layout):
    """How observables came about."""

    mission: str = Field(description="Mission.")
    camera: str = Field(description="Camera.")
    version: str = Field(description="Of the program that made them.")
    catalog: str = Field(description="Spec of the star catalog.")
    kernels: list[KernelEntry] = Field(description="Kernels that were loaded.")
    images: list[str] = Field(default=[], description="Pictures; without: all of the file.")


class ObservablesFile(Layout):
    """Observables of many pictures."""

    format: Literal["opnav_workbench observables"] = Field(description="What this file is.")
    format_version: Literal[1] = Field(description="Version of this layout.")
    written_by: str = Field(description="Program and version.")
    conventions: dict[str, str] = Field(
        description="Time tag, directions, light time, aberration, frame, signs."
    )
    origins: list[OriginEntry] = Field(description="How they came about.")
    fields: dict[str, dict[str, Any]] = Field(description="Unit, shape and meaning of every field.")
    observables: list[ObservableEntry] = Field(description="One a body, method and picture.")  # type: ignore[valid-type]


# ---- BODY.json of a sequence


Row20 = Annotated[list[float], Field(min_length=20, max_length=20)]
Covariance20 = Annotated[
    list[Row20], Field(min_length=20, max_length=20), AfterValidator(_sound_scaled_covariance)
]
Sigma = Annotated[float, Field(gt=0.0)]
Sigmas2 = Annotated[list[Sigma], Field(min_length=2, max_length=2)]
Sigmas3 = Annotated[list[Sigma], Field(min_length=3, max_length=3)]
Sizes3 = Sigmas3
SHARED = (
    "position, velocity, radii (logarithms), pole, meridian, spin, center of figure, limb, map (logarithms)"
)


class BodyImage(Layout):
    """A picture's attitude, solved with the body."""

    image: str = Field(min_length=1, description="Name of the picture.")
    attitude_correction_rad: Triple = Field(
        description="Small rotation about the camera frame's axes, solved after before; rad."
    )
    attitude_covariance_rad2: Covariance3 = Field(description="Of it; rad^2.")


class BodyResidual(Layout):
    """What remains of an outline or of a landmark."""

    image: str = Field(min_length=1, description="Name of the picture.")
    kind: str = Field(min_length=1, description="outline, or the landmark's name.")
    residual_px: list[float] = Field(description="Observed minus computed; pixels.")
    sigmas: Annotated[float, Field(ge=0.0)] | None = Field(
        description="Its size, as the sigma of equal probability."
    )
    used: bool = Field(description="Whether it took part.")
    reason: str = Field(description="Why not.")


class LeftOut(Layout):
    """A picture that tells nothing of the body."""

    image: str = Field(min_length=1, description="Name of the picture.")
    reason: str = Field(min_length=1, description="Why.")


class MapGain(Layout):
    """A picture's brightness over that of the albedo map."""

    image: str = Field(min_length=1, description="Name of the picture.")
    gain: float = Field(description="Picture over map.")


class BodyMap(Layout):
    """The albedo map beside the file, in short."""

    lines: Annotated[int, Field(gt=0)] = Field(description="Of the map; it is twice as wide.")
    seen_share: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        description="Share of the surface that a picture shows."
    )
    absolute: bool = Field(description="Whether its values are albedos, else relative to their mean.")
    lunar_weight: Annotated[float, Field(ge=0.0, le=1.0)] | None = Field(
        description="Share of Lommel-Seeliger's law under which the pictures agree best; null: another law, the mission's."
    )
    darkest: float = Field(ge=0.0, description="Least value of the map.")
    brightest: float = Field(ge=0.0, description="Greatest value of the map.")
    gains: list[MapGain] = Field(description="Pictures that it rests on.")


class BodyFile(Layout):
    """A body's size, axes, pole, spin and center of figure, as a sequence of pictures tells them."""

    format_version: Literal[1] = Field(description="Version of this layout.")
    version: str = Field(description="Of opnav_workbench.")
    body: str = Field(min_length=1, description="SPICE name.")
    body_id: int = Field(description="SPICE id.")
    epoch_et: float = Field(description="Of state and prime meridian, TDB seconds past J2000.")
    radii_km: Sizes3 = Field(description="Semi-axes; km.")
    radii_sigma_km: Sigmas3 = Field(description="1 sigma of each; km.")
    a_priori_radii_km: Sizes3 = Field(description="As believed before; km.")
    pole_ra_deg: float = Field(description="Right ascension of the pole, J2000; deg.")
    pole_dec_deg: float = Field(ge=-90.0, le=90.0, description="Declination of the pole; deg.")
    pole_sigma_deg: Sigmas2 = Field(description="1 sigma toward east and north; deg.")
    prime_meridian_deg: Annotated[list[float], Field(min_length=2, max_length=2)] = Field(
        description="At J2000, and its rate, as in the PCK; deg, deg/day."
    )
    phase_sigma_deg: Sigma = Field(description="1 sigma of the rotation's phase at the epoch; deg.")
    spin_rate_rad_s: float = Field(description="rad/s.")
    spin_sigma_rad_s: Sigma = Field(description="1 sigma; rad/s.")
    center_of_figure_km: Triple = Field(description="From the center of mass, body-fixed; km.")
    center_of_figure_sigma_km: Sigmas3 = Field(description="1 sigma; km.")
    state_correction: Annotated[list[float], Field(min_length=6, max_length=6)] = Field(
        description="Of the body relative to the spacecraft, J2000, true minus believed; km, km/s."
    )
    covariance: Covariance20 = Field(description=f"Of what all pictures share: {SHARED}.")
    a_priori_covariance: Covariance20 = Field(description="The same before.")
    images: list[BodyImage] = Field(description="Pictures in use.")
    residuals: list[BodyResidual] = Field(description="What remains.")
    excess_px: float = Field(ge=0.0, description="Scatter of outlines beyond what they state; pixels.")
    chi2: float = Field(ge=0.0, description="Of measurements and a priori knowledge together.")
    degrees_of_freedom: int = Field(ge=0, description="Of chi2.")
    converged: bool = Field(description="Whether the steps came to an end.")
    observability: list[str] = Field(description="What the pictures tell and what they do not.")
    messages: list[str] = Field(description="What must be known of the whole.")
    left_out: list[LeftOut] = Field(description="Pictures that tell nothing.")
    albedo_map: BodyMap | None = Field(
        default=None, description="Of the surface; null: not asked for, or all pictures are small."
    )

    @model_validator(mode="after")
    def _agrees(self) -> "BodyFile":
        """Hold sigmas against the covariance that they are taken from."""
        of_radii = [
            self.covariance[k][k] ** 0.5 * size for k, size in zip(range(6, 9), self.radii_km, strict=True)
        ]
        if not np.allclose(of_radii, self.radii_sigma_km, rtol=1e-6):
            raise ValueError("radii_sigma_km is not that of the covariance")
        return self
