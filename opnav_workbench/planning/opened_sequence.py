"""A sequence with mission, catalog and surfaces opened once, and what each planned picture is made of.

Flow   sequence -> `OpenedSequence` -> attitude, stray light -> `PictureInputs`, the very input of a simulated picture

A planned picture is a simulated one that is not exposed: stars, bodies, optics and detector are those of
`opnav_workbench.simulation`, so that a plan and a rehearsal cannot disagree about them.

`confirming_inputs` gives noise realisations of what was planned. What the plan counts as an error is one there: the
noise of the detector, and the catalog's errors, which a simulated sky otherwise does not have. The attitude may be
off from the planned one, as in flight.
"""

import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.catalog import StarTable
from opnav_workbench.constants import SUN_ID
from opnav_workbench.geometry import (
    angle_between,
    apparent_direction,
    quaternion_from_matrix,
    unit,
    unit_from_radec,
)
from opnav_workbench.geometry.aiming import aim
from opnav_workbench.kernels import KernelSet, body_id, camera_attitude, et_from_utc, state
from opnav_workbench.mission import Mission
from opnav_workbench.planning.sequence import PictureSequence, PlannedPicture, PlannedPointing
from opnav_workbench.scene import body_target, observer_from_kernels
from opnav_workbench.simulation import DetectorEffects, OpenedScenario, PictureInputs, ScenarioPicture
from opnav_workbench.simulation.effects import Sky
from opnav_workbench.simulation.scenario import ActualAttitude, AttitudePlan, PredictedAttitude
from opnav_workbench.simulation.scenario_file import FieldError
from opnav_workbench.simulation.true_state import shifted_attitude
from opnav_workbench.targets import TargetState
from opnav_workbench.yaml_file import Location

__all__ = ["OpenedSequence", "confirming_inputs", "open_sequence", "reason_of"]


# ---- Mission, catalog and surfaces opened once, and what each planned picture is made of.


@dataclass(frozen=True, slots=True, eq=False)
class OpenedSequence:
    """A sequence with everything opened that its pictures share; use it inside an active `KernelSet`."""

    sequence: PictureSequence
    opened_scenario: OpenedScenario

    @property
    def mission(self) -> Mission:
        """The sequence's mission."""
        return self.opened_scenario.mission

    @classmethod
    def open(cls, sequence: PictureSequence) -> "OpenedSequence":
        """Open mission, catalog and surfaces, and look every body's name up.

        Raises
        ------
        MissionError
            One of them is not there or not known; the message names the line of the sequence.
        """
        opened = cls(sequence, OpenedScenario.open(sequence.scenario()))
        _check_names(sequence)
        return opened

    def targets(self, picture: PlannedPicture) -> tuple[str, ...]:
        """Return the names of the bodies that a picture is to measure."""
        named = self.sequence.targets if picture.targets is None else picture.targets
        return self.mission.default_targets if named is None else named

    def bodies_drawn(self, picture: PlannedPicture) -> tuple[str, ...]:
        """Return the bodies that are drawn: the targets, and those whose looks the sequence describes."""
        names = dict.fromkeys(name.upper() for name in self.targets(picture))
        return tuple(names | dict.fromkeys(body.name.upper() for body in self.sequence.bodies))

    def camera(self, picture: PlannedPicture) -> Camera:
        """Return a picture's camera; raises CameraError or MissionError where photometry is not known."""
        return self._scenario_with(picture, np.eye(3)).camera(_scenario_picture(picture))

    def et(self, picture: PlannedPicture) -> float:
        """Return mid-exposure, TDB s past J2000."""
        assert picture.utc is not None  # a series has been expanded
        return et_from_utc(picture.utc.isoformat())

    def pointing(self, picture: PlannedPicture) -> PlannedPointing:
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
        spacecraft = self.mission.spacecraft_id
        observer = observer_from_kernels(spacecraft, et)
        return apparent_direction(body_target(name, spacecraft, et).direction, observer.velocity_km_s)

    def target(self, name: str, et: float) -> TargetState:
        """Return a body as the spacecraft sees it."""
        return body_target(name, self.mission.spacecraft_id, et)

    def elongation_deg(self, direction: FloatArray, et: float) -> float:
        """Return the angle between a direction (3,) and the Sun, seen from the spacecraft."""
        sun = state(SUN_ID, et, self.mission.spacecraft_id, correction="CN").position_km
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
        seed_name
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
        inputs = self._scenario_with(named, attitude).inputs(
            _scenario_picture(named, self.bodies_drawn(picture))
        )
        stray = self.stray_light_dn_s(elongation) * camera.require("gain_e_per_dn")
        return replace(inputs, effects=_with_stray_light(inputs.effects, stray)) if stray else inputs

    def _scenario_with(self, picture: PlannedPicture, attitude: FloatArray) -> OpenedScenario:
        """Return the opened scenario with this picture alone, and its attitude."""
        w, x, y, z = (float(q) for q in quaternion_from_matrix(attitude))
        plan = AttitudePlan(
            predicted=PredictedAttitude(source="fixed", quaternion_camera_from_j2000=(w, x, y, z)),
            actual=ActualAttitude(source="none"),
            motion=self.sequence.motion,
        )
        update = {"attitude": plan, "pictures": (picture,)}
        scenario = self.opened_scenario.scenario.model_copy(update=update)
        return replace(self.opened_scenario, scenario=scenario)


def _scenario_picture(picture: PlannedPicture, drawn: Sequence[str] | None = None) -> ScenarioPicture:
    return ScenarioPicture(
        0, picture if drawn is None else picture.model_copy(update={"targets": tuple(drawn)})
    )


def _with_stray_light(effects: DetectorEffects, rate_e_s: float) -> DetectorEffects:
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
        with sequence.naming(place):
            body_id(name)


def reason_of(error: BaseException) -> str:
    """Return what an error says, without the place in a file that it was wrapped with."""
    said = error.reason if isinstance(error, FieldError) and error.reason else str(error)
    return " ".join(said.split())


# ---- Pictures simulated to confirm a plan: noise realisations of what was planned.

CATALOG_STREAM = 1001  # no stream of the simulation's own effects has this number


def confirming_inputs(
    opened: OpenedSequence,
    picture: PlannedPicture,
    number: int,
    *,
    shift_px: tuple[float, float] = (0.0, 0.0),
    twist_deg: float = 0.0,
) -> PictureInputs:
    """Return the inputs of a simulated picture that confirms a planned one, for `expose_picture`.

    Parameters
    ----------
    number
        Of the trial: noise and catalog errors are drawn anew for each; the same number gives the same picture.
    shift_px : (float, float)
        How the true attitude differs from the planned one: where the boresight's sky moves on the detector.
    twist_deg
        The same about the boresight.

    Raises
    ------
    OpNavError
        As `OpenedSequence.inputs`.
    """
    inputs = opened.inputs(picture, seed_name=f"{picture.name}_{number:04d}")
    planned = inputs.predicted_camera_from_j2000
    true = shifted_attitude(planned, inputs.camera, shift_px, twist_deg)
    return replace(
        inputs,
        name=f"{picture.name}_{number:04d}",
        stars=_displaced_stars(inputs.stars, inputs.et, inputs.observer.position_km, inputs.seed),
        path=inputs.path.turned(true @ planned.T),
    )


def _displaced_stars(stars: StarTable, et: float, observer_km: FloatArray, seed: int) -> StarTable:
    """Move each star by a draw from its catalog covariance at the picture's time, its unknown parallax included."""
    draws = np.random.default_rng([seed, CATALOG_STREAM]).normal(size=(len(stars), 2))
    value, vector = np.linalg.eigh(stars.sky_covariance(et, observer_km))
    scale: FloatArray = np.sqrt(np.maximum(value, 0.0))
    east, north = np.einsum("nij,nj->ni", vector, scale * draws).T
    ra = np.asarray(stars.ra_rad) + east / np.cos(stars.dec_rad)
    return replace(stars, ra_rad=ra, dec_rad=np.asarray(stars.dec_rad) + north)


# ---- A whole sequence planned: its pictures one by one, and its approach searches.


@contextlib.contextmanager
def open_sequence(sequence: PictureSequence) -> Iterator[OpenedSequence]:
    """Open the kernels of a sequence and all that its pictures share.

    Raises
    ------
    MissionError
        It names no kernels and none are active, or they or something else is not there.
    """
    source = sequence.scenario().kernel_source()
    with contextlib.ExitStack() as stack:
        if source is not None:
            with sequence.naming(("kernels",)):
                kernels = KernelSet(source)
            stack.enter_context(kernels)
        elif KernelSet.active() is None:
            raise sequence.fault(
                ("kernels",), "the sequence names no kernels, and none are loaded; name a set"
            )
        yield OpenedSequence.open(sequence)
