"""What a header says against itself, or against what any spacecraft can do: times, exposure, state and attitude.

A contradiction is one line that names the keywords and the numbers. It stands in ``Picture.contradictions``, makes the
picture's status ``partial``, and is never silently believed: what takes the place of the fact is said in the same line.
What takes kernels to tell stands in ``session.contradictions``.

Times       differ by more than their last printed digits, and the 0.05 ms by which implementations of TDB differ
Exposure    longer than a day, or than the span that the header states; its middle outside that span
Position    inside the Sun, or farther from it than a thousand astronomical units: kilometers are meant
Velocity    slower than any orbit that clears the Sun, or faster than the Sun's and the deepest planet's wells make:
            zero, and meters or astronomical units in the place of kilometers
Attitude    four numbers that are no rotation (`opnav_workbench.image.header`)
"""

import math
import re
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.constants import AU_KM, DAY_S, SUN_GM_KM3_S2, SUN_RADIUS_KM

__all__ = ["BelievedState", "believed_state", "check_exposure", "printed_unit_s", "time_tolerance_s"]

# s: SPICE keeps one term of TDB - TT; ERFA's series differs by up to 0.05 ms.
TIME_SCALES_S = 5e-5
SECONDS_OF_TIME = re.compile(r":\d{2}:\d{2}(?:\.(?P<decimals>\d+))?")
MINUTES_OF_TIME = re.compile(r"\d{1,2}:\d{2}")
LONGEST_EXPOSURE_S = DAY_S  # longer than any camera's; a second in the place of a millisecond is found sooner
FARTHEST_KM = 1000.0 * AU_KM  # six times as far as any spacecraft has come
FASTEST_LEAVING_KM_S = 17.0  # Voyager 1, the fastest of those that leave the Sun
DEEPEST_WELL_KM_S = (
    60.0  # escape speed at Jupiter's cloud tops: a spacecraft there has that beside the planet's motion
)
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
    position_km: FloatArray | None, velocity_km_s: FloatArray | None, keywords: tuple[str, str]
) -> BelievedState:
    """Return a heliocentric state as it can be believed.

    Parameters
    ----------
    position_km, velocity_km_s : (3,) array or None
        As stated, with respect to the Sun.
    keywords
        The header's words for position and velocity, for messages.

    Notes
    -----
    A velocity that is not believed is taken as zero with the second moment of all directions: a third of the square of
    the fastest that leaves the Sun from there, ``2 GM / r + (17 km/s)^2``.
    """
    said: list[str] = []
    distance = MERCURY_PERIHELION_KM
    if position_km is not None:
        distance = float(np.linalg.norm(position_km))
        if not SUN_RADIUS_KM < distance < FARTHEST_KM:
            said.append(
                f"{keywords[0]} state a place {distance:.6g} km from the Sun's center, where no spacecraft is; "
                "it is not used (kilometers are meant), and stars have no parallax unless kernels tell the place"
            )
            position_km, distance = np.zeros(3), MERCURY_PERIHELION_KM
    sigma = 0.0
    if velocity_km_s is not None and (wrong := _wrong_speed(float(np.linalg.norm(velocity_km_s)), distance)):
        sigma = unknown_velocity_sigma_km_s(distance)
        said.append(f"{keywords[1]} state a velocity of {wrong}; it is not used")
        velocity_km_s = np.zeros(3)
    return BelievedState(position_km, velocity_km_s, sigma, tuple(said))


def unknown_velocity_sigma_km_s(distance_km: float = MERCURY_PERIHELION_KM) -> float:
    """Return the sigma of each axis of a velocity that nobody knows, at a distance from the Sun (`believed_state`)."""
    return math.sqrt((2.0 * SUN_GM_KM3_S2 / distance_km + FASTEST_LEAVING_KM_S**2) / 3.0)


def _wrong_speed(speed_km_s: float, distance_km: float) -> str:
    """Return what is wrong with a speed with respect to the Sun, at a distance from it; empty if nothing is."""
    well = 2.0 * SUN_GM_KM3_S2 / distance_km
    slowest = math.sqrt(well * SUN_RADIUS_KM / (distance_km + SUN_RADIUS_KM))
    fastest = math.sqrt(well) + DEEPEST_WELL_KM_S
    if speed_km_s < slowest:
        return f"{speed_km_s:.4g} km/s, with which a spacecraft there falls into the Sun (below {slowest:.2g} km/s)"
    if speed_km_s > fastest:
        return f"{speed_km_s:.6g} km/s, faster than any spacecraft there (above {fastest:.0f} km/s)"
    return ""
