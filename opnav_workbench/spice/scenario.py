"""Scenario files: what a mission, its bodies and its pictures' pointing are, as far as SPICE kernels say it.

A scenario is a YAML file, or the mapping read from one, of plain numbers; `make_kernels` makes kernels of it.
"""

from collections.abc import Mapping
from os import PathLike
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from opnav_workbench.errors import MissionError
from opnav_workbench.spice.planets import EPHEMERIS_NAMES
from opnav_workbench.spice.scenario_parts import (
    Body,
    BodyRef,
    Clock,
    FileStem,
    FixedFrame,
    Instrument,
    Spacecraft,
    Span,
    Strict,
)
from opnav_workbench.spice.scenario_pointing import Pointing
from opnav_workbench.spice.scenario_trajectories import Trajectory
from opnav_workbench.yaml_file import check_model, read_model

__all__ = ["Scenario", "load_scenario"]


class Scenario(Strict):
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
