"""The state of a session: a frozen value that every step replaces.

Beside it stand the pure functions of the state alone: the statuses of stars before they are searched and after the
analyst's decisions (a decision outranks what was measured), and what is still to be decided before a notebook may go on.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.errors import SessionError
from opnav_workbench.observables import Observable
from opnav_workbench.scene import AssistedBody, StarPrediction
from opnav_workbench.stars import ShapePrior, StarCenters
from opnav_workbench.stars.pointing import PointingSolution

if TYPE_CHECKING:
    from opnav_workbench.bodies import BodyCenter, Circle
    from opnav_workbench.landmarks import LandmarkSolution

__all__ = [
    "ACCEPTED",
    "BODY_METHODS",
    "BY_HAND",
    "HEADER_TOPIC",
    "LOST",
    "MARKED",
    "MAX_POINT_DIAMETER_PX",
    "MEASURED_STATUSES",
    "ORIENTATION_TOPIC",
    "REJECTED",
    "TRUSTED_STATUSES",
    "BodyMethod",
    "BodyRequest",
    "FieldFound",
    "FieldMatch",
    "JointFound",
    "ScanChoice",
    "SessionState",
    "StarStatus",
    "best_center",
    "check_star_ids",
    "decide_stars",
    "has_center",
    "landmark_name",
    "open_decisions",
    "predicted_stars",
    "skipped_topic",
    "unsearched_statuses",
    "with_decisions",
]


HEADER_TOPIC = "header"  # of the notes that say what contradicts itself
ORIENTATION_TOPIC = "orientation"  # of those that say that the stars contradict the a priori attitude
EXAMPLE_NAMES = 3  # names that a message gives as examples
# Statuses of a star whose center is shown, used or not; the others are not_detected and off_detector.
MEASURED_STATUSES = ("used", "rejected", "saturated", "blended")
BodyMethod = Literal[
    "auto", "disk", "unresolved", "cross_correlation", "least_squares", "limb_scan", "ellipse"
]
BODY_METHODS: tuple[BodyMethod, ...] = get_args(BodyMethod)
# A wider body is no point any more: not in the pattern of stars, where its limb would add false detections, and not for the
# unresolved method, which models a point.
MAX_POINT_DIAMETER_PX = 3.0
TRUSTED_STATUSES = ("ok", "uncertain")  # statuses of centers that say where a body is


def landmark_name(body: str, identity: str) -> str:
    """Return how a landmark is called among those of all bodies.

    Examples
    --------
    >>> landmark_name("BENNU", "N12.3E045.6")
    'BENNU:N12.3E045.6'
    """
    return f"{body}:{identity}"


def skipped_topic(name: str) -> str:
    """Topic of the note that says why a target is left out."""
    return f"{name} left out"


@dataclass(frozen=True, slots=True)
class StarStatus:
    """A star's status and, where it is not used, why."""

    status: str
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class FieldFound:
    """The star field identified.

    Attributes
    ----------
    camera_from_j2000 : (3, 3) array
        Attitude that brings the stars onto their detections, to a pixel.
    shift_px : (2,) array
        Observed minus a priori place of the field's center, without distortion.
    twist_rad
        Turn of the picture, positive from +pixel toward +line.
    confidence
        1 - estimated probability that it is another field.
    search : {"a priori", "wide", "lost", "marked", "by hand"}
        Found within the limits of the a priori pointing, by a wider search, by a search of the whole sky, from two stars
        marked by the analyst, or where the analyst moved it.
    sure
        False for a proposal that the analyst should confirm.
    """

    camera_from_j2000: FloatArray
    shift_px: FloatArray
    twist_rad: float
    confidence: float
    search: str
    sure: bool

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True)
class ScanChoice:
    """Limb scans that the analyst chose."""

    numbers: tuple[int, ...]
    reason: str = ""


@dataclass(frozen=True, slots=True)
class BodyRequest:
    """What was asked for when a body's center was found, so that it can be found again.

    Attributes
    ----------
    name, method
        The method as asked for, such as ``auto``.
    circle : (float, float, float) or None
        Pixel, line and radius of a circle given for this search alone.
    together
        Bodies that were found jointly with it, itself included; empty for a body alone.
    scene
        Bodies in the picture that nobody asked for, but whose light, shadow or disk may matter.
    """

    name: str
    method: str
    search_radius_px: float | None = None
    circle: tuple[float, float, float] | None = None
    scans: tuple[int, ...] | None = None
    solve_range: bool = False
    together: tuple[str, ...] = ()
    scene: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class JointFound:
    """Bodies whose centers were found together.

    Attributes
    ----------
    covariance_px2 : (2 n, 2 n) array
        Pixel and line of the first, of the second, ...; nan for a body without a center.
    """

    names: tuple[str, ...]
    method: str
    covariance_px2: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True, eq=False)
class SessionState:
    """Everything that the steps so far have found; immutable.

    Attributes
    ----------
    a_priori
        Stars predicted with the a priori pointing, around the detector.
    centers
        Fitted centers, one row per star of `a_priori`.
    found_status
        One per star of `a_priori`, as measuring left it: neither pointing nor analyst has rejected any yet.
    status
        The same after the pointing's outliers and the analyst's decisions.
    targets
        Names of the targets expected in the picture.
    decisions : mapping of str to (str, str)
        Analyst's verdict ("rejected" or "accepted") and reason by star id; they outrank the automatic ones.
    placed : mapping of str to (float, float)
        Where the analyst saw a star (pixel, line), by star id; it is looked for there.
    star_methods : mapping of str to str
        Centerfinder of stars that were fitted again with another one than the rest, by star id.
    circles : mapping of str to Circle
        Where the analyst saw a body, by name.
    assisted : mapping of str to AssistedBody
        Bodies as the analyst described them, by name; they outrank ephemerides.
    scan_choices : mapping of str to ScanChoice
        Limb scans that the analyst chose, by body.
    user_notes
        The analyst's remarks.
    star_field
        The field as identification, or the analyst, found it.
    psf
        The frame's own PSF.
    requests
        One per body of `bodies`.
    landmarks
        One per body whose landmarks were looked for.
    landmark_decisions : mapping of str to (str, str)
        As `decisions`, by the landmark's name (`landmark_name`).
    skipped_targets
        Targets asked for that neither kernels nor star list know.
    notes : mapping of str to tuple of str
        What the analyst must know, by topic; a step that is repeated replaces its own notes.
    """

    a_priori: StarPrediction | None = None
    centers: StarCenters | None = None
    found_status: tuple[StarStatus, ...] = ()
    status: tuple[StarStatus, ...] = ()
    targets: tuple[str, ...] = ()
    decisions: MappingProxyType[str, tuple[str, str]] = field(default_factory=lambda: MappingProxyType({}))
    placed: MappingProxyType[str, tuple[float, float]] = field(default_factory=lambda: MappingProxyType({}))
    star_methods: MappingProxyType[str, str] = field(default_factory=lambda: MappingProxyType({}))
    circles: "MappingProxyType[str, Circle]" = field(default_factory=lambda: MappingProxyType({}))
    assisted: MappingProxyType[str, AssistedBody] = field(default_factory=lambda: MappingProxyType({}))
    scan_choices: MappingProxyType[str, ScanChoice] = field(default_factory=lambda: MappingProxyType({}))
    user_notes: tuple[str, ...] = ()
    star_field: FieldFound | None = None
    psf: ShapePrior | None = None
    pointing: PointingSolution | None = None
    bodies: "tuple[BodyCenter, ...]" = ()
    requests: tuple[BodyRequest, ...] = ()
    joint: tuple[JointFound, ...] = ()
    observables: tuple[Observable, ...] = ()
    landmarks: "tuple[LandmarkSolution, ...]" = ()
    landmark_decisions: MappingProxyType[str, tuple[str, str]] = field(
        default_factory=lambda: MappingProxyType({})
    )
    skipped_targets: tuple[str, ...] = ()
    notes: MappingProxyType[str, tuple[str, ...]] = field(default_factory=lambda: MappingProxyType({}))

    def replace(self, **changes: Any) -> "SessionState":
        """Return a copy with some fields changed."""
        return replace(self, **changes)

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Which facts of the header contradict each other, the kernels or the stars, and what is used."""
        return (*self.notes.get(HEADER_TOPIC, ()), *self.notes.get(ORIENTATION_TOPIC, ()))

    @property
    def messages(self) -> tuple[str, ...]:
        """All notes in the order of their topics, each once."""
        return tuple(dict.fromkeys(note for notes in self.notes.values() for note in notes))

    def with_notes(self, topic: str, *messages: str) -> "SessionState":
        """Return a copy whose notes on `topic` are these and no others."""
        notes = {key: value for key, value in self.notes.items() if key != topic}
        return replace(self, notes=MappingProxyType(notes | ({topic: messages} if messages else {})))

    def mask(self, *statuses: str) -> np.ndarray:
        """Return which stars have one of the given statuses."""
        return np.array([s.status in statuses for s in self.status], dtype=bool)


# ---- Which detection is which star: the field's rotation against the a priori pointing.

BY_HAND, MARKED = "by hand", "marked"  # searches of a field that the analyst moved, or marked two stars of
LOST = "lost"  # the search of the whole sky


@dataclass(frozen=True, slots=True, eq=False)
class FieldMatch:
    """Where each star is expected on the picture.

    Attributes
    ----------
    stars
        Predicted anew, where the field lies so far off that others are on the detector; else None.
    expected_px : (n, 2) array
    visible : (n,) array of bool
        Expected on the detector.
    radius_px
        How far from the expected place a star may lie.
    """

    found: FieldFound | None
    stars: StarPrediction | None
    expected_px: FloatArray
    visible: BoolArray
    radius_px: float
    messages: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self)


# ---- The analyst's decisions on stars, and what they make of the automatic statuses.

ACCEPTED, REJECTED = "accepted", "rejected"


def unsearched_statuses(on_detector: BoolArray) -> tuple[StarStatus, ...]:
    """Return the statuses of stars that are predicted (n,) on the detector or off it, and not looked for yet."""
    return tuple(
        StarStatus("not_detected", "not searched yet")
        if on
        else StarStatus("off_detector", "predicted outside the detector")
        for on in on_detector
    )


def predicted_stars(state: SessionState) -> StarPrediction:
    """Return the predicted stars.

    Raises
    ------
    SessionError
        There are none yet.
    """
    if state.a_priori is None:
        raise SessionError("no stars are predicted yet: call predict() first.")
    return state.a_priori


def has_center(state: SessionState) -> BoolArray:
    """Return which predicted stars have a measured center."""
    if state.centers is None:
        return np.zeros(len(state.found_status), dtype=bool)
    return np.asarray(np.isfinite(state.centers.pixel_line).all(axis=1))


def with_decisions(state: SessionState, statuses: Sequence[StarStatus]) -> tuple[StarStatus, ...]:
    """Return `statuses` (one per predicted star) with the analyst's decisions carried out."""
    if state.a_priori is None:
        return tuple(statuses)
    decisions = state.decisions  # on few of many stars
    rows = zip(state.a_priori.id.tolist(), statuses, has_center(state).tolist(), strict=True)
    return tuple(
        _decided(decisions[star], status, measured) if star in decisions else status
        for star, status, measured in rows
    )


def _decided(decision: tuple[str, str], status: StarStatus, measured: bool) -> StarStatus:
    verdict, reason = decision
    if verdict == REJECTED:
        return StarStatus("rejected", f"by the analyst: {reason}" if reason else "by the analyst")
    # What was fitted off the detector, at its edge, is no picture of that star.
    if verdict == ACCEPTED and measured and status.status != "off_detector":
        return StarStatus("used", reason)
    return status


def check_star_ids(stars: StarPrediction, ids: Sequence[str]) -> None:
    """Refuse ids that none of the predicted stars has.

    Raises
    ------
    SessionError
        They are named, and some that there are.
    """
    known = stars.id.tolist()
    unknown = sorted(set(ids) - set(known))
    if unknown:
        raise SessionError(
            f"no star {', '.join(unknown)} in this field; stars are named as in result.json, "
            f"such as {', '.join(sorted(known)[:EXAMPLE_NAMES])}."
        )


def decide_stars(state: SessionState, ids: Sequence[str], verdict: str, reason: str) -> SessionState:
    """Return the state with a decision on some stars, effective at once.

    Raises
    ------
    SessionError
        No stars are predicted yet, or one of `ids` is not among them.
    """
    stars = predicted_stars(state)
    check_star_ids(stars, ids)
    decisions = dict(state.decisions) | dict.fromkeys(ids, (verdict, reason))
    rows = zip(stars.id.tolist(), state.found_status, state.status, strict=True)
    statuses = [found if star in ids else status for star, found, status in rows]
    state = state.replace(decisions=MappingProxyType(decisions))
    return state.replace(status=with_decisions(state, statuses))


# ---- Gates of a notebook: what must be decided before its later cells may run.


def open_decisions(state: SessionState, needs: Sequence[str]) -> list[str]:
    """Return what is missing of `needs`, one line each.

    Raises
    ------
    SessionError
        A need is unknown.
    """
    unknown = [need for need in needs if need not in GATES]
    if unknown:
        raise SessionError(f"unknown need {', '.join(unknown)}; choose of {', '.join(GATES)}.")
    lines = (GATES[need](state) for need in needs)
    return [line for line in lines if line]


def _stars_confirmed(state: SessionState) -> str:
    if state.a_priori is None or state.centers is None:
        return "no stars are found yet: predict() and find_stars()"
    open_ones = [
        star
        for star, used in zip(state.a_priori.id.tolist(), state.mask("used"), strict=True)
        if used and star not in state.decisions
    ]
    if not open_ones:
        return ""
    named = ", ".join(open_ones[:EXAMPLE_NAMES]) + (", ..." if len(open_ones) > EXAMPLE_NAMES else "")
    return f"{len(open_ones)} stars wait to be accepted or rejected ({named})"


def _pointing(state: SessionState) -> str:
    return "" if state.pointing is not None else "the pointing is not solved: repoint()"


def _bodies(state: SessionState) -> str:
    found = {body.name for body in state.bodies}
    open_ones = [name for name in state.targets if name not in found]
    return f"{', '.join(open_ones)} not looked for yet: find_body()" if open_ones else ""


def _observables(state: SessionState) -> str:
    if len(state.observables) == len(state.bodies) and np.all(
        [o.name == b.name for o, b in zip(state.observables, state.bodies, strict=True)]
    ):
        return ""
    return "the observables are not computed: observables()"


GATES: dict[str, Callable[[SessionState], str]] = {
    "stars_confirmed": _stars_confirmed,
    "pointing": _pointing,
    "bodies": _bodies,
    "observables": _observables,
}


def best_center(state: SessionState, name: str) -> "BodyCenter | None":
    """Return a body's center that is to be trusted most: the last that is ok, else the last uncertain one."""
    found = [body for body in state.bodies if body.name == name and body.status in TRUSTED_STATUSES]
    return next((body for body in reversed(found) if body.status == "ok"), found[-1] if found else None)
