"""The planner's desk: mission, catalog and surfaces opened once, and what each planned picture is made of.

Flow   sequence -> `Desk` -> attitude, stray light -> `PictureInputs`, the very input of a simulated picture

A planned picture is a simulated one that is not exposed: stars, bodies, optics and detector are those of
`opnav_workbench.simulation`, so that a plan and a rehearsal cannot disagree about them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import TargetState
from opnav_workbench.camera import Camera
from opnav_workbench.errors import OpNavError
from opnav_workbench.geometry import (
    angle_between,
    apparent_direction,
    quaternion_from_matrix,
    unit,
    unit_from_radec,
)
from opnav_workbench.planning.sequence import PictureSequence
from opnav_workbench.planning.sequence_parts import PlannedPicture, Pointing
from opnav_workbench.scene import body_target, observer_from_kernels
from opnav_workbench.simulation import DetectorEffects, PictureInputs, Task, Workshop
from opnav_workbench.simulation.effects import Sky
from opnav_workbench.simulation.scenario_parts import ActualAttitude, AttitudePlan, PredictedAttitude
from opnav_workbench.spice import body_id, camera_attitude, et_from_utc, state
from opnav_workbench.spice.aiming import aim
from opnav_workbench.yaml_file import Location

__all__ = ["Desk", "reason_of"]

SUN = 10


@dataclass(frozen=True, slots=True, eq=False)
class Desk:
    """A sequence with everything opened that its pictures share; use it inside an active `KernelSet`."""

    sequence: PictureSequence
    workshop: Workshop

    @classmethod
    def open(cls, sequence: PictureSequence) -> "Desk":
        """Open mission, catalog and surfaces, and look every body's name up.

        Raises
        ------
        MissionError
            One of them is not there or not known; the message names the line of the sequence.
        """
        scenario = sequence.scenario()
        try:
            workshop = Workshop.open(scenario)
        except OpNavError as error:
            text = str(error)
            raise type(error)(text.replace("picture scenario", "picture sequence", 1)) from error
        _check_names(sequence)
        return cls(sequence, workshop)

    def targets(self, picture: PlannedPicture) -> tuple[str, ...]:
        """Return the names of the bodies that a picture is to measure."""
        named = self.sequence.targets if picture.targets is None else picture.targets
        return self.workshop.mission.default_targets if named is None else named

    def drawn(self, picture: PlannedPicture) -> tuple[str, ...]:
        """Return the bodies that are drawn: the targets, and those whose looks the sequence describes."""
        names = dict.fromkeys(name.upper() for name in self.targets(picture))
        return tuple(names | dict.fromkeys(body.name.upper() for body in self.sequence.bodies))

    def camera(self, picture: PlannedPicture) -> Camera:
        """Return a picture's camera; raises CameraError or MissionError where photometry is not known."""
        return self._of(picture, np.eye(3)).camera(_task(picture))

    def et(self, picture: PlannedPicture) -> float:
        """Return mid-exposure, TDB s past J2000."""
        assert picture.utc is not None  # a series has been expanded
        return et_from_utc(picture.utc.isoformat())

    def pointing(self, picture: PlannedPicture) -> Pointing:
        """Return where a picture shall look."""
        return picture.pointing or self.sequence.pointing

    def attitude(self, picture: PlannedPicture, camera: Camera, et: float) -> FloatArray:
        """Return ``camera_from_j2000`` (3, 3) as planned.

        Raises
        ------
        KernelError
            The kernels do not have the attitude, or a body that is tracked.
        """
        pointing = self.pointing(picture)
        if pointing.kernels:
            return camera_attitude(camera.frame, et)
        if pointing.track:
            direction = unit(np.sum([self.direction(name, et) for name in pointing.track], axis=0))
        else:
            assert pointing.ra_deg is not None
            assert pointing.dec_deg is not None
            direction = unit_from_radec(math.radians(pointing.ra_deg), math.radians(pointing.dec_deg))
        offset = np.asarray(pointing.offset_px) * camera.pixel_scale_rad
        return aim(direction, math.radians(pointing.twist_deg), camera.focal_from_camera, offset)

    def direction(self, name: str, et: float) -> FloatArray:
        """Return a body's apparent direction (3,), J2000."""
        spacecraft = self.workshop.mission.spacecraft_id
        observer = observer_from_kernels(spacecraft, et)
        return apparent_direction(body_target(name, spacecraft, et).direction, observer.velocity_km_s)

    def target(self, name: str, et: float) -> TargetState:
        """Return a body as the spacecraft sees it."""
        return body_target(name, self.workshop.mission.spacecraft_id, et)

    def elongation_deg(self, direction: FloatArray, et: float) -> float:
        """Return the angle between a direction (3,) and the Sun, seen from the spacecraft."""
        sun = state(SUN, et, self.workshop.mission.spacecraft_id, correction="CN").position_km
        return float(np.degrees(angle_between(sun, direction)))

    def stray_light_dn_s(self, elongation_deg: float) -> float:
        """Return the stated level of scattered sunlight at an elongation; 0 where the sequence states none."""
        table = np.asarray(self.sequence.sun.stray_light_dn_s, dtype=np.float64)
        if not table.size:
            return 0.0
        level = np.log(np.maximum(table[:, 1], 1e-30))
        return float(np.exp(np.interp(elongation_deg, table[:, 0], level)))

    def inputs(self, picture: PlannedPicture, *, seed_name: str = "") -> PictureInputs:
        """Collect what a planned picture is made of.

        Parameters
        ----------
        picture : PlannedPicture
        seed_name : str
            Another name for other noise, of pictures that confirm the plan.

        Raises
        ------
        OpNavError
            The kernels do not cover it, or its camera or bodies lack numbers.
        """
        camera, et = self.camera(picture), self.et(picture)
        attitude = self.attitude(picture, camera, et)
        elongation = self.elongation_deg(attitude.T @ camera.boresight, et)
        named = picture if not seed_name else picture.model_copy(update={"name": seed_name})
        inputs = self._of(named, attitude).inputs(_task(named, self.drawn(picture)))
        stray = self.stray_light_dn_s(elongation) * camera.require("gain_e_per_dn")
        return replace(inputs, effects=_lit(inputs.effects, stray)) if stray else inputs

    def _of(self, picture: PlannedPicture, attitude: FloatArray) -> Workshop:
        """Return a workshop whose scenario has this picture alone, with its attitude."""
        w, x, y, z = (float(q) for q in quaternion_from_matrix(attitude))
        plan = AttitudePlan(
            predicted=PredictedAttitude(source="fixed", quaternion_camera_from_j2000=(w, x, y, z)),
            actual=ActualAttitude(source="none"),
            motion=self.sequence.motion,
        )
        update = {"attitude": plan, "pictures": (picture,)}
        return replace(self.workshop, scenario=self.workshop.scenario.model_copy(update=update))


def _task(picture: PlannedPicture, drawn: Sequence[str] | None = None) -> Task:
    return Task(0, picture if drawn is None else picture.model_copy(update={"targets": tuple(drawn)}))


def _lit(effects: DetectorEffects, rate_e_s: float) -> DetectorEffects:
    sky = effects.sky or Sky()
    return effects.model_copy(update={"sky": sky.model_copy(update={"rate_e_s": sky.rate_e_s + rate_e_s})})


def _check_names(sequence: PictureSequence) -> None:
    """Refuse names that nobody knows, wherever they stand."""
    places: list[tuple[Location, str]] = [
        (("targets", i), name) for i, name in enumerate(sequence.targets or ())
    ]
    places += [(("pointing", "track", i), name) for i, name in enumerate(sequence.pointing.track)]
    for k, picture in enumerate(sequence.pictures):
        places += [(("pictures", k, "targets", i), name) for i, name in enumerate(picture.targets or ())]
        tracked = picture.pointing.track if picture.pointing else ()
        places += [(("pictures", k, "pointing", "track", i), name) for i, name in enumerate(tracked)]
    places += [(("search", k, "target"), search.target) for k, search in enumerate(sequence.search)]
    for place, name in places:
        try:
            body_id(name)
        except OpNavError as error:
            raise sequence.fault(place, str(error)) from error


def reason_of(error: BaseException) -> str:
    """Return what an error says, without the place in a scenario that it was wrapped with."""
    cause = error.__cause__
    inner = cause if isinstance(cause, OpNavError) and str(cause) in str(error) else error
    return " ".join(str(inner).split())
