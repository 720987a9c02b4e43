"""Cameras from SPICE instrument kernels: ``INS<id>_*`` pool variables in, the fields of a `Camera` out.

Kernels of NAIF, addenda of ISIS and what missions add to both are read; what a kernel gives is used in this order:

optics      ``OOC_*`` (Owen and O'Connell: LORRI), ``OPENCV_OD_*`` (OSIRIS-REx NAV team's Brown model), ``FOCAL_LENGTH`` with
            ``TRANSX/Y`` or ``ITRANSS/L``, with ``PIXEL_PITCH`` or ``PIXEL_SIZE``, ``IFOV``, last the field of view
axes        ``SPOC_FITS_NAXIS1/2``, ``TRANSX/Y`` (ISIS: focal plane X, Y mm from sample, line), ``OOC_KMAT``
center      ``OOC_CCD_CENTER``, ``OPENCV_OD_C``, ``DISTORTION_X/Y``, ``BORESIGHT_SAMPLE/LINE``, ``FOV_CENTER_PIXEL``,
            ``CCD_CENTER``, ``CENTER``
distortion  those of the optics, ``OD_T_X/Y``, ``OD_A1..3_CORR``, ``DISTORTION_K1/K2``, ``RAD_DIST_COEFF``, ``OD_K``, ``K1``

Nothing is guessed silently: every field has an `Origin`. Where no kernel says how the detector lies, pixel is guessed along
that side of the field of view that is as long as the detector has pixels (of alike ones along ``FOV_REF_VECTOR``, or the
frame's first axis), and line along boresight x pixel: a picture with its first line on top, as archives show most, is then
not mirrored. Units are told by each other: a field of view that is several times too wide or too narrow both ways is
refused. Photometry, PSF and attitude errors are not in kernels: give them as overrides.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera.distortion import BrownDistortion, Distortion, NoDistortion, OwenDistortion
from opnav_workbench.camera.lens_models import (
    RadialDistortion,
    RationalDistortion,
    TaylorDistortion,
    centered,
)
from opnav_workbench.camera.origins import How, Origin
from opnav_workbench.constants import ARCSEC_PER_RAD, RAD_PER_DEG
from opnav_workbench.errors import CameraError

__all__ = ["SHORTEST_FOCAL_MM", "camera_fields_from_ik", "nearest_axes"]

Values = Mapping[str, tuple[Any, ...]]

PER_MICRO = 1e6
LENGTH_IN_MM = {
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetres"), 1.0),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetres"), 10.0),
    **dict.fromkeys(("m", "meter", "meters", "metres"), 1e3),
    **dict.fromkeys(("um", "micron", "microns", "micrometer", "micrometers"), 1e-3),
    **dict.fromkeys(("km", "kilometer", "kilometers"), 1e6),
}
ANGLE_IN_RAD = {
    **dict.fromkeys(("DEGREES", "DEGREE", "DEG"), RAD_PER_DEG),
    **dict.fromkeys(("RADIANS", "RADIAN", "RAD"), 1.0),
    **dict.fromkeys(("MILLIRADIANS", "MRAD"), 1e-3),
    **dict.fromkeys(("MICRORADIANS", "URAD"), 1e-6),
    **dict.fromkeys(("ARCMINUTES", "ARCMIN"), 60.0 / ARCSEC_PER_RAD),
    **dict.fromkeys(("ARCSECONDS", "ARCSEC"), 1.0 / ARCSEC_PER_RAD),
}
IFOV_TOLERANCE = (
    0.03  # pitch over focal length and IFOV differ by up to 0.3 % in flight kernels; a wrong unit by 10x
)
UNIT_TOLERANCE = 3.0  # a field of view tells meters from millimeters, whatever part of the detector it is of
NOMINAL_FOCAL_MM = 100.0  # where only angles are known, any focal length does: pixels per mm follow from it
PARALLEL = 0.7  # |cosine| that tells along from across
WIDEST_RAD = 87.0 * RAD_PER_DEG  # from the boresight: what lies farther has no gnomonic coordinates
# Of the angle to the axis, and at least; HRSC's lines agree to 0.01
DETECTOR_TOLERANCE, ALIKE_RAD = 0.05, 1e-3
ALONG_Z = 1e-6  # sine of the angle from Z up to which a boresight lies along it
PITCH_MM = (1e-3, 0.2)  # of a detector's pixel, the largest range; units of length lie 1000 apart
SIZE_UNITS = (("mm", 1.0), ("um", 1e-3), ("m", 1e3))
SHORTEST_FOCAL_MM = 1.0
# Of kernels whose comments project X and Y of the frame onto pixel and line
XY_CODE = "OOC_KMAT", "DISTORTION_X"
COUNTS = {
    "n_pixel": ("PIXEL_SAMPLES", "FRAME_SAMPLES", "FILTER_SAMPLES", "S_MAX", "PIXEL_COLUMNS"),
    "n_line": ("PIXEL_LINES", "FRAME_LINES", "FILTER_LINES", "L_MAX", "PIXEL_ROWS"),
}
MOST_PIXELS = 1 << 20  # along an axis: no detector or scan has a million
# The first that fits the field of view
IFOV_UNITS = ("microrad", 1e-6), ("rad", 1.0), ("mrad", 1e-3), ("deg", RAD_PER_DEG)
LONGEST_IFOV_RAD = (
    0.01  # in radians where the kernel tells no field of view: a smaller number of microradians is no pixel
)
SQUARE = (
    0.02  # a field of view and a detector whose sides differ by less than that tell nothing of how they lie
)
BOUNDARIES = ("FOV_BOUNDARY_CORNERS", "FOV_BOUNDARY")


@dataclass(slots=True)
class _Kernel:
    """The variables of an instrument, what the caller says instead, and where each field came from."""

    pool: Values
    frames: Values
    instrument_id: int
    overrides: Mapping[str, Any]
    origins: list[Origin] = field(default_factory=list)

    def note(self, how: How, name: str, text: str) -> None:
        if name not in self.overrides:
            self.origins.append(Origin(name, how, text))


def camera_fields_from_ik(
    values: Mapping[str, Sequence[Any]],
    instrument_id: int,
    *,
    pixel_direction: ArrayLike | None = None,
    line_direction: ArrayLike | None = None,
    **overrides: Any,
) -> dict[str, Any]:
    """Return the fields of `Camera`; see `Camera.from_ik`."""
    pool, frames = _without_prefix(values, instrument_id)
    kernel = _Kernel(pool, frames, instrument_id, overrides)
    size = (_count(kernel, "n_pixel"), _count(kernel, "n_line"))
    frame, axes, matrix, offset_px = _orientation(kernel, size, pixel_direction, line_direction)
    fields: dict[str, Any] = {
        "name": _name(kernel, frame),
        "frame": frame,
        "instrument_id": instrument_id,
        "n_pixel": size[0],
        "n_line": size[1],
        "focal_from_camera": axes,
        "source": f"instrument kernel, INS{instrument_id}",
    }
    fields |= _optics(kernel, axes, size, matrix)
    _check_field(kernel, axes, size, fields)
    if "center_pixel_line" not in fields:
        lens, moved_mm = centered(fields.get("distortion", NoDistortion()))
        moved_px = np.asarray(overrides.get("pixel_from_mm", fields["pixel_from_mm"])) @ moved_mm
        if moved_px.any():
            kernel.note(
                "derived",
                "center_pixel_line",
                f"moved by {_short(moved_px)} px, as the distortion moves the boresight",
            )
        fields |= {"distortion": lens, "center_pixel_line": _center(kernel, size) + offset_px + moved_px}
    fields |= _aperture(kernel, fields) | overrides
    given = tuple(Origin(name, "known", "given by the caller") for name in overrides)
    return fields | {"origins": (*kernel.origins, *given)}


# ---- The variables.


def _without_prefix(values: Mapping[str, Sequence[Any]], instrument_id: int) -> tuple[Values, Values]:
    """The instrument's own variables without their prefix, and those of frames by their full names."""
    prefixes = (f"INS{instrument_id}_", f"INS_{instrument_id}_")
    pool: dict[str, tuple[Any, ...]] = {}
    frames: dict[str, tuple[Any, ...]] = {}
    for key, value in values.items():
        bare = next((key.removeprefix(p) for p in prefixes if key.startswith(p)), key)
        whole = (value,) if isinstance(value, str | float | int) else tuple(value)
        if (
            bare.startswith(("FRAME_", "TKFRAME_"))
            and bare != "FRAME_ID"
            and not bare.startswith(_OWN_FRAME_KEYS)
        ):
            frames[bare] = whole
        elif not bare.startswith("INS"):
            pool[bare] = whole
    if not pool:
        raise CameraError(
            f"no {prefixes[0]}* variables; load the instrument kernel that defines {instrument_id}."
        )
    return pool, frames


_OWN_FRAME_KEYS = ("FRAME_SAMPLES", "FRAME_LINES")


def _numbers(pool: Values, key: str, count: int) -> FloatArray:
    if key not in pool:
        raise CameraError(
            f"the instrument kernel gives no {key}; give the field it determines as an argument."
        )
    try:
        numbers = np.array(pool[key], dtype=np.float64)
    except ValueError as error:
        raise CameraError(f"{key} of the instrument kernel is not numeric: {pool[key]!r}.") from error
    if numbers.shape != (count,):
        raise CameraError(f"{key} of the instrument kernel has {numbers.size} values; {count} expected.")
    return numbers


def _text(pool: Values, key: str, default: str | None = None) -> str:
    if key in pool:
        return str(pool[key][0]).strip()
    if default is None:
        raise CameraError(f"the instrument kernel gives no {key}; give the frame as an argument.")
    return default


def _count(kernel: _Kernel, name: str) -> int:
    given = kernel.overrides.get(name)
    if given:
        return int(given)
    for key in COUNTS[name]:
        if key in kernel.pool:
            stated = float(_numbers(kernel.pool, key, 1)[0])
            if not (0 < stated <= MOST_PIXELS and stated == round(stated)):
                raise CameraError(
                    f"{key} of the instrument kernel is {stated:g}, no number of pixels; give {name} as an argument."
                )
            kernel.note("known", name, f"{stated:g}, {key}")
            return round(stated)
    raise CameraError(f"the instrument kernel gives no {COUNTS[name][0]}; give {name} as an argument.")


def _name(kernel: _Kernel, frame: str) -> str:
    for key in ("INSTRUMENT_NAME", "NAME", "FOV_FRAME"):
        if key in kernel.pool:
            return _text(kernel.pool, key)
    return frame or f"instrument {kernel.instrument_id}"


# ---- Frame and axes.


def _orientation(
    kernel: _Kernel,
    size: tuple[int, int],
    pixel_direction: ArrayLike | None,
    line_direction: ArrayLike | None,
) -> tuple[str, FloatArray, FloatArray | None, FloatArray]:
    """Frame, focal axes, px/mm where ISIS' matrices give it, and how far the boresight lies from ISIS' origin, px."""
    pool = kernel.pool
    isis = _isis_mm_from_pixel(pool)
    axes = kernel.overrides.get("focal_from_camera")
    told = (
        axes is not None
        or pixel_direction is not None
        or any(key in pool for key in ("SPOC_FITS_NAXIS1", "OOC_KMAT"))
    )
    found = None if isis is None or told else _isis_frame(kernel, isis[0])
    if isis is None or found is None:
        frame = _frame(kernel)
        focal = (
            _axes(kernel, size, pixel_direction, line_direction)
            if axes is None
            else np.asarray(axes, dtype=np.float64)
        )
        return frame, focal, None, np.zeros(2)
    return _isis_orientation(kernel, found, *isis)


def _isis_orientation(
    kernel: _Kernel, found: tuple[str, FloatArray], shift_mm: FloatArray, mm_from_pixel: FloatArray
) -> tuple[str, FloatArray, FloatArray, FloatArray]:
    """As `_orientation`: focal axes along X and Y of the frame, with the signs that make the scale positive."""
    frame, boresight = found
    turn = np.zeros((2, 3))
    turn[:, :2] = nearest_axes(mm_from_pixel.T)
    pixel_from_mm: FloatArray = np.asarray(np.linalg.inv(turn[:, :2] @ mm_from_pixel), dtype=np.float64)
    names = ", ".join(f"{'-' if row.sum() < 0.0 else '+'}{'XY'[int(np.abs(row).argmax())]}" for row in turn)
    kernel.note("known", "focal_from_camera", f"pixel, line along {names} of {frame}: TRANSX, TRANSY")
    kernel.note("known", "pixel_from_mm", f"{_short(pixel_from_mm)} px/mm: TRANSX, TRANSY")
    offset_px = -np.linalg.inv(mm_from_pixel) @ shift_mm
    return frame, np.vstack([turn, boresight]), pixel_from_mm, np.asarray(offset_px, dtype=np.float64)


def nearest_axes(along_xy: FloatArray) -> FloatArray:
    """Return unit vectors (2, 2) along X and Y or against them: those that pixel and line run most along.

    Parameters
    ----------
    along_xy : (2, 2) array
        Rows: how pixel and line run, in X and Y.
    """
    along = int(np.abs(along_xy[0]).argmax())
    turn = np.zeros((2, 2))
    for row, axis in enumerate((along, 1 - along)):
        turn[row, axis] = np.sign(along_xy[row, axis]) or 1.0
    return turn


def _isis_mm_from_pixel(pool: Values) -> tuple[FloatArray, FloatArray] | None:
    """Offset (2,) mm and matrix (2, 2) mm/px of ISIS: focal plane X, Y from sample and line."""
    if "TRANSX" in pool and "TRANSY" in pool:
        rows = np.stack([_numbers(pool, "TRANSX", 3), _numbers(pool, "TRANSY", 3)])
        shift, matrix = rows[:, 0], rows[:, 1:]
    elif "ITRANSS" in pool and "ITRANSL" in pool:
        rows = np.stack([_numbers(pool, "ITRANSS", 3), _numbers(pool, "ITRANSL", 3)])
        if np.linalg.det(rows[:, 1:]) == 0.0:
            raise CameraError(
                "ITRANSS and ITRANSL of the instrument kernel are singular; give pixel_from_mm."
            )
        matrix = np.asarray(np.linalg.inv(rows[:, 1:]), dtype=np.float64)
        shift = -matrix @ rows[:, 0]
    else:
        return None
    if np.linalg.det(matrix) == 0.0:
        raise CameraError("TRANSX and TRANSY of the instrument kernel are singular; give pixel_from_mm.")
    return shift, matrix


def _isis_frame(kernel: _Kernel, shift_mm: FloatArray) -> tuple[str, FloatArray] | None:
    """The frame whose X and Y are ISIS' focal plane, and the boresight in it, +Z or -Z; None where none suits."""
    own = _frame(kernel)
    if "BORESIGHT" not in kernel.pool or _looks_along_z(kernel):
        kernel.note("derived", "boresight", "+Z of the frame, as ISIS' cameras look along theirs")
        return own, np.array([0.0, 0.0, 1.0])
    boresight = _unit(_numbers(kernel.pool, "BORESIGHT", 3), "BORESIGHT")
    frames = (
        {own: boresight} if own == _text(kernel.pool, "FOV_FRAME", own) else {own: np.array([0.0, 0.0, 1.0])}
    )
    for name, turned in [*frames.items(), *_fixed_frames(kernel, boresight).items()]:
        if np.hypot(*turned[:2]) < ALONG_Z:
            if name != own:
                kernel.note(
                    "derived", "frame", f"{name}, which the addendum defines and whose Z is the boresight"
                )
            return name, np.array([0.0, 0.0, np.sign(turned[2])])
    if _puts_detector_there(kernel, shift_mm, boresight):
        kernel.note(
            "derived",
            "boresight",
            "+Z of the frame: TRANSX and TRANSY put the detector where BORESIGHT looks",
        )
        return own, np.array([0.0, 0.0, 1.0])
    kernel.note(
        "guessed",
        "focal_from_camera",
        f"TRANSX and TRANSY suit a camera that looks along Z, and BORESIGHT is {_short(boresight)} in {own}: left aside",
    )
    return None


def _puts_detector_there(kernel: _Kernel, shift_mm: FloatArray, boresight: FloatArray) -> bool:
    """Whether a detector beside the axis is what BORESIGHT looks along: HRSC's lines, each in the frame of the head."""
    key = next((key for key in ("FOCAL_LENGTH", "DEFAULT_FOCAL_LENGTH") if key in kernel.pool), None)
    if key is None:
        return False
    detector = _unit(np.append(shift_mm, _numbers(kernel.pool, key, 1)), "TRANSX")
    off_axis = float(np.hypot(*boresight[:2]))
    return bool(np.linalg.norm(detector - boresight) < max(DETECTOR_TOLERANCE * off_axis, ALIKE_RAD))


def _looks_along_z(kernel: _Kernel) -> bool:
    """Whether BORESIGHT is a part of the field's own, while the kernel's projection divides by Z."""
    return "DISTORTION_X" in kernel.pool or "OD_A1_CORR" in kernel.pool


def _frame(kernel: _Kernel) -> str:
    """Name of the frame: the caller's, the one an addendum names, the field of view's, the instrument's own."""
    if "frame" in kernel.overrides:
        return str(kernel.overrides["frame"])
    pool = kernel.pool
    if "FRAME_ID" in pool:
        number = round(float(_numbers(pool, "FRAME_ID", 1)[0]))
        if f"FRAME_{number}_NAME" in kernel.frames:
            name = _text(kernel.frames, f"FRAME_{number}_NAME")
            kernel.note("known", "frame", f"{name}, FRAME_ID")
            return name
    for source, key in (
        (pool, "FOV_FRAME"),
        (pool, "FRAME"),
        (kernel.frames, f"FRAME_{kernel.instrument_id}_NAME"),
    ):
        if key in source:
            kernel.note("known", "frame", f"{_text(source, key)}, {key}")
            return _text(source, key)
    return _text(pool, "FOV_FRAME")


def _fixed_frames(kernel: _Kernel, boresight: FloatArray) -> dict[str, FloatArray]:
    """The boresight in each frame that is fixed to the field of view's and defined beside it."""
    found: dict[str, FloatArray] = {}
    own = _text(kernel.pool, "FOV_FRAME", "")
    for key, value in kernel.frames.items():
        if not (key.startswith("TKFRAME_") and key.endswith("_RELATIVE") and str(value[0]).strip() == own):
            continue
        number = key.removeprefix("TKFRAME_").removesuffix("_RELATIVE")
        turned = _relative_from_frame(kernel.frames, number)
        if turned is not None and f"FRAME_{number}_NAME" in kernel.frames:
            found[_text(kernel.frames, f"FRAME_{number}_NAME")] = turned.T @ boresight
    return found


def _relative_from_frame(frames: Values, number: str) -> FloatArray | None:
    """The rotation of a frame of fixed offset, from its angles (SPICE's Frames Required Reading); None for other forms."""
    keys = [f"TKFRAME_{number}_{name}" for name in ("ANGLES", "AXES")]
    if any(key not in frames for key in keys):
        return None
    degrees = _text(frames, f"TKFRAME_{number}_UNITS", "RADIANS").upper().startswith("DEG")
    angles = _numbers(frames, keys[0], 3) * (RAD_PER_DEG if degrees else 1.0)
    result = np.eye(3)
    for angle, axis in zip(angles, _numbers(frames, keys[1], 3), strict=True):
        i, j = (int(axis) % 3), ((int(axis) + 1) % 3)
        turn = np.eye(3)
        turn[i, i] = turn[j, j] = np.cos(angle)
        turn[i, j], turn[j, i] = np.sin(angle), -np.sin(angle)
        result = result @ turn
    return result


def _axes(
    kernel: _Kernel,
    size: tuple[int, int],
    pixel_direction: ArrayLike | None,
    line_direction: ArrayLike | None,
) -> FloatArray:
    pool = kernel.pool
    own_code = next((key for key in XY_CODE if key in pool), "")
    boresight = np.array([0.0, 0.0, 1.0])
    if not _looks_along_z(kernel):
        boresight = _boresight(kernel)
    if pixel_direction is not None:
        pixel, how = np.asarray(pixel_direction, dtype=np.float64), "given by the caller"
    elif "SPOC_FITS_NAXIS1" in pool:
        pixel, how = _numbers(pool, "SPOC_FITS_NAXIS1", 3), "SPOC_FITS_NAXIS1"
    elif own_code:
        pixel, how = np.array([1.0, 0.0, 0.0]), f"{own_code}, whose code takes X and Y of the frame"
        line_direction = [0.0, 1.0, 0.0] if line_direction is None else line_direction
    else:
        pixel, how = _guessed_pixel(pool, boresight, size), ""
    pixel = _unit(pixel - (pixel @ boresight) * boresight, "the pixel direction")
    if line_direction is None and pixel_direction is None and "SPOC_FITS_NAXIS2" in pool:
        line_direction = _numbers(pool, "SPOC_FITS_NAXIS2", 3)
    line = np.cross(boresight, pixel)
    if line_direction is not None:
        line = line * _sense(line_direction, line, pixel)
        kernel.note("known", "focal_from_camera", f"pixel and line: {how or 'given by the caller'}")
    else:
        guess = (
            f"pixel {_short(pixel)} ({how or 'the field of view'}), line {_short(line)} (boresight x pixel)"
        )
        kernel.note("guessed", "focal_from_camera", f"{guess}; no keyword says how the detector lies")
    return np.stack([pixel, line, boresight])


def _boresight(kernel: _Kernel) -> FloatArray:
    """Return the boresight; of kernels without one, the middle of the field of view's corners."""
    pool = kernel.pool
    if "BORESIGHT" in pool or not any(key in pool for key in BOUNDARIES):
        return _unit(_numbers(pool, "BORESIGHT", 3), "BORESIGHT")
    corners = _corners(pool)
    middle = _unit((corners / np.linalg.norm(corners, axis=1)[:, None]).sum(axis=0), "FOV_BOUNDARY_CORNERS")
    kernel.note("derived", "boresight", f"{_short(middle)}: the middle of the field of view's corners")
    return middle


def _guessed_pixel(pool: Values, boresight: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Return a direction (3,) along which pixels may run: the side of the field of view that suits their number.

    Of a square field or detector it is the reference direction.
    """
    first = _reference(pool, boresight)
    sides = np.stack([first, np.cross(boresight, first), boresight])
    try:
        tangents = _tangents(pool, sides)
    except CameraError:  # of which the scale does not come
        return first
    if not (tangents > 0.0).all():
        return first
    wide, long = float(np.log(tangents[0] / tangents[1])), float(np.log(size[0] / size[1]))
    crossed = abs(wide + long) < abs(wide - long) and min(abs(wide), abs(long)) > SQUARE
    if not crossed:
        return first
    return np.asarray(sides[1] if sides[1][np.abs(sides[1]).argmax()] > 0.0 else -sides[1])


def _reference(pool: Values, boresight: FloatArray) -> FloatArray:
    """Return a unit vector across the boresight along a side of the field of view."""
    if "FOV_REF_VECTOR" in pool or not any(key in pool for key in BOUNDARIES):
        reference = _numbers(pool, "FOV_REF_VECTOR", 3)
        return _unit(reference - (reference @ boresight) * boresight, "FOV_REF_VECTOR")
    corners = _corners(pool)
    if len(corners) < 3:
        raise CameraError(
            "FOV_BOUNDARY_CORNERS of the instrument kernel are no corners; give pixel_direction."
        )
    plane = corners / (corners @ boresight)[:, None]
    edges = np.roll(plane, -1, axis=0) - plane
    # along the edge that runs most along the first of the frame's axes that lies across the boresight
    axis = np.eye(3)[int(np.flatnonzero(np.abs(boresight) < PARALLEL)[0])]
    along = _unit(edges[int(np.abs([_unit(e, "an edge") @ axis for e in edges]).argmax())], "an edge")
    return along if along @ axis > 0.0 else -along


def _sense(line_direction: ArrayLike, line: FloatArray, pixel: FloatArray) -> float:
    along = float(np.asarray(line_direction, dtype=np.float64) @ line)
    if abs(along) < PARALLEL * float(np.linalg.norm(line_direction)):
        raise CameraError(
            f"line direction {np.asarray(line_direction).tolist()} and pixel direction {pixel.tolist()} "
            "are not at right angles; give two vectors across the boresight."
        )
    return float(np.sign(along))


def _unit(vector: FloatArray, what: str) -> FloatArray:
    length = float(np.linalg.norm(vector))
    if not length > 0.0:
        raise CameraError(
            f"{what} of the instrument kernel has no direction across the boresight: {vector.tolist()}."
        )
    return np.asarray(vector / length)


def _short(array: FloatArray) -> str:
    return np.array2string(np.round(array, 7) + 0.0, separator=", ").replace("\n", "")


# ---- Where the boresight falls.


def _center(kernel: _Kernel, size: tuple[int, int]) -> FloatArray:
    """Pixel and line of the boresight, counted from 0."""
    pool, middle = kernel.pool, 0.5 * (np.array(size, dtype=np.float64) - 1.0)
    if "OOC_CCD_CENTER" in pool:
        return _told(kernel, "OOC_CCD_CENTER", _numbers(pool, "OOC_CCD_CENTER", 2), 0.0)
    own = [float(_numbers(pool, f"DISTORTION_{a}", 1)[0]) for a in "XY"] if "DISTORTION_Y" in pool else None
    if own is not None and "BORESIGHT_SAMPLE" not in pool:
        return _told(kernel, "DISTORTION_X, DISTORTION_Y", np.array(own), 0.5)
    if "BORESIGHT_SAMPLE" in pool and "BORESIGHT_LINE" in pool:
        place = [float(_numbers(pool, f"BORESIGHT_{axis}", 1)[0]) for axis in ("SAMPLE", "LINE")]
        if (
            own is not None and own[0] == place[0]
        ):  # the addendum repeats the kernel's number, whose first pixel is 0.5
            return _told(kernel, "BORESIGHT_SAMPLE, BORESIGHT_LINE", np.array(place), 0.5)
        return _counted(kernel, "BORESIGHT_SAMPLE, BORESIGHT_LINE", np.array(place), middle, "known", 1.0)
    if "FOV_CENTER_PIXEL" in pool:
        return _told(kernel, "FOV_CENTER_PIXEL", _numbers(pool, "FOV_CENTER_PIXEL", 2), 0.0)
    for key in ("CCD_CENTER", "CENTER"):
        if key in pool:
            return _counted(kernel, key, _numbers(pool, key, 2), middle, "guessed", 0.0)
    kernel.note("guessed", "center_pixel_line", f"{middle.tolist()}, the middle of the detector")
    return middle


def _told(kernel: _Kernel, key: str, place: FloatArray, first: float) -> FloatArray:
    found = np.asarray(place - first)
    kernel.note("known", "center_pixel_line", f"{found.tolist()}: {key}, whose first pixel is {first:g}")
    return found


def _counted(
    kernel: _Kernel, key: str, place: FloatArray, middle: FloatArray, how: How, first: float
) -> FloatArray:
    """A place whose first pixel is 0 or 1: told where one of both makes it the middle of the detector."""
    for number in (0.0, 1.0):
        if np.array_equal(place - number, middle):
            kernel.note(
                "derived",
                "center_pixel_line",
                f"{middle.tolist()}: {key} {place.tolist()} is the middle, counted from {number:g}",
            )
            return middle
    convention = "ISIS counts from 1" if how == "known" else f"taken as counted from {first:g}"
    kernel.note(how, "center_pixel_line", f"{(place - first).tolist()}: {key} {place.tolist()}, {convention}")
    return np.asarray(place - first)


# ---- Focal length, scale and distortion.


def _optics(
    kernel: _Kernel, axes: FloatArray, size: tuple[int, int], matrix: FloatArray | None
) -> dict[str, Any]:
    """Focal length, px/mm and distortion from the best description that the kernel has."""
    pool = kernel.pool
    if "OOC_EM" in pool:
        return _owen(kernel)
    if "OPENCV_OD_K" in pool:
        return _opencv(kernel)
    focal_key = next((key for key in ("FOCAL_LENGTH", "DEFAULT_FOCAL_LENGTH") if key in pool), "")
    if "focal_length_mm" in kernel.overrides or focal_key:
        return _with_focal_length(kernel, axes, size, matrix, focal_key)
    if matrix is not None:
        raise CameraError("the instrument kernel gives no FOCAL_LENGTH; give focal_length_mm as an argument.")
    if "IFOV" in pool:
        return _angular(kernel, axes, size)
    return _field_of_view(kernel, axes, size)


def _owen(kernel: _Kernel) -> dict[str, Any]:
    pool = kernel.pool
    e2, e5, e6 = _numbers(pool, "OOC_EM", 3)
    kernel.note(
        "known", "focal_length_mm, pixel_from_mm, distortion", "OOC_FOCAL_LENGTH, OOC_KMAT, OOC_EM (Owen)"
    )
    # The kernel's own code hands KMAT to a Fortran matrix product: Kx, Kyx, Kxy, Ky.
    return {
        "focal_length_mm": float(_numbers(pool, "OOC_FOCAL_LENGTH", 1)[0]),
        "pixel_from_mm": _numbers(pool, "OOC_KMAT", 4).reshape(2, 2).T,
        "distortion": OwenDistortion(e2_per_mm2=e2, e5_per_mm=e5, e6_per_mm=e6),
    }


def _opencv(kernel: _Kernel) -> dict[str, Any]:
    pool = kernel.pool
    focal_mm = _length_mm(pool, "FOCAL_LENGTH", "FOCAL_LENGTH_UNITS")
    k1, k2, k3, k4, k5, k6 = _numbers(pool, "OPENCV_OD_K", 6)
    p1, p2 = _numbers(pool, "OPENCV_OD_P", 2)
    kernel.note("known", "pixel_from_mm, distortion", "OPENCV_OD_F, OPENCV_OD_K, OPENCV_OD_P (Brown)")
    kernel.note("known", "center_pixel_line", "OPENCV_OD_C, counted from 1 as ISIS reads it")
    return {
        "focal_length_mm": focal_mm,
        "pixel_from_mm": np.diag(_numbers(pool, "OPENCV_OD_F", 2) / focal_mm),
        "center_pixel_line": _numbers(pool, "OPENCV_OD_C", 2) - 1.0,
        "distortion": BrownDistortion(focal_mm, k1, k2, k3, k4, k5, k6, p1, p2),
    }


def _with_focal_length(
    kernel: _Kernel, axes: FloatArray, size: tuple[int, int], matrix: FloatArray | None, focal_key: str
) -> dict[str, Any]:
    told = kernel.overrides.get("focal_length_mm")
    pitch_mm = _pitch_mm(kernel) if matrix is None else 1.0 / np.sqrt(abs(np.linalg.det(matrix))) * np.ones(2)
    if told is not None:
        focal_mm = float(told)
    else:
        focal_mm = _focal_mm(kernel, focal_key, axes, size, pitch_mm)
    if pitch_mm is None and "pixel_from_mm" in kernel.overrides:
        pitch_mm = 1.0 / np.abs(np.diag(np.asarray(kernel.overrides["pixel_from_mm"], dtype=np.float64)))
    elif pitch_mm is None and "IFOV" not in kernel.pool:
        raise CameraError(
            "the instrument kernel gives no TRANSX, PIXEL_PITCH, PIXEL_SIZE or IFOV; give pixel_from_mm as an argument."
        )
    elif pitch_mm is None:
        pitch_mm = np.full(2, focal_mm * float(_numbers(kernel.pool, "IFOV", 1)[0]) / PER_MICRO)
        kernel.note("derived", "pixel_from_mm", "FOCAL_LENGTH times IFOV")
    if matrix is None:
        matrix = np.diag(1.0 / pitch_mm)
        _check_ifov(kernel.pool, focal_mm, float(pitch_mm[0]))
    return {
        "focal_length_mm": focal_mm,
        "pixel_from_mm": matrix,
        "distortion": _distortion(kernel, focal_mm, float(pitch_mm[0])),
    }


def _pitch_mm(kernel: _Kernel) -> FloatArray | None:
    """Size of a pixel, mm; None where the kernel does not say."""
    pool = kernel.pool
    for key in ("PIXEL_PITCH", "PIXEL_SIZE"):
        if key not in pool:
            continue
        try:
            stated = np.broadcast_to(np.array(pool[key], dtype=np.float64), (2,))
        except ValueError as error:
            raise CameraError(
                f"{key} of the instrument kernel is not one or two numbers: {pool[key]!r}."
            ) from error
        for unit, scale in SIZE_UNITS:
            if PITCH_MM[0] <= float(stated[0]) * scale <= PITCH_MM[1]:
                kernel.note(
                    "derived",
                    "pixel_from_mm",
                    f"{key} {stated.tolist()}, in {unit}: no other unit gives a pixel",
                )
                return np.asarray(stated * scale)
        raise CameraError(
            f"{key} of the instrument kernel is {stated.tolist()}: no size of a pixel in um, mm or m."
        )
    return None


def _focal_mm(
    kernel: _Kernel, key: str, axes: FloatArray, size: tuple[int, int], pitch_mm: FloatArray | None
) -> float:
    """The focal length, mm; in meters where only these agree with the field of view, as Hayabusa's kernels have it."""
    pool = kernel.pool
    if "FOCAL_LENGTH_UNITS" in pool:
        focal_mm = _length_mm(pool, key, "FOCAL_LENGTH_UNITS")
        kernel.note("known", "focal_length_mm", f"{focal_mm:g}, {key}")
        return focal_mm
    stated = float(_numbers(pool, key, 1)[0])
    if not stated > 0.0:
        raise CameraError(
            f"{key} of the instrument kernel is {stated:g}; give focal_length_mm as an argument."
        )
    expected = None if pitch_mm is None else _focal_of_field(kernel, axes, size, pitch_mm)
    in_meters = stated < SHORTEST_FOCAL_MM and (
        expected is None or max(stated * 1e3 / expected, expected / (stated * 1e3)) < UNIT_TOLERANCE
    )
    if in_meters:
        how: How = "guessed" if expected is None else "derived"
        why = "too short for mm" if expected is None else "as the field of view has it"
        kernel.note(how, "focal_length_mm", f"{stated * 1e3:g}: {key} {stated:g} taken in meters, {why}")
        return stated * 1e3
    kernel.note("known", "focal_length_mm", f"{stated:g}, {key}, in mm as kernels have it")
    filters = sorted(name for name in pool if name.endswith("_FOCAL_LENGTH") and name != key)
    if filters:
        kernel.note(
            "known", "focal_length_mm", f"{len(filters)} filters have lengths of their own: {filters[0]}, ..."
        )
    if "FL_TEMP_COEFFS" in pool:
        kernel.note("known", "focal_length_mm", "depends on temperature: FL_TEMP_COEFFS")
    return stated


def _focal_of_field(
    kernel: _Kernel, axes: FloatArray, size: tuple[int, int], pitch_mm: FloatArray
) -> float | None:
    try:
        tangents = _tangents(kernel.pool, axes)
    except CameraError:
        return None
    return float((0.5 * size[0] * pitch_mm[0]) / tangents[0]) if tangents[0] > 0.0 else None


def _check_ifov(pool: Values, focal_mm: float, pitch_mm: float) -> None:
    if "IFOV" not in pool:
        return
    # One value, or one along each axis; microradians as a rule, radians in Dawn's kernels; negative: not known.
    stated = float(np.array(pool["IFOV"], dtype=np.float64).flat[0])
    computed = pitch_mm / focal_mm * PER_MICRO
    if stated > 0.0 and all(
        abs(value - computed) > IFOV_TOLERANCE * computed for value in (stated, stated * PER_MICRO)
    ):
        raise CameraError(
            f"IFOV {stated} microrad in the instrument kernel is not the pixel's size {pitch_mm * 1e3:g} um "
            f"over FOCAL_LENGTH {focal_mm} mm = {computed:.4g} microrad; check units, or give pixel_from_mm."
        )


def _angular(kernel: _Kernel, axes: FloatArray, size: tuple[int, int]) -> dict[str, Any]:
    stated = _positive_pair(kernel.pool, "IFOV")
    unit, unit_rad = _ifov_unit(kernel.pool, axes, size, float(stated[0]))
    kernel.note(
        "derived",
        "pixel_from_mm",
        f"IFOV {_short(stated)} in {unit}, with a nominal focal length of {NOMINAL_FOCAL_MM:g} mm",
    )
    return {
        "focal_length_mm": NOMINAL_FOCAL_MM,
        "pixel_from_mm": np.diag(1.0 / (stated * unit_rad * NOMINAL_FOCAL_MM)),
    }


def _positive_pair(pool: Values, key: str) -> FloatArray:
    """Return one number for both axes, or one for each."""
    try:
        stated = np.array(np.broadcast_to(np.array(pool[key], dtype=np.float64), (2,)))
    except ValueError as error:
        raise CameraError(
            f"{key} of the instrument kernel is not one or two numbers: {pool[key]!r}."
        ) from error
    if not (stated > 0.0).all():
        raise CameraError(
            f"{key} of the instrument kernel is {stated.tolist()}; give pixel_from_mm as an argument."
        )
    return stated


def _ifov_unit(pool: Values, axes: FloatArray, size: tuple[int, int], ifov: float) -> tuple[str, float]:
    """Return the unit of an IFOV that makes the field of view; of kernels without one, microradians or radians."""
    try:
        expected = float(np.max(_tangents(pool, axes) / (0.5 * np.array(size))))
    except CameraError:
        return IFOV_UNITS[1] if ifov < LONGEST_IFOV_RAD else IFOV_UNITS[0]
    for unit, unit_rad in IFOV_UNITS:
        if 1.0 / UNIT_TOLERANCE < ifov * unit_rad / expected < UNIT_TOLERANCE:
            return unit, unit_rad
    return IFOV_UNITS[0]


def _check_field(kernel: _Kernel, axes: FloatArray, size: tuple[int, int], fields: Mapping[str, Any]) -> None:
    """Refuse a scale that makes the kernel's field of view several times too wide or too narrow both ways: a wrong unit.

    One way alone it may be, as of a strip of the detector.
    """
    if {"focal_length_mm", "pixel_from_mm", "focal_from_camera"} & set(kernel.overrides):
        return
    try:
        told = _tangents(kernel.pool, axes)
    except CameraError:
        return
    if not (told > 0.0).all():
        return
    pitch_mm = np.linalg.norm(np.linalg.inv(fields["pixel_from_mm"]), axis=0)
    made = 0.5 * np.array(size) * pitch_mm / fields["focal_length_mm"]
    ratio = made / told
    narrower = bool((ratio < 1.0 / UNIT_TOLERANCE).all())
    if narrower and "n_pixel" in kernel.overrides:
        kernel.note(
            "guessed",
            "pixel_from_mm",
            f"that of the whole detector, though {size[0]} pixels see {ratio[0]:.2g} of the field of view: a window? "
            "If they are binned, multiply the size of a pixel",
        )
    elif narrower or (ratio > UNIT_TOLERANCE).all():
        wide, narrow = (2.0 * np.degrees(np.arctan(tangents)) for tangents in (made, told))
        in_m = bool((np.abs(np.log(ratio * 1e-3)) < np.log(UNIT_TOLERANCE)).any())
        hint = " (a focal length in m, or pixels in um taken for mm?)" if in_m else ""
        raise CameraError(
            f"{size[0]} x {size[1]} pixels of {pitch_mm[0] * 1e3:.4g} um behind {fields['focal_length_mm']:.4g} mm see "
            f"{wide[0]:.4g} x {wide[1]:.4g} deg, but the kernel's field of view is {narrow[0]:.4g} x {narrow[1]:.4g} deg"
            f"{hint}; "
            "check the units and the number of pixels, or give focal_length_mm and pixel_from_mm."
        )


def _field_of_view(kernel: _Kernel, axes: FloatArray, size: tuple[int, int]) -> dict[str, Any]:
    """Pinhole whose detector edges lie on the field of view's."""
    pixels_per_mm = 0.5 * np.array(size, dtype=np.float64) / (_tangents(kernel.pool, axes) * NOMINAL_FOCAL_MM)
    kernel.note(
        "derived",
        "pixel_from_mm",
        f"the field of view, with a nominal focal length of {NOMINAL_FOCAL_MM:g} mm",
    )
    return {"focal_length_mm": NOMINAL_FOCAL_MM, "pixel_from_mm": np.diag(pixels_per_mm)}


def _tangents(pool: Values, axes: FloatArray) -> FloatArray:
    """Tangents of half the field of view along pixel and line."""
    return (
        _corner_tangents(pool, axes)
        if any(key in pool for key in BOUNDARIES)
        else _angle_tangents(pool, axes)
    )


def _corners(pool: Values) -> FloatArray:
    """Return the vectors (n, 3) to the field of view's corners; of a circle, one."""
    key = next(key for key in BOUNDARIES if key in pool)
    try:
        return np.array(pool[key], dtype=np.float64).reshape(-1, 3)
    except ValueError as error:
        raise CameraError(f"{key} of the instrument kernel holds no vectors of three numbers.") from error


def _angle_tangents(pool: Values, axes: FloatArray) -> FloatArray:
    """Tangents of the half angles along pixel and line."""
    unit = _text(pool, "FOV_ANGLE_UNITS", "RADIANS").upper()
    if unit not in ANGLE_IN_RAD:
        raise CameraError(f"FOV_ANGLE_UNITS {unit!r}; one of {', '.join(ANGLE_IN_RAD)} expected.")
    along = float(_numbers(pool, "FOV_REF_ANGLE", 1)[0])
    across = float(_numbers(pool, "FOV_CROSS_ANGLE", 1)[0]) if "FOV_CROSS_ANGLE" in pool else along  # circle
    reference = _unit(_numbers(pool, "FOV_REF_VECTOR", 3), "FOV_REF_VECTOR")
    angles = np.array((along, across) if abs(axes[0] @ reference) > PARALLEL else (across, along))
    if not (angles * ANGLE_IN_RAD[unit] < WIDEST_RAD).all():
        raise CameraError(
            f"a field of view {angles.max():g} {unit} from its middle to its edge is no camera's."
        )
    return np.tan(angles * ANGLE_IN_RAD[unit])


def _corner_tangents(pool: Values, axes: FloatArray) -> FloatArray:
    corners = _corners(pool) @ axes.T
    if not (corners[:, 2] > 0.0).all():
        raise CameraError(
            "FOV_BOUNDARY_CORNERS of the instrument kernel reach 90 deg from the boresight: no camera's."
        )
    return np.asarray(np.abs(corners[:, :2] / corners[:, 2:]).max(axis=0))


def _length_mm(pool: Values, key: str, unit_key: str) -> float:
    unit = _text(pool, unit_key, "mm").lower()
    if unit not in LENGTH_IN_MM:
        raise CameraError(f"{unit_key} {unit!r}; one of {', '.join(LENGTH_IN_MM)} expected.")
    return float(_numbers(pool, key, 1)[0]) * LENGTH_IN_MM[unit]


def _aperture(kernel: _Kernel, fields: Mapping[str, Any]) -> dict[str, float]:
    pool = kernel.pool
    if "APERTURE_DIAMETER" in pool:
        kernel.note("known", "aperture_m", "APERTURE_DIAMETER")
        return {"aperture_m": _length_mm(pool, "APERTURE_DIAMETER", "APERTURE_DIAM_UNITS") / 1000.0}
    for key in ("F/RATIO", "F/NUMBER", "F_NUMBER"):
        if key in pool and "focal_length_mm" in fields and fields["focal_length_mm"] != NOMINAL_FOCAL_MM:
            ratio = float(_numbers(pool, key, 1)[0])
            if ratio > 0.0:
                kernel.note("derived", "aperture_m", f"focal length over {key} {ratio:g}")
                return {"aperture_m": float(fields["focal_length_mm"]) / ratio / 1000.0}
    return {}


# ---- Distortion.


def _distortion(kernel: _Kernel, focal_mm: float, pitch_mm: float) -> Distortion:
    """The distortion of the first keyword that the kernel has."""
    if "distortion" in kernel.overrides:
        return kernel.overrides["distortion"]  # type: ignore[no-any-return]
    for key, read in DISTORTIONS:
        if key in kernel.pool:
            return read(kernel, focal_mm, pitch_mm)
    kernel.note("guessed", "distortion", "none: no keyword of the kernel describes one")
    return NoDistortion()


def _taylor(kernel: _Kernel, _focal_mm: float, _pitch_mm: float) -> Distortion:
    kernel.note("known", "distortion", "OD_T_X, OD_T_Y: polynomials of third degree, mm")
    return TaylorDistortion(_numbers(kernel.pool, "OD_T_X", 10), _numbers(kernel.pool, "OD_T_Y", 10))


def _rational(kernel: _Kernel, _focal_mm: float, _pitch_mm: float) -> Distortion:
    kernel.note("known", "distortion", "OD_A1_CORR, OD_A2_CORR, OD_A3_CORR: quotients of polynomials, mm")
    return RationalDistortion(*(_numbers(kernel.pool, f"OD_A{n}_CORR", 6) for n in (1, 2, 3)))


def _pixel_radial(kernel: _Kernel, focal_mm: float, pitch_mm: float) -> Distortion:
    """JunoCam: distorted = ideal (1 + K1 r^2 + K2 r^4), r px."""
    k1, k2 = (float(_numbers(kernel.pool, f"DISTORTION_K{n}", 1)[0]) for n in (1, 2))
    kernel.note("known", "distortion", "DISTORTION_K1, DISTORTION_K2: distorted from ideal, px")
    focal_px = focal_mm / pitch_mm
    return BrownDistortion(focal_mm, k1=k1 * focal_px**2, k2=k2 * focal_px**4)


def _forward_radial(kernel: _Kernel, focal_mm: float, _pitch_mm: float) -> Distortion:
    """Dawn: distorted = ideal (1 + E1 r^2), r mm."""
    e1 = float(_numbers(kernel.pool, "RAD_DIST_COEFF", 1)[0])
    kernel.note("known", "distortion", f"RAD_DIST_COEFF {e1:g} /mm^2, distorted from ideal")
    return BrownDistortion(focal_mm, k1=e1 * focal_mm**2)


def _one_radial(kernel: _Kernel, _focal_mm: float, _pitch_mm: float) -> Distortion:
    """ISIS: ideal = distorted (1 + K1 r^2), r mm."""
    k1 = float(_numbers(kernel.pool, "K1", 1)[0])
    kernel.note(
        "derived", "distortion", f"K1 {k1:g} /mm^2, ideal = distorted (1 + K1 r^2) as ISIS computes it"
    )
    return RadialDistortion(k1_per_mm2=-k1)


def _radial(kernel: _Kernel, _focal_mm: float, pitch_mm: float) -> Distortion:
    """``OD_K``: ISIS' polynomial, or what the comments of the mission's kernel say."""
    of_line = LINE_OD_K.get(abs(kernel.instrument_id) // 1000)
    if of_line is not None and len(kernel.pool["OD_K"]) == 1:
        k1 = float(_numbers(kernel.pool, "OD_K", 1)[0])
        kernel.note("derived", "distortion", f"OD_K {k1:g}: {of_line}")
        # 1 / (1 + k r^2) to its fourth power: 3e-6 px at the end of the line
        return RadialDistortion(0.0, k1, -(k1**2), k1**3)
    if len(kernel.pool["OD_K"]) != 3:
        raise CameraError(
            f"OD_K of the instrument kernel has {len(kernel.pool['OD_K'])} values, 3 make a radial distortion; "
            "give distortion as an argument."
        )
    k = _numbers(kernel.pool, "OD_K", 3)
    if not k.any():
        kernel.note("known", "distortion", "none: OD_K is zero")
        return NoDistortion()
    meaning, terms = OD_K_OF_SPACECRAFT.get(abs(kernel.instrument_id) // 1000, ISIS_OD_K)
    kernel.note("derived", "distortion", f"OD_K {k.tolist()}: {meaning}")
    return RadialDistortion(*terms(k, pitch_mm))


Terms = tuple[float, float, float, float]


def _isis_terms(k: FloatArray, _pitch_mm: float) -> Terms:
    return float(k[0]), float(k[1]), float(k[2]), 0.0


def _lro_terms(k: FloatArray, _pitch_mm: float) -> Terms:
    return 0.0, -float(k[0]), -float(k[1]), -float(k[2])


def _hayabusa2_terms(k: FloatArray, pitch_mm: float) -> Terms:
    return 1.0 - float(k[0]), -float(k[1]) / pitch_mm**2, -float(k[2]) / pitch_mm**4, 0.0


LINE_OD_K = {
    85: "ideal = distorted / (1 + k r^2), r mm, as the comments of LROC's kernel say of its narrow angle cameras"
}
ISIS_OD_K = ("ideal = distorted (1 - k0 - k1 r^2 - k2 r^4), r mm, as ISIS computes it", _isis_terms)
# What the keyword means stands in the comments of kernels only: lro_lroc_v18.ti ("Distortion Model Parameters"), and
# hyb2oncAddendum0001.ti after the ONC bundle of DARTS.
OD_K_OF_SPACECRAFT: dict[int, tuple[str, Callable[[FloatArray, float], Terms]]] = {
    85: (
        "ideal = distorted (1 + k0 r^2 + k1 r^4 + k2 r^6), r mm, as the comments of LROC's kernel say",
        _lro_terms,
    ),
    37: (
        "ideal = distorted (k0 + k1 r^2 + k2 r^4), r px, as the comments of ONC's addendum say",
        _hayabusa2_terms,
    ),
}
Reader = Callable[[_Kernel, float, float], Distortion]
DISTORTIONS: tuple[tuple[str, Reader], ...] = (
    ("OD_T_X", _taylor),
    ("OD_A1_CORR", _rational),
    ("DISTORTION_K1", _pixel_radial),
    ("RAD_DIST_COEFF", _forward_radial),
    ("OD_K", _radial),
    ("K1", _one_radial),
)
