"""What a header says against the loaded kernels: time against the clock, position against the trajectory, attitude.

Flow    header and kernels -> `settled_time` -> et, and lines that make the picture ``partial``

What a header says against itself stands in `opnav_workbench.image.contradictions`. A tolerance is what the facts that are
compared can know:

Clock       a reading anywhere in the exposure, one count of its last field, the clock's drift beyond the kernel's last
            record, the time's printed digits, and a second between command, shutter and telemetry: labels of twelve missions
            (New Horizons to Voyager) stay within it, those of Galileo by 0.6 s
Trajectory  a maneuver of 10 m/s that one of the two does not know, and a month of flight since: predicted trajectories of
            New Horizons differ by 100 to 600 km; and 120 km by which kernels and the series for the barycenter differ
Attitude    five sigmas of two a priori attitudes, as the camera file states them
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from opnav_workbench.camera import Camera
from opnav_workbench.constants import DAY_S
from opnav_workbench.errors import KernelError
from opnav_workbench.geometry import vector_from_rotation
from opnav_workbench.geometry.times import text_from_et
from opnav_workbench.image import KeywordMap, barycentric_from_heliocentric
from opnav_workbench.image.contradictions import time_tolerance_s
from opnav_workbench.kernels import KernelSet, camera_attitude, clock_tolerance_s, et_from_sclk, knows_clock
from opnav_workbench.scene import observer_from_kernels
from opnav_workbench.session.context import Context

__all__ = ["SettledTime", "attitude_contradiction", "settled_time"]

COMMAND_TO_TELEMETRY_S = 1.0
UNKNOWN_MANEUVER_KM_S, SINCE_S = 0.010, 30.0 * DAY_S
BARYCENTER_KM = 120.0
TRAJECTORY_KM = UNKNOWN_MANEUVER_KM_S * SINCE_S + BARYCENTER_KM
ATTITUDE_SIGMAS = 5.0


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
    keywords = picture.keywords or KeywordMap(**context.mission.keywords)  # a sidecar has words of its own
    found = _against_kernels(context, keywords, et)
    if picture.rival_et is None:
        return SettledTime(et, picture.utc or "", tuple(filter(None, found.values())))
    rival = _against_kernels(context, keywords, picture.rival_et)
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


def _against_kernels(context: Context, keywords: KeywordMap, et: float) -> dict[str, str]:
    """Return what clock and trajectory say against a time: nothing where they agree; who cannot tell has no entry."""
    if KernelSet.active() is None:
        return {}
    said = {
        "the spacecraft clock": _against_clock(context, keywords, et),
        "the header's position": _against_trajectory(context, keywords, et),
    }
    return {who: text for who, text in said.items() if text is not None}


def _against_clock(context: Context, keywords: KeywordMap, et: float) -> str | None:
    picture, clock = context.picture, context.mission.clock_id
    if picture.sclk is None or (picture.et is None and picture.utc is None) or not knows_clock(clock):
        return None
    if not any(letter.isdigit() for letter in picture.sclk):
        return f"{keywords.sclk} = {picture.sclk!r} is no reading of a clock"
    try:
        off = et_from_sclk(clock, picture.sclk) - et
        tolerance = clock_tolerance_s(clock, picture.sclk, et)
    except KernelError:  # written otherwise than the kernel's clock
        return None
    stated = keywords.value(picture.header, "utc") or keywords.value(picture.header, "et")
    tolerance += time_tolerance_s(stated) + COMMAND_TO_TELEMETRY_S
    tolerance += 0.5 * float(np.nan_to_num(picture.exposure_s))
    rows = context.camera.rows
    tolerance += 0.0 if rows is None else 0.5 * rows.span_s(context.camera.n_line)
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
        said.append(f"position ({', '.join(keywords.sun_position or ())}) by {far:.6g} km")
    if fast > UNKNOWN_MANEUVER_KM_S:
        said.append(f"velocity ({', '.join(keywords.sun_velocity or ())}) by {fast:.4g} km/s")
    if not said:
        return ""
    return f"off the kernels' by more than predictions are: the header's {' and '.join(said)}; the kernels' is used"


# ---- Attitude, against the CK.


def attitude_contradiction(context: Context, et: float) -> tuple[str, ...]:
    """Return what the header's attitude says against that of a CK; nothing where they agree, or one is silent."""
    geometry, kernels, camera = context.picture.header_geometry, KernelSet.active(), context.camera
    if geometry is None or geometry.camera_from_j2000 is None or kernels is None:
        return ()
    try:
        by_kernels = camera_attitude(camera.frame, et)
    except KernelError:
        return ()
    turn = vector_from_rotation(geometry.camera_from_j2000 @ by_kernels.T)
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
