"""Pictures of a rehearsal: what is true is drawn, what was predicted is written.

The kernels are the predicted ones; for each picture the true places of spacecraft and target differ from theirs by the
case's offsets at that time. Headers come from the prediction and from the camera as calibrated.
"""

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.files import make_folder
from opnav_workbench.geometry import SPEED_OF_LIGHT_KM_S
from opnav_workbench.rehearsal.ort_perturb import OrtCase, random_of
from opnav_workbench.rehearsal.ort_perturb_camera import faulty
from opnav_workbench.rehearsal.ort_scenario import OrtEntry, OrtScenario
from opnav_workbench.simulation import (
    DetectorEffects,
    PictureScenario,
    SimulatedPicture,
    Task,
    Truth,
    Workshop,
    chosen_tasks,
    expose_picture,
    truth_of,
)
from opnav_workbench.simulation.effects import CosmicRays, LostData
from opnav_workbench.simulation.flight_fits import FlightRecord, write_flight_fits
from opnav_workbench.simulation.processes import in_processes
from opnav_workbench.simulation.scenario_parts import (
    ActualAttitude,
    AttitudePlan,
    BodyOffset,
    Perturbations,
    PictureEntry,
    SpacecraftOffset,
)
from opnav_workbench.simulation.scenario_surfaces import BodyOptions, Mottled
from opnav_workbench.spice import KernelSet, et_from_utc, state

__all__ = ["make_pictures", "picture_scenario"]

SUFFIX = ".fit"


@dataclass(frozen=True, slots=True)
class Assignment:
    """What every process needs to make the rehearsal's pictures.

    Attributes
    ----------
    scenario : OrtScenario
    case : OrtCase
    epoch_et : float
    metakernel : Path
        Of the package.
    out : Path
        Folder of the pictures.
    """

    scenario: OrtScenario
    case: OrtCase
    epoch_et: float
    metakernel: Path
    out: Path


def make_pictures(
    assignment: Assignment, jobs: int, progress: Callable[[Truth], None]
) -> Mapping[str, Truth]:
    """Make all pictures, also those that will be lost; return what each of them truly shows.

    Raises
    ------
    MissionError, KernelError, CameraError, CatalogError
        The scenario asks for something that there is not; checked before the first picture.
    SessionError
        The folder cannot be written, or a process died.
    """
    with _opened(assignment) as workshop:
        tasks = chosen_tasks(workshop.scenario, ())
        workshop.check(tasks)
        make_folder(assignment.out)
        if min(jobs, len(tasks)) == 1:
            truths = []
            for task in tasks:
                truths.append(_make(workshop, task, assignment))
                progress(truths[-1])
        else:
            truths = list(in_processes(tasks, min(jobs, len(tasks)), _start, (assignment,), _work, progress))
    return {truth.picture.stem: truth for truth in truths}


def picture_scenario(scenario: OrtScenario, case: OrtCase) -> PictureScenario:
    """Return the pictures as a picture scenario, with what is the same for all of them."""
    content = PictureScenario(
        description=scenario.title,
        mission=scenario.source(scenario.mission),
        catalog=scenario.catalog,
        magnitude_limit=scenario.magnitude_limit,
        seed=int(random_of(case.seed, "pictures").integers(2**62)),
        bodies=tuple(_surface(body, scenario, case) for body in _drawn_bodies(scenario)),
        detector=scenario.detector,
        pictures=tuple(_entry(picture, scenario) for picture in scenario.sequence()),
    )
    return content.at_path(scenario.path)  # maps and shapes count from the same file


def _drawn_bodies(scenario: OrtScenario) -> list[BodyOptions]:
    """Return the scenario's bodies, and those whose albedo alone is told."""
    albedo = scenario.perturbations.albedo
    known = {body.name.upper() for body in scenario.bodies}
    more = () if albedo is None else tuple(n for n in albedo.bodies if n.upper() not in known)
    return [*scenario.bodies, *(BodyOptions(name=name) for name in more)]


def _surface(body: BodyOptions, scenario: OrtScenario, case: OrtCase) -> BodyOptions:
    seeds = {name.upper(): seed for name, seed in case.albedo_seeds.items()}
    unknown = scenario.perturbations.albedo
    if unknown is None or body.name.upper() not in seeds:
        return body
    mottled = Mottled(map="mottled", dark=unknown.dark, bright=unknown.bright, seed=seeds[body.name.upper()])
    return body.model_copy(update={"albedo": mottled})


def _entry(picture: OrtEntry, scenario: OrtScenario) -> PictureEntry:
    return PictureEntry(
        name=picture.name,
        utc=picture.utc,
        camera=picture.camera,
        exposure_s=picture.exposure_s,
        targets=scenario.targets if picture.targets is None else picture.targets,
    )


# -- one by one ----------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def _opened(assignment: Assignment) -> Iterator[Workshop]:
    with KernelSet(assignment.metakernel):
        yield Workshop.open(picture_scenario(assignment.scenario, assignment.case))


def _make(workshop: Workshop, task: Task, assignment: Assignment) -> Truth:
    case, name = assignment.case, task.picture.name
    true = replace(workshop, scenario=_as_flown(workshop, task, assignment))
    inputs = true.inputs(task)
    calibrated = inputs.camera
    camera = faulty(calibrated, case.focal_length, case.corner_px)
    picture = expose_picture(replace(inputs, camera=camera))
    path = assignment.out / f"{name}{SUFFIX}"
    write_flight_fits(path, picture.exposed, _record(picture, workshop, task))
    truth = truth_of(picture, workshop.mission, path, true.settings(task))
    return replace(truth, noiseless_electrons=None)


def _record(picture: SimulatedPicture, workshop: Workshop, task: Task) -> FlightRecord:
    """Return what the header is made of: the prediction, and the camera as calibrated."""
    inputs = picture.inputs
    return FlightRecord(
        mission=workshop.mission,
        camera=workshop.camera(task),
        et=inputs.et,
        exposure_s=inputs.exposure_s,
        camera_from_j2000=inputs.predicted_camera_from_j2000,
        identity=inputs.header,
        target=inputs.bodies[0].target.name if inputs.bodies else None,
    )


def _as_flown(workshop: Workshop, task: Task, assignment: Assignment) -> PictureScenario:
    """Return the scenario with what is true of one picture."""
    case, name = assignment.case, task.picture.name
    update: dict[str, Any] = {
        "perturbations": _places(workshop, task, assignment),
        "detector": _detector(assignment.scenario, case, name),
    }
    if name in case.shifts_px:
        pixel, line, twist = case.shifts_px[name]
        actual = ActualAttitude(source="error", shift_px=(pixel, line), twist_deg=twist)
        update["attitude"] = AttitudePlan(actual=actual)
    return workshop.scenario.model_copy(update=update).at_path(workshop.scenario.path)


def _places(workshop: Workshop, task: Task, assignment: Assignment) -> Perturbations:
    case = assignment.case
    assert task.picture.utc is not None  # a series has been expanded
    et = et_from_utc(task.picture.utc.isoformat())
    craft = case.offset("spacecraft", et - assignment.epoch_et)
    # The target is seen where it was when the light left.
    seen = state(case.target, et, workshop.mission.spacecraft_id)
    light_time_s = float(np.linalg.norm(seen.position_km)) / SPEED_OF_LIGHT_KM_S
    moved = case.offset("target", et - light_time_s - assignment.epoch_et)[:3]
    bodies = (BodyOffset(name=case.target, offset_km=tuple(moved.tolist())),) if moved.any() else ()
    spacecraft = SpacecraftOffset(
        position_km=tuple(craft[:3].tolist()), velocity_km_s=tuple(craft[3:].tolist())
    )
    return Perturbations(bodies=bodies, spacecraft=spacecraft)


def _detector(scenario: OrtScenario, case: OrtCase, name: str) -> DetectorEffects:
    p = scenario.perturbations
    update: dict[str, Any] = {}
    if name in case.storm and p.cosmic_ray_storm is not None:
        update["cosmic_rays"] = CosmicRays(
            rate_per_cm2_s=case.storm_rate_per_cm2_s, electrons_per_um=p.cosmic_ray_storm.electrons_per_um
        )
    if name in case.gaps and p.data_gaps is not None:
        update["lost_data"] = LostData(**p.data_gaps.model_dump(exclude={"pictures"}))
    return scenario.detector.model_copy(update=update)


# -- several processes ---------------------------------------------------------------------------------------------

_WORK: list[Callable[[Task], Truth]] = []  # of this process: one, once it has started
_STACK = contextlib.ExitStack()


def _start(assignment: Assignment) -> None:
    workshop = _STACK.enter_context(_opened(assignment))
    _WORK.append(partial(_make, workshop, assignment=assignment))


def _work(task: Task) -> Truth:
    return _WORK[0](task)


def lose(folder: Path, names: Sequence[str]) -> None:
    """Take away the pictures that never arrive."""
    for name in names:
        (folder / f"{name}{SUFFIX}").unlink()


def cut_short(folder: Path, names: Sequence[str], seed: int) -> None:
    """Cut the pictures that arrive in part, in the middle of their first plane."""
    for name in names:
        path = folder / f"{name}{SUFFIX}"
        share = random_of(seed, f"truncated/{name}").uniform(0.05, 0.2)
        with path.open("r+b") as stream:
            stream.truncate(int(share * path.stat().st_size))
