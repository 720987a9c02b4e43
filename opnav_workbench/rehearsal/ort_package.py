"""Packages of operational readiness tests (ORT), the paper's rehearsals of mission-critical phases.

A package is a folder that tells a team what it would be told in flight, and no more:

    DIR/ort.yaml        mission, sequence, what to estimate and how well it is known; checksums of everything
    DIR/briefing.md     the same for people, and briefing.html
    DIR/pictures/       flight-like pictures; headers hold what was predicted
    DIR/kernels/        the predicted kernels and their metakernel
    DIR/truth.sealed    what was true, encrypted
    DIR.key             opens it; stays with the director

It is made in a hidden folder beside its place and moved there whole.
"""

import contextlib
import hashlib
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

from opnav_workbench.camera import Camera
from opnav_workbench.errors import MissionError, SessionError
from opnav_workbench.files import sha256_of
from opnav_workbench.mission import Mission
from opnav_workbench.rehearsal.ort_briefing import write_briefing
from opnav_workbench.rehearsal.ort_package_file import (
    FORMAT,
    BPlaneContent,
    OrtContent,
    PictureContent,
    SealContent,
    digest,
    write_content,
)
from opnav_workbench.rehearsal.ort_package_kernels import copy_kernels, copy_mission
from opnav_workbench.rehearsal.ort_package_open import (
    PICTURES,
    SEALED,
    OrtPackage,
    OrtPicture,
    key_beside,
    open_rehearsal,
)
from opnav_workbench.rehearsal.ort_package_pointing import add_pointing
from opnav_workbench.rehearsal.ort_perturb import OrtCase, OrtGeometry, draw_case, geometry_at_epoch
from opnav_workbench.rehearsal.ort_perturb_pictures import (
    SUFFIX,
    Assignment,
    cut_short,
    lose,
    make_pictures,
)
from opnav_workbench.rehearsal.ort_scenario import OrtScenario, load_ort_scenario
from opnav_workbench.rehearsal.ort_truth import SealedTruth, seal, write_key
from opnav_workbench.rehearsal.ort_truth_values import sealed_values
from opnav_workbench.simulation import Truth
from opnav_workbench.spice import KernelSet, utc_from_et

__all__ = ["OrtPackage", "OrtPicture", "new_rehearsal", "open_rehearsal"]

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
    seed : int, optional
        Draws the case; the same seed gives the same pictures, bit for bit. None: one that nobody knows, as a blind
        rehearsal needs: whoever has scenario and seed can make the package again.
    jobs : int
        Processes. A script that asks for more than one must guard its main part (``if __name__ == "__main__"``).
    pictures : int, optional
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
        sealed = _Maker(content, temporary, drawn, jobs, progress or _quiet).make()
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
class _Maker:
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
        truths = self._pictures(case, geometry, metakernel, total)
        with KernelSet(metakernel):
            values = sealed_values(self.scenario, case, geometry, truths, cameras, mission.spacecraft_id)
        return self._seal(content, values)

    def _pictures(
        self, case: OrtCase, geometry: OrtGeometry, metakernel: Path, total: int
    ) -> Mapping[str, Truth]:
        done: list[str] = []

        def one_more(truth: Truth) -> None:
            done.append(truth.picture.stem)
            self.progress(len(done), total, truth.picture.stem)

        out = self.folder / PICTURES
        assignment = Assignment(self.scenario, case, geometry.epoch_et, metakernel, out)
        truths = make_pictures(assignment, self.jobs, one_more)
        lose(out, case.missing)
        cut_short(out, case.truncated, self.seed)
        return truths

    def _content(
        self, mission: Mission, named: str, metakernel: Path, geometry: OrtGeometry, case: OrtCase
    ) -> OrtContent:
        s, sequence = self.scenario, self.scenario.sequence()
        last = datetime.fromisoformat(sequence[-1].time)
        return OrtContent(
            format=FORMAT,
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
            b_plane=_flyby(s.b_plane, geometry),
            due_utc=(last + timedelta(hours=s.due_hours)).isoformat(timespec="seconds"),
            deliver=s.deliver,
            pictures=tuple(
                PictureContent(
                    name=p.name,
                    file=f"{PICTURES}/{p.name}{SUFFIX}",
                    utc=p.time,
                    camera=p.camera,
                    exposure_s=p.exposure_s,
                    targets=s.targets if p.targets is None else p.targets,
                    received=p.name not in case.missing,
                )
                for p in sequence
            ),
            sha256={},
            sealed_truth=SealContent(file=SEALED, sha256="", plain_sha256=""),
        )

    def _seal(self, content: OrtContent, values: Mapping[str, Any]) -> SealedTruth:
        files = sorted(p for p in self.folder.rglob("*") if p.is_file())
        sums = {path.relative_to(self.folder).as_posix(): sha256_of(path) for path in files}
        told = content.model_copy(update={"sha256": sums})
        sealed = seal(values, digest(told.model_dump(mode="json")))
        (self.folder / SEALED).write_bytes(sealed.token)
        seen = SealContent(
            file=SEALED, sha256=hashlib.sha256(sealed.token).hexdigest(), plain_sha256=sealed.commitment
        )
        write_content(self.folder, told.model_copy(update={"sealed_truth": seen}))
        return sealed


def _cameras(scenario: OrtScenario, mission: Mission) -> dict[str, Camera]:
    """Return the camera of each picture, as calibrated; each file is read once."""
    sequence = scenario.sequence()
    read = {name: mission.camera_named(name) for name in dict.fromkeys(p.camera for p in sequence)}
    return {picture.name: read[picture.camera] for picture in sequence}


def _flyby(body: str, geometry: OrtGeometry) -> BPlaneContent:
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
