"""The one place where a session's state lives: a frozen value that every step replaces."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.bodies import TargetState
from opnav_workbench.bodycenters import BodyCenter, Circle
from opnav_workbench.catalog import StarTable
from opnav_workbench.observables import Observable
from opnav_workbench.pointing import PointingSolution
from opnav_workbench.scene import Observer, StarPrediction
from opnav_workbench.starcenters import ShapePrior, StarCenters

__all__ = [
    "MEASURED_STATUSES",
    "BodyRequest",
    "FieldFound",
    "Inputs",
    "JointFound",
    "ScanChoice",
    "SessionState",
    "StarStatus",
    "skipped_topic",
]

# Statuses of a star whose center is shown, used or not; the others are not_detected and off_detector.
MEASURED_STATUSES = ("used", "rejected", "saturated", "blended")


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """What came from outside the picture (kernels, header, catalog), kept so that a session resumes without them.

    Attributes
    ----------
    et : float
        Mid-exposure, TDB seconds past J2000.
    utc : str
    observer : Observer
    a_priori_camera_from_j2000 : (3, 3) array
    attitude_source : str
        "kernels" or "header".
    stars : StarTable
        Catalog rows around the a priori field.
    targets : mapping of str to TargetState
    wide_stars : StarTable or None
        Brightest catalog rows as far around as the widest search goes, once one was needed.
    shapes : mapping of str to Path
        Shape models of targets, where the kernels hold one.
    """

    et: float
    utc: str
    observer: Observer
    a_priori_camera_from_j2000: FloatArray
    attitude_source: str
    stars: StarTable
    targets: MappingProxyType[str, TargetState]
    wide_stars: StarTable | None = None
    shapes: MappingProxyType[str, Path] = field(default_factory=lambda: MappingProxyType({}))

    def __post_init__(self) -> None:
        freeze_arrays(self)


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
    twist_rad : float
        Turn of the picture, positive from +pixel toward +line.
    confidence : float
        1 - estimated probability that it is another field.
    search : {"a priori", "wide", "marked", "by hand"}
        Found within the limits of the a priori pointing, by a wider search, from two stars marked by the analyst, or where
        the analyst moved it.
    sure : bool
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
    """Limb scans that the analyst chose.

    Attributes
    ----------
    numbers : tuple of int
    reason : str
    """

    numbers: tuple[int, ...]
    reason: str = ""


@dataclass(frozen=True, slots=True)
class BodyRequest:
    """What was asked for when a body's center was found, so that it can be found again.

    Attributes
    ----------
    name, method : str
        The method as asked for, such as ``auto``.
    search_radius_px : float or None
    circle : (float, float, float) or None
        Pixel, line and radius of a circle given for this search alone.
    scans : tuple of int or None
    solve_range : bool
    together : tuple of str
        Bodies that were found jointly with it, itself included; empty for a body alone.
    scene : tuple of str
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
    names : tuple of str
    method : str
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
    a_priori : StarPrediction or None
        Stars predicted with the a priori pointing, around the detector.
    centers : StarCenters or None
        Fitted centers, one row per star of `a_priori`.
    found_status : tuple of StarStatus
        One per star of `a_priori`, as measuring left it: neither pointing nor analyst has judged yet.
    status : tuple of StarStatus
        The same after the pointing's outliers and the analyst's decisions.
    targets : tuple of str
        Names of the targets expected in the picture.
    decisions : mapping of str to (str, str)
        Analyst's verdict ("rejected" or "accepted") and reason by star id; they outrank the automatic ones.
    placed : mapping of str to (float, float)
        Where the analyst saw a star (pixel, line), by star id; it is looked for there.
    star_methods : mapping of str to str
        Centerfinder of stars that were fitted again with another one than the rest, by star id.
    circles : mapping of str to Circle
        Where the analyst saw a body, by name.
    scan_choices : mapping of str to ScanChoice
        Limb scans that the analyst chose, by body.
    user_notes : tuple of str
        The analyst's remarks.
    star_field : FieldFound or None
        The field as identification, or the analyst, found it.
    psf : ShapePrior or None
        The frame's own PSF.
    pointing : PointingSolution or None
    bodies : tuple of BodyCenter
    requests : tuple of BodyRequest
        One per body of `bodies`.
    joint : tuple of JointFound
    observables : tuple of Observable
    skipped_targets : tuple of str
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
    circles: MappingProxyType[str, Circle] = field(default_factory=lambda: MappingProxyType({}))
    scan_choices: MappingProxyType[str, ScanChoice] = field(default_factory=lambda: MappingProxyType({}))
    user_notes: tuple[str, ...] = ()
    star_field: FieldFound | None = None
    psf: ShapePrior | None = None
    pointing: PointingSolution | None = None
    bodies: tuple[BodyCenter, ...] = ()
    requests: tuple[BodyRequest, ...] = ()
    joint: tuple[JointFound, ...] = ()
    observables: tuple[Observable, ...] = ()
    skipped_targets: tuple[str, ...] = ()
    notes: MappingProxyType[str, tuple[str, ...]] = field(default_factory=lambda: MappingProxyType({}))

    def replace(self, **changes: Any) -> "SessionState":
        """Return a copy with some fields changed."""
        return replace(self, **changes)

    @property
    def messages(self) -> tuple[str, ...]:
        """All notes in the order of their topics, each once."""
        return tuple(dict.fromkeys(note for notes in self.notes.values() for note in notes))

    def noting(self, topic: str, *messages: str) -> "SessionState":
        """Return a copy whose notes on `topic` are these and no others."""
        notes = {key: value for key, value in self.notes.items() if key != topic}
        return replace(self, notes=MappingProxyType(notes | ({topic: messages} if messages else {})))

    def mask(self, *statuses: str) -> np.ndarray:
        """Return which stars have one of the given statuses."""
        return np.array([s.status in statuses for s in self.status], dtype=bool)
