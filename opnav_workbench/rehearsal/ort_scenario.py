"""Scenarios of operational readiness tests (ORT): what a team rehearses, and what the director hides from it.

A scenario names a mission, predicted kernels, the picture sequence, what the team shall estimate and how well that is
known before, and the perturbations. Those are stated, or distributions that a rehearsal's seed draws from, so that a
team that has read the file still does not know its case. Ready ones stand in ``kernels_meta/<mission>/rehearsals`` and
are called ``<mission>/<name>``; those files are examples of the schema.
"""

from collections.abc import Mapping
from datetime import timedelta
from os import PathLike
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import Field, PositiveFloat, PositiveInt, field_validator, model_validator

from opnav_workbench.errors import EstimationError, MissionError
from opnav_workbench.estimation.parameters import parse_groups
from opnav_workbench.rehearsal.ort_perturb_schema import OrtPerturbations
from opnav_workbench.simulation.effects import DetectorEffects
from opnav_workbench.simulation.scenario_file import ScenarioFile, require_distinct
from opnav_workbench.simulation.scenario_surfaces import BodyOptions
from opnav_workbench.spice.scenario_parts import FileStem, Strict, Utc
from opnav_workbench.yaml_file import check_model

__all__ = ["OrtEntry", "OrtPointing", "OrtScenario", "load_ort_scenario", "ort_scenario_names"]

Sigma = PositiveFloat | tuple[PositiveFloat, PositiveFloat, PositiveFloat]


class OrtPointing(Strict):
    """Where the commanded attitude puts a target, in place of the attitude that the kernels have."""

    target: str | None = None  # None: the first of the picture's targets
    offset_px: tuple[float, float] = (0.0, 0.0)  # of the target from the boresight: pixel, line
    twist_deg: float = 0.0


class OrtEntry(Strict):
    """One picture at `utc`, or `count` pictures from `start` every `step_s` (named ``NAME_1``, ...)."""

    name: FileStem
    utc: Utc | None = None  # mid-exposure
    start: Utc | None = None
    step_s: PositiveFloat | None = None
    count: PositiveInt | None = None
    camera: str  # name of one of the mission's camera files
    exposure_s: PositiveFloat
    targets: tuple[str, ...] | None = None  # None: the scenario's
    pointing: OrtPointing | None = None  # None: as the kernels have it

    @model_validator(mode="after")
    def _one_time(self) -> Self:
        series = [value is not None for value in (self.start, self.step_s, self.count)]
        if (self.utc is not None) == any(series) or (any(series) and not all(series)):
            raise ValueError("give either utc, or start, step_s and count")
        return self

    @property
    def time(self) -> str:
        """Mid-exposure of a single picture, UTC."""
        assert self.utc is not None  # a series has been expanded
        return self.utc.isoformat(timespec="milliseconds")

    def expanded(self) -> tuple[Self, ...]:
        """Return the pictures of a series, each with its own name and time."""
        if self.start is None or self.step_s is None or self.count is None:
            return (self,)
        digits = len(str(self.count))
        none = {"start": None, "step_s": None, "count": None}
        return tuple(
            self.model_copy(
                update={
                    **none,
                    "name": f"{self.name}_{i + 1:0{digits}d}",
                    "utc": self.start + timedelta(seconds=i * self.step_s),
                }
            )
            for i in range(self.count)
        )


class OrtScenario(ScenarioFile):
    """A whole rehearsal; see the files in ``kernels_meta/<mission>/rehearsals``."""

    WHAT: ClassVar[str] = "rehearsal scenario"
    FOLDER: ClassVar[str] = "rehearsals"
    UNTITLED: ClassVar[str] = "rehearsal"
    title: str
    description: str  # what the team is told of the mission phase
    mission: str  # name or YAML file
    kernels: str  # predicted: kernel-set name, metakernel or folder; a relative path counts from this file
    catalog: str = "bundled"
    magnitude_limit: float = 30.0  # of catalog stars
    targets: Annotated[tuple[str, ...], Field(min_length=1)]
    b_plane: str  # body whose B-plane the flyby is told in
    parameters: Annotated[dict[str, Sigma], Field(min_length=1)]  # to estimate, with a priori sigmas
    epoch: Utc | None = None  # of the corrected states; None: the last picture
    due_hours: PositiveFloat = 24.0  # after the last picture is received
    deliver: tuple[str, ...] = ()  # beside what every rehearsal asks for
    bodies: tuple[BodyOptions, ...] = ()  # how they truly look
    detector: DetectorEffects = DetectorEffects()
    perturbations: OrtPerturbations = OrtPerturbations()
    pictures: Annotated[tuple[OrtEntry, ...], Field(min_length=1)]

    @field_validator("parameters")
    @classmethod
    def _known(cls, parameters: dict[str, Any]) -> dict[str, Any]:
        try:
            groups = parse_groups(tuple(parameters))
        except EstimationError as error:
            raise ValueError(str(error)) from error
        ranges = [group.name for group in groups if group.size == 1]
        if ranges:
            raise ValueError(f"{', '.join(ranges)}: a rehearsal estimates positions and velocities only")
        return parameters

    @field_validator("pictures")
    @classmethod
    def _pictures_once(cls, pictures: tuple[OrtEntry, ...]) -> tuple[OrtEntry, ...]:
        require_distinct([picture.name for entry in pictures for picture in entry.expanded()])
        return pictures

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        hidden = [name for name in self.perturbations.moved() if name not in self.parameters]
        if hidden:
            raise ValueError(
                f"parameters: the perturbations change {', '.join(hidden)}, which the team does not estimate; add it "
                "with its a priori sigma"
            )
        self._check_losses([picture.name for picture in self.sequence()])
        return self

    def _check_losses(self, names: list[str]) -> None:
        lost = self.perturbations.lost_images
        if lost is None:
            return
        unknown = sorted(set(lost.spare) - set(names))
        if unknown:
            raise ValueError(
                f"perturbations.lost_images.spare: no picture {', '.join(unknown)}; there are {', '.join(names)}"
            )
        if lost.missing + lost.truncated >= len(names) - len(lost.spare) + bool(lost.spare):
            raise ValueError(
                f"perturbations.lost_images: {lost.missing + lost.truncated} lost of {len(names)} pictures, "
                f"{len(lost.spare)} spared; at least one must arrive"
            )

    def sequence(self) -> tuple[OrtEntry, ...]:
        """Return all pictures, in the order of their times."""
        pictures = (picture for entry in self.pictures for picture in entry.expanded())
        return tuple(sorted(pictures, key=lambda p: (p.time, p.name)))

    def limited(self, count: int | None) -> "OrtScenario":
        """Return the scenario with at most `count` of its pictures, spread over the sequence, the last one among them.

        Lost pictures are no more than then make sense: one of each kind.
        """
        pictures = self.sequence()
        if count is None or count >= len(pictures):
            return self
        if count < 1:
            raise MissionError(f"{count} pictures; give 1 or more.")
        chosen = np.unique(np.rint(np.linspace(len(pictures) - 1, 0, count)).astype(int))
        kept = tuple(pictures[i] for i in chosen)
        return check_model(
            self.model_dump() | {"pictures": [p.model_dump() for p in kept]} | self._fewer(kept),
            OrtScenario,
            self.WHAT,
            MissionError,
        ).at_path(self.path)

    def _fewer(self, kept: tuple[OrtEntry, ...]) -> dict[str, Any]:
        content = self.perturbations.model_dump()
        lost = content["lost_images"]
        if lost is not None:
            names = {picture.name for picture in kept}
            lost["spare"] = tuple(name for name in lost["spare"] if name in names)
            room = max(0, (len(kept) - 1) // 2)
            lost["missing"] = min(lost["missing"], 1, room)
            lost["truncated"] = min(lost["truncated"], 1, room - lost["missing"])
        return {"perturbations": content}

    @property
    def epoch_utc(self) -> str:
        """Time of the corrected states."""
        return (
            self.sequence()[-1].time if self.epoch is None else self.epoch.isoformat(timespec="milliseconds")
        )


def ort_scenario_names() -> tuple[str, ...]:
    """Return the names ``<mission>/<name>`` of the ready rehearsals, sorted.

    Examples
    --------
    >>> "new_horizons/pluto_final_approach" in ort_scenario_names()
    True
    """
    return OrtScenario.ready_names()


def load_ort_scenario(source: str | PathLike[str] | Mapping[str, Any]) -> OrtScenario:
    """Read and check a rehearsal scenario.

    Parameters
    ----------
    source : str, path or mapping
        Name of a ready scenario, YAML file, or its content.

    Raises
    ------
    MissionError
        The name is unknown (the message lists the known), or the file breaks the schema: the message names the line,
        the field and what may stand there.

    Examples
    --------
    >>> load_ort_scenario("new_horizons/pluto_final_approach").b_plane
    'PLUTO BARYCENTER'
    """
    return OrtScenario.load(source)
