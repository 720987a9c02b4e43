"""The parts of a scenario file: spacecraft, clock, frames, cameras and bodies.

Calendar times are UTC; tables of states and orbit epochs are TDB unless they say otherwise.
"""

from collections.abc import Mapping
from datetime import datetime
from itertools import pairwise
from pathlib import PurePosixPath
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    Field,
    PositiveFloat,
    PositiveInt,
    StringConstraints,
    model_validator,
)

from opnav_workbench.geometry.rotations import checked_rotation
from opnav_workbench.yaml_file import CalendarTime, StrictModel, Utc, Vector3

__all__ = [
    "Body",
    "BodyName",
    "BodyRef",
    "Clock",
    "FixedFrame",
    "FrameName",
    "Instrument",
    "JulianDate",
    "OwenTerms",
    "RelativePath",
    "Shape",
    "Spacecraft",
    "Span",
    "Tdb",
]

FRAME_NAME_CHARS = 26  # SPICE: the pool variable FRAME_<name> has at most 32
BODY_NAME_CHARS = 36  # SPICE
CLOCK_COUNTS = 4294967296  # a 32-bit counter of seconds, as spacecraft clocks have
FIRST_JD, LAST_JD = 2086302.5, 2688976.5  # years 1000 and 2650: beyond the planetary ephemeris on both sides


def _beside(name: str) -> str:
    path = PurePosixPath(name)
    if not name or path.is_absolute() or ".." in path.parts or "\\" in name:
        raise ValueError(f"{name!r} is not a path inside the scenario's folder")
    return name


def _no_zone(moment: datetime) -> datetime:
    if moment.tzinfo is not None:
        raise ValueError("this epoch has no time zone; write it without Z or offset")
    return moment


def _rotation(rows: tuple[Any, ...]) -> tuple[Any, ...]:
    checked_rotation(rows)
    return rows


def _orthonormal(rows: tuple[Any, ...]) -> tuple[Any, ...]:
    matrix = np.asarray(rows)
    checked_rotation(matrix * np.sign(np.linalg.det(matrix) or 1.0))  # mirrored detectors are allowed
    return rows


Tdb = Annotated[CalendarTime, AfterValidator(_no_zone)]
JulianDate = Annotated[float, Field(strict=True, ge=FIRST_JD, le=LAST_JD)]  # TDB
RelativePath = Annotated[str, AfterValidator(_beside)]
Matrix3 = tuple[Vector3, Vector3, Vector3]
RotationRows = Annotated[Matrix3, AfterValidator(_rotation)]
FocalAxes = Annotated[Matrix3, AfterValidator(_orthonormal)]
FrameName = Annotated[str, StringConstraints(pattern=r"^[A-Z][A-Z0-9_+-]*$", max_length=FRAME_NAME_CHARS)]
BodyName = Annotated[str, StringConstraints(pattern=r"^[A-Z0-9][A-Z0-9_ +./-]*$", max_length=BODY_NAME_CHARS)]
Keyword = Annotated[str, StringConstraints(pattern=r"^[A-Z][A-Z0-9_/]*$", max_length=22)]
BodyRef = int | str  # a NAIF id, or a name of this scenario


class Span(StrictModel):
    """The time that the kernels serve."""

    start: Utc
    end: Utc

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.end <= self.start:
            raise ValueError(f"end {self.end.isoformat()} is not after start {self.start.isoformat()}")
        return self


class NamedFrame(StrictModel):
    """A frame that a CK orients."""

    name: FrameName
    id: int


class Spacecraft(StrictModel):
    """A spacecraft and its bus frame, the one that its CK gives."""

    name: BodyName
    id: Annotated[int, Field(lt=0)]
    aliases: tuple[BodyName, ...] = ()
    frame: NamedFrame


class Clock(StrictModel):
    """A two-field spacecraft clock, ``seconds:subcounts``, tied to time by `start` or by `correlation`."""

    id: Annotated[int, Field(lt=0)]
    subcounts: PositiveInt = 65536
    counts: PositiveInt = CLOCK_COUNTS
    time_system: Literal["TDB", "TDT"] = "TDB"
    start: Utc | None = None  # the clock reads zero
    partitions: tuple[tuple[int, int], ...] = ()  # first and last tick of each; none: one that never ends
    correlation: tuple[tuple[int, Tdb, PositiveFloat], ...] = ()  # tick, time, seconds per count
    delimiter: Literal[":", "."] = ":"  # between seconds and subcounts, in readings that SPICE writes

    @model_validator(mode="after")
    def _tied_once(self) -> Self:
        if (self.start is None) == (not self.correlation):
            raise ValueError("give either start or correlation, not both and not neither")
        return self

    @model_validator(mode="after")
    def _partitions_apart(self) -> Self:
        last_tick = self.counts * self.subcounts - 1
        for i, (first, last) in enumerate(self.partitions):
            if not 0 <= first < last <= last_tick:
                raise ValueError(
                    f"partitions.{i}: [{first}, {last}] is no interval of ticks within 0..{last_tick}"
                )
        for i, (before, after) in enumerate(pairwise(self.partitions), start=1):
            # A clock may start again from any earlier reading; flight clocks go back by less than a count, too.
            if before[0] < after[0] < before[1] - self.subcounts:
                raise ValueError(
                    f"partitions.{i}: [{after[0]}, {after[1]}] overlaps [{before[0]}, {before[1]}]; "
                    "let it start at the end of the one before, or where the counter was reset to"
                )
        return self

    @model_validator(mode="after")
    def _correlation_rises(self) -> Self:
        for i, (before, after) in enumerate(pairwise(self.correlation), start=1):
            if after[0] <= before[0] or after[1] <= before[1]:
                raise ValueError(f"correlation.{i}: tick and time must both be after those of the row before")
        return self


class FixedFrame(StrictModel):
    """A frame mounted on another: ``v_frame = matrix @ v_relative``."""

    name: FrameName
    id: int
    relative_to: FrameName
    matrix: RotationRows


class OwenTerms(StrictModel):
    """Distortion of the JPL OpNav model, in the terms that kernels have room for (``OOC_EM``)."""

    model: Literal["owen"]
    e2_per_mm2: float = 0.0
    e5_per_mm: float = 0.0
    e6_per_mm: float = 0.0


class BrownTerms(StrictModel):
    """Distortion of the Brown (OpenCV) model, in the terms that kernels have room for (``OPENCV_OD``)."""

    model: Literal["brown"]
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    p1: float = 0.0
    p2: float = 0.0


class Instrument(StrictModel):
    """A camera: detector and optics as plain numbers; further IK keywords as they are."""

    name: BodyName
    id: Annotated[int, Field(lt=0)]
    frame: FrameName
    focal_length_mm: PositiveFloat
    pixel_size_um: PositiveFloat
    n_pixel: PositiveInt
    n_line: PositiveInt
    center_pixel_line: tuple[float, float] | None = None  # none: the middle of the detector
    focal_from_camera: FocalAxes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    fov_half_angles_deg: tuple[PositiveFloat, PositiveFloat] | None = None  # none: from the detector
    distortion: Annotated[OwenTerms | BrownTerms, Field(discriminator="model")] | None = None
    keywords: Mapping[Keyword, float | str | tuple[float, ...] | tuple[str, ...]] = {}

    @property
    def center(self) -> tuple[float, float]:
        """Where the boresight falls, pixel and line."""
        return self.center_pixel_line or ((self.n_pixel - 1) / 2, (self.n_line - 1) / 2)

    @property
    def pixel_scale_rad(self) -> float:
        """Angle of one pixel at the boresight."""
        return self.pixel_size_um * 1e-3 / self.focal_length_mm


class BodyFrame(StrictModel):
    """A body-fixed frame that SPICE does not know by itself."""

    name: FrameName
    id: int


class Shape(StrictModel):
    """A shape model of triangles: an OBJ or cmod file, beside the scenario or with a full path."""

    file: str
    unit: Literal["km", "m"] = "km"


class Body(StrictModel):
    """A natural body; what is left out does not enter the PCK."""

    name: BodyName
    id: int
    aliases: tuple[BodyName, ...] = ()
    source: str
    radii_km: tuple[PositiveFloat, PositiveFloat, PositiveFloat] | None = None
    gm_km3_s2: PositiveFloat | None = None
    pole_ra_deg: tuple[float, ...] = ()  # value at J2000, then rate per Julian century
    pole_dec_deg: tuple[float, ...] = ()
    prime_meridian_deg: tuple[float, ...] = ()  # value at J2000, then rate per day
    frame: BodyFrame | None = None
    shape: Shape | None = None

    @model_validator(mode="after")
    def _whole_rotation(self) -> Self:
        given = [bool(self.pole_ra_deg), bool(self.pole_dec_deg), bool(self.prime_meridian_deg)]
        if any(given) and not all(given):
            raise ValueError("pole_ra_deg, pole_dec_deg and prime_meridian_deg belong together: give all")
        return self
