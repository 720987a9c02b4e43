"""Cameras from SPICE instrument kernels: ``INS<id>_*`` pool variables in, the fields of a `Camera` out.

What a kernel gives is used in this order:

optics    ``OOC_*`` (Owen and O'Connell: LORRI), ``OPENCV_OD_*`` (OSIRIS-REx NAV team's Brown model),
          ``FOCAL_LENGTH`` with ``PIXEL_SIZE``, ``IFOV``, and last the field of view with the number of pixels
axes      ``SPOC_FITS_NAXIS1/2``, else pixel along ``FOV_REF_VECTOR`` and line along pixel x boresight (the
          sky is seen upright in a display with lines upward, as LORRI and OCAMS have it)

Kernels state ``PIXEL_SIZE`` in micrometers, ``IFOV`` in microradians and pixels from 0. Photometry, PSF and
attitude errors are not in kernels: give them as overrides.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera.distortion import BrownDistortion, OwenDistortion
from opnav_workbench.constants import ARCSEC_PER_RAD, RAD_PER_DEG
from opnav_workbench.errors import CameraError

__all__ = ["camera_fields_from_ik"]

Values = Mapping[str, tuple[Any, ...]]

MM_PER_UM = 1e-3
PER_MICRO = 1e6
LENGTH_IN_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "millimeters": 1.0, "meters": 1000.0}
ANGLE_IN_RAD = {
    "DEGREES": RAD_PER_DEG,
    "RADIANS": 1.0,
    "ARCMINUTES": 60.0 / ARCSEC_PER_RAD,
    "ARCSECONDS": 1.0 / ARCSEC_PER_RAD,
}
IFOV_TOLERANCE = (
    0.03  # pixel size over focal length and IFOV differ by up to 0.3 % in flight kernels; a wrong unit by 10x
)
NOMINAL_FOCAL_MM = 100.0  # where only angles are known, any focal length does: pixels per mm follow from it
PARALLEL = 0.7  # |cosine| that tells along from across


def camera_fields_from_ik(
    values: Mapping[str, Sequence[Any]],
    instrument_id: int,
    *,
    pixel_direction: ArrayLike | None = None,
    line_direction: ArrayLike | None = None,
    **overrides: Any,
) -> dict[str, Any]:
    """Return the fields of `Camera`; see `Camera.from_ik`."""
    pool = _without_prefix(values, instrument_id)
    axes = overrides.get("focal_from_camera")
    axes = (
        _axes(pool, pixel_direction, line_direction) if axes is None else np.asarray(axes, dtype=np.float64)
    )
    size = tuple(overrides.get(name) or _count(pool, key, name) for name, key in _SIZES)
    fields: dict[str, Any] = {
        "name": _text(pool, "INSTRUMENT_NAME", _text(pool, "FOV_FRAME", f"instrument {instrument_id}")),
        "frame": overrides["frame"] if "frame" in overrides else _text(pool, "FOV_FRAME"),
        "instrument_id": instrument_id,
        "n_pixel": size[0],
        "n_line": size[1],
        "focal_from_camera": axes,
        "center_pixel_line": _center(pool, size),
        "source": f"instrument kernel, INS{instrument_id}",
    }
    if "APERTURE_DIAMETER" in pool:
        fields["aperture_m"] = _length_mm(pool, "APERTURE_DIAMETER", "APERTURE_DIAM_UNITS") / 1000.0
    return fields | _optics(pool, axes, size) | overrides


_SIZES = (("n_pixel", "PIXEL_SAMPLES"), ("n_line", "PIXEL_LINES"))


def _without_prefix(values: Mapping[str, Sequence[Any]], instrument_id: int) -> dict[str, tuple[Any, ...]]:
    prefix = f"INS{instrument_id}_"
    pool = {key.removeprefix(prefix): value for key, value in values.items()}
    if not pool:
        raise CameraError(f"no {prefix}* variables; load the instrument kernel that defines {instrument_id}.")
    return {
        key: (value,) if isinstance(value, str | float | int) else tuple(value)
        for key, value in pool.items()
        if not key.startswith("INS-")
    }


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


def _count(pool: Values, key: str, name: str) -> int:
    if key not in pool:
        raise CameraError(f"the instrument kernel gives no {key}; give {name} as an argument.")
    return round(float(_numbers(pool, key, 1)[0]))


def _axes(pool: Values, pixel_direction: ArrayLike | None, line_direction: ArrayLike | None) -> FloatArray:
    boresight = _unit(_numbers(pool, "BORESIGHT", 3), "BORESIGHT")
    if pixel_direction is not None:
        pixel = np.asarray(pixel_direction, dtype=np.float64)
    elif "SPOC_FITS_NAXIS1" in pool:
        pixel = _numbers(pool, "SPOC_FITS_NAXIS1", 3)
    else:
        pixel = _numbers(pool, "FOV_REF_VECTOR", 3)
    pixel = _unit(pixel - (pixel @ boresight) * boresight, "the pixel direction")
    if line_direction is None and pixel_direction is None and "SPOC_FITS_NAXIS2" in pool:
        line_direction = _numbers(pool, "SPOC_FITS_NAXIS2", 3)
    line = np.cross(pixel, boresight)
    if line_direction is not None:
        along = float(np.asarray(line_direction, dtype=np.float64) @ line)
        if abs(along) < PARALLEL * float(np.linalg.norm(line_direction)):
            raise CameraError(
                f"line direction {np.asarray(line_direction).tolist()} and pixel direction {pixel.tolist()} "
                "are not at right angles; give two vectors across the boresight."
            )
        line = line * np.sign(along)
    return np.stack([pixel, line, boresight])


def _unit(vector: FloatArray, what: str) -> FloatArray:
    length = float(np.linalg.norm(vector))
    if not length > 0.0:
        raise CameraError(
            f"{what} of the instrument kernel has no direction across the boresight: {vector.tolist()}."
        )
    return np.asarray(vector / length)


def _center(pool: Values, size: tuple[int, ...]) -> FloatArray:
    for key in ("OOC_CCD_CENTER", "CCD_CENTER", "FOV_CENTER_PIXEL"):
        if key in pool:
            return _numbers(pool, key, 2)
    return 0.5 * (np.array(size, dtype=np.float64) - 1.0)


def _optics(pool: Values, axes: FloatArray, size: tuple[int, ...]) -> dict[str, Any]:
    """Focal length, px/mm and distortion from the best description that the kernel has."""
    builders: tuple[tuple[str, Callable[[Values], dict[str, Any]]], ...] = (
        ("OOC_EM", _owen),
        ("OPENCV_OD_K", _opencv),
        ("FOCAL_LENGTH", _pinhole),
        ("IFOV", _angular),
    )
    for key, build in builders:
        if key in pool:
            return build(pool)
    return _field_of_view(pool, axes, size)


def _owen(pool: Values) -> dict[str, Any]:
    e2, e5, e6 = _numbers(pool, "OOC_EM", 3)
    # The kernel's own code hands KMAT to a Fortran matrix product: Kx, Kyx, Kxy, Ky.
    return {
        "focal_length_mm": float(_numbers(pool, "OOC_FOCAL_LENGTH", 1)[0]),
        "pixel_from_mm": _numbers(pool, "OOC_KMAT", 4).reshape(2, 2).T,
        "distortion": OwenDistortion(e2_per_mm2=e2, e5_per_mm=e5, e6_per_mm=e6),
    }


def _opencv(pool: Values) -> dict[str, Any]:
    focal_mm = _length_mm(pool, "FOCAL_LENGTH", "FOCAL_LENGTH_UNITS")
    k1, k2, k3, k4, k5, k6 = _numbers(pool, "OPENCV_OD_K", 6)
    p1, p2 = _numbers(pool, "OPENCV_OD_P", 2)
    return {
        "focal_length_mm": focal_mm,
        "pixel_from_mm": np.diag(_numbers(pool, "OPENCV_OD_F", 2) / focal_mm),
        "center_pixel_line": _numbers(pool, "OPENCV_OD_C", 2) - 1.0,  # counted from 1, as ISIS reads it
        "distortion": BrownDistortion(focal_mm, k1, k2, k3, k4, k5, k6, p1, p2),
    }


def _pinhole(pool: Values) -> dict[str, Any]:
    focal_mm = _length_mm(pool, "FOCAL_LENGTH", "FOCAL_LENGTH_UNITS")
    if "PIXEL_SIZE" not in pool:
        pitch_mm = np.full(2, focal_mm * float(_numbers(pool, "IFOV", 1)[0]) / PER_MICRO)
    else:
        pitch_mm = np.broadcast_to(np.array(pool["PIXEL_SIZE"], dtype=np.float64), (2,)) * MM_PER_UM
        _check_ifov(pool, focal_mm, float(pitch_mm[0]))
    return {"focal_length_mm": focal_mm, "pixel_from_mm": np.diag(1.0 / pitch_mm)}


def _check_ifov(pool: Values, focal_mm: float, pitch_mm: float) -> None:
    if "IFOV" not in pool:
        return
    # One value, or one along each axis; microradians as a rule, radians in Dawn's kernels.
    stated, computed = (
        float(np.array(pool["IFOV"], dtype=np.float64).flat[0]),
        pitch_mm / focal_mm * PER_MICRO,
    )
    if all(abs(value - computed) > IFOV_TOLERANCE * computed for value in (stated, stated * PER_MICRO)):
        raise CameraError(
            f"IFOV {stated} microrad in the instrument kernel is not PIXEL_SIZE {pitch_mm / MM_PER_UM} um "
            f"over FOCAL_LENGTH {focal_mm} mm = {computed:.4g} microrad; check units, or give pixel_from_mm."
        )


def _angular(pool: Values) -> dict[str, Any]:
    pixels_per_mm = PER_MICRO / float(_numbers(pool, "IFOV", 1)[0]) / NOMINAL_FOCAL_MM
    return {"focal_length_mm": NOMINAL_FOCAL_MM, "pixel_from_mm": pixels_per_mm * np.eye(2)}


def _field_of_view(pool: Values, axes: FloatArray, size: tuple[int, ...]) -> dict[str, Any]:
    """Pinhole whose detector edges lie on the field of view's."""
    tangents = _corner_tangents(pool, axes) if "FOV_BOUNDARY_CORNERS" in pool else _angle_tangents(pool, axes)
    pixels_per_mm = 0.5 * np.array(size, dtype=np.float64) / (tangents * NOMINAL_FOCAL_MM)
    return {"focal_length_mm": NOMINAL_FOCAL_MM, "pixel_from_mm": np.diag(pixels_per_mm)}


def _angle_tangents(pool: Values, axes: FloatArray) -> FloatArray:
    """Tangents of the half angles along pixel and line."""
    unit = _text(pool, "FOV_ANGLE_UNITS", "RADIANS").upper()
    if unit not in ANGLE_IN_RAD:
        raise CameraError(f"FOV_ANGLE_UNITS {unit!r}; one of {', '.join(ANGLE_IN_RAD)} expected.")
    along = float(_numbers(pool, "FOV_REF_ANGLE", 1)[0])
    across = float(_numbers(pool, "FOV_CROSS_ANGLE", 1)[0]) if "FOV_CROSS_ANGLE" in pool else along  # circle
    reference = _unit(_numbers(pool, "FOV_REF_VECTOR", 3), "FOV_REF_VECTOR")
    angles = (along, across) if abs(axes[0] @ reference) > PARALLEL else (across, along)
    return np.tan(np.array(angles) * ANGLE_IN_RAD[unit])


def _corner_tangents(pool: Values, axes: FloatArray) -> FloatArray:
    corners = np.array(pool["FOV_BOUNDARY_CORNERS"], dtype=np.float64).reshape(-1, 3) @ axes.T
    return np.asarray(np.abs(corners[:, :2] / corners[:, 2:]).max(axis=0))


def _length_mm(pool: Values, key: str, unit_key: str) -> float:
    unit = _text(pool, unit_key, "mm").lower()
    if unit not in LENGTH_IN_MM:
        raise CameraError(f"{unit_key} {unit!r}; one of {', '.join(LENGTH_IN_MM)} expected.")
    return float(_numbers(pool, key, 1)[0]) * LENGTH_IN_MM[unit]
