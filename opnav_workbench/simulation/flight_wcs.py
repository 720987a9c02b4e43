"""World coordinates of a picture for its FITS header: a tangent plane at the predicted boresight, with SIP distortion.

With u the offset of a pixel from CRPIX and U = u + f(u, v), V = v + g(u, v) that of an ideal camera, the tangent-plane
coordinates are CD (U, V); f and g are polynomials fitted to the camera's own distortion. No aberration is applied: the
coordinates are those of apparent directions, as the attitude in a CK is.

Source: Calabretta & Greisen (2002), doi:10.1051/0004-6361:20021327; SIP after Shupe et al. (2005), ADASS XIV, 491.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import radec_from_unit, tangent_basis

__all__ = ["wcs_cards"]

GRID = 33  # points along each side of the detector for the fits
ORDERS = (2, 3, 4, 5, 6, 7)
GOOD_PX = 0.001  # largest misfit that asks for no higher order
NO_DISTORTION_PX = 1e-6

Powers = tuple[tuple[int, int], ...]


def wcs_cards(camera: Camera, camera_from_j2000: ArrayLike) -> dict[str, Any]:
    """Return the WCS cards of a picture, the boresight's coordinates at CRVAL.

    Parameters
    ----------
    camera : Camera
    camera_from_j2000 : (3, 3) array_like
        The attitude that the header states.
    """
    attitude = np.asarray(camera_from_j2000, dtype=np.float64)
    axis = camera.project(camera.boresight)  # where the optical axis really falls
    pixels, ideal = _offsets(camera, axis)
    distorted = np.abs(ideal - pixels).max() > NO_DISTORTION_PX
    linear, sip = _sip(pixels, ideal) if distorted else (np.eye(2), {})
    matrix = _tangent_from_ideal(camera, attitude) @ linear
    ra, dec = radec_from_unit(camera.boresight @ attitude)
    kind = "-SIP" if distorted else ""
    cards: dict[str, Any] = {
        "WCSAXES": 2,
        "CTYPE1": f"RA---TAN{kind}",
        "CTYPE2": f"DEC--TAN{kind}",
        "CUNIT1": "deg",
        "CUNIT2": "deg",
        "CRPIX1": float(axis[0] + 1.0),  # FITS counts from 1
        "CRPIX2": float(axis[1] + 1.0),
        "CRVAL1": float(np.degrees(ra)),
        "CRVAL2": float(np.degrees(dec)),
    }
    cards |= {f"CD{i + 1}_{j + 1}": float(matrix[i, j]) for i in (0, 1) for j in (0, 1)}
    return cards | sip


def _offsets(camera: Camera, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return offsets (n, 2), px, of detector points from the optical axis, and those of an ideal camera."""
    x, y = np.meshgrid(np.linspace(0, camera.n_pixel - 1, GRID), np.linspace(0, camera.n_line - 1, GRID))
    points = np.stack([x.ravel(), y.ravel()], axis=-1)
    a_b_c = camera.unproject(points) @ camera.focal_from_camera.T
    ideal_mm = camera.focal_length_mm * a_b_c[:, :2] / a_b_c[:, 2:]
    return points - axis, ideal_mm @ camera.pixel_from_mm.T


def _tangent_from_ideal(camera: Camera, attitude: FloatArray) -> FloatArray:
    """Return d(east, north)/d(pixel, line), deg/px, of the ideal camera."""
    pixel_axis, line_axis, boresight = camera.focal_from_camera @ attitude
    sky = np.stack(tangent_basis(*radec_from_unit(boresight)))
    per_mm = sky @ np.stack([pixel_axis, line_axis], axis=1) / camera.focal_length_mm
    return np.asarray(np.degrees(per_mm @ np.linalg.inv(camera.pixel_from_mm)))


def _sip(pixels: FloatArray, ideal: FloatArray) -> tuple[FloatArray, dict[str, Any]]:
    """Return the linear part of ideal(pixels), which belongs into CD, and the SIP cards of the rest."""
    powers, forward = _fit(pixels, ideal - pixels)
    linear = np.eye(2) + forward[:2].T
    to_linear = np.linalg.inv(linear).T
    cards = _polynomials(("A", "B"), powers[2:], forward[2:] @ to_linear)
    straight = ideal @ to_linear
    return linear, cards | _polynomials(("AP", "BP"), *_fit(straight, pixels - straight))


def _polynomials(names: tuple[str, str], powers: Powers, coefficients: FloatArray) -> dict[str, Any]:
    cards: dict[str, Any] = {}
    for name, column in zip(names, coefficients.T, strict=True):
        cards[f"{name}_ORDER"] = max(p + q for p, q in powers)
        cards |= {f"{name}_{p}_{q}": float(c) for (p, q), c in zip(powers, column, strict=True)}
    return cards


def _fit(points: FloatArray, shift: FloatArray) -> tuple[Powers, FloatArray]:
    """Fit polynomials without a constant: powers of both coordinates, x first, and coefficients (k, 2)."""
    scale = np.abs(points).max()
    for order in ORDERS:
        powers = tuple((p, n - p) for n in range(1, order + 1) for p in range(n, -1, -1))
        x, y = (points / scale).T
        basis = np.stack([x**p * y**q for p, q in powers], axis=1)
        fitted = np.linalg.lstsq(basis, shift, rcond=None)[0]
        if np.abs(basis @ fitted - shift).max() < GOOD_PX:
            break
    degree = np.array([p + q for p, q in powers])
    return powers, fitted / scale ** degree[:, None]
