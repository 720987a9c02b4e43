"""What a header says against the loaded kernels: time against the clock, position against the trajectory, attitude.

Flow    header and kernels -> `settled_time` -> et, and lines that make the picture ``partial``

What a header says against itself stands in `opnav_workbench.image.contradictions`. A tolerance is what the facts that are
compared can know:

Clock       a reading anywhere in the exposure, one count of its last field, the clock's drift beyond the kernel's last
            record, the time's printed digits, and a second between command, shutter and telemetry: labels of twelve missions
            (New Horizons to Voyager) stay within it, those of Galileo by 0.6 s; a tenth of one where the mission's file says
            that the reading is that of the middle
Trajectory  a maneuver of 10 m/s that one of the two does not know, and a month of flight since: predicted trajectories of
            New Horizons differ by 100 to 600 km; and 120 km by which kernels and the series for the barycenter differ
Earth       1,000 km where the header states its place with respect to the spacecraft: half a minute of its motion
Attitude    five sigmas of two a priori attitudes, as the camera file states them; of two statements in one header also what
            lies between boresight and middle of the detector, and aberration
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.constants import DAY_S, SPEED_OF_LIGHT_KM_S
from opnav_workbench.errors import KernelError
from opnav_workbench.geometry import (
    angle_between,
    camera_from_j2000,
    pointing_angles,
    unit_from_radec,
    vector_from_rotation,
    wrapped,
)
from opnav_workbench.geometry.times import text_from_et
from opnav_workbench.image import KeywordMap, barycentric_from_heliocentric
from opnav_workbench.image.contradictions import (
    EARTH_KM,
    check_frame_exposure,
    earth_is_off,
    time_tolerance_s,
)
from opnav_workbench.image.picture import stated_span
from opnav_workbench.kernels import KernelSet, camera_attitude, clock_tolerance_s, et_from_sclk, knows_clock
from opnav_workbench.scene import observer_from_kernels
from opnav_workbench.session.context import Context

__all__ = [
    "SettledTime",
    "attitude_contradiction",
    "exposure_contradiction",
    "header_attitude",
    "settled_time",
]

COMMAND_TO_TELEMETRY_S = 1.0
PREDICTED_CLOCK_S = 0.1  # New Horizons' headers of 2020 and a clock kernel made later: 0.011 s
UNKNOWN_MANEUVER_KM_S, SINCE_S = 0.010, 30.0 * DAY_S
BARYCENTER_KM = 120.0
TRAJECTORY_KM = UNKNOWN_MANEUVER_KM_S * SINCE_S + BARYCENTER_KM
ATTITUDE_SIGMAS = 5.0
ABERRATION_RAD = 60.0 / SPEED_OF_LIGHT_KM_S  # of a spacecraft at Mercury, in one of two statements


def _keywords(context: Context) -> KeywordMap:
    """Return what the words of the picture's header mean: a sidecar has some of its own."""
    return context.picture.keywords or KeywordMap(**context.mission.keywords)


# ---- Time: ET, UTC, clock, and where the spacecraft was then.


@dataclass(frozen=True, slots=True)
class SettledTime:
    """The mid-exposure time that is used, and what contradicts it."""

    et: float
    utc: str
    contradictions: tuple[str, ...] = ()


def settled_time(context: Context, et: float) -> SettledTime:
    """Return the mid-exposure time of a picture, and what contradicts it.

    Of an ET and a UTC that differ, that one is taken with which clock and trajectory agree; the ET where they cannot tell.

    Parameters
    ----------
    et
        As the header has it, TDB s past J2000.
    """
    picture = context.picture
    keywords = _keywords(context)
    found = _against_facts(context, keywords, et)
    if picture.rival_et is None:
        return SettledTime(et, picture.utc or "", tuple(filter(None, found.values())))
    rival = _against_facts(context, keywords, picture.rival_et)
    agreeing, agreeing_with_rival = _agreeing(found, rival), _agreeing(rival, found)
    differ = f"{keywords.et} and {keywords.utc} differ by {et - picture.rival_et:+.3f} s"
    if len(agreeing_with_rival) > len(agreeing):
        why = f"{keywords.utc} is used, {_support(agreeing_with_rival)}"
        left = filter(None, rival.values())
        return SettledTime(picture.rival_et, text_from_et(picture.rival_et), (f"{differ}; {why}", *left))
    why = _support(agreeing) if agreeing else "as nothing tells which of them is wrong"
    left = filter(None, found.values())
    return SettledTime(et, picture.utc or "", (f"{differ}; {keywords.et} is used, {why}", *left))


def _support(agreeing: Sequence[str]) -> str:
    return f"with which {' and '.join(agreeing)} agree{'s' if len(agreeing) == 1 else ''}"


def _agreeing(found: Mapping[str, str], other: Mapping[str, str]) -> list[str]:
    """Return who agrees with one time and not with the other."""
    return [who for who, text in found.items() if not text and other.get(who) != ""]


def _against_facts(context: Context, keywords: KeywordMap, et: float) -> dict[str, str]:
    """Return what clock, trajectory and Earth say against a time: nothing where they agree; who cannot tell has no entry."""
    said = {"the place of the Earth in the header": _against_earth(context, keywords, et)}
    if KernelSet.active() is not None:
        said["the spacecraft clock"] = _against_clock(context, keywords, et)
        said["the header's position"] = _against_trajectory(context, keywords, et)
    return {who: text for who, text in said.items() if text is not None}


def _against_earth(context: Context, keywords: KeywordMap, et: float) -> str | None:
    geometry = context.picture.header_geometry
    if (
        geometry is None
        or geometry.earth_km is None
        or geometry.spacecraft_from_sun_km is None
        or not geometry.spacecraft_from_sun_km.any()
    ):
        return None
    off_km, _ = earth_is_off(np.asarray(geometry.spacecraft_from_sun_km), np.asarray(geometry.earth_km), et)
    if off_km <= EARTH_KM:
        return ""
    places = ", ".join((*keywords.words("sun_position"), *keywords.words("earth_position")))
    return f"{places} put the Earth {off_km:.6g} km from where it was: time or one of the places is wrong"


def _against_clock(context: Context, keywords: KeywordMap, et: float) -> str | None:
    picture, clock = context.picture, context.mission.clock_id
    if picture.sclk is None or (picture.et is None and picture.utc is None) or not knows_clock(clock):
        return None
    try:
        off = et_from_sclk(clock, picture.sclk) - et
        tolerance = clock_tolerance_s(clock, picture.sclk, et)
    except KernelError:  # written otherwise than the kernel's clock
        return None
    stated = keywords.value(picture.header, "utc") or keywords.value(picture.header, "et")
    tolerance += time_tolerance_s(stated)
    if keywords.sclk_at == "middle":
        tolerance += PREDICTED_CLOCK_S
    else:
        rows = context.camera.rows
        span_s = 0.0 if rows is None else rows.span_s(context.camera.n_line)
        tolerance += COMMAND_TO_TELEMETRY_S + 0.5 * (float(np.nan_to_num(picture.exposure_s)) + span_s)
    if abs(off) <= tolerance:
        return ""
    return (
        f"the clock reading {keywords.sclk} = {picture.sclk} is {off:+.3f} s from the middle of the exposure, "
        f"where {tolerance:.3f} s can be"
    )


# ---- Position and velocity, against the trajectory of the kernels.


def _against_trajectory(context: Context, keywords: KeywordMap, et: float) -> str | None:
    geometry = context.picture.header_geometry
    if (
        geometry is None
        or geometry.spacecraft_from_sun_km is None
        or not geometry.spacecraft_from_sun_km.any()
    ):
        return None
    try:
        known = observer_from_kernels(context.mission.spacecraft_id, et)
    except KernelError:
        return None
    velocity = geometry.spacecraft_velocity_km_s
    with_velocity = velocity is not None and geometry.velocity_sigma_km_s == 0.0
    position_km, velocity_km_s = barycentric_from_heliocentric(
        geometry.spacecraft_from_sun_km, np.zeros(3) if velocity is None else velocity, et
    )
    far = float(np.linalg.norm(position_km - known.position_km))
    fast = float(np.linalg.norm(velocity_km_s - known.velocity_km_s)) if with_velocity else 0.0
    said = []
    if far > TRAJECTORY_KM:
        said.append(f"position ({', '.join(keywords.words('sun_position'))}) by {far:.6g} km")
    if fast > UNKNOWN_MANEUVER_KM_S:
        said.append(f"velocity ({', '.join(keywords.words('sun_velocity'))}) by {fast:.4g} km/s")
    if not said:
        return ""
    return f"off the kernels' by more than predictions are: the header's {' and '.join(said)}; the kernels' is used"


# ---- Exposure, against begin and end, where the camera is known to take all of a picture at once.


def exposure_contradiction(context: Context) -> tuple[str, ...]:
    """Return what a frame camera's begin and end say against its exposure; nothing of scans and framelets."""
    picture, keywords = context.picture, _keywords(context)
    span = stated_span(picture.header, keywords)
    if span is None or keywords.exposure_s is None or context.camera.rows is not None:
        return ()
    if context.mission.span_of(picture.header) != "exposure":
        return ()
    tolerance_s = time_tolerance_s(*span.stated)
    return tuple(check_frame_exposure(keywords.exposure_s, picture.exposure_s, span.seconds, tolerance_s))


# ---- Attitude, against what else the header says of it, and against the CK.


def header_attitude(context: Context) -> FloatArray | None:
    """Return the attitude that a header states, None where it states none.

    It is that of the quaternion; or that of the boresight's right ascension, declination and a twist.
    """
    geometry = context.picture.header_geometry
    if geometry is None:
        return None
    if geometry.camera_from_j2000 is not None:
        return np.asarray(geometry.camera_from_j2000)
    ra, dec, twist = _stated_rad(context)
    return camera_from_j2000(ra, dec, twist, context.camera.focal_from_camera) if np.isfinite(twist) else None


def _stated_rad(context: Context) -> FloatArray:
    """Return the boresight's right ascension, declination and twist; nan where the header does not state them."""
    geometry = context.picture.header_geometry
    if geometry is None or geometry.boresight_deg is None:
        return np.full(3, np.nan)
    return np.radians(geometry.boresight_deg)


def attitude_contradiction(context: Context, et: float, used: str) -> tuple[str, ...]:
    """Return what the header's attitude says against itself and that of a CK; nothing where they agree, or one is silent.

    Parameters
    ----------
    et
        TDB s past J2000.
    used
        Which attitude the picture begins with: ``kernels``, ``header``, or neither.
    """
    by_kernels = _ck_attitude(context, et)
    within = _against_itself(context)
    if not within:
        return _against_ck(context, by_kernels)
    if used == "header":
        within += "; the first is used"
    elif used == "kernels" and by_kernels is not None:
        within += f"; the CK's is used, {_agreeing_with(context, by_kernels)}"
    return (within, *_against_ck(context, by_kernels))


def _ck_attitude(context: Context, et: float) -> FloatArray | None:
    if KernelSet.active() is None:
        return None
    try:
        return camera_attitude(context.camera.frame, et)
    except KernelError:
        return None


def _against_itself(context: Context) -> str:
    """Return how far a header's quaternion and its boresight's angles are apart; nothing where they agree."""
    geometry, camera = context.picture.header_geometry, context.camera
    if geometry is None or geometry.camera_from_j2000 is None or geometry.boresight_deg is None:
        return ""
    how = _apart(camera, np.asarray(geometry.camera_from_j2000), _stated_rad(context))
    if not how:
        return ""
    return f"the attitude of {_words(context, 'quaternion')} and that of {_words(context, 'boresight', 'twist')} are {how}"


def _apart(camera: Camera, attitude: FloatArray, stated_rad: FloatArray) -> str:
    """Return how far an attitude is from a right ascension, declination and twist, if by more than the two can be."""
    ra, dec, twist = stated_rad
    off = float(angle_between(attitude.T @ camera.boresight, unit_from_radec(ra, dec)))
    if off > _can_be_off_rad(camera):
        return f"{np.degrees(off):.4g} deg apart"
    turned = float(wrapped(pointing_angles(attitude, camera.focal_from_camera)[2] - twist))
    if abs(turned) > ATTITUDE_SIGMAS * np.sqrt(2.0) * np.radians(camera.attitude_sigma.twist_deg):
        return f"turned by {np.degrees(turned):.4g} deg"
    return ""


def _words(context: Context, *names: str) -> str:
    keywords = _keywords(context)
    return ", ".join(word for name in names for word in keywords.words(name))


def _agreeing_with(context: Context, by_kernels: FloatArray) -> str:
    attitude, camera = header_attitude(context), context.camera
    assert attitude is not None  # it contradicts itself
    first = _sigmas_of_difference(camera, vector_from_rotation(attitude @ by_kernels.T)) <= ATTITUDE_SIGMAS
    second = not _apart(camera, by_kernels, _stated_rad(context))
    if first and second:
        return "which lies between them"
    return f"with which {'the first' if first else 'the second' if second else 'neither'} agrees"


def _can_be_off_rad(camera: Camera) -> float:
    """Return how far the boresight and what a header calls so may lie apart."""
    middle = camera.unproject(0.5 * np.array([camera.n_pixel - 1.0, camera.n_line - 1.0]))
    from_middle = float(np.nan_to_num(angle_between(middle, camera.boresight)))
    known_px = ATTITUDE_SIGMAS * np.sqrt(2.0) * camera.attitude_sigma.cross_px
    return from_middle + float(known_px) * camera.pixel_scale_rad + ABERRATION_RAD


def _against_ck(context: Context, by_kernels: FloatArray | None) -> tuple[str, ...]:
    """Return how far the header's attitude, or its boresight alone, is from the CK's; nothing where they agree."""
    if by_kernels is None:
        return ()
    attitude, camera = header_attitude(context), context.camera
    if attitude is None:
        stated = _stated_rad(context)
        how = _apart(camera, by_kernels, stated) if np.isfinite(stated[:2]).all() else ""
        return (f"the boresight of {_words(context, 'boresight')} and the CK's are {how}",) if how else ()
    turn = vector_from_rotation(attitude @ by_kernels.T)
    sigmas = _sigmas_of_difference(camera, turn)
    if sigmas <= ATTITUDE_SIGMAS:
        return ()
    angle_deg = float(np.degrees(np.linalg.norm(turn)))
    a_priori = f"{sigmas:.0f} sigmas of the camera file's a priori attitude"
    return (f"the header's attitude is turned by {angle_deg:.4g} deg against the CK's: {a_priori}",)


def _sigmas_of_difference(camera: Camera, turn_rad: np.ndarray) -> float:
    """Return how many sigmas a turn is, where both attitudes have the camera's a priori covariance."""
    covariance = 2.0 * camera.a_priori_covariance_rad2
    return float(np.sqrt(turn_rad @ np.linalg.solve(covariance, turn_rad)))
