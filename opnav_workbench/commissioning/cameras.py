"""The camera that took a picture, from instrument kernels, image support data or a few numbers."""

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import AttitudeSigma, Camera, NoDistortion, Origin, RowTiming
from opnav_workbench.camera.support_data import read_support_data
from opnav_workbench.constants import RAD_PER_DEG
from opnav_workbench.errors import CameraError, MissionError, OpNavError, some_of
from opnav_workbench.kernels import KernelSet, instrument_ids, instrument_values

__all__ = [
    "NO_WORDS",
    "Numbers",
    "PictureWords",
    "camera_of_kernels",
    "camera_of_numbers",
    "camera_of_support_data",
    "with_rows",
]

SHOWN = 16  # instruments named in an error: more than a filter wheel has
FEW = 3  # numbers of each
POINTING_RAD = 1e-3  # how well a spacecraft's attitude is known, where nobody says
MOST_CROSS_PX = 60.0
ALIKE_PX = 0.01  # filters whose pictures differ by less are one camera
SCAN_LINES = 1024  # of a scan that nobody has taken yet
SCANNER = "a line scanner? --line-scan --line-time-s 0.002 (s from line to line)"
WHEEL_PX = 5.0  # filters of one camera, whose lens focuses their colors elsewhere: Dawn's are 1.5 px apart in a corner
NETWORK = 5  # places along each side that this is asked at


@dataclass(frozen=True, slots=True)
class Numbers:
    """What a person knows of a camera; None where not known."""

    focal_mm: float | None = None
    pixel_um: float | None = None
    fov_deg: float | None = None  # from edge to edge along pixel
    size: tuple[int, int] | None = None  # pixels, lines
    line_time_s: float | None = (
        None  # of a rolling shutter or a line scan, from a line to the next; negative: the last comes first
    )
    scans: bool = False  # whether the camera's motion makes the lines

    def size_with(self, shape: tuple[int, int] | None) -> tuple[int, int] | None:
        """Return pixels and lines: the size told, else that of a picture's shape."""
        return self.size or (None if shape is None else (shape[1], shape[0]))


@dataclass(frozen=True, slots=True)
class PictureWords:
    """What a picture's header says of the camera and the filter that took it; empty where nothing."""

    instruments: tuple[str, ...] = ()
    filters: tuple[str, ...] = ()


NO_WORDS = PictureWords()


def camera_of_kernels(
    kernels: Sequence[str | Path],
    wanted: str | None,
    shape: tuple[int, int] | None,
    numbers: Numbers,
    words: PictureWords = NO_WORDS,
) -> Camera:
    """Return the camera that instrument kernels describe: the one wanted, else the one that a picture tells.

    A picture tells by its size, and by its words for instrument and filter; filters of the same optics are one camera.

    Parameters
    ----------
    wanted
        NAIF number, or part of the name.
    shape
        Lines and pixels of the picture.
    numbers
        Stand in for what the kernels do not give.
    words
        Of the picture's header.

    Raises
    ------
    CameraError
        No instrument is a camera, or none or several are the one; they are named, each with why not.
    """
    given: dict[str, Any] = {}
    size = numbers.size_with(shape)
    if numbers.focal_mm is not None:
        given["focal_length_mm"] = numbers.focal_mm
    found: list[Camera] = []
    fitted: list[Camera] = []
    refused: dict[str, list[int]] = {}
    others: list[int] = []
    with KernelSet(kernels):
        for number in instrument_ids():
            values = instrument_values(number)
            if wanted is not None and not _is_wanted(wanted, number, values):
                others.append(number)
                continue
            try:
                camera = Camera.from_ik(values, number, **given)
                found.append(_scanned(camera, size) if numbers.scans else camera)
            except OpNavError as error:
                try:
                    fitted.append(_fitted(values, number, size, given, error))
                except OpNavError as why:
                    # What follows says it to callers in Python; what to do here is said below.
                    refused.setdefault(str(why).partition(";")[0].rstrip("."), []).append(number)
    if shape is not None and wanted is None:
        found = _of_size(found, shape, or_refuse=not fitted)
    if len(found) == 1 and shape is not None and not numbers.scans:
        _check_size(found[0], shape, kernels)
    found = found or fitted  # one that states its size comes before one that takes the picture's
    if not found:
        raise CameraError(_nothing_found(refused, size, others))
    camera = _the_one(found, words)
    if camera.n_line == 1 and not numbers.scans:
        raise CameraError(f"{camera.name} ({camera.instrument_id}) has one line of pixels; {SCANNER}.")
    return _with_pointing(camera)


def _scanned(camera: Camera, size: tuple[int, int] | None) -> Camera:
    """The camera with as many lines as a scan has: those of the picture, not of the detector."""
    if size is not None and size[0] == camera.n_pixel:
        told = Origin("n_line", "known", f"{size[1]}, the scan's")
    elif camera.n_line == 1:
        size = camera.n_pixel, SCAN_LINES
        told = Origin("n_line", "guessed", f"{SCAN_LINES}; scans have any length")
    else:
        return camera
    origins = tuple(origin for origin in camera.origins if origin.field != "n_line")
    return replace(camera, n_line=size[1], origins=(*origins, told))


def _nothing_found(
    refused: Mapping[str, Sequence[int]], size: tuple[int, int] | None, others: Sequence[int]
) -> str:
    """Say why no instrument of the kernels (numbers by reason) is a camera, and what cures it; others were not wanted."""
    if not refused and others:
        return (
            f"no camera in these kernels: no instrument of that number or name (--instrument); there are "
            f"{_listed(others)}."
        )
    if not refused:
        return "no camera in these kernels: no instrument at all; give its instrument kernel (--ik probe_cam.ti)."
    remedy = "give the numbers that are missing, or the kernel that has them, too (another --ik)"
    if any("PIXEL_SAMPLES" in why for why in refused) and size is None:
        remedy = "give a picture (--image) or --size 1024x1024; beside an ISIS addendum its IK is needed, too (--ik)"
    elif any("OD_K" in why for why in refused):
        remedy = "leave the addendum out: its distortion follows a law of its own"
    elif any("FOV_FRAME" in why for why in refused):
        remedy = "an addendum alone makes no camera: give the instrument kernel that it belongs to, too (another --ik)"
    reasons = [f"{why} ({_listed(numbers)})" for why, numbers in list(refused.items())[:FEW]]
    return f"no camera in these kernels: {'; '.join(reasons)}; {remedy}."


# ---- Which one of several: what the picture says, and what is alike.


def _the_one(found: Sequence[Camera], words: PictureWords) -> Camera:
    """Return the camera that a picture's words leave; filters of the same optics are one.

    Raises
    ------
    CameraError
        Several are left; they are named.
    """
    why: list[str] = []
    for word in words.instruments:
        named = [camera for camera in found if _squeezed(word) in _squeezed(camera.name + " " + camera.frame)]
        if _squeezed(word) and 0 < len(named) < len(found):
            found = named
            why.append(f"the picture's instrument is {word}")
    for word in words.filters:
        of_filter = _of_filter(found, word)
        if 0 < len(of_filter) < len(found):
            found = of_filter
            why.append(f"the picture's filter is {word}")
    first = min(found, key=lambda camera: abs(camera.instrument_id))
    others = [camera for camera in found if camera is not first]
    apart_px = max((_apart_px(first, other) for other in others), default=0.0)
    if apart_px >= ALIKE_PX:
        if not words.filters and apart_px < WHEEL_PX and _is_wheel(first, others):
            text = (
                f"{first.instrument_id}, the camera itself: its filter is not told; with one of the {len(others)} others "
                f"places are up to {apart_px:.1f} px off (--instrument)"
            )
            guess = Origin("instrument_id", "guessed", text)
            return replace(first, origins=(*first.origins, guess))
        raise CameraError(
            f"{len(found)} cameras in these kernels: {_named(found)}; choose one by its number,"
            f" --instrument {first.instrument_id} (filters and modes of a camera have numbers of their own)."
        )
    if others:
        why.append(f"{_listed([other.instrument_id for other in others])} see the same to {ALIKE_PX:g} px")
    if not why:
        return first
    told = Origin("instrument_id", "derived", f"{first.instrument_id}: {'; '.join(why)}")
    return replace(first, origins=(*first.origins, told))


def _squeezed(text: str) -> str:
    return re.sub(r"[^A-Z0-9]", "", text.upper())


def _of_filter(found: Sequence[Camera], word: str) -> list[Camera]:
    """Cameras of a filter: by the last part of their names, or by its number, which NAIF puts into the last digit."""
    named = [c for c in found if word.upper() == re.split(r"[^A-Z0-9]", c.name.upper())[-1]]
    number = int(word) if word.isdigit() and int(word) < 10 else None
    if named or number is None:
        return named
    base = {camera.instrument_id for camera in found if camera.instrument_id % 10 == 0}
    return [camera for camera in found if camera.instrument_id + number in base]


def _apart_px(camera: Camera, other: Camera) -> float:
    """How far apart two cameras see a direction at most, px; infinite of other frames and sizes."""
    if (camera.n_pixel, camera.n_line, camera.frame) != (other.n_pixel, other.n_line, other.frame):
        return math.inf
    across, down = (np.linspace(0.0, n - 1.0, NETWORK) for n in (camera.n_pixel, camera.n_line))
    places: FloatArray = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    apart = np.linalg.norm(other.project(camera.unproject(places)) - places, axis=1)
    return float(np.nan_to_num(apart, nan=np.inf).max())


def _is_wheel(camera: Camera, others: Sequence[Camera]) -> bool:
    """Whether others are the filters of a camera, by names and numbers."""
    return camera.instrument_id % 10 == 0 and all(other.name == camera.name for other in others)


def _listed(numbers: Sequence[int]) -> str:
    return some_of(list(map(str, numbers)), SHOWN)


def _of_size(every: Sequence[Camera], shape: tuple[int, int], *, or_refuse: bool) -> list[Camera]:
    """Return the cameras that make pictures of a size; where there are some, and none does, refuse them."""
    found = [camera for camera in every if (camera.n_line, camera.n_pixel) == shape]
    if found or not every or not or_refuse:
        return found
    sizes = sorted({(camera.n_pixel, camera.n_line) for camera in every})
    one_line = any(across == shape[1] and down == 1 for across, down in sizes)
    remedy = SCANNER if one_line else "give the kernel of this picture's camera (--ik)"
    raise CameraError(
        f"no camera in these kernels makes {shape[1]} x {shape[0]} pixels: {_named(every)} make "
        f"{', '.join(f'{across} x {down}' for across, down in sizes[:SHOWN])}; {remedy}."
    )


def _check_size(camera: Camera, shape: tuple[int, int], kernels: Sequence[str | Path]) -> None:
    """Refuse a camera that makes pictures of another size, and name those that make this one's."""
    if (camera.n_line, camera.n_pixel) == shape:
        return
    others: list[Camera] = []
    with KernelSet(kernels):
        for number in instrument_ids():
            with suppress(OpNavError):
                others.append(Camera.from_ik(instrument_values(number), number))
    fitting = [other for other in others if (other.n_line, other.n_pixel) == shape]
    remedy = (
        f"of that size are {_named(fitting)}: --instrument {fitting[0].instrument_id}"
        if fitting
        else "none of these kernels makes that size: give a whole picture of this camera, or its numbers (--focal-mm, "
        "--pixel-um) instead of the kernel"
    )
    raise CameraError(
        f"{camera.name} ({camera.instrument_id}) makes {camera.n_pixel} x {camera.n_line} pixels, and the picture has "
        f"{shape[1]} x {shape[0]}; {remedy}."
    )


def _named(found: Sequence[Camera]) -> str:
    """Name the cameras, each name once where there are several: what a mission has, not what its first camera has."""
    groups: dict[str, list[Camera]] = {}
    for camera in found:
        groups.setdefault(camera.name, []).append(camera)
    parts = [
        f"{name} ({', '.join(str(c.instrument_id) for c in group[:FEW])}{' and more' if len(group) > FEW else ''})"
        for name, group in groups.items()
    ]
    if len(groups) == 1:
        parts = [f"{c.instrument_id} ({c.name}, {c.focal_length_mm:g} mm)" for c in found]
    return some_of(parts, SHOWN)


def _is_wanted(wanted: str, number: int, values: Any) -> bool:
    texts = [str(value[0]) for key, value in values.items() if key.endswith(("_NAME", "_FOV_FRAME"))]
    return wanted.strip() == str(number) or any(wanted.casefold() in text.casefold() for text in texts)


def _fitted(
    values: Any, number: int, size: tuple[int, int] | None, given: dict[str, Any], error: OpNavError
) -> Camera:
    """The camera of kernels that give no number of pixels, with those told or the picture's; else why there is none."""
    if size is None:
        raise error
    return Camera.from_ik(values, number, n_pixel=size[0], n_line=size[1], **given)


def camera_of_numbers(name: str, number: int, shape: tuple[int, int] | None, numbers: Numbers) -> Camera:
    """Return a pinhole that looks along +Z of a frame of its own.

    Raises
    ------
    MissionError
        The numbers do not make a camera; the message says which are missing.
    """
    size = numbers.size_with(shape)
    if size is None:
        raise MissionError("how many pixels has the camera? Give a picture (--image) or --size 1024x1024.")
    if numbers.fov_deg is not None:
        pixel_um = numbers.pixel_um or 10.0
        focal_mm = 0.5 * size[0] * pixel_um * 1e-3 / float(np.tan(0.5 * numbers.fov_deg * RAD_PER_DEG))
        how = f"{numbers.fov_deg:g} deg over {size[0]} pixels"
    elif numbers.focal_mm is not None and numbers.pixel_um is not None:
        focal_mm, pixel_um = numbers.focal_mm, numbers.pixel_um
        how = f"{focal_mm:g} mm, {pixel_um:g} um, as given"
    else:
        raise MissionError("give an instrument kernel (--ik), or --focal-mm with --pixel-um, or --fov-deg.")
    origins = (
        Origin("focal_length_mm, pixel_from_mm", "known", how),
        Origin("n_pixel, n_line", "known", f"{size[0]} x {size[1]}"),
        Origin("center_pixel_line", "guessed", "the middle of the detector"),
        Origin("focal_from_camera", "guessed", "pixel +X, line +Y, boresight +Z of a frame of its own"),
        Origin("distortion", "guessed", "none"),
    )
    camera = Camera(
        name=name,
        frame=f"{name.upper()}_CAMERA",
        instrument_id=number,
        n_pixel=size[0],
        n_line=size[1],
        focal_length_mm=focal_mm,
        center_pixel_line=0.5 * (np.array(size, dtype=np.float64) - 1.0),
        pixel_from_mm=np.eye(2) * 1e3 / pixel_um,
        focal_from_camera=np.eye(3),
        distortion=NoDistortion(),
        source="numbers given to opnav mission new",
        origins=origins,
    )
    return _with_pointing(camera)


def camera_of_support_data(path: Path, name: str, shape: tuple[int, int] | None) -> tuple[Camera, str]:
    """Return the camera that image support data of a picture describe, and the spacecraft's name.

    Raises
    ------
    CameraError
        They cannot be read, or are of a picture of another size.
    """
    told = read_support_data(path)
    camera = told.camera
    if shape is not None and (camera.n_line, camera.n_pixel) != shape:
        raise CameraError(
            f"{path.name} is of a picture of {camera.n_pixel} x {camera.n_line} pixels, and this one has {shape[1]} x "
            f"{shape[0]}; give the image support data of this picture (--isd)."
        )
    known = Origin(
        "optics, detector", "known", f"{path.name}, image support data of {told.sensor or 'a camera'}"
    )
    frame = Origin(
        "frame",
        "derived",
        f"that of {path.name}: Z to the sky, X and Y as its focal plane; no kernel knows it",
    )
    camera = replace(
        camera, name=name, frame=f"{name.upper()}_CAMERA", origins=(*camera.origins, known, frame)
    )
    return _with_pointing(camera), told.spacecraft


def with_rows(camera: Camera, numbers: Numbers) -> Camera:
    """The camera with a rolling shutter or as a line scanner, where a person knows of it.

    Raises
    ------
    MissionError
        A line scanner without the time from line to line.
    """
    line_time_s = numbers.line_time_s
    if line_time_s is None:
        if numbers.scans:
            raise MissionError(
                "a line scan (--line-scan) has a time from line to line; give it: --line-time-s 0.004."
            )
        return camera
    known = Origin("rows", "known", f"{line_time_s:g} s from line to line, as given")
    if not numbers.scans:
        return replace(camera, rows=RowTiming(line_time_s), origins=(*camera.origins, known))
    line = float(camera.center_pixel_line[1])
    guess = Origin(
        "rows.detector_line", "guessed", f"{line:g}, the boresight's: every line of the picture is that one"
    )
    return replace(camera, rows=RowTiming(line_time_s, line), origins=(*camera.origins, known, guess))


def _with_pointing(camera: Camera) -> Camera:
    """The camera with the attitude errors of a usual spacecraft."""
    cross_px = float(np.clip(POINTING_RAD / camera.pixel_scale_rad, 1.0, MOST_CROSS_PX))
    guess = Origin("attitude_sigma", "guessed", f"{cross_px:.0f} px across the boresight, 0.2 deg about it")
    return replace(
        camera, attitude_sigma=AttitudeSigma(round(cross_px, 1), 0.2), origins=(*camera.origins, guess)
    )
