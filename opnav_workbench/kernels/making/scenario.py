"""Scenario files: a mission's trajectories and pointing plan, and the whole, as far as SPICE kernels say it.

A scenario is a YAML file, or the mapping read from one, of plain numbers; `make_kernels` makes kernels of it. Calendar
times are UTC; tables of states and orbit epochs are TDB unless they say otherwise; `start`, `end` and maneuvers of a
trajectory are UTC.

A window of the pointing plan holds the camera on targets or on a fixed direction; a pattern (mosaic, list of offsets,
scan) moves it about that. How the flown attitude differs from the plan stands under `actual`::

    pointing:
      instrument: NAVCAM
      windows:
      - {start: 2031-03-01T01:00:00, end: 2031-03-01T02:00:00, track: [ROCK], twist_deg: 30}
      - start: 2031-03-01T03:00:00
        end: 2031-03-01T03:30:00
        track: [ROCK]
        mosaic: {columns: 3, rows: 2, overlap: 0.1, dwell_s: 60, slew_s: 30}
      - {start: ..., end: ..., ra_deg: 200, dec_deg: -40, scan: {rate_deg_s: 0.01, position_angle_deg: 90}}
      actual:
        shift_px: [14.3, -9.6]
        twist_deg: 0.06
        drift_px_h: [0.2, 0.0]
        jitter: [{axis: line, frequency_hz: 2.5, amplitude_px: 0.3}]
        spectra: [{axis: pixel, unit: urad, psd: [[0.1, 4.0], [10, 0.02]], rms: 1.5}]
        jitter_windows: [{start: 2031-03-01T01:30:00, end: 2031-03-01T01:30:20}]
        seed: 1
"""

from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from os import PathLike
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, NonNegativeInt, PositiveFloat, PositiveInt, model_validator

from opnav_workbench.errors import MissionError
from opnav_workbench.kernels.making.forces import EPHEMERIS_NAMES
from opnav_workbench.kernels.making.scenario_parts import (
    Body,
    BodyName,
    BodyRef,
    Clock,
    FixedFrame,
    FrameName,
    Instrument,
    JulianDate,
    RelativePath,
    Spacecraft,
    Span,
    Tdb,
)
from opnav_workbench.yaml_file import FileStem, Pair, StrictModel, Utc, Vector3, check_model, read_model

__all__ = [
    "AttitudeError",
    "ElementsOrbit",
    "EphemerisExcerpt",
    "Forces",
    "JitterLine",
    "JitterSpectrum",
    "KeplerOrbit",
    "ModelOrbit",
    "Mosaic",
    "OffsetList",
    "PointingWindow",
    "PropagatedOrbit",
    "Scan",
    "Scenario",
    "StateFile",
    "StateTable",
    "Trajectory",
    "load_scenario",
]


# ---- Trajectories in a scenario file.

StateRow = tuple[Tdb, float, float, float, float, float, float]
StateVector = tuple[float, float, float, float, float, float]
Epoch = JulianDate | Tdb


class _Arc(StrictModel):
    """One body's motion; `start` and `end` cut an arc out, so that a body can have several."""

    target: BodyRef
    source: str
    frame: FrameName = "J2000"
    start: Utc | None = None  # none: the span of the scenario, and a day around it
    end: Utc | None = None
    spk_type: Literal[9, 13] = 13  # Lagrange (positions and velocities apart) or Hermite (together)

    @model_validator(mode="after")
    def _forward(self) -> Self:
        if self.start is not None and self.end is not None and self.end <= self.start:
            raise ValueError(f"end {self.end.isoformat()} is not after start {self.start.isoformat()}")
        return self

    def references(self) -> Iterator[tuple[str, BodyRef]]:
        """Yield the bodies that the trajectory names, each with the field that names it."""
        for field in ("target", "center"):
            body = getattr(self, field)
            if body is not None:
                yield field, body
        for i, body in enumerate(getattr(self, "perturbers", None) or ()):
            yield f"perturbers.{i}", body


class _Trajectory(_Arc):
    center: BodyRef


class StateTable(_Trajectory):
    """States at epochs, between which SPICE interpolates."""

    kind: Literal["states"]
    time_scale: Literal["TDB", "UTC"] = "TDB"
    rows: Annotated[tuple[StateRow, ...], Field(min_length=2)]  # epoch, km, km/s

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for i, (a, b) in enumerate(pairwise(row[0] for row in self.rows)):
            if b <= a:
                raise ValueError(f"rows.{i + 1}: {b.isoformat()} is not after {a.isoformat()}")
        return self


class StateFile(_Trajectory):
    """States in a CSV file beside the scenario; see `state_tables.read_states` for its columns."""

    kind: Literal["table"]
    file: RelativePath


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


class EphemerisExcerpt(_Arc):
    """A planet, the Sun, the Moon or a barycenter, cut out of a planetary ephemeris without loss.

    With `center`, the state relative to that body, sampled; without, the file's own segments of the body and of the
    centers it refers to, down to the Solar System barycenter.
    """

    kind: Literal["ephemeris"]
    center: BodyRef | None = None
    source: str = "JPL DE440"
    file: str | None = None  # another SPK than DE440, beside the scenario or with a full path


class Radiation(StrictModel):
    """Solar radiation pressure on a sphere or a plate held towards the Sun."""

    area_m2: PositiveFloat
    mass_kg: PositiveFloat
    reflectivity: Annotated[float, Field(ge=0.0, le=2.0)] = 1.0  # 1 absorbs all light, 2 returns all of it


class Maneuver(StrictModel):
    """A sudden change of velocity, in the frame of the trajectory."""

    epoch: Utc
    delta_v_m_s: Vector3


class Forces(StrictModel):
    """What moves a body: gravity of point masses and, where they are given, smaller forces."""

    perturbers: tuple[BodyRef, ...] | None = None  # none: Sun, planets and Moon
    relativity: bool = True  # of the Sun
    radiation: Radiation | None = None
    transverse_au_d2: float = 0.0  # A2 at 1 au, falling with the square of the distance: Yarkovsky effect
    maneuvers: tuple[Maneuver, ...] = ()
    tolerance: Annotated[float, Field(ge=1e-13, le=1e-6)] = 1e-13  # relative, of one integration step

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        for i, (a, b) in enumerate(pairwise(m.epoch for m in self.maneuvers)):
            if b <= a:
                raise ValueError(f"maneuvers.{i + 1}.epoch: {b.isoformat()} is not after {a.isoformat()}")
        return self


class PropagatedOrbit(_Trajectory, Forces):
    """An orbit integrated from one state, forward and backward."""

    kind: Literal["propagated"]
    epoch: Epoch
    state: StateVector
    units: Literal["km", "au"] = "km"  # km and km/s, or au and au/day


class ElementsOrbit(_Trajectory, Forces):
    """A small body from osculating elements as the MPC and JPL print them; propagated, or as a fixed ellipse."""

    kind: Literal["elements"]
    center: Literal[10, "SUN"] = 10
    frame: FrameName = "ECLIPJ2000"
    epoch: Epoch
    perihelion_au: PositiveFloat | None = None
    semi_major_axis_au: PositiveFloat | None = None
    eccentricity: Annotated[float, Field(ge=0.0)]
    inclination_deg: float
    node_deg: float
    argument_deg: float  # of perihelion
    mean_anomaly_deg: float | None = None
    perihelion_time: Epoch | None = None
    propagation: Literal["n_body", "two_body"] = "n_body"

    @model_validator(mode="after")
    def _determined(self) -> Self:
        if (self.perihelion_au is None) == (self.semi_major_axis_au is None):
            raise ValueError("give either perihelion_au or semi_major_axis_au")
        if (self.mean_anomaly_deg is None) == (self.perihelion_time is None):
            raise ValueError("give either mean_anomaly_deg or perihelion_time")
        if self.eccentricity >= 1.0 and (self.perihelion_au is None or self.perihelion_time is None):
            raise ValueError("an open orbit is given by perihelion_au and perihelion_time")
        return self


Trajectory = Annotated[
    StateTable | StateFile | KeplerOrbit | ModelOrbit | EphemerisExcerpt | PropagatedOrbit | ElementsOrbit,
    Field(discriminator="kind"),
]


# ---- The pointing plan in a scenario file; calendar times are UTC.

MOST_PLACES = 10_000  # of a mosaic; more is a misprint
MICRO = 1e-6

Fraction = Annotated[float, Field(ge=0.0, lt=1.0)]
Axis = Literal["pixel", "line", "twist"]


class DwellPattern(StrictModel):
    """Places held one after the other from the window's start; the last one until the window's end."""

    dwell_s: PositiveFloat
    slew_s: PositiveFloat

    def duration_s(self, places: int) -> float:
        """Return how long so many places and the slews between them take."""
        return places * self.dwell_s + (places - 1) * self.slew_s


class Mosaic(DwellPattern):
    """A grid of fields around the aim, row by row."""

    columns: PositiveInt  # along pixel
    rows: PositiveInt  # along line
    overlap: Fraction = 0.0  # of the detector's width and height
    order: Literal["snake", "raster"] = "snake"  # there and back, or each row from its start

    @model_validator(mode="after")
    def _not_too_many(self) -> Self:
        if self.count > MOST_PLACES:
            raise ValueError(f"{self.columns} x {self.rows} places; {MOST_PLACES} at most")
        return self

    @property
    def count(self) -> int:
        """Number of places."""
        return self.columns * self.rows

    def places_px(self, n_pixel: int, n_line: int) -> Iterable[Pair]:
        """Return where the aim is put, px from the boresight, in order."""
        steps = (1.0 - self.overlap) * n_pixel, (1.0 - self.overlap) * n_line
        for row in range(self.rows):
            back = self.order == "snake" and row % 2 == 1
            for column in reversed(range(self.columns)) if back else range(self.columns):
                yield (
                    (column - (self.columns - 1) / 2) * steps[0],
                    (row - (self.rows - 1) / 2) * steps[1],
                )


class OffsetList(DwellPattern):
    """Fields at given offsets: where the aim is put, px from the boresight, one after the other."""

    list_px: Annotated[tuple[Pair, ...], Field(min_length=1, max_length=MOST_PLACES)]

    @property
    def count(self) -> int:
        """Number of places."""
        return len(self.list_px)

    def places_px(self, _n_pixel: int, _n_line: int) -> Iterable[Pair]:
        """Return the list."""
        return self.list_px


class Scan(StrictModel):
    """A turn at an even rate along a great circle, through the whole window.

    Either what is aimed at moves along `direction` (pixel, line) on the detector, or the boresight moves toward
    `position_angle_deg` (east of J2000 north, at the scan's start) on the sky.
    """

    rate_deg_s: PositiveFloat
    direction: Pair | None = None
    position_angle_deg: float | None = None
    start_px: Pair = (0.0, 0.0)  # where the aim is at the start

    @model_validator(mode="after")
    def _one_direction(self) -> Self:
        if (self.direction is None) == (self.position_angle_deg is None):
            raise ValueError("give either direction (on the detector) or position_angle_deg (on the sky)")
        if self.direction is not None and not np.any(self.direction):
            raise ValueError("direction [0, 0] points nowhere")
        return self


class PointingWindow(StrictModel):
    """A time during which the camera is held on something: targets, or a fixed direction."""

    start: Utc
    end: Utc
    step_s: PositiveFloat | None = None  # between attitudes; none: as close as `tolerance_rad` needs
    tolerance_rad: PositiveFloat = (
        1e-9  # error of even turns between the attitudes, while no slew is under way
    )
    track: tuple[BodyRef, ...] = ()  # several: the middle of their directions
    ra_deg: float | None = None
    dec_deg: Annotated[float, Field(ge=-90.0, le=90.0)] | None = None
    twist_deg: float = 0.0  # position angle of increasing line, east of J2000 north
    offset_px: Pair = (0.0, 0.0)  # pixel, line of what is tracked, from the boresight
    mosaic: Mosaic | None = None
    offsets: OffsetList | None = None
    scan: Scan | None = None

    @model_validator(mode="after")
    def _one_aim(self) -> Self:
        if self.end <= self.start:
            raise ValueError(f"end {self.end.isoformat()} is not after start {self.start.isoformat()}")
        fixed = self.ra_deg is not None and self.dec_deg is not None
        if fixed == bool(self.track) or (self.ra_deg is None) != (self.dec_deg is None):
            raise ValueError("give either track or both of ra_deg and dec_deg")
        return self

    @model_validator(mode="after")
    def _one_pattern(self) -> Self:
        if sum(p is not None for p in (self.mosaic, self.offsets, self.scan)) > 1:
            raise ValueError("give one of mosaic, offsets and scan")
        dwells, length = self.dwells, (self.end - self.start).total_seconds()
        if dwells is not None and dwells.duration_s(dwells.count) > length:
            raise ValueError(
                f"{dwells.count} places need {dwells.duration_s(dwells.count):g} s, the window has {length:g} s"
            )
        return self

    @property
    def dwells(self) -> Mosaic | OffsetList | None:
        """The pattern of places, if there is one."""
        return self.mosaic if self.mosaic is not None else self.offsets


class JitterLine(StrictModel):
    """One sine of the jitter: ``amplitude * cos(2 pi frequency t + phase)``, t from the span's start."""

    axis: Axis
    frequency_hz: PositiveFloat
    amplitude_px: PositiveFloat | None = None  # not for twist
    amplitude_urad: PositiveFloat | None = None
    phase_deg: float | None = None  # none: drawn from the seed

    @model_validator(mode="after")
    def _one_amplitude(self) -> Self:
        if (self.amplitude_px is None) == (self.amplitude_urad is None):
            raise ValueError("give either amplitude_px or amplitude_urad")
        if self.axis == "twist" and self.amplitude_px is not None:
            raise ValueError("a twist has no pixels; give amplitude_urad")
        return self

    def amplitude_rad(self, pixel_scale_rad: float) -> float:
        """Return the amplitude as an angle."""
        if self.amplitude_px is not None:
            return self.amplitude_px * pixel_scale_rad
        assert self.amplitude_urad is not None
        return self.amplitude_urad * MICRO


class JitterSpectrum(StrictModel):
    """Jitter by its one-sided power spectral density, as many sines of random phase."""

    axis: Axis
    unit: Literal["px", "urad"]
    psd: Annotated[tuple[tuple[PositiveFloat, PositiveFloat], ...], Field(min_length=2)]  # Hz, unit^2/Hz
    rms: PositiveFloat | None = None  # scales the whole to this, in `unit`
    terms: Annotated[int, Field(ge=1, le=4096)] = 64

    @model_validator(mode="after")
    def _increasing(self) -> Self:
        if any(b[0] <= a[0] for a, b in pairwise(self.psd)):
            raise ValueError("psd: the frequencies must increase")
        if self.axis == "twist" and self.unit == "px":
            raise ValueError("a twist has no pixels; give urad")
        return self

    def unit_rad(self, pixel_scale_rad: float) -> float:
        """Return the angle of one `unit`."""
        return pixel_scale_rad if self.unit == "px" else MICRO


class AttitudeError(StrictModel):
    """How the flown attitude differs from the predicted one; see `delta_pixel, delta_line, delta_twist`."""

    shift_px: Pair = (0.0, 0.0)  # where the boresight's sky moves on the detector
    twist_deg: float = 0.0
    drift_px_h: Pair = (0.0, 0.0)  # growth of the shift per hour since the span's start
    drift_twist_deg_h: float = 0.0
    jitter: tuple[JitterLine, ...] = ()
    spectra: tuple[JitterSpectrum, ...] = ()
    jitter_windows: tuple[
        Span, ...
    ] = ()  # jitter, and attitudes close enough for it, in these only; none: always
    jitter_tolerance_px: PositiveFloat = (
        1e-3  # error of even turns between attitudes: below any center's error
    )
    fade_s: Annotated[float, Field(ge=0.01)] = (
        1.0  # within which jitter swells before such a window, and dies after it
    )
    seed: NonNegativeInt = 0

    @property
    def drifts(self) -> bool:
        """Whether the error grows with time."""
        return any((*self.drift_px_h, self.drift_twist_deg_h))

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for i, (before, after) in enumerate(pairwise(self.jitter_windows)):
            if (after.start - before.end).total_seconds() <= 2.0 * self.fade_s:
                raise ValueError(
                    f"jitter_windows.{i + 1}: starts less than {2.0 * self.fade_s:g} s (twice fade_s) after the "
                    "end of the one before; put them in order, or join them"
                )
        return self


class Pointing(StrictModel):
    """The plan for one camera; what carries it follows."""

    instrument: BodyName
    windows: Annotated[tuple[PointingWindow, ...], Field(min_length=1)]
    actual: AttitudeError | None = None


# ---- Scenario files.


class Scenario(StrictModel):
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
                raise ValueError(
                    f"frames.{i}.relative_to: {frame.relative_to} is neither the bus nor listed before it"
                )
            known.add(frame.name)
        for i, instrument in enumerate(self.instruments):
            if instrument.frame not in known:
                raise ValueError(f"instruments.{i}.frame: {instrument.frame} is not one of {sorted(known)}")

    def _check_references(self) -> None:
        references = [
            (f"trajectories.{i}.{field}", body)
            for i, t in enumerate(self.trajectories)
            for field, body in t.references()
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
            raise ValueError(
                f"pointing.windows.{len(self.pointing.windows) - 1}.end: after the end of the span"
            )

    @property
    def body_ids(self) -> dict[str, int]:
        """NAIF ids by name: the planets' ephemeris, and the spacecraft and the bodies with their aliases."""
        things: tuple[Spacecraft | Body, ...] = (self.spacecraft, *self.bodies)
        own = {name: thing.id for thing in things for name in (thing.name, *thing.aliases)}
        return EPHEMERIS_NAMES | own

    def body_id(self, reference: BodyRef) -> int:
        """Return the NAIF id of a name or id."""
        return reference if isinstance(reference, int) else self.body_ids[reference.upper()]

    def names_of(self, body_id: int) -> frozenset[str]:
        """Return what a body may be called in a table: its names here, and its number."""
        return frozenset(name for name, number in self.body_ids.items() if number == body_id) | {str(body_id)}

    @property
    def pointed_instrument(self) -> Instrument:
        """The instrument that the pointing plan is for."""
        return next(i for i in self.instruments if i.name == self.pointing.instrument)


def load_scenario(source: Mapping[str, Any] | PathLike[str] | str) -> Scenario:
    """Read and check a scenario.

    Parameters
    ----------
    source : mapping or path
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
    if isinstance(source, Mapping):
        return check_model(source, Scenario, "scenario", MissionError)
    return read_model(source, Scenario, "scenario", MissionError)
