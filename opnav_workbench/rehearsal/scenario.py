"""Scenarios of operational readiness tests (ORT): what a team rehearses, and what the director hides from it.

A scenario names a mission, predicted kernels, the picture sequence, what the team shall estimate and how well that
is known before, and the perturbations. Those are stated, each as a number or as a distribution that a rehearsal's
seed draws from, so that a team that has read the file still does not know its case. Their names are those of
Jackman & Dumont, AAS 13-443: target barycenter, time of flight, B-plane target, spacecraft ephemeris, attitude,
albedo, camera, lost images, cosmic rays. Ready ones stand in ``kernels_meta/<mission>/rehearsals`` and are called
``<mission>/<name>``; those files are examples of the schema.
"""

from collections.abc import Mapping, Sequence
from datetime import timedelta
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import (
    BeforeValidator,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    field_validator,
    model_validator,
)

from opnav_workbench.errors import EstimationError, MissionError
from opnav_workbench.estimation.parameters import parse_groups
from opnav_workbench.paths import is_file
from opnav_workbench.simulation.effects import DetectorEffects
from opnav_workbench.simulation.scenario import require_short_series
from opnav_workbench.simulation.scenario_file import (
    BodyAppearance,
    ScenarioFile,
    ShapeFile,
    require_distinct,
)
from opnav_workbench.yaml_file import Also, FileStem, StrictModel, Utc, check_model

__all__ = [
    "Distribution",
    "OrbitTask",
    "OrtEntry",
    "OrtPerturbations",
    "OrtScenario",
    "load_ort_scenario",
    "ort_scenario_names",
]


# ---- How a rehearsal's scenario states its perturbations.


class Distribution(StrictModel):
    """A number to draw: normal with a sigma, or uniform between two ends; `either_sign` lets the seed turn its sign."""

    normal: PositiveFloat | None = None
    mean: float = 0.0
    uniform: tuple[float, float] | None = None
    either_sign: bool = False

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if (self.normal is None) == (self.uniform is None):
            raise ValueError("give normal (a sigma) or uniform (two ends)")
        if self.uniform is not None and (self.uniform[1] < self.uniform[0] or self.mean):
            raise ValueError("uniform takes its two ends, the lower first, and no mean")
        return self


def _bare_number(value: Any) -> Any:
    """Let a bare number stand for a distribution without width."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return {"uniform": (value, value)}
    return value


Amount = Annotated[Distribution, BeforeValidator(_bare_number), Also(("number",))]
Three = tuple[Amount, Amount, Amount]
NOTHING = Distribution(uniform=(0.0, 0.0))


class TargetShift(StrictModel):
    """Moves the target's barycenter, and all that belongs to it, from where the predicted kernels have it."""

    body: Annotated[str, Field(min_length=1)]
    toward_sun_km: Amount = NOTHING
    any_direction_km: Amount = NOTHING  # a length, in a direction that the seed draws
    position_km: Three = (NOTHING,) * 3  # J2000
    velocity_km_s: Three = (NOTHING,) * 3

    def moves_position(self) -> bool:
        """Return whether a position is off at the epoch."""
        return _given((self.toward_sun_km, self.any_direction_km, *self.position_km))


class SpacecraftError(StrictModel):
    """True minus predicted state of the spacecraft at the epoch."""

    any_direction_km: Amount = NOTHING
    position_km: Three = (NOTHING,) * 3  # J2000
    velocity_km_s: Three = (NOTHING,) * 3

    def moves_position(self) -> bool:
        """Return whether a position is off at the epoch."""
        return _given((self.any_direction_km, *self.position_km))


class BPlaneShift(StrictModel):
    """Moves the spacecraft's incoming asymptote across, in the axes of the predicted B-plane."""

    b_dot_t_km: Amount = NOTHING
    b_dot_r_km: Amount = NOTHING


class AttitudePerturbation(StrictModel):
    """True against predicted attitude; where it is left out, an error of the camera's a priori size."""

    shift_px: Amount = NOTHING  # length, in a direction that the seed draws
    twist_deg: Amount = NOTHING
    every_picture: bool = True  # an error of its own for each picture; else one for all
    held_s: NonNegativeFloat = 0.0  # pictures that follow one another within this share their error


class BodyError(StrictModel):
    """True against believed orientation of the body in orbit about it, and the team's map against its true surface."""

    pole_deg: tuple[Amount, Amount] = (NOTHING, NOTHING)  # toward east and north
    meridian_deg: Amount = NOTHING  # at the epoch
    spin: Amount = NOTHING  # of the rate, as a part of it
    map_scale: Three = (NOTHING,) * 3  # the map is too large by this part along each axis


class AlbedoError(StrictModel):
    """A mottled surface where the team has a uniform one, and light that is not the predicted."""

    bodies: Annotated[tuple[str, ...], Field(min_length=1)]
    dark: Annotated[float, Field(ge=0.0, le=2.0)] = 0.2
    bright: Annotated[float, Field(gt=0.0, le=2.0)] = 0.8
    features: PositiveInt | None = None  # number and sizes of patches; None: those of a mottled map
    smallest_deg: PositiveFloat | None = None
    largest_deg: PositiveFloat | None = None

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.bright <= self.dark:
            raise ValueError(f"bright {self.bright} is not above dark {self.dark}")
        return self


class CameraFault(StrictModel):
    """The true camera against the calibrated one."""

    focal_length: Amount = NOTHING  # relative: 1e-3 is a focal length longer by a thousandth
    corner_px: Amount = NOTHING  # radial (cubic) distortion that is not in the calibration, at the corners


class LostImages(StrictModel):
    """Pictures that never arrive, or only in part."""

    missing: NonNegativeInt = 0
    truncated: NonNegativeInt = 0
    spare: tuple[str, ...] = ()  # pictures that are never lost


class DataGaps(StrictModel):
    """Lines and blocks that telemetry loses in some of the pictures."""

    pictures: PositiveInt
    lines: NonNegativeInt = 0
    blocks: NonNegativeInt = 0
    block_px: PositiveInt = 32


class CosmicRayStorm(StrictModel):
    """A storm of energetic particles while some of the pictures are taken."""

    pictures: PositiveInt
    rate_per_cm2_s: Amount
    electrons_per_um: NonNegativeFloat = 80.0


class OrtPerturbations(StrictModel):
    """All of them; what is left out is as predicted."""

    target_barycenter: TargetShift | None = None
    spacecraft_ephemeris: SpacecraftError | None = None
    b_plane_target: BPlaneShift | None = None
    time_of_flight_s: Amount = NOTHING  # positive: the spacecraft arrives later than predicted
    attitude: AttitudePerturbation | None = None
    albedo: AlbedoError | None = None
    body: BodyError | None = None
    camera: CameraFault | None = None
    lost_images: LostImages | None = None
    data_gaps: DataGaps | None = None
    cosmic_ray_storm: CosmicRayStorm | None = None
    stars: bool = True  # off by what their catalog leaves open, as in flight; the same way in every picture

    def moved(self) -> tuple[str, ...]:
        """Return the estimator's parameters that they change."""
        groups: list[str] = []
        for mover, error in (("target", self.target_barycenter), ("spacecraft", self.spacecraft_ephemeris)):
            if error is not None:
                groups += [f"{mover}_position"] if error.moves_position() else []
                groups += [f"{mover}_velocity"] if _given(error.velocity_km_s) else []
        flyby = self.b_plane_target is not None or _given((self.time_of_flight_s,))
        return tuple(dict.fromkeys([*groups, *(["spacecraft_position"] if flyby else [])]))


def _given(amounts: Sequence[Distribution]) -> bool:
    return any(amount != NOTHING for amount in amounts)


# ---- Scenarios of operational readiness tests (ORT).

Sigma = PositiveFloat | tuple[PositiveFloat, PositiveFloat, PositiveFloat]


class OrtPointing(StrictModel):
    """Where the commanded attitude puts a target, in place of the attitude that the kernels have."""

    target: str | None = None  # None: the first of the picture's targets
    offset_px: tuple[float, float] = (0.0, 0.0)  # of the target from the boresight: pixel, line
    twist_deg: float = 0.0


class OrtEntry(StrictModel):
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
        if self.start is not None and self.step_s is not None and self.count is not None:
            require_short_series(self.start, self.step_s, self.count)
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


class OrbitTask(StrictModel):
    """A rehearsal in orbit: the map of the body that the team gets, and how well body and map are known.

    The map is made of the true surface: smoothed, stretched, its landmarks' places scattered.
    """

    body: Annotated[str, Field(min_length=1)]
    spacing_km: PositiveFloat  # between landmarks, at least
    sample_km: PositiveFloat  # between samples of a maplet
    samples: Annotated[int, Field(ge=15, le=201)] = 41  # along a side of a maplet, odd
    detail_km: PositiveFloat  # what is finer is not in the map
    place_sigma_km: PositiveFloat  # of each landmark's place, each axis
    pole_sigma_deg: PositiveFloat
    meridian_sigma_deg: PositiveFloat  # at the epoch
    spin_sigma: PositiveFloat  # of the rate, as a part of it
    map_sigma: PositiveFloat  # of the map's size along each axis, as a part of it
    predict_hours: PositiveFloat = 24.0  # after the last picture, for when the spacecraft's place is asked

    @model_validator(mode="after")
    def _odd(self) -> Self:
        if self.samples % 2 == 0:
            raise ValueError(
                f"samples {self.samples} is even; a maplet has a middle sample, give an odd number"
            )
        return self


ORBIT_PARAMETERS = ("spacecraft_position", "spacecraft_velocity")


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
    b_plane: str | None = None  # body whose B-plane the flyby is told in
    orbit: OrbitTask | None = None  # in place of a flyby
    parameters: Annotated[dict[str, Sigma], Field(min_length=1)]  # to estimate, with a priori sigmas
    epoch: Utc | None = None  # of the corrected states; None: the last picture
    due_hours: PositiveFloat = 24.0  # after the last picture is received
    deliver: tuple[str, ...] = ()  # beside what every rehearsal asks for
    bodies: tuple[BodyAppearance, ...] = ()  # how they truly look
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
    def _flyby_or_orbit(self) -> Self:
        if (self.b_plane is None) == (self.orbit is None):
            raise ValueError("give b_plane (of a flyby) or orbit, one of them")
        p = self.perturbations
        if self.orbit is None:
            if p.body is not None:
                raise ValueError("perturbations.body goes with orbit: a flyby's team does not solve for it")
            return self
        if set(self.parameters) != set(ORBIT_PARAMETERS) or any(
            isinstance(sigma, tuple) for sigma in self.parameters.values()
        ):
            raise ValueError(
                f"parameters: with orbit give {' and '.join(ORBIT_PARAMETERS)}, one sigma each for all axes"
            )
        if p.target_barycenter is not None or p.b_plane_target is not None or _given((p.time_of_flight_s,)):
            raise ValueError(
                "target_barycenter, b_plane_target and time_of_flight_s go with a flyby, not with orbit"
            )
        return self

    @property
    def center(self) -> str:
        """Body that the spacecraft's state is told from."""
        return self.orbit.body if self.orbit is not None else str(self.b_plane)

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

    def with_shape(self, file: Path, unit: str = "km") -> "OrtScenario":
        """Return a scenario in orbit with the surface of a shape model in place of a made one.

        Raises
        ------
        MissionError
            It is no scenario in orbit, or there is no such file.
        """
        if self.orbit is None:
            raise MissionError("a shape goes with a rehearsal in orbit, such as osiris_rex/bennu_orbit.")
        if not is_file(file):
            raise MissionError(f"shape of {self.orbit.body}: there is no file {file}.")
        found = check_model({"file": str(file.absolute()), "unit": unit}, ShapeFile, "shape", MissionError)
        body = self.orbit.body.upper()
        bodies = tuple(
            one if one.name.upper() != body else one.model_copy(update={"shape": found, "terrain": None})
            for one in self.bodies
        )
        return self.model_copy(update={"bodies": bodies}).at_path(self.path)

    def _fewer(self, kept: tuple[OrtEntry, ...]) -> dict[str, Any]:
        content = self.perturbations.model_dump()
        lost = content["lost_images"]
        if lost is not None:
            names = {picture.name for picture in kept}
            lost["spare"] = tuple(name for name in lost["spare"] if name in names)
            room = max(0, min((len(kept) - 1) // 2, len(kept) - len(lost["spare"])))
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
