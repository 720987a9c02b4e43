"""Solved pointings as a "reconstructed" CK, so that others can use them.

A picture's pointing holds for the middle of its exposure. Each picture becomes an interval of its own that spans the
exposure; within it the camera turns at the rate that the loaded CK gives there, or not at all where it gives none.
The CK orients the spacecraft's bus, through the mounting of the camera in the loaded frames kernel; where that is not
loaded, it orients the camera itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.errors import KernelError, SessionError
from opnav_workbench.geometry import matrix_from_quaternion, rotation_from_vector
from opnav_workbench.kernels import KernelSet, camera_rate, ck_structure, knows_frame, rotation, write_ck
from opnav_workbench.mission import Mission, load_mission
from opnav_workbench.version import __version__

__all__ = ["Reconstruction", "write_reconstructed_ck"]

MARGIN_S = 2e-3  # header times are rounded to a millisecond: a reader's idea of mid-exposure must lie inside
APART_S = 1e-4  # between intervals, and the least that one may reach from mid-exposure
MICRO = 1e6


@dataclass(frozen=True, slots=True)
class Reconstruction:
    """What was written.

    Attributes
    ----------
    frame
        What the CK orients: the bus, or the camera where its mounting was not known.
    structure_id
        NAIF id of that in the CK.
    pictures
        Pictures whose pointing the CK holds, in order of time.
    skipped : tuple of (str, str)
        Pictures left out, and why.
    note
        What a user of the CK must know; empty as a rule.
    """

    path: Path
    frame: str
    structure_id: int
    pictures: tuple[str, ...]
    skipped: tuple[tuple[str, str], ...]
    note: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class _Picture:
    """A solved picture."""

    name: str
    utc: str
    camera: Camera
    et: float
    half_s: float
    camera_from_j2000: FloatArray
    sigmas_rad: FloatArray  # (3,) about the camera frame's axes
    n_stars: int
    rms_px: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclass(frozen=True, slots=True)
class _Structure:
    """What a CK orients."""

    frame: str
    id: int
    clock: int
    note: str = ""


def write_reconstructed_ck(
    results: Sequence[Mapping[str, Any]],
    out: str | Path,
    mission: Mission | None = None,
    *,
    without_twist: bool = False,
) -> Reconstruction:
    """Write the solved pointings of pictures as a CK.

    Needs an active `KernelSet` with LSK and SCLK; the frames kernel makes the CK one of the bus, and a CK with rates
    gives the rate during the exposures.

    Parameters
    ----------
    results
        As `ImageSession.result` returns them and ``result.json`` holds them; all of one mission.
    out
        The CK; an older file of that name is replaced once the new one is whole.
    mission
        Default: the one that the results name.
    without_twist
        Take pictures whose stars did not determine the twist, too; they keep their a priori twist.

    Raises
    ------
    SessionError
        No picture has a solved pointing (each is named with its reason), or missions or cameras do not go together.
    KernelError
        No kernels, no clock at the time of a picture, or the file cannot be written; nothing is left half-written.
    """
    if KernelSet.active() is None:
        raise KernelError(
            "a CK needs the spacecraft clock: open kernels with LSK and SCLK (and FK, for the camera's mounting)."
        )
    mission = mission or load_mission(_only([str(r["mission"]) for r in results], "missions"))
    reasons = [(str(r["image"]), _reason(r, without_twist)) for r in results]
    solved = [_picture(r, mission) for r, (_, why) in zip(results, reasons, strict=True) if not why]
    pictures, twice = _without_twins(sorted(solved, key=lambda p: p.et))
    skipped = (*((name, why) for name, why in reasons if why), *twice)
    if not pictures:
        why = "; ".join(f"{name}: {reason}" for name, reason in skipped)
        raise SessionError(f"no picture with a pointing to write{': ' + why if why else ''}.")
    structure = _structure(mission, pictures)
    nodes = [_nodes(p, half, structure) for p, half in zip(pictures, _halves(pictures), strict=True)]
    write_ck(
        out,
        structure.id,
        structure.clock,
        np.concatenate([et for et, _, _ in nodes]),
        np.concatenate([attitudes for _, attitudes, _ in nodes]),
        np.concatenate([rates for _, _, rates in nodes]),
        interval_starts=np.cumsum([0, *(len(et) for et, _, _ in nodes[:-1])]).tolist(),
        comment=_comment(mission, structure, pictures, skipped),
    )
    names = tuple(p.name for p in pictures)
    return Reconstruction(Path(out), structure.frame, structure.id, names, skipped, structure.note)


def _only(values: Sequence[str], what: str) -> str:
    different = sorted(set(values))
    if len(different) != 1:
        raise SessionError(
            f"one CK holds pictures of one spacecraft, but the {what} are {', '.join(different) or 'none'}; "
            "write them apart."
        )
    return different[0]


def _reason(result: Mapping[str, Any], without_twist: bool) -> str:
    """Return why a picture is left out; empty if it is not."""
    pointing = result.get("pointing")
    if pointing is None:
        messages = [str(m) for m in result.get("messages") or ()]
        return f"no pointing solved ({messages[0]})" if messages else "no pointing solved"
    contradictions = (result.get("provenance") or {}).get("contradictions")
    if contradictions:
        return f"its header contradicts itself, the kernels or the stars ({contradictions[0]})"
    if not pointing.get("twist_solved", True) and not without_twist:
        return "its stars do not determine the twist (--without-twist takes it with the a priori twist)"
    return ""


def _picture(result: Mapping[str, Any], mission: Mission) -> _Picture:
    try:
        pointing = result["pointing"]
        covariance = np.array(pointing["covariance_rad2"], dtype=np.float64)  # null becomes nan
        return _Picture(
            name=str(result["image"]),
            utc=str(result["utc"]),
            camera=mission.camera_named(str(result["camera"])),
            et=float(result["et"]),
            half_s=0.5 * float(result["exposure_s"] or 0.0) + MARGIN_S,
            camera_from_j2000=matrix_from_quaternion(pointing["quaternion_camera_from_j2000"]),
            sigmas_rad=np.sqrt(np.diag(covariance)),
            n_stars=int(pointing["n_stars"]),
            rms_px=float(np.nan if pointing["rms_px"] is None else pointing["rms_px"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise SessionError(
            f"the result of {result.get('image', 'a picture')} is damaged ({error!r}); process the picture again."
        ) from error


def _without_twins(pictures: Sequence[_Picture]) -> tuple[list[_Picture], list[tuple[str, str]]]:
    """Keep the surest of pictures taken at the same time: a CK holds one attitude at a time."""
    kept: list[_Picture] = []
    left: list[tuple[str, str]] = []
    for picture in pictures:
        if not kept or picture.et - kept[-1].et > 3.0 * APART_S:
            kept.append(picture)
            continue
        surer, other = sorted(
            (kept[-1], picture), key=lambda p: float(np.nan_to_num(p.sigmas_rad, nan=np.inf).max())
        )
        kept[-1] = surer
        left.append((other.name, f"taken at the same time as {surer.name}, whose pointing is surer"))
    return kept, left


def _halves(pictures: Sequence[_Picture]) -> FloatArray:
    """Return how far each interval reaches from mid-exposure (n, 2), before and after; neighbours do not overlap."""
    halves = np.array([[p.half_s, p.half_s] for p in pictures])
    for i, (first, second) in enumerate(pairwise(pictures)):
        room = 0.5 * (second.et - first.et - APART_S)
        halves[i, 1], halves[i + 1, 0] = min(halves[i, 1], room), min(halves[i + 1, 0], room)
    return halves


def _structure(mission: Mission, pictures: Sequence[_Picture]) -> _Structure:
    """Choose what the CK orients: the bus, or the camera where no frames kernel mounts it."""
    frames = sorted({p.camera.frame for p in pictures})
    bus = ck_structure(mission.bus_frame)
    if bus is not None and all(knows_frame(frame) for frame in frames):
        return _Structure(mission.bus_frame, *bus)
    frame = _only(frames, "cameras")
    own = ck_structure(frame)
    if own is not None:
        return _Structure(frame, *own)
    number = pictures[0].camera.instrument_id
    note = (
        f"no loaded frames kernel mounts {frame} on {mission.bus_frame}: the CK orients {frame} itself, as structure "
        f"{number}; to read it, load an FK that makes {frame} a CK frame (class 3) of that id"
    )
    return _Structure(frame, number, mission.clock_id, note)


def _nodes(
    picture: _Picture, halves: FloatArray, structure: _Structure
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return epochs (3,), attitudes (3, 3, 3) and rates (3, 3) of one picture's interval, the middle one as solved."""
    frame, rate = picture.camera.frame, _rate(picture)
    steps = np.array([-halves[0], 0.0, halves[1]])
    attitudes = picture.camera_from_j2000 @ rotation_from_vector(-steps[:, None] * rate)
    if structure.frame != frame:
        attitudes = rotation(frame, structure.frame, picture.et) @ attitudes
    return picture.et + steps, attitudes, np.tile(rate, (3, 1))


def _rate(picture: _Picture) -> FloatArray:
    try:
        return camera_rate(picture.camera.frame, picture.et)
    except KernelError:  # no CK then, or one without rates
        return np.zeros(3)


def _comment(
    mission: Mission, structure: _Structure, pictures: Sequence[_Picture], skipped: Sequence[tuple[str, str]]
) -> str:
    """Return what stands in the CK's comment area: pictures, sigmas, program."""
    lines = [
        f"Reconstructed attitude of {structure.frame} ({structure.id}), {mission.spacecraft_name}: camera pointing",
        f"solved from stars by opnav_workbench {__version__}, one interval per picture, spanning its exposure.",
        "",
        "sigmas: one-sigma rotation about the x, y, z axes of the camera's frame, microradians",
        "",
        *(_line(p) for p in pictures),
        "",
        *(f"left out: {name}: {why}" for name, why in skipped),
        *([f"note: {structure.note}"] if structure.note else []),
    ]
    return "\n".join(lines)


def _line(p: _Picture) -> str:
    sigmas = " ".join(f"{MICRO * s:.3f}" for s in p.sigmas_rad)
    return (
        f"{p.name}  {p.utc} UTC  {p.camera.name}  sigmas {sigmas}  {p.n_stars} stars, rms {p.rms_px:.3f} px"
    )
