"""What all pictures of a scenario share, opened once per process: mission, catalog, surfaces of bodies.

`OpenedScenario.check` looks at every picture before the first is made, and names the line of the scenario that is
wrong; `OpenedScenario.inputs` collects what one picture is made of.
"""

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera, RowSweep
from opnav_workbench.catalog import Catalog, StarTable, open_catalog
from opnav_workbench.geometry import apparent_direction, radec_from_unit
from opnav_workbench.kernels import body_id, camera_attitude, et_from_utc
from opnav_workbench.mission import Mission, load_mission
from opnav_workbench.psf import GaussianPsf, Psf
from opnav_workbench.render import BodyModel
from opnav_workbench.scene import Observer, sweep_of, with_course
from opnav_workbench.simulation.attitude_path import (
    STEP_PX,
    STILL_PX,
    AttitudePath,
    kernel_path,
    moving_path,
    sky_turn,
)
from opnav_workbench.simulation.detector_properties import detector_values
from opnav_workbench.simulation.flight_fits import dark_columns_of
from opnav_workbench.simulation.picture import PictureInputs
from opnav_workbench.simulation.scenario import PictureEntry, PictureScenario
from opnav_workbench.simulation.surfaces import Surface, surface_of
from opnav_workbench.simulation.true_state import (
    flown_kernels,
    predicted_attitude,
    true_attitude,
    true_observer,
    true_stars,
    true_target,
)
from opnav_workbench.targets import TargetState
from opnav_workbench.yaml_file import Location

__all__ = ["OpenedScenario", "ScenarioPicture", "picture_seed"]

CONE_SHARE = 1.05  # of the half diagonal: distortion, aberration, and the light of stars just outside
SEED_BYTES = 6


@dataclass(frozen=True, slots=True)
class ScenarioPicture:
    """One picture to make.

    Attributes
    ----------
    index
        Of its entry in the scenario.
    entry
        With one time; of a series, that of this picture.
    """

    index: int
    entry: PictureEntry

    @property
    def name(self) -> str:
        """Its own name."""
        return self.entry.name

    def place(self, field: str) -> Location:
        """Return where a field of this picture stands in the file."""
        return ("pictures", self.index, field)


@dataclass(frozen=True, slots=True, eq=False)
class OpenedScenario:
    """A scenario with everything opened that its pictures need; use it inside an active `KernelSet`."""

    scenario: PictureScenario
    mission: Mission
    catalog: Catalog
    surfaces: Mapping[str, Surface]
    _cameras: dict[str, Camera] = field(
        default_factory=dict, repr=False
    )  # read once, by the cards that tell them

    @classmethod
    def open(cls, scenario: PictureScenario) -> "OpenedScenario":
        """Open mission, catalog, albedo maps and shapes.

        Raises
        ------
        MissionError
            One of them is not there or not usable; the message names the line of the scenario.
        """
        with scenario.naming(("mission",)):
            mission = load_mission(scenario.source(scenario.mission))
        with scenario.naming(("catalog",)):
            catalog = open_catalog(scenario.catalog)
        surfaces = {}
        for i, body in enumerate(scenario.bodies):
            with scenario.naming(("bodies", i, "name")):
                body_id(body.name)
            surfaces[body.name.upper()] = surface_of(body, scenario, ("bodies", i))
        return cls(scenario, mission, catalog, surfaces)

    def check(self, pictures: Sequence[ScenarioPicture]) -> None:
        """Refuse what would fail later: cameras, exposures, times, targets.

        Raises
        ------
        MissionError
            The message names the line of the scenario, and what is allowed.
        """
        for i, offset in enumerate(self.scenario.perturbations.bodies):
            with self.scenario.naming(("perturbations", "bodies", i, "name")):
                body_id(offset.name)
        for picture in pictures:
            camera = self.camera(picture)
            fault = camera.exposure_fault(picture.entry.exposure_s)
            if fault:
                raise self.scenario.fault(picture.place("exposure_s"), fault)
            with self.scenario.naming(
                picture.place("start" if self.scenario.pictures[picture.index].utc is None else "utc"),
            ):
                et = self._mid_exposure_et(picture)
                true_observer(self.mission.spacecraft_id, et, self.scenario.perturbations)
                predicted_attitude(self.scenario.attitude.predicted, camera, et)
            plan = self.scenario.attitude.actual
            if plan.kernels is not None:
                with self.scenario.naming(("attitude", "actual", "kernels")):
                    true_attitude(plan, np.eye(3), camera, et, 0, self.scenario.folder)
            self._bodies(picture, camera, et)

    def camera(self, picture: ScenarioPicture) -> Camera:
        """Return the camera of a picture, by its name or its header cards."""
        entry, scenario = picture.entry, self.scenario
        place = "header" if entry.camera is None else "camera"
        with scenario.naming(picture.place(place)):
            cards = self._header(picture)
            key = repr(sorted(cards.items()))
            camera = self._cameras.get(key) or self._cameras.setdefault(key, self.mission.camera_for(cards))
            camera.require_photometry()
            detector_values(camera, scenario.detector, entry.exposure_s, entry.level)
        return camera

    def inputs(self, picture: ScenarioPicture) -> PictureInputs:
        """Collect what one picture is made of.

        Raises
        ------
        OpNavError
            As `check` does.
        """
        scenario, entry, camera = self.scenario, picture.entry, self.camera(picture)
        et, seed = self._mid_exposure_et(picture), picture_seed(scenario.seed, entry.name)
        predicted = predicted_attitude(scenario.attitude.predicted, camera, et)
        path = self._attitude_path(camera, predicted, et, _smearing_s(camera, entry.exposure_s), seed)
        if camera.rows is not None:
            with self.scenario.naming(("attitude", "motion")):
                camera = replace(camera, sweep=self._sweep(camera, predicted, et, seed))
        return PictureInputs(
            name=entry.name,
            camera=camera,
            et=et,
            exposure_s=entry.exposure_s,
            observer=true_observer(self.mission.spacecraft_id, et, scenario.perturbations),
            predicted_camera_from_j2000=predicted,
            path=path,
            stars=self._stars(camera, path.middle, et),
            bodies=self._bodies(picture, camera, et),
            body_tracks_px=tuple(
                self._body_track_px(n, picture, camera, path) for n in self.targets(picture)
            ),
            psf=self._psf(camera),
            effects=scenario.detector,
            place_effects=scenario.switches,
            level=entry.level,
            dark_columns=dark_columns_of(self.mission, camera) if entry.level == "raw" else 0,
            seed=seed,
            header=self._header(picture),
            without_law=self._without_law(picture),
        )

    def truth_settings(self, picture: ScenarioPicture) -> dict[str, Any]:
        """Return what the truth file keeps of the scenario: all of it but the other pictures."""
        content = self.scenario.model_dump(mode="json", exclude={"pictures"})
        return content | {"picture": picture.entry.model_dump(mode="json", exclude_none=True)}

    # -- one by one ------------------------------------------------------------------------------------------------

    def _mid_exposure_et(self, picture: ScenarioPicture) -> float:
        assert picture.entry.utc is not None  # a series has been expanded
        return et_from_utc(picture.entry.utc.isoformat())

    def _header(self, picture: ScenarioPicture) -> dict[str, str | int | float]:
        """Header cards that tell mission and camera, and those that the scenario adds."""
        cards = {key: _one_value(value) for key, value in self.mission.keywords.get("required", {}).items()}
        named = picture.entry.camera
        if named is not None:
            choices = {choice.file.stem: choice for choice in self.mission.cameras}
            if named not in choices:
                raise self.scenario.fault(
                    picture.place("camera"),
                    f"unknown camera {named!r}; {self.mission.name} has {', '.join(choices)}",
                )
            cards |= {key: _one_value(value) for key, value in choices[named].match.items()}
        return cards | picture.entry.header

    def _attitude_path(
        self, camera: Camera, predicted: FloatArray, et: float, exposure_s: float, seed: int
    ) -> AttitudePath:
        plan, folder = self.scenario.attitude, self.scenario.folder
        true = true_attitude(plan.actual, predicted, camera, et, seed, folder)
        moving = plan.motion.camera_motion()
        if not plan.motion.from_kernels:
            return moving_path(camera, true, et, exposure_s, motion=moving, seed=seed)
        with (
            self.scenario.naming(("attitude", "motion", "from_kernels")),
            flown_kernels(plan.actual, folder),
        ):
            path = kernel_path(camera, et, exposure_s, motion=moving, seed=seed)
            return path.turned(true @ camera_attitude(camera.frame, et).T)

    def _sweep(self, camera: Camera, predicted: FloatArray, et: float, seed: int) -> RowSweep:
        """Return how the camera truly turns from line to line."""
        assert camera.rows is not None
        plan, folder = self.scenario.attitude, self.scenario.folder
        true = true_attitude(plan.actual, predicted, camera, et, seed, folder)
        motion, by_kernels = plan.motion.camera_motion(), plan.motion.from_kernels
        with flown_kernels(plan.actual, folder) if by_kernels else nullcontext():
            turned = true @ camera_attitude(camera.frame, et).T if by_kernels else np.eye(3)

            def attitude(time_s: float) -> FloatArray:
                there = turned @ camera_attitude(camera.frame, et + time_s) if by_kernels else true
                return np.asarray(sky_turn(camera, motion.offsets(time_s, seed)) @ there)

            def velocity(time_s: float) -> FloatArray:
                return true_observer(
                    self.mission.spacecraft_id, et + time_s, self.scenario.perturbations
                ).velocity_km_s

            return sweep_of(camera, attitude, velocity)

    def _stars(self, camera: Camera, attitude: FloatArray, et: float) -> StarTable:
        ra, dec = (float(a) for a in radec_from_unit(attitude.T @ camera.boresight))
        radius = CONE_SHARE * camera.half_diagonal_rad
        stars = self.catalog.cone(ra, dec, radius, mag_limit=self.scenario.magnitude_limit, et_s=et)
        return true_stars(stars, self.scenario.seed) if self.scenario.star_errors else stars

    def _psf(self, camera: Camera) -> Psf:
        widths = self.scenario.psf_sigma_px
        return camera.psf_model if widths is None else GaussianPsf(*widths)

    def targets(self, picture: ScenarioPicture) -> tuple[str, ...]:
        """Return the names of the bodies in a picture."""
        named = picture.entry.targets
        return tuple(body.name for body in self.scenario.bodies) if named is None else named

    def _bodies(self, picture: ScenarioPicture, camera: Camera, et: float) -> tuple[BodyModel, ...]:
        models = []
        for name in self.targets(picture):
            options = self.scenario.body(name)
            place: Location = picture.place("targets")
            for i, body in enumerate(self.scenario.bodies):
                place = ("bodies", i, "brightness") if body is options else place
            surface = self.surfaces.get(name.upper())
            with self.scenario.naming(place):
                surface = surface or surface_of(options, self.scenario, place)
                target = self._target(name, camera, et)
                models.append(surface.model(target, self.mission, camera, picture.entry.exposure_s))
        return tuple(models)

    def _target(self, name: str, camera: Camera, et: float) -> TargetState:
        """Return a body as it truly is, with its course where the camera's lines are exposed one after the other."""
        craft, truth = self.mission.spacecraft_id, self.scenario.perturbations
        target = true_target(name, craft, et, truth)
        if camera.rows is None:
            return target
        half_s = 0.5 * camera.rows.span_s(camera.n_line)
        return with_course(target, half_s, lambda time_s: true_target(name, craft, et + time_s, truth))

    def _without_law(self, picture: ScenarioPicture) -> tuple[str, ...]:
        """Return the bodies of a picture that are drawn by a law that nobody gave."""
        bare = {body.name.upper() for body in self.scenario.bodies if "law" not in body.model_fields_set}
        known = self.surfaces.keys() - bare
        return tuple(name for name in self.targets(picture) if name.upper() not in known)

    def _body_track_px(
        self, name: str, picture: ScenarioPicture, camera: Camera, path: AttitudePath
    ) -> FloatArray | None:
        """Return how a body moves on the detector during the exposure; None: as the sky does, or out of sight."""
        et, half_s = self._mid_exposure_et(picture), 0.5 * picture.entry.exposure_s
        start, stop = (self._direction(name, et + t) for t in (-half_s, half_s))
        if np.linalg.norm(stop - start) < STILL_PX * camera.pixel_scale_rad:
            return None
        if path.is_still:
            moved = np.diff(camera.project(np.stack([start, stop]) @ path.middle.T), axis=0)
            if not np.isfinite(moved).all():
                return None
            count = 2 * int(np.ceil(np.linalg.norm(moved) / STEP_PX)) + 1
            return np.asarray(((np.arange(count) + 0.5) / count - 0.5)[:, None] * moved)
        time = (path.et - et) / (2.0 * half_s) + 0.5
        places = path.places(camera, (start + time[:, None] * (stop - start))[None])[0]
        return np.asarray(places - places[len(path) // 2]) if np.isfinite(places).all() else None

    def _direction(self, name: str, et: float) -> FloatArray:
        truth, spacecraft = self.scenario.perturbations, self.mission.spacecraft_id
        observer: Observer = true_observer(spacecraft, et, truth)
        target = true_target(name, spacecraft, et, truth)
        return apparent_direction(target.direction, observer.velocity_km_s)


def picture_seed(seed: int, name: str) -> int:
    """Return a picture's own seed, from the scenario's and its name: no matter which others are made, or where.

    Examples
    --------
    >>> picture_seed(1, "a") == picture_seed(1, "a"), picture_seed(1, "a") == picture_seed(1, "b")
    (True, False)
    """
    return int.from_bytes(hashlib.sha256(f"{seed}/{name}".encode()).digest()[:SEED_BYTES], "big")


def _one_value(value: object) -> str | int | float:
    """Return a card's value, or the first of several that would do."""
    chosen = value[0] if isinstance(value, list | tuple) else value
    assert isinstance(chosen, str | int | float)
    return chosen


def _smearing_s(camera: Camera, exposure_s: float) -> float:
    """Return how much of an exposure smears: a charge that follows the scan does so but for a line."""
    return exposure_s if camera.rows is None else exposure_s / camera.rows.tdi_lines
