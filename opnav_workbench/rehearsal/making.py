"""Packages of operational readiness tests (ORT) in the making: the paper's rehearsals of mission-critical phases.

A package (see `opnav_workbench.rehearsal.package`) is made in a hidden folder beside its place and moved there
whole. Predicted kernels and mission file are copied, so that the folder works wherever it goes; where a sequence
commands attitudes of its own, they are written as a CK over the other kernels.
"""

import contextlib
import hashlib
import math
import os
import secrets
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.errors import MissionError, SessionError
from opnav_workbench.files import sha256_of
from opnav_workbench.geometry import apparent_direction
from opnav_workbench.geometry.aiming import aim
from opnav_workbench.kernels import (
    KernelSet,
    ck_structure,
    et_from_utc,
    rotation,
    utc_from_et,
    write_ck,
    write_text_kernel,
)
from opnav_workbench.kernels.text_kernels import metakernel_assignments
from opnav_workbench.mission import Mission, load_mission, mission_names
from opnav_workbench.rehearsal.briefing import write_briefing
from opnav_workbench.rehearsal.case import OrtCase, OrtGeometry, draw_case, geometry_at_epoch
from opnav_workbench.rehearsal.orbit.team_map import maplets_name, shape_name, write_team_map
from opnav_workbench.rehearsal.package import (
    MAP_FOLDER,
    PACKAGE_FORMAT,
    PICTURE_FOLDER,
    SEALED_FILE,
    BPlaneContent,
    OrbitContent,
    OrtContent,
    OrtPackage,
    PictureContent,
    SealContent,
    key_beside,
    open_rehearsal,
    public_digest,
    write_content,
)
from opnav_workbench.rehearsal.pictures import (
    PICTURE_SUFFIX,
    PictureBatch,
    make_pictures,
    remove_missing,
    truncate_pictures,
)
from opnav_workbench.rehearsal.scenario import OrbitTask, OrtEntry, OrtScenario, load_ort_scenario
from opnav_workbench.rehearsal.sealed_truth import SealedTruth, seal, write_key
from opnav_workbench.rehearsal.truth_content import predicted_utc, sealed_values
from opnav_workbench.scene import body_target, observer_from_kernels
from opnav_workbench.simulation import Truth

__all__ = ["new_rehearsal"]


# ---- Predicted kernels and mission file of a package: copied, so that the folder works wherever it goes.

KERNEL_FOLDER = "kernels"
MISSION_FOLDER = "mission"
METAKERNEL_NOTE = "Predicted kernels of a rehearsal. Paths count from this folder."


def copy_kernels(scenario: OrtScenario, folder: Path) -> Path:
    """Copy the predicted kernels into ``folder/kernels`` and return their metakernel, all paths relative.

    Raises
    ------
    KernelError
        A kernel is missing or no kernel.
    MissionError
        Two kernels of one name.
    """
    source = scenario.source(scenario.kernels)
    files = [kernel.path for kernel in KernelSet(source).kernels() if kernel.kind != "META"]
    names = [path.name for path in files]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise MissionError(
            f"rehearsal scenario: kernels: two kernels are named {', '.join(twice)}; rename one."
        )
    target = folder / KERNEL_FOLDER
    target.mkdir()
    for path in files:
        shutil.copyfile(path, target / path.name)
    metakernel = target / f"{Path(source).stem}.tm"
    write_text_kernel(metakernel, "MK", metakernel_assignments(names), METAKERNEL_NOTE)
    return metakernel


def copy_mission(scenario: OrtScenario, folder: Path) -> tuple[Mission, str]:
    """Return the mission and how ``ort.yaml`` names it: by name, else by its file copied into ``folder/mission``.

    Raises
    ------
    MissionError
        There is no such mission, or it names files outside its folder.
    """
    named = scenario.source(scenario.mission)
    mission = load_mission(named)
    if named in mission_names():
        return mission, named
    home = mission.path.parent
    files = [mission.path, *(choice.file for choice in mission.cameras), *home.glob("headers/*.yaml")]
    files += [path for path in (mission.target_stars,) if path is not None]
    for surface in mission.target_surfaces.values():
        files += [surface.shape] if surface.shape is not None else []
        files += [surface.albedo_map.file] if surface.albedo_map is not None else []
    for path in files:
        if not path.resolve().is_relative_to(home.resolve()):
            raise MissionError(
                f"mission file {mission.path}: {path} is not in its folder; a package cannot copy it."
            )
        place = folder / MISSION_FOLDER / path.resolve().relative_to(home.resolve())
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, place)
    return mission, f"{MISSION_FOLDER}/{mission.path.name}"


# ---- A sequence's own pointing.

HOLD_S = 2.0  # the attitude is held so long before and after an exposure
POINTING_CK = "sequence_predicted.bc"


def add_pointing(
    scenario: OrtScenario, mission: Mission, cameras: Mapping[str, Camera], metakernel: Path
) -> None:
    """Write the commanded attitudes of the pictures that have a pointing of their own, and add them to the metakernel.

    Raises
    ------
    MissionError
        Two of them overlap, or a target cannot be held there.
    KernelError
        The kernels do not know spacecraft, target or frame.
    """
    pictures = [picture for picture in scenario.sequence() if picture.pointing is not None]
    if not pictures:
        return
    with KernelSet(metakernel) as kernels:
        held = [_held_attitude(picture, scenario, mission, cameras[picture.name]) for picture in pictures]
        _write_attitudes(metakernel.with_name(POINTING_CK), held, mission)
        names = [path.name for path in kernels.paths if path != metakernel]
    write_text_kernel(metakernel, "MK", metakernel_assignments([*names, POINTING_CK]), METAKERNEL_NOTE)


def _held_attitude(
    picture: OrtEntry, scenario: OrtScenario, mission: Mission, camera: Camera
) -> tuple[FloatArray, FloatArray]:
    """Return begin and end of an attitude (2,), and ``bus_from_j2000`` (3, 3)."""
    assert picture.pointing is not None
    et = et_from_utc(picture.time)
    body = (
        (picture.targets or scenario.targets)[0]
        if picture.pointing.target is None
        else picture.pointing.target
    )
    seen = body_target(body, mission.spacecraft_id, et).direction
    apparent = apparent_direction(seen, observer_from_kernels(mission.spacecraft_id, et).velocity_km_s)
    pixel, line = (offset * camera.pixel_scale_rad for offset in picture.pointing.offset_px)
    try:
        attitude = aim(
            apparent, math.radians(picture.pointing.twist_deg), camera.focal_from_camera, (pixel, line)
        )
    except ValueError as error:
        raise MissionError(f"rehearsal scenario: pictures: {picture.name}: pointing: {error}.") from error
    half = 0.5 * picture.exposure_s + HOLD_S
    return np.array([et - half, et + half]), rotation(camera.frame, mission.bus_frame, et) @ attitude


def _write_attitudes(path: Path, held: list[tuple[FloatArray, FloatArray]], mission: Mission) -> None:
    times = np.concatenate([window for window, _ in held])
    if (np.diff(times) <= 0.0).any():
        raise MissionError(
            f"rehearsal scenario: pictures: two with a pointing of their own are less than {2.0 * HOLD_S:g} s apart; give "
            "them more time."
        )
    structure = ck_structure(mission.bus_frame)
    if structure is None:
        raise MissionError(
            f"rehearsal scenario: no CK orients the frame {mission.bus_frame} in these kernels."
        )
    write_ck(
        path,
        structure[0],
        mission.clock_id,
        times,
        np.repeat(np.stack([attitude for _, attitude in held]), 2, axis=0),
        np.zeros((len(times), 3)),
        interval_starts=range(0, len(times), 2),
        comment="Commanded attitudes of a rehearsal's picture sequence, written by opnav_workbench.\n",
    )


# ---- Packages of operational readiness tests (ORT), the paper's rehearsals of mission-critical phases.

SEED_BITS = 62  # of a seed that nobody chose: too many to try
POLE = "ecliptic"

Progress = Callable[[int, int, str], None]


def new_rehearsal(
    scenario: str | os.PathLike[str] | Mapping[str, Any] | OrtScenario,
    out: str | os.PathLike[str],
    *,
    seed: int | None = None,
    jobs: int = 1,
    pictures: int | None = None,
    progress: Progress | None = None,
) -> OrtPackage:
    """Make a rehearsal's package: pictures with a sealed truth.

    Parameters
    ----------
    scenario : str, path, mapping or OrtScenario
        See `load_ort_scenario`.
    out : path
        Folder of the package, not there yet. Beside it, ``OUT.key`` opens the truth.
    seed
        Draws the case; the same seed gives the same pictures, bit for bit. None: one that nobody knows, as a blind
        rehearsal needs: whoever has scenario and seed can make the package again.
    jobs
        Processes. A script that asks for more than one must guard its main part (``if __name__ == "__main__"``).
    pictures
        At most so many of the sequence's pictures, for a quick run.
    progress : callable, optional
        Called with pictures done, pictures in all, and a few words.

    Raises
    ------
    MissionError, KernelError, CameraError, CatalogError, EstimationError
        The scenario asks for something that there is not; nothing is left behind.
    SessionError
        The folder or its key is there already, or cannot be written.
    """
    if jobs < 1:
        raise MissionError(f"{jobs} jobs; give 1 or more.")
    content = scenario if isinstance(scenario, OrtScenario) else load_ort_scenario(scenario)
    content = content.limited(pictures)
    folder = Path(out).expanduser().absolute()
    _require_free(folder)
    drawn = secrets.randbits(SEED_BITS) if seed is None else seed
    with _whole_or_not(folder) as temporary:
        sealed = _PackageMaker(content, temporary, drawn, jobs, progress or _quiet).make()
        _same_times(temporary)
        write_key(key_beside(folder), sealed.key)
    return open_rehearsal(folder)


def _quiet(_done: int, _total: int, _words: str) -> None:
    """Say nothing."""


def _require_free(folder: Path) -> None:
    for path in (folder, key_beside(folder)):
        if path.exists() or path.is_symlink():
            raise SessionError(
                f"{path} is there already; a rehearsal is never overwritten. Choose another folder, or remove it."
            )


@contextlib.contextmanager
def _whole_or_not(folder: Path) -> Iterator[Path]:
    """Yield a hidden folder, and move it to its place when the block ends well; else leave nothing, no key either."""
    temporary: Path | None = None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}-"))
        temporary.chmod(0o755)
        yield temporary
        temporary.rename(folder)
    except OSError as error:
        raise SessionError(
            f"cannot make the rehearsal {folder}: {error.strerror or error}. Free some space or choose another folder."
        ) from error
    finally:
        if temporary is not None and temporary.exists():
            shutil.rmtree(temporary, ignore_errors=True)
            key_beside(folder).unlink(missing_ok=True)


def _same_times(folder: Path) -> None:
    """Give all files one time: the order in which they were made is nobody's business."""
    now = int(time.time())
    for path in folder.rglob("*"):
        os.utime(path, (now, now))


@dataclass(frozen=True, slots=True)
class _PackageMaker:
    """One package in the making."""

    scenario: OrtScenario
    folder: Path
    seed: int
    jobs: int
    progress: Progress

    def make(self) -> SealedTruth:
        """Write everything into the folder; return the sealed truth and its key."""
        total = len(self.scenario.sequence())
        self.progress(0, total, "kernels")
        metakernel = copy_kernels(self.scenario, self.folder)
        mission, named = copy_mission(self.scenario, self.folder)
        cameras = _cameras(self.scenario, mission)
        add_pointing(self.scenario, mission, cameras, metakernel)
        with KernelSet(metakernel):
            geometry = geometry_at_epoch(self.scenario, mission)
            case = draw_case(self.scenario, geometry, self.seed)
            content = self._content(mission, named, metakernel, geometry, case)
            write_briefing(self.folder, content, mission, cameras)
            if self.scenario.orbit is not None:
                self.progress(0, total, "the map")
                places = write_team_map(self.scenario, self.scenario.orbit, case, self.folder / MAP_FOLDER)
        truths = self._pictures(case, geometry, metakernel, total)
        with KernelSet(metakernel):
            values = sealed_values(self.scenario, case, geometry, truths, cameras, mission.spacecraft_id)
        if self.scenario.orbit is not None:
            values["orbit"] |= {"places_km": places}
        return self._seal(content, values)

    def _pictures(
        self, case: OrtCase, geometry: OrtGeometry, metakernel: Path, total: int
    ) -> Mapping[str, Truth]:
        done: list[str] = []

        def one_more(truth: Truth) -> None:
            done.append(truth.picture.stem)
            self.progress(len(done), total, truth.picture.stem)

        out = self.folder / PICTURE_FOLDER
        batch = PictureBatch(self.scenario, case, geometry.epoch_et, metakernel, out)
        truths = make_pictures(batch, self.jobs, one_more)
        remove_missing(out, case.missing)
        truncate_pictures(out, case.truncated, self.seed)
        return truths

    def _content(
        self, mission: Mission, named: str, metakernel: Path, geometry: OrtGeometry, case: OrtCase
    ) -> OrtContent:
        s, sequence = self.scenario, self.scenario.sequence()
        last = datetime.fromisoformat(sequence[-1].time)
        return OrtContent(
            format=PACKAGE_FORMAT,
            name=s.name,
            title=s.title,
            description=" ".join(s.description.split()),
            mission=named,
            catalog=s.catalog,
            targets=s.targets,
            reference_body=mission.reference_body,
            kernels=metakernel.relative_to(self.folder).as_posix(),
            epoch_utc=utc_from_et(geometry.epoch_et),
            parameters=s.parameters,
            b_plane=None if s.b_plane is None else _flyby_content(s.b_plane, geometry),
            orbit=None if s.orbit is None else _orbit_content(s.orbit, geometry, predicted_utc(s)),
            due_utc=(last + timedelta(hours=s.due_hours)).isoformat(timespec="seconds"),
            deliver=s.deliver,
            pictures=tuple(
                PictureContent(
                    name=p.name,
                    file=f"{PICTURE_FOLDER}/{p.name}{PICTURE_SUFFIX}",
                    utc=p.time,
                    camera=p.camera,
                    exposure_s=p.exposure_s,
                    targets=s.targets if p.targets is None else p.targets,
                    received=p.name not in case.missing,
                )
                for p in sequence
            ),
            sha256={},
            sealed_truth=SealContent(file=SEALED_FILE, sha256="", plain_sha256=""),
        )

    def _seal(self, content: OrtContent, values: Mapping[str, Any]) -> SealedTruth:
        files = sorted(p for p in self.folder.rglob("*") if p.is_file())
        sums = {path.relative_to(self.folder).as_posix(): sha256_of(path) for path in files}
        told = content.model_copy(update={"sha256": sums})
        sealed = seal(values, public_digest(told.model_dump(mode="json")))
        (self.folder / SEALED_FILE).write_bytes(sealed.token)
        seen = SealContent(
            file=SEALED_FILE, sha256=hashlib.sha256(sealed.token).hexdigest(), plain_sha256=sealed.commitment
        )
        write_content(self.folder, told.model_copy(update={"sealed_truth": seen}))
        return sealed


def _cameras(scenario: OrtScenario, mission: Mission) -> dict[str, Camera]:
    """Return the camera of each picture, as calibrated; each file is read once."""
    sequence = scenario.sequence()
    read = {name: mission.camera_named(name) for name in dict.fromkeys(p.camera for p in sequence)}
    return {picture.name: read[picture.camera] for picture in sequence}


def _orbit_content(orbit: OrbitTask, geometry: OrtGeometry, predict_utc: str) -> OrbitContent:
    return OrbitContent(
        body=orbit.body,
        gm_km3_s2=geometry.gm_km3_s2,
        distance_km=float(np.linalg.norm(geometry.relative_state[:3])),
        maplets=f"{MAP_FOLDER}/{maplets_name(orbit.body)}",
        shape=f"{MAP_FOLDER}/{shape_name(orbit.body)}",
        predict_utc=predict_utc,
        **orbit.model_dump(include={"pole_sigma_deg", "meridian_sigma_deg", "spin_sigma", "map_sigma"}),
    )


def _flyby_content(body: str, geometry: OrtGeometry) -> BPlaneContent:
    plane = geometry.flyby()
    return BPlaneContent(
        body=body,
        gm_km3_s2=geometry.gm_km3_s2,
        pole=POLE,
        closest_utc=utc_from_et(geometry.epoch_et + plane.closest_s),
        closest_km=plane.closest_km,
        b_dot_t_km=plane.b_dot_t_km,
        b_dot_r_km=plane.b_dot_r_km,
        time_of_flight_s=plane.linearized_s,
        v_infinity_km_s=plane.v_infinity_km_s,
    )
