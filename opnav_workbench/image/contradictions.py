"""What a header says against itself, or against what any spacecraft can do: times, exposure, state and attitude.

A contradiction is one line that names the keywords and the numbers. It stands in ``Picture.contradictions``, makes the
picture's status ``partial``, and is never silently believed: what takes the place of the fact is said in the same line.
What takes kernels to tell stands in ``session.contradictions``.

Times       differ by more than their last printed digits, and the 0.05 ms by which implementations of TDB differ
Order       after the picture reached the Earth, or more than a day after its file was made; another of its times outside
            its begin and end
Exposure    longer than a day, or than the span that the header states; that longer than a day; its middle outside it; of a
            frame camera also a thousandth of the span: milliseconds for seconds
Position    inside the Sun, or farther from it than a thousand astronomical units: kilometers are meant
Velocity    slower than any orbit that clears the Sun, or faster than the Sun's well and that of a planet at hand make: zero,
            meters or astronomical units in the place of kilometers, most doubled ones; backward around the Sun, by more
            than a planet at hand makes: a sign or axes
Earth       its place and velocity with respect to the spacecraft, where they are stated too, put it where it was not
Attitude    four numbers that are no rotation (`opnav_workbench.image.header`)
"""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import erfa
import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.constants import (
    AU_KM,
    DAY_S,
    J2000_JD,
    SPEED_OF_LIGHT_KM_S,
    SUN_GM_KM3_S2,
    SUN_RADIUS_KM,
)
from opnav_workbench.geometry import angle_between

__all__ = [
    "EARTH_KM",
    "BelievedState",
    "believed_state",
    "check_exposure",
    "check_frame_exposure",
    "check_order",
    "check_sun_distance",
    "earth_is_off",
    "printed_unit_s",
    "time_tolerance_s",
]

# s: SPICE keeps one term of TDB - TT; ERFA's series differs by up to 0.05 ms.
TIME_SCALES_S = 5e-5
SECONDS_OF_TIME = re.compile(r":\d{2}:\d{2}(?:\.(?P<decimals>\d+))?")
MINUTES_OF_TIME = re.compile(r"\d{1,2}:\d{2}")
SHUTTER_S = 0.4  # Dawn's labels have 0.192 s beside the exposure, the most of eight missions'
UNIT_RATIO = math.sqrt(1000.0)  # nearer, in ratio, to a thousandth than to the whole
LONGEST_EXPOSURE_S = DAY_S  # longer than any camera's; a second in the place of a millisecond is found sooner
FARTHEST_KM = 1000.0 * AU_KM  # six times as far as any spacecraft has come
FASTEST_LEAVING_KM_S = 17.0  # Voyager 1, the fastest of those that leave the Sun
DEEPEST_WELL_KM_S = (
    60.0  # escape speed at Jupiter's cloud tops: a spacecraft there has that beside the planet's motion
)
# GM over the Sun's, by the numbers of `erfa.plan94`, Mercury to Neptune (IAU 2009 masses).
PLANET_MASSES = np.array([1.66e-7, 2.448e-6, 3.040e-6, 3.227e-7, 9.548e-4, 2.859e-4, 4.366e-5, 5.151e-5])
ECLIPTIC_NORTH = np.array([0.0, -math.sin(math.radians(23.4393)), math.cos(math.radians(23.4393))])
STEEPEST_DEG = 100.0  # no spacecraft's path leaned more than Ulysses', 80 deg
EARTH_KM = 1000.0  # the series and headers agree to 60 km; half a minute of the Earth's motion
EARTH_KM_S = 0.01  # seven times the rate of light time, which is in some velocities
MERCURY_PERIHELION_KM = 0.3075 * AU_KM  # where nothing tells the distance: the Sun's well is deep there


# ---- Times.


def printed_unit_s(value: object) -> float:
    """Return the unit of the last printed digit of a time, s: of a text's seconds, or of a number of seconds.

    Trailing zeros of numbers are not kept by a header's readers, so that the unit may come out ten times too wide.

    Examples
    --------
    >>> printed_unit_s("2015-06-03T04:02:12"), printed_unit_s("04:02:12.25"), printed_unit_s(12.125)
    (1.0, 0.01, 0.001)
    """
    if isinstance(value, str):
        if found := SECONDS_OF_TIME.search(value):
            return 10.0 ** -len(found["decimals"] or "")
        if MINUTES_OF_TIME.search(value):
            return 60.0
    decimals = repr(value).strip("'").partition(".")[2]
    return 10.0 ** -len(decimals) if decimals.isdigit() and set(decimals) != {"0"} else 1.0


def time_tolerance_s(*stated: object) -> float:
    """Return by how much statements of one time may differ: their last printed digits and the scales' own difference."""
    return sum(printed_unit_s(value) for value in stated) + TIME_SCALES_S


# What labels (PDS; ISIS without the underscores) call later events, the first first, and by how much their times may be
# early: files carry local times, and dates without a time.
LATER_WORDS = {
    "EARTH_RECEIVED_START_TIME": 0.0,
    "EARTH_RECEIVED_TIME": 0.0,
    "EARTH_RECEIVED_STOP_TIME": 0.0,
    "PRODUCT_CREATION_TIME": DAY_S,
}
OWN_WORDS = ("IMAGE_TIME", "IMAGE_MID_TIME")  # other times of the picture itself


def check_order(
    et: float,
    seconds_of: Callable[[str], tuple[object, float] | None],
    span: tuple[float, float] | None,
    tolerance_s: float,
) -> list[str]:
    """Return which of a header's other times contradict that of the picture.

    Parameters
    ----------
    et
        Of the picture, TDB s past J2000.
    seconds_of
        Returns what a header says under a word, and the same in TDB s past J2000; None where it says no time.
    span, tolerance_s
        When the exposure began and ended on the same scale, and what the digits leave open.
    """
    said = []
    for word, early_s in LATER_WORDS.items():
        found = seconds_of(word)
        if found is not None and et > found[1] + early_s + time_tolerance_s(found[0]):
            said.append(
                f"the picture was taken {et - found[1]:.6g} s after {word} = {found[0]}, as the header states both"
            )
            break
    for word in OWN_WORDS if span is not None else ():
        found = seconds_of(word)
        if found is None or span is None:
            continue
        slack_s = tolerance_s + printed_unit_s(found[0]) + SHUTTER_S
        if not span[0] - slack_s <= found[1] <= span[1] + slack_s:
            said.append(f"{word} = {found[0]} lies outside the header's begin and end")
    return said


# ---- Exposure, against itself and against the span that the header states.


def check_exposure(
    keyword: str, exposure_s: float, span_s: tuple[float, float] | None, tolerance_s: float, middle_s: float
) -> list[str]:
    """Return what contradicts an exposure.

    Parameters
    ----------
    keyword
        Of the exposure.
    span_s
        When the exposure began and ended, by the header; None where it does not say.
    tolerance_s
        What the span's digits leave open.
    middle_s
        The middle of the exposure, on the span's scale; nan where it is not known.
    """
    said = []
    if exposure_s > LONGEST_EXPOSURE_S:
        said.append(
            f"{keyword} is an exposure of {exposure_s:g} s, longer than a day: its unit, or the number, is wrong"
        )
    if span_s is None:
        return said
    begin, end = span_s
    if end - begin > LONGEST_EXPOSURE_S:
        said.append(
            f"the header's begin and end lie {end - begin:.6g} s apart, longer than a day: one is wrong"
        )
    if exposure_s > end - begin + tolerance_s:
        said.append(
            f"{keyword} is an exposure of {exposure_s:g} s, but the header's begin and end lie {end - begin:g} s apart"
        )
    if not math.isnan(middle_s) and not begin - tolerance_s <= middle_s <= end + tolerance_s:
        off = middle_s - (begin if middle_s < begin else end)
        said.append(
            f"the middle of the exposure lies {abs(off):.6g} s {'before its begin' if off < 0 else 'after its end'}, "
            "as the header states them"
        )
    return said


def check_frame_exposure(
    keyword: str, exposure_s: float, span_s: tuple[float, float], tolerance_s: float
) -> list[str]:
    """Return what contradicts the exposure of a frame, whose begin and end enclose little else.

    Parameters
    ----------
    keyword, exposure_s, span_s, tolerance_s
        As of `check_exposure`.
    """
    begin, end = span_s
    if not UNIT_RATIO * exposure_s < end - begin - tolerance_s - SHUTTER_S:
        return []
    said = (
        f"{keyword} is an exposure of {exposure_s:g} s, but the header's begin and end lie {end - begin:g} s apart: "
        "its unit, or the number, is wrong (where they enclose several frames the camera's entry in the mission file says "
        "`span_of: frames`)"
    )
    return [said]


# ---- Position and velocity with respect to the Sun, against what any spacecraft can do.


@dataclass(frozen=True, slots=True, eq=False)
class BelievedState:
    """A state with respect to the Sun: as stated, or what takes its place where it cannot be.

    Attributes
    ----------
    position_km, velocity_km_s : (3,) array or None
        J2000.
    velocity_sigma_km_s
        Of each axis; 0 where the velocity is as stated.
    contradictions
        What is not believed, and what is used instead.
    """

    position_km: FloatArray | None
    velocity_km_s: FloatArray | None
    velocity_sigma_km_s: float = 0.0
    contradictions: tuple[str, ...] = ()


def believed_state(
    position_km: FloatArray | None,
    velocity_km_s: FloatArray | None,
    keywords: tuple[str, str],
    times: Sequence[float] = (),
    earth: tuple[FloatArray | None, FloatArray | None] = (None, None),
) -> BelievedState:
    """Return a heliocentric state as it can be believed.

    Parameters
    ----------
    position_km, velocity_km_s : (3,) array or None
        As stated, with respect to the Sun.
    keywords
        The header's words for position and velocity, for messages.
    times
        When that was, by each of the header's statements, TDB s past J2000: where the planets were.
    earth : pair of (3,) arrays or None
        Position and velocity of the Earth with respect to the spacecraft, as stated beside it.

    Notes
    -----
    A velocity that is not believed is taken as zero with the second moment of all directions: a third of the square of
    the fastest that leaves the Sun from there, ``2 GM / r + (17 km/s)^2``.
    """
    said: list[str] = []
    distance, place = MERCURY_PERIHELION_KM, position_km
    if position_km is not None:
        distance = float(np.linalg.norm(position_km))
        if not SUN_RADIUS_KM < distance < FARTHEST_KM:
            said.append(
                f"{keywords[0]} state a place {distance:.6g} km from the Sun's center, where no spacecraft is; "
                "it is not used (kilometers are meant), and stars have no parallax unless kernels tell the place"
            )
            position_km, distance, place = np.zeros(3), MERCURY_PERIHELION_KM, None
    sigma = 0.0
    wrong = "" if velocity_km_s is None else _wrong_velocity(velocity_km_s, distance, place, times, earth)
    if wrong:
        sigma = unknown_velocity_sigma_km_s(distance)
        said.append(f"{keywords[1]} state a velocity {wrong}; it is not used")
        velocity_km_s = np.zeros(3)
    return BelievedState(position_km, velocity_km_s, sigma, tuple(said))


def check_sun_distance(place_km: FloatArray | None, distance_km: float | None, word: str) -> tuple[str, ...]:
    """Return how a place with respect to the Sun and a distance that is stated beside it contradict each other."""
    if place_km is None or distance_km is None or not math.isfinite(distance_km) or not place_km.any():
        return ()
    stated = float(np.linalg.norm(place_km))
    if abs(stated - distance_km) <= EARTH_KM:
        return ()
    return (
        f"{word} is {distance_km:.6g} km, but the Sun's position in the header is {stated:.6g} km; the latter is used",
    )


def unknown_velocity_sigma_km_s(distance_km: float = MERCURY_PERIHELION_KM) -> float:
    """Return the sigma of each axis of a velocity that nobody knows, at a distance from the Sun (`believed_state`)."""
    return math.sqrt((2.0 * SUN_GM_KM3_S2 / distance_km + FASTEST_LEAVING_KM_S**2) / 3.0)


def _wrong_velocity(
    velocity_km_s: FloatArray,
    distance_km: float,
    place_km: FloatArray | None,
    times: Sequence[float],
    earth: tuple[FloatArray | None, FloatArray | None],
) -> str:
    """Return what is wrong with a velocity with respect to the Sun; empty if nothing is."""
    speed = float(np.linalg.norm(velocity_km_s))
    well = 2.0 * SUN_GM_KM3_S2 / distance_km
    near = DEEPEST_WELL_KM_S
    if place_km is not None and times:
        near = max(_planet_well_km_s(place_km, et) for et in times)
    slowest = math.sqrt(well * SUN_RADIUS_KM / (distance_km + SUN_RADIUS_KM))
    fastest = math.hypot(math.sqrt(well), FASTEST_LEAVING_KM_S) + near
    if speed < slowest:
        return f"of {speed:.4g} km/s, with which a spacecraft there falls into the Sun (below {slowest:.2g} km/s)"
    if speed > fastest:
        return f"of {speed:.6g} km/s, faster than any spacecraft there (above {fastest:.0f} km/s)"
    if place_km is not None and times:
        forward = np.cross(ECLIPTIC_NORTH, place_km)
        # What a planet's well gives.
        most = near * forward / np.linalg.norm(forward) if near and forward.any() else 0.0
        turning = np.cross(place_km, velocity_km_s + most)
        leaning = float(np.degrees(angle_between(turning, ECLIPTIC_NORTH))) if turning.any() else 0.0
        if leaning > STEEPEST_DEG:
            return (
                f"that goes backward around the Sun ({leaning:.0f} deg against the ecliptic, {STEEPEST_DEG:.0f} at most): "
                "its sign or axes, or those of the place, are wrong"
            )
    return _against_earth(velocity_km_s, place_km, times, earth)


def _planet_well_km_s(place_km: FloatArray, et: float) -> float:
    """Return the escape speed at a place from the planet in whose Hill sphere it lies, 0 where it lies in none."""
    planets = erfa.plan94(J2000_JD, et / DAY_S, np.arange(1, len(PLANET_MASSES) + 1))["p"] * AU_KM
    far = np.linalg.norm(planets - place_km, axis=1)
    hill = np.linalg.norm(planets, axis=1) * np.cbrt(PLANET_MASSES / 3.0)
    wells = np.sqrt(2.0 * SUN_GM_KM3_S2 * PLANET_MASSES / far)
    return float(np.max(wells, where=far < hill, initial=0.0))


# ---- The Earth's place and velocity, where they are stated too.


def earth_is_off(place_km: FloatArray, earth_km: FloatArray, et: float) -> tuple[float, FloatArray]:
    """Return how far a place and the Earth's with respect to it put the Earth from where it is, and was as light left.

    Parameters
    ----------
    place_km, earth_km : (3,) array
        Spacecraft with respect to the Sun, Earth with respect to the spacecraft.

    Returns
    -------
    off_km
        The nearer of the two.
    earth_velocity_km_s : (3,) array
        Of the Earth with respect to the Sun then.
    """
    light_s = float(np.linalg.norm(earth_km)) / SPEED_OF_LIGHT_KM_S
    heliocentric, _ = erfa.epv00(J2000_JD, (et - np.array([0.0, light_s])) / DAY_S)
    off = np.linalg.norm(heliocentric["p"] * AU_KM - (place_km + earth_km), axis=1)
    nearer = int(np.argmin(off))
    return float(off[nearer]), heliocentric["v"][nearer] * AU_KM / DAY_S


def _against_earth(
    velocity_km_s: FloatArray,
    place_km: FloatArray | None,
    times: Sequence[float],
    earth: tuple[FloatArray | None, FloatArray | None],
) -> str:
    """Return how a velocity with respect to the Sun and the Earth's velocity contradict each other."""
    earth_km, earth_km_s = earth
    if place_km is None or earth_km is None or earth_km_s is None or not times:
        return ""
    _, known_km_s = min((earth_is_off(place_km, earth_km, et) for et in times), key=lambda found: found[0])
    off = float(np.linalg.norm(velocity_km_s + earth_km_s - known_km_s))
    if off <= EARTH_KM_S:
        return ""
    return f"that is {off:.4g} km/s off what the Earth's with respect to the spacecraft says"
