"""Trajectories in a scenario file.

Tables of states and orbit epochs are TDB unless they say otherwise; `start`, `end` and maneuvers are UTC.
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, PositiveFloat, model_validator

from opnav_workbench.spice.scenario_parts import (
    BodyRef,
    FrameName,
    JulianDate,
    RelativePath,
    Strict,
    Tdb,
    Utc,
    Vector3,
)

__all__ = [
    "ElementsOrbit",
    "EphemerisExcerpt",
    "Forces",
    "KeplerOrbit",
    "Maneuver",
    "ModelOrbit",
    "PropagatedOrbit",
    "StateFile",
    "StateTable",
    "Trajectory",
]

Row = tuple[Tdb, float, float, float, float, float, float]
State = tuple[float, float, float, float, float, float]
Epoch = JulianDate | Tdb
SUN: Literal[10] = 10


class _Arc(Strict):
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
    rows: Annotated[tuple[Row, ...], Field(min_length=2)]  # epoch, km, km/s

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for i, (a, b) in enumerate(pairwise(row[0] for row in self.rows)):
            if b <= a:
                raise ValueError(f"rows.{i + 1}: {b.isoformat()} is not after {a.isoformat()}")
        return self


class StateFile(_Trajectory):
    """States in a CSV file beside the scenario; see `trajectory_tables.read_states` for its columns."""

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


class Radiation(Strict):
    """Solar radiation pressure on a sphere or a plate held towards the Sun."""

    area_m2: PositiveFloat
    mass_kg: PositiveFloat
    reflectivity: Annotated[float, Field(ge=0.0, le=2.0)] = 1.0  # 1 absorbs all light, 2 returns all of it


class Maneuver(Strict):
    """A sudden change of velocity, in the frame of the trajectory."""

    epoch: Utc
    delta_v_m_s: Vector3


class Forces(Strict):
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
    state: State
    units: Literal["km", "au"] = "km"  # km and km/s, or au and au/day


class ElementsOrbit(_Trajectory, Forces):
    """A small body from osculating elements as the MPC and JPL print them; propagated, or as a fixed ellipse."""

    kind: Literal["elements"]
    center: Literal[10, "SUN"] = SUN
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
