"""Pictures without stars take the pointing of their neighbors: the second round of a call with many pictures.

A short exposure of a bright body shows no star; the long one beside it does. What the stars of one say of the a priori
attitude's error holds for the other, as far as the settings ``carry_jitter_px``, ``carry_walk_px`` and ``carry_drift_px_s``
say (`stars.pointing.carried`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench import report
from opnav_workbench.camera import Camera
from opnav_workbench.files import read_json
from opnav_workbench.geometry import matrix_from_quaternion
from opnav_workbench.processing.automatic import find_targets
from opnav_workbench.processing.model import OpenedProcessing
from opnav_workbench.session import RESULT_FILE, SESSION_FILE, ImageSession, Settings
from opnav_workbench.stars.pointing import AttitudeMotion, SolvedAttitude

__all__ = ["FIGURE_FILE", "carry_between", "may_take_pointing", "pointings_to_take", "take_pointing"]

FIGURE_FILE = "summary.png"
AGAIN = "process the picture again."


@dataclass(frozen=True, slots=True)
class Donor:
    """A picture with stars that others may take the pointing from; only of one camera and one source of attitudes."""

    camera: str
    source: str
    attitude: SolvedAttitude


def carry_between(
    folders: Sequence[Path],
    opened: OpenedProcessing,
    say: Callable[[str, str], None] = lambda _name, _words: None,
) -> dict[Path, dict[str, Any]]:
    """Carry pointings to the pictures whose stars do not tell theirs, find their targets, and save them.

    Parameters
    ----------
    folders
        Of pictures that were processed, each with ``result.json`` and ``session.json``; others are left out.
    say
        Called with a folder's name and a few words before each step.

    Returns
    -------
    dict of Path to dict
        The new content of ``result.json`` by folder, where there is a new one.

    Raises
    ------
    SessionError
        A file of them is damaged.
    """
    made = {}
    for folder, near in pointings_to_take(folders, opened.settings).items():
        say(folder.name, f"carrying the pointing of {near[0].image}")
        made[folder] = take_pointing(folder, near, opened)
    return made


def pointings_to_take(folders: Sequence[Path], settings: Settings) -> dict[Path, tuple[SolvedAttitude, ...]]:
    """Return the folders of pictures whose stars do not tell their pointing, each with its neighbors', the nearest first.

    Raises
    ------
    SessionError
        A file of them is damaged.
    """
    if not settings.carry_within_s > 0.0:
        return {}
    results = {
        folder: read_json(folder / RESULT_FILE, AGAIN)
        for folder in folders
        if (folder / RESULT_FILE).is_file() and (folder / SESSION_FILE).is_file()
    }
    donors = [donor for folder, result in results.items() if (donor := _donor(folder, result)) is not None]
    giving = {donor.attitude.image for donor in donors}
    found = {}
    for folder, result in results.items():
        if result["image"] in giving or not may_take_pointing(result, settings):
            continue
        if near := _near(donors, result, settings):
            found[folder] = near
    return found


def may_take_pointing(result: dict[str, Any], settings: Settings) -> bool:
    """Whether a picture's own stars do not tell its pointing for sure, and others may."""
    asked = settings.carry_within_s > 0.0 and "provenance" in result
    return asked and not (result.get("pointing") and _field_sure(result))


def _field_sure(result: dict[str, Any]) -> bool:
    field = result.get("identification")
    return field is None or bool(field["sure"])


def _donor(folder: Path, result: dict[str, Any]) -> Donor | None:
    """What a picture may give; None where its stars do not tell its pointing for sure."""
    pointing = result.get("pointing")
    doubted = result["provenance"].get("contradictions") or not _field_sure(result)
    source = str(result["provenance"]["attitude_source"])
    if not pointing or not pointing["n_stars"] or not pointing["twist_solved"] or doubted or source == "none":
        return None
    a_priori = read_json(folder / SESSION_FILE, AGAIN)["inputs"]["a_priori_camera_from_j2000"]
    attitude = SolvedAttitude(
        image=str(result["image"]),
        et=float(result["et"]),
        camera_from_j2000=matrix_from_quaternion(pointing["quaternion_camera_from_j2000"]),
        a_priori_camera_from_j2000=np.array(a_priori, float),
        covariance_rad2=np.array(pointing["covariance_rad2"], float),
    )
    return Donor(str(result["camera"]), source, attitude)


def _near(donors: Sequence[Donor], result: dict[str, Any], settings: Settings) -> tuple[SolvedAttitude, ...]:
    same = (str(result["camera"]), str(result["provenance"]["attitude_source"]))
    near = [
        donor.attitude
        for donor in donors
        if (donor.camera, donor.source) == same
        and abs(donor.attitude.et - float(result["et"])) <= settings.carry_within_s
    ]
    return tuple(sorted(near, key=lambda attitude: abs(attitude.et - float(result["et"]))))


def take_pointing(folder: Path, near: Sequence[SolvedAttitude], opened: OpenedProcessing) -> dict[str, Any]:
    """Give a picture its neighbors' pointing, find its targets, save it, and return its new result.

    Raises
    ------
    OpNavError
        Its files are damaged or cannot be written, or the settings say nothing of the motion between pictures.
    """
    session = ImageSession.resume(folder)
    session.carry_pointing(near, motion_of(opened.settings, session.context.camera))
    find_targets(session, opened)
    session.save(folder)
    report.write_summary(session, folder / FIGURE_FILE)
    return session.result()


def motion_of(settings: Settings, camera: Camera) -> AttitudeMotion:
    """Return what settings say of the motion between pictures of a camera.

    Raises
    ------
    OpNavError
        They say that nothing moves, or something less than nothing.
    """
    scale = camera.pixel_scale_rad
    return AttitudeMotion(
        jitter_rad=settings.carry_jitter_px * scale,
        walk_rad=settings.carry_walk_px * scale,
        drift_rad_s=settings.carry_drift_px_s * scale,
    )
