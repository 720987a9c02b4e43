"""Pictures of a rehearsal: what is true is drawn, what was predicted is written.

The kernels are the predicted ones; for each picture the true places of spacecraft and target differ from theirs by
the case's offsets at that time. The true camera has a focal length and a distortion that the calibration does not
have. Headers come from the prediction and from the camera as calibrated.
"""

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.camera.distortion import DirectDistortion, Distortion
from opnav_workbench.constants import SPEED_OF_LIGHT_KM_S
from opnav_workbench.estimation.body import BodyRotation
from opnav_workbench.files import make_folder
from opnav_workbench.geometry import vector_from_rotation
from opnav_workbench.kernels import KernelSet, body_attitude, et_from_utc, state
from opnav_workbench.processes import in_processes
from opnav_workbench.rehearsal.case import OrtCase, perturbation_random
from opnav_workbench.rehearsal.scenario import OrtEntry, OrtScenario
from opnav_workbench.simulation import (
    DetectorEffects,
    OpenedScenario,
    PictureScenario,
    ScenarioPicture,
    Truth,
    chosen_pictures,
    expose_picture,
    truth_of,
)
from opnav_workbench.simulation.effects import CosmicRays, LostData
from opnav_workbench.simulation.flight_fits import write_flight_fits
from opnav_workbench.simulation.output import flight_record
from opnav_workbench.simulation.scenario import (
    ActualAttitude,
    AttitudePlan,
    BodyOffset,
    Perturbations,
    PictureEntry,
    SpacecraftOffset,
)
from opnav_workbench.simulation.scenario_file import BodyAppearance, Mottled

__all__ = ["AddedRadial", "camera_with_faults", "make_pictures"]


# ---- The true camera of a rehearsal: a focal length and a distortion that the calibration does not have.


@dataclass(frozen=True, slots=True)
class AddedRadial(DirectDistortion):
    """A distortion with a further cubic radial term: the distorted point moves on by ``k r^2 (x, y)`` of the ideal one."""

    base: Distortion
    k_per_mm2: float

    def distort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the point on the detector (..., 2) mm, of ideal coordinates (..., 2) mm."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        r2 = np.sum(xy * xy, axis=-1, keepdims=True)
        return np.asarray(self.base.distort(xy) + self.k_per_mm2 * r2 * xy)

    def jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(distorted)/d(ideal) (..., 2, 2) at ideal coordinates (..., 2) mm."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        r2 = np.sum(xy * xy, axis=-1)[..., None, None]
        outer = xy[..., :, None] * xy[..., None, :]
        return np.asarray(self.base.jacobian(xy) + self.k_per_mm2 * (r2 * np.eye(2) + 2.0 * outer))


def camera_with_faults(camera: Camera, focal_length: float, corner_px: float) -> Camera:
    """Return the camera as it truly is.

    Parameters
    ----------
    camera
        As calibrated.
    focal_length
        True focal length over the calibrated one, minus 1.
    corner_px
        How far the further distortion moves a point at the detector's corner outward.
    """
    if focal_length == 0.0 and corner_px == 0.0:
        return camera
    half_px = 0.5 * np.array([camera.n_pixel, camera.n_line])
    corner_mm = np.linalg.solve(camera.pixel_from_mm, half_px)
    radius_mm, radius_px = float(np.linalg.norm(corner_mm)), float(np.linalg.norm(half_px))
    k = corner_px / radius_px / radius_mm**2
    longer = camera.focal_length_mm * (1.0 + focal_length)
    distortion = camera.distortion if k == 0.0 else AddedRadial(camera.distortion, k)
    return replace(camera, focal_length_mm=longer, distortion=distortion)


# ---- Pictures of a rehearsal: what is true is drawn, what was predicted is written.

PICTURE_SUFFIX = ".fit"


@dataclass(frozen=True, slots=True)
class PictureBatch:
    """What every process needs to make the rehearsal's pictures.

    Attributes
    ----------
    metakernel
        Of the package.
    out
        Folder of the pictures.
    """

    scenario: OrtScenario
    case: OrtCase
    epoch_et: float
    metakernel: Path
    out: Path


def make_pictures(batch: PictureBatch, jobs: int, progress: Callable[[Truth], None]) -> Mapping[str, Truth]:
    """Make all pictures, also those that will be lost; return what each of them truly shows.

    Raises
    ------
    MissionError, KernelError, CameraError, CatalogError
        The scenario asks for something that there is not; checked before the first picture.
    SessionError
        The folder cannot be written, or a process died.
    """
    with _scenario_opened(batch) as opened:
        pictures = chosen_pictures(opened.scenario, ())
        opened.check(pictures)
        make_folder(batch.out)
        opening, work = partial(_scenario_opened, batch), partial(_make_picture, batch=batch)
        truths = in_processes(pictures, jobs, opening, work, progress, here=opened)
    return {truth.picture.stem: truth for truth in truths}


def picture_scenario(scenario: OrtScenario, case: OrtCase) -> PictureScenario:
    """Return the pictures as a picture scenario, with what is the same for all of them."""
    content = PictureScenario(
        description=scenario.title,
        mission=scenario.source(scenario.mission),
        catalog=scenario.catalog,
        magnitude_limit=scenario.magnitude_limit,
        seed=int(perturbation_random(case.seed, "pictures").integers(2**62)),
        bodies=tuple(_true_appearance(body, scenario, case) for body in _drawn_bodies(scenario)),
        detector=scenario.detector,
        star_errors=scenario.perturbations.stars,
        pictures=tuple(_picture_entry(picture, scenario) for picture in scenario.sequence()),
    )
    return content.at_path(scenario.path)  # maps and shapes count from the same file


def _drawn_bodies(scenario: OrtScenario) -> list[BodyAppearance]:
    """Return the scenario's bodies, and those whose albedo alone is told."""
    albedo = scenario.perturbations.albedo
    known = {body.name.upper() for body in scenario.bodies}
    more = () if albedo is None else tuple(n for n in albedo.bodies if n.upper() not in known)
    return [*scenario.bodies, *(BodyAppearance(name=name) for name in more)]


def _true_appearance(body: BodyAppearance, scenario: OrtScenario, case: OrtCase) -> BodyAppearance:
    if body.terrain is not None:
        body = body.model_copy(
            update={"terrain": body.terrain.model_copy(update={"seed": case.terrain_seed})}
        )
    seeds = {name.upper(): seed for name, seed in case.albedo_seeds.items()}
    unknown = scenario.perturbations.albedo
    if unknown is None or body.name.upper() not in seeds:
        return body
    mottled = Mottled(
        map="mottled",
        dark=unknown.dark,
        bright=unknown.bright,
        seed=seeds[body.name.upper()],
        **unknown.model_dump(include={"features", "smallest_deg", "largest_deg"}, exclude_none=True),
    )
    return body.model_copy(update={"albedo": mottled})


def _picture_entry(picture: OrtEntry, scenario: OrtScenario) -> PictureEntry:
    targets = scenario.targets if picture.targets is None else picture.targets
    if scenario.orbit is not None:  # it is near: there is no picture without it
        targets = tuple(dict.fromkeys((*targets, scenario.orbit.body)))
    return PictureEntry(
        name=picture.name,
        utc=picture.utc,
        camera=picture.camera,
        exposure_s=picture.exposure_s,
        targets=targets,
    )


# -- one by one ----------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def _scenario_opened(batch: PictureBatch) -> Iterator[OpenedScenario]:
    with KernelSet(batch.metakernel):
        yield OpenedScenario.open(picture_scenario(batch.scenario, batch.case))


def _make_picture(opened: OpenedScenario, picture: ScenarioPicture, batch: PictureBatch) -> Truth:
    case, name = batch.case, picture.name
    true = replace(opened, scenario=_as_flown(opened, picture, batch))
    inputs = true.inputs(picture)
    calibrated = inputs.camera
    camera = camera_with_faults(calibrated, case.focal_length, case.corner_px)
    made = expose_picture(replace(inputs, camera=camera))
    path = batch.out / f"{name}{PICTURE_SUFFIX}"
    write_flight_fits(path, made.exposure, flight_record(made, opened.mission, calibrated))
    truth = truth_of(made, opened.mission, path, true.truth_settings(picture))
    return replace(truth, noiseless_electrons=None)


def _as_flown(opened: OpenedScenario, picture: ScenarioPicture, batch: PictureBatch) -> PictureScenario:
    """Return the scenario with what is true of one picture."""
    case, name = batch.case, picture.name
    update: dict[str, Any] = {
        "perturbations": _true_places(opened, picture, batch),
        "detector": _true_detector(batch.scenario, case, name),
    }
    if name in case.shifts_px:
        pixel, line, twist = case.shifts_px[name]
        actual = ActualAttitude(source="error", shift_px=(pixel, line), twist_deg=twist)
        update["attitude"] = AttitudePlan(actual=actual)
    return opened.scenario.model_copy(update=update).at_path(opened.scenario.path)


def _true_places(opened: OpenedScenario, picture: ScenarioPicture, batch: PictureBatch) -> Perturbations:
    case = batch.case
    assert picture.entry.utc is not None  # a series has been expanded
    et = et_from_utc(picture.entry.utc.isoformat())
    craft = case.offset("spacecraft", et - batch.epoch_et)
    # The target is seen where it was when the light left.
    seen = state(case.target, et, opened.mission.spacecraft_id)
    light_time_s = float(np.linalg.norm(seen.position_km)) / SPEED_OF_LIGHT_KM_S
    moved = case.offset("target", et - light_time_s - batch.epoch_et)[:3]
    bodies = (BodyOffset(name=case.target, offset_km=tuple(moved.tolist())),) if moved.any() else ()
    if batch.scenario.orbit is not None:
        turned = _turned_rad(batch.scenario.orbit.body, case, batch.epoch_et, et - light_time_s)
        bodies = (*bodies, BodyOffset(name=batch.scenario.orbit.body, turned_rad=turned))
    spacecraft = SpacecraftOffset(
        position_km=tuple(craft[:3].tolist()), velocity_km_s=tuple(craft[3:].tolist())
    )
    return Perturbations(bodies=bodies, spacecraft=spacecraft)


def _turned_rad(body: str, case: OrtCase, epoch_et: float, et: float) -> tuple[float, float, float]:
    """Return how the body is turned from its believed orientation at a time, about its own axes."""
    believed = BodyRotation.from_attitudes(lambda t: body_attitude(body, t), epoch_et)
    true = believed.turned(case.body_step).body_from_j2000(et)
    x, y, z = vector_from_rotation(true @ body_attitude(body, et).T).tolist()
    return x, y, z


def _true_detector(scenario: OrtScenario, case: OrtCase, name: str) -> DetectorEffects:
    p = scenario.perturbations
    update: dict[str, Any] = {}
    if name in case.storm and p.cosmic_ray_storm is not None:
        update["cosmic_rays"] = CosmicRays(
            rate_per_cm2_s=case.storm_rate_per_cm2_s, electrons_per_um=p.cosmic_ray_storm.electrons_per_um
        )
    if name in case.gaps and p.data_gaps is not None:
        update["lost_data"] = LostData(**p.data_gaps.model_dump(exclude={"pictures"}))
    return scenario.detector.model_copy(update=update)


def remove_missing(folder: Path, names: Sequence[str]) -> None:
    """Take away the pictures that never arrive."""
    for name in names:
        (folder / f"{name}{PICTURE_SUFFIX}").unlink()


def truncate_pictures(folder: Path, names: Sequence[str], seed: int) -> None:
    """Cut the pictures that arrive in part, in the middle of their first plane."""
    for name in names:
        path = folder / f"{name}{PICTURE_SUFFIX}"
        share = perturbation_random(seed, f"truncated/{name}").uniform(0.05, 0.2)
        with path.open("r+b") as stream:
            stream.truncate(int(share * path.stat().st_size))
