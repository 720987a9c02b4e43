"""Scenario files: what a mission, its bodies and its pictures' pointing are, as far as SPICE kernels say it.

A scenario is a YAML file (or the mapping read from one) with plain numbers. `make_kernels` turns it into kernels.
Calendar times are UTC; tables of states and orbit epochs are TDB unless they say otherwise.
"""

from collections.abc import Mapping
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import yaml
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PositiveFloat,
    PositiveInt,
    StringConstraints,
    ValidationError,
    model_validator,
)

from opnav_workbench.errors import MissionError
from opnav_workbench.geometry.rotations import checked_rotation

__all__ = [
    "AttitudeError",
    "Body",
    "Clock",
    "FixedFrame",
    "Instrument",
    "KeplerOrbit",
    "ModelOrbit",
    "Pointing",
    "Scenario",
    "Spacecraft",
    "StateTable",
    "Window",
    "load_scenario",
]

FRAME_NAME_CHARS = 26  # SPICE: the pool variable FRAME_<name> has at most 32
BODY_NAME_CHARS = 36  # SPICE
ERRORS_SHOWN = 3  # a file of the wrong kind breaks every rule at once; the first few tell the story
CLOCK_COUNTS = 4294967296  # a 32-bit counter of seconds, as spacecraft clocks have


def _naive_utc(moment: datetime) -> datetime:
    return moment if moment.tzinfo is None else moment.astimezone(UTC).replace(tzinfo=None)


def _no_zone(moment: datetime) -> datetime:
    if moment.tzinfo is not None:
        raise ValueError("a TDB epoch has no time zone; write it without Z or offset")
    return moment


def _rotation(rows: tuple[Any, ...]) -> tuple[Any, ...]:
    checked_rotation(rows)
    return rows


def _orthonormal(rows: tuple[Any, ...]) -> tuple[Any, ...]:
    matrix = np.asarray(rows)
    checked_rotation(matrix * np.sign(np.linalg.det(matrix) or 1.0))  # mirrored detectors are allowed
    return rows


Utc = Annotated[datetime, AfterValidator(_naive_utc)]
Tdb = Annotated[datetime, AfterValidator(_no_zone)]
Vector3 = tuple[float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]
RotationRows = Annotated[Matrix3, AfterValidator(_rotation)]
FocalAxes = Annotated[Matrix3, AfterValidator(_orthonormal)]
FrameName = Annotated[str, StringConstraints(pattern=r"^[A-Z][A-Z0-9_+-]*$", max_length=FRAME_NAME_CHARS)]
BodyName = Annotated[str, StringConstraints(pattern=r"^[A-Z0-9][A-Z0-9_ +./-]*$", max_length=BODY_NAME_CHARS)]
FileStem = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", max_length=40)]
Keyword = Annotated[str, StringConstraints(pattern=r"^[A-Z][A-Z0-9_/]*$", max_length=22)]
BodyRef = int | str  # a NAIF id, or a name of this scenario
Row = tuple[datetime, float, float, float, float, float, float]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Span(_Strict):
    """The time that the kernels serve."""

    start: Utc
    end: Utc

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.end <= self.start:
            raise ValueError(f"end {self.end.isoformat()} is not after start {self.start.isoformat()}")
        return self


class NamedFrame(_Strict):
    """A frame that a CK orients."""

    name: FrameName
    id: int


class Spacecraft(_Strict):
    """A spacecraft and its bus frame, the one that its CK gives."""

    name: BodyName
    id: Annotated[int, Field(lt=0)]
    aliases: tuple[BodyName, ...] = ()
    frame: NamedFrame


class Clock(_Strict):
    """A two-field spacecraft clock, ``seconds:subcounts``; either `start` or `correlation` ties it to time."""

    id: Annotated[int, Field(lt=0)]
    subcounts: PositiveInt = 65536
    counts: PositiveInt = CLOCK_COUNTS
    time_system: Literal["TDB", "TDT"] = "TDB"
    start: Utc | None = None  # the clock reads zero
    partitions: tuple[tuple[int, int], ...] = ()  # first and last tick of each; none: one that never ends
    correlation: tuple[tuple[int, Tdb, PositiveFloat], ...] = ()  # tick, time, seconds per count

    @model_validator(mode="after")
    def _tied_once(self) -> Self:
        if (self.start is None) == (not self.correlation):
            raise ValueError("give either start or correlation, not both and not neither")
        return self


class FixedFrame(_Strict):
    """A frame mounted on another: ``v_frame = matrix @ v_relative``."""

    name: FrameName
    id: int
    relative_to: FrameName
    matrix: RotationRows


class Instrument(_Strict):
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
    keywords: Mapping[Keyword, float | str | tuple[float, ...] | tuple[str, ...]] = {}

    @property
    def pixel_scale_rad(self) -> float:
        """Angle of one pixel at the boresight."""
        return self.pixel_size_um * 1e-3 / self.focal_length_mm


class BodyFrame(_Strict):
    """A body-fixed frame that SPICE does not know by itself."""

    name: FrameName
    id: int


class Body(_Strict):
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

    @model_validator(mode="after")
    def _whole_rotation(self) -> Self:
        given = [bool(self.pole_ra_deg), bool(self.pole_dec_deg), bool(self.prime_meridian_deg)]
        if any(given) and not all(given):
            raise ValueError("pole_ra_deg, pole_dec_deg and prime_meridian_deg belong together; give all or none")
        return self


class _Trajectory(_Strict):
    target: BodyRef
    center: BodyRef
    source: str
    frame: FrameName = "J2000"


class StateTable(_Trajectory):
    """States at epochs, between which SPICE interpolates."""

    kind: Literal["states"]
    time_scale: Literal["TDB", "UTC"] = "TDB"
    rows: Annotated[tuple[Row, ...], Field(min_length=2)]  # epoch, km, km/s

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for i, (a, b) in enumerate(pairwise(row[0] for row in self.rows)):
            if b.tzinfo is not None or b <= a:
                raise ValueError(f"rows.{i + 1}: {b.isoformat()} must have no zone and be after {a.isoformat()}")
        return self


class KeplerOrbit(_Trajectory):
    """An unperturbed orbit, tabulated over the span."""

    kind: Literal["kepler"]
    epoch: Tdb
    gm_km3_s2: PositiveFloat
    periapsis_km: PositiveFloat
    eccentricity: Annotated[float, Field(ge=0.0)]
    inclination_deg: float
    node_deg: float
    argument_deg: float
    mean_anomaly_deg: float
    step_s: PositiveFloat | None = None  # none: fine enough for interpolation to 1e-6 of the periapsis


class ModelOrbit(_Trajectory):
    """The Sun or the Earth about the Solar System barycenter: the series of `erfa.epv00`, good to 14 km."""

    kind: Literal["epv00"]
    target: Literal[10, 399]
    center: Literal[0] = 0
    source: str = "ERFA epv00 (Simon et al. series)"


Trajectory = Annotated[StateTable | KeplerOrbit | ModelOrbit, Field(discriminator="kind")]


class Window(_Strict):
    """A time during which the camera is held on something: targets, or a fixed direction."""

    start: Utc
    end: Utc
    step_s: PositiveFloat = 600.0
    track: tuple[BodyRef, ...] = ()  # several: the middle of their directions
    ra_deg: float | None = None
    dec_deg: Annotated[float, Field(ge=-90.0, le=90.0)] | None = None
    twist_deg: float = 0.0  # position angle of increasing line, east of J2000 north
    offset_px: tuple[float, float] = (0.0, 0.0)  # pixel, line of what is tracked, from the boresight

    @model_validator(mode="after")
    def _one_aim(self) -> Self:
        if self.end <= self.start:
            raise ValueError(f"end {self.end.isoformat()} is not after start {self.start.isoformat()}")
        fixed = self.ra_deg is not None and self.dec_deg is not None
        if fixed == bool(self.track) or (self.ra_deg is None) != (self.dec_deg is None):
            raise ValueError("give either track or both of ra_deg and dec_deg")
        return self


class AttitudeError(_Strict):
    """How the flown attitude differs from the predicted one; see `delta_pixel, delta_line, delta_twist`."""

    shift_px: tuple[float, float] = (0.0, 0.0)  # where the boresight's sky moves on the detector
    twist_deg: float = 0.0


class Pointing(_Strict):
    """The plan for one camera; what carries it follows."""

    instrument: BodyName
    windows: Annotated[tuple[Window, ...], Field(min_length=1)]
    actual: AttitudeError | None = None


class Scenario(_Strict):
    """A whole scenario; see `load_scenario`."""

    mission: str
    name: FileStem  # of the metakernel and the other files
    description: str = ""
    span: Span
    spacecraft: Spacecraft
    clock: Clock
    frames: tuple[FixedFrame, ...] = ()
    instruments: Annotated[tuple[Instrument, ...], Field(min_length=1)]
    bodies: Annotated[tuple[Body, ...], Field(min_length=1)]
    trajectories: Annotated[tuple[Trajectory, ...], Field(min_length=1)]
    pointing: Pointing

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for check in (self._check_frames, self._check_references, self._check_windows):
            check()
        return self

    def _check_frames(self) -> None:
        known = {self.spacecraft.frame.name}
        for i, frame in enumerate(self.frames):
            if frame.relative_to not in known:
                raise ValueError(f"frames.{i}.relative_to: {frame.relative_to} is neither the bus frame nor listed before")
            known.add(frame.name)
        for i, instrument in enumerate(self.instruments):
            if instrument.frame not in known:
                raise ValueError(f"instruments.{i}.frame: {instrument.frame} is not one of {sorted(known)}")

    def _check_references(self) -> None:
        references = [
            (f"trajectories.{i}.{field}", getattr(t, field))
            for i, t in enumerate(self.trajectories)
            for field in ("target", "center")
        ]
        references += [
            (f"pointing.windows.{i}.track", r) for i, w in enumerate(self.pointing.windows) for r in w.track
        ]
        for place, reference in references:
            if isinstance(reference, str) and reference.upper() not in self.body_ids:
                raise ValueError(f"{place}: {reference!r} is not a body of this scenario, nor a NAIF id")
        if self.spacecraft.id not in {self.body_id(t.target) for t in self.trajectories}:
            raise ValueError(f"trajectories: none has the spacecraft {self.spacecraft.id} as target")

    def _check_windows(self) -> None:
        if self.pointing.instrument not in {i.name for i in self.instruments}:
            raise ValueError(f"pointing.instrument: {self.pointing.instrument} is not among the instruments")
        last = self.span.start
        for i, window in enumerate(self.pointing.windows):
            if window.start < last:
                raise ValueError(f"pointing.windows.{i}.start: before the span or inside the window before")
            last = window.end
        if last > self.span.end:
            raise ValueError(f"pointing.windows.{len(self.pointing.windows) - 1}.end: after the end of the span")

    @property
    def body_ids(self) -> dict[str, int]:
        """NAIF ids by name; the spacecraft and its bodies, with their aliases."""
        things: tuple[Spacecraft | Body, ...] = (self.spacecraft, *self.bodies)
        return {name: thing.id for thing in things for name in (thing.name, *thing.aliases)}

    def body_id(self, reference: BodyRef) -> int:
        """Return the NAIF id of a name or id."""
        return reference if isinstance(reference, int) else self.body_ids[reference.upper()]

    @property
    def pointed_instrument(self) -> Instrument:
        """The instrument that the pointing plan is for."""
        return next(i for i in self.instruments if i.name == self.pointing.instrument)


def load_scenario(source: Mapping[str, Any] | Path | str) -> Scenario:
    """Read and check a scenario.

    Parameters
    ----------
    source : mapping, Path or str
        The content, or the YAML file that holds it.

    Raises
    ------
    MissionError
        The file cannot be read, or a field is missing, unknown or wrong; the message names the field.

    Examples
    --------
    >>> load_scenario({"mission": "m", "name": "bad name"})
    Traceback (most recent call last):
    opnav_workbench.errors.MissionError: scenario: name: String should match pattern ...
    """
    label = "scenario" if isinstance(source, Mapping) else f"scenario {source}"
    content = source if isinstance(source, Mapping) else _read_yaml(Path(source), label)
    try:
        return Scenario.model_validate(content)
    except ValidationError as error:
        raise MissionError(f"{label}: {_summary(error)}") from error


def _read_yaml(path: Path, label: str) -> Any:
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MissionError(f"{label}: cannot be read: {error.strerror}; check the path.") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        raise MissionError(f"{label}: is not YAML: {reason}") from error


def _summary(error: ValidationError) -> str:
    problems = error.errors(include_url=False)
    shown = [_problem(p["loc"], p["msg"]) for p in problems[:ERRORS_SHOWN]]
    more = len(problems) - len(shown)
    return "; ".join(shown) + (f"; and {more} more" if more else "")


def _problem(location: tuple[int | str, ...], message: str) -> str:
    # pydantic inserts the name of the chosen union member, which is no field of the file
    fields = [str(part) for part in location if part not in {"states", "kepler", "epv00"}]
    text = message.removeprefix("Value error, ")
    return f"{'.'.join(fields)}: {text}" if fields else text
