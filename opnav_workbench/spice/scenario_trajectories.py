"""Trajectories in a scenario file.

Tables of states and orbit epochs are TDB unless they say otherwise.
"""

from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, PositiveFloat, model_validator

from opnav_workbench.spice.scenario_parts import BodyRef, FrameName, Strict, Tdb

__all__ = ["KeplerOrbit", "ModelOrbit", "StateTable", "Trajectory"]

Row = tuple[Tdb, float, float, float, float, float, float]


class _Trajectory(Strict):
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
            if b <= a:
                raise ValueError(f"rows.{i + 1}: {b.isoformat()} is not after {a.isoformat()}")
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
