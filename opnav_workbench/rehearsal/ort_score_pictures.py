"""One picture of a rehearsal against its truth: was it lost, where did it point, what was found, missed, invented."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import matrix_from_quaternion, vector_from_rotation
from opnav_workbench.rehearsal.ort_score_check import Check, checked
from opnav_workbench.rehearsal.ort_score_stars import StarScore, score_stars
from opnav_workbench.rehearsal.ort_solution_pictures import DISK_FROM_PX, PictureResult
from opnav_workbench.rehearsal.score import compare
from opnav_workbench.simulation import Truth

__all__ = ["CenterScore", "PictureScore", "score_picture"]


@dataclass(frozen=True, slots=True, eq=False)
class CenterScore:
    """A body in a picture.

    Attributes
    ----------
    body, method, status : str
        As the team reports it; the last of several methods that is sure.
    visible : bool
        Whether it truly is on the detector, and not hidden.
    check : Check or None
        None: no center was claimed.
    verdict : {"good", "poor", "wrong", "unsure", "missed", "false", "absent"}
        unsure: reported as uncertain; false: claimed where there is none; absent: rightly not claimed.
    """

    body: str
    method: str
    status: str
    visible: bool
    check: Check | None
    verdict: str


@dataclass(frozen=True, slots=True, eq=False)
class PictureScore:
    """A picture.

    Attributes
    ----------
    name, utc : str
    et : float
    status : str
        As the team reports it.
    lost : str
        Why it holds nothing usable; empty where it does.
    verdict : {"good", "not solved", "lost, named", "claimed though lost", "not reported"}
    pointing : Check or None
    centers : tuple of CenterScore
    stars : StarScore
    messages : tuple of str
        Of the team.
    """

    name: str
    utc: str
    et: float
    status: str
    lost: str
    verdict: str
    pointing: Check | None
    centers: tuple[CenterScore, ...]
    stars: StarScore
    messages: tuple[str, ...]


def score_picture(
    reported: PictureResult,
    truth: Truth | None,
    camera: Camera | None,
    targets: Sequence[str],
    *,
    lost: str = "",
    utc: str = "",
    disk_sigma_px: float = 0.0,
) -> PictureScore:
    """Hold what a team says of a picture against its truth.

    Parameters
    ----------
    reported : PictureResult
    truth : Truth or None
        None: the picture was never taken.
    camera : Camera or None
        None where there is no truth.
    targets : sequence of str
        Bodies that the team is to find.
    lost : str
        Why the picture holds nothing usable; empty where it does.
    utc : str
    disk_sigma_px : float
        What the team adds (in squares) to the sigmas of disks.
    """
    pointing: Check | None = None
    centers: tuple[CenterScore, ...] = ()
    stars = StarScore()
    if truth is not None and camera is not None and not lost:
        pointing = _pointing(reported.result, truth, camera) if reported.solved else None
        centers = _centers(reported, truth, targets, disk_sigma_px)
        stars = score_stars(reported.result, truth)
    return PictureScore(
        name=reported.name,
        utc=utc,
        et=np.nan if truth is None else truth.et,
        status=reported.status,
        lost=lost,
        verdict=_verdict(reported, lost),
        pointing=pointing,
        centers=centers,
        stars=stars,
        messages=reported.messages,
    )


def _verdict(reported: PictureResult, lost: str) -> str:
    if reported.status == "missing":
        return "not reported"
    if lost:
        return "claimed though lost" if _claims(reported) else "lost, named"
    return "good" if reported.solved else "not solved"


def _claims(reported: PictureResult) -> bool:
    """Whether a team claims anything of a picture: a pointing, or a body's center."""
    bodies = reported.result.get("bodies") or ()
    return reported.status != "failed" and (reported.solved or any(_is_claimed(b) for b in bodies))


def _is_claimed(body: Mapping[str, Any]) -> bool:
    return body.get("status") == "ok" and body.get("observed") is not None


def _pointing(result: Mapping[str, Any], truth: Truth, camera: Camera) -> Check:
    """Return the attitude's check: values as the sky's shift on the detector, sigmas of the rotation itself."""
    rows = compare(truth, {"pointing": result["pointing"]}, camera)
    solved = matrix_from_quaternion(np.asarray(result["pointing"]["quaternion_camera_from_j2000"], float))
    rotation = vector_from_rotation(solved @ truth.camera_from_j2000.T)
    whole = checked("", (), (), rotation, np.zeros(3), result["pointing"]["covariance_rad2"])
    names, units = tuple(row.name for row in rows), tuple(row.unit for row in rows)
    solved_values, true, error, sigma = (
        np.array([getattr(row, name) for row in rows]) for name in ("solved", "truth", "error", "sigma")
    )
    return Check("pointing", names, units, solved_values, true, error, sigma, whole.sigmas)


def _centers(
    reported: PictureResult, truth: Truth, targets: Sequence[str], disk_sigma_px: float
) -> tuple[CenterScore, ...]:
    true = {name.upper(): place for name, place in truth.bodies.items()}
    visible = _visible(truth)
    entries = reported.result.get("bodies") or ()
    return tuple(
        _center(
            name, [b for b in entries if str(b["name"]).upper() == name.upper()], true, visible, disk_sigma_px
        )
        for name in targets
    )


def _visible(truth: Truth) -> frozenset[str]:
    rows = truth.objects[truth.objects["kind"] == "body"]
    seen = np.asarray(rows["on_detector"], bool) & ~np.asarray(rows["occulted"], bool)
    return frozenset(str(name).upper() for name in rows["id"][seen])


def _center(
    name: str,
    entries: Sequence[Mapping[str, Any]],
    true: Mapping[str, FloatArray],
    visible: frozenset[str],
    disk_sigma_px: float,
) -> CenterScore:
    seen = name.upper() in visible
    claimed = [entry for entry in entries if _is_claimed(entry)]
    if not claimed:
        status = str(entries[-1]["status"]) if entries else "not looked for"
        method = str(entries[-1]["method"]) if entries else ""
        missed = "unsure" if status == "uncertain" else "missed"
        return CenterScore(name, method, status, seen, None, missed if seen else "absent")
    entry = claimed[-1]
    if name.upper() not in true:
        return CenterScore(name, str(entry["method"]), "ok", seen, None, "false")
    check = checked(
        name,
        ("pixel", "line"),
        ("px", "px"),
        entry["observed"],
        true[name.upper()],
        np.asarray(entry["covariance_px2"], float) + _disk(entry, disk_sigma_px),
    )
    # A body just off the detector shows part of its disk: found there within its sigmas, it is no invention.
    verdict = check.verdict if seen or check.verdict == "good" else "false"
    return CenterScore(name, str(entry["method"]), "ok", seen, check, verdict)


def _disk(entry: Mapping[str, Any], sigma_px: float) -> FloatArray:
    wide = float(entry.get("diameter_px") or 0.0) > DISK_FROM_PX
    return np.asarray(sigma_px**2 * wide * np.eye(2))
