"""Distortion given by polynomials: the SIP convention of FITS headers, and the Legendre series of MVIC."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.polynomial import legendre, polynomial
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, readonly
from opnav_workbench.camera.distortion import DirectDistortion, InverseDistortion
from opnav_workbench.errors import CameraError

__all__ = ["ForwardSipDistortion", "LegendreDistortion", "SipDistortion"]

LEGENDRE_DEGREE = 5
# Degrees (in x, in y) of the coefficients as the kernel lists them: total degree 1 to 5, x degree rising.
LEGENDRE_TERMS = tuple((i, n - i) for n in range(1, LEGENDRE_DEGREE + 1) for i in range(n + 1))
SIP_MAX_ORDER = 9  # the SIP convention's own limit

SipCoefficients = Mapping[tuple[int, int], float]  # value of u^p v^q by (p, q), px^(1 - p - q)


@dataclass(frozen=True, slots=True, eq=False)
class _SipPolynomials:
    """The map u' = u + f(u, v), v' = v + g(u, v) of pixel offsets from the boresight, acting on mm."""

    KEYWORDS: ClassVar[tuple[str, str]]  # prefixes of the header keywords along pixel and along line

    pixel_from_mm: FloatArray
    f: FloatArray
    g: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixel_from_mm", readonly(self.pixel_from_mm, (2, 2), "pixel_from_mm"))
        for name in ("f", "g"):
            object.__setattr__(self, name, readonly(getattr(self, name), (None, None), name))

    @classmethod
    def from_coefficients(cls, pixel_from_mm: ArrayLike, f: SipCoefficients, g: SipCoefficients) -> Self:
        """Return the model of coefficients keyed by the powers (p, q) of u and v.

        Parameters
        ----------
        pixel_from_mm : (2, 2) array_like
            The camera's matrix, px/mm.
        f, g : mapping
            Coefficients along pixel and along line, px^(1 - p - q).
        """
        return cls(np.asarray(pixel_from_mm, dtype=np.float64), _square(f), _square(g))

    @classmethod
    def from_keywords(cls, keywords: Mapping[str, Any], pixel_from_mm: ArrayLike) -> Self:
        """Return the model of a FITS header's keywords: ``AP_3_0``, ``BP_0_2``... or ``A_3_0``, ``B_0_2``...

        Raises
        ------
        CameraError
            The keywords hold no such coefficients.
        """
        along_pixel, along_line = (_keyed(keywords, prefix) for prefix in cls.KEYWORDS)
        return cls.from_coefficients(pixel_from_mm, along_pixel, along_line)

    def _map(self, xy_mm: ArrayLike) -> FloatArray:
        xy = np.asarray(xy_mm, dtype=np.float64)
        u, v = np.moveaxis(xy @ self.pixel_from_mm.T, -1, 0)
        shift = np.stack([polynomial.polyval2d(u, v, self.f), polynomial.polyval2d(u, v, self.g)], axis=-1)
        return np.asarray(xy + shift @ np.linalg.inv(self.pixel_from_mm).T)

    def _map_jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        u, v = np.moveaxis(np.asarray(xy_mm, dtype=np.float64) @ self.pixel_from_mm.T, -1, 0)
        rows = [
            np.stack(
                [polynomial.polyval2d(u, v, polynomial.polyder(c, axis=axis)) for axis in (0, 1)], axis=-1
            )
            for c in (self.f, self.g)
        ]
        return np.asarray(
            np.eye(2) + np.linalg.inv(self.pixel_from_mm) @ np.stack(rows, axis=-2) @ self.pixel_from_mm
        )


@dataclass(frozen=True, slots=True, eq=False)
class SipDistortion(_SipPolynomials, DirectDistortion):
    """SIP distortion from its reverse polynomials AP, BP, which give distorted from ideal pixel offsets.

    Build it with `from_coefficients` or `from_keywords`. The inverse is numerical: forward coefficients A, B
    of the same header agree with it to their fit error only.

    References
    ----------
    Shupe et al. (2005), ADASS XIV, ASP Conf. Ser. 347, 491.

    Examples
    --------
    >>> lens = SipDistortion.from_coefficients([[76.9, 0], [0, 76.9]], {(3, 0): 4.6e-9}, {(2, 1): 4.6e-9})
    >>> (lens.distort([[6.0, 0.0]]) * 76.9).round(3)  # 461.4 px, and 4.6e-9 * 461.4^3 = 0.452 px
    array([[461.852,   0.   ]])
    """

    KEYWORDS: ClassVar[tuple[str, str]] = ("AP", "BP")

    def distort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the point on the detector (..., 2) mm, of ideal coordinates (..., 2) mm."""
        return self._map(xy_mm)

    def jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(distorted)/d(ideal) (..., 2, 2) at ideal coordinates (..., 2) mm."""
        return self._map_jacobian(xy_mm)


@dataclass(frozen=True, slots=True, eq=False)
class ForwardSipDistortion(_SipPolynomials, InverseDistortion):
    """SIP distortion from its forward polynomials A, B, which give ideal from distorted pixel offsets.

    For headers that carry no reverse polynomials; `distort` is their numerical inverse. Build it with
    `from_coefficients` or `from_keywords`.

    References
    ----------
    Shupe et al. (2005), ADASS XIV, ASP Conf. Ser. 347, 491.
    """

    KEYWORDS: ClassVar[tuple[str, str]] = ("A", "B")

    def undistort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the ideal coordinates (..., 2) mm, of points on the detector (..., 2) mm."""
        return self._map(xy_mm)

    def undistort_jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(ideal)/d(distorted) (..., 2, 2) at points on the detector (..., 2) mm."""
        return self._map_jacobian(xy_mm)


def _square(coefficients: SipCoefficients) -> FloatArray:
    """Coefficients as a matrix [p, q]."""
    order = max((p + q for p, q in coefficients), default=0)
    if order > SIP_MAX_ORDER:
        raise CameraError(
            f"SIP coefficients of order {order}; the convention ends at {SIP_MAX_ORDER}, check the keys."
        )
    matrix = np.zeros((max(order, 1) + 1,) * 2)  # at least 2 x 2, so that it has derivatives
    for powers, value in coefficients.items():
        matrix[powers] = value
    return matrix


def _keyed(keywords: Mapping[str, Any], name: str) -> dict[tuple[int, int], float]:
    powers = [(p, q) for p in range(SIP_MAX_ORDER + 1) for q in range(SIP_MAX_ORDER + 1 - p)]
    found = {(p, q): float(keywords[f"{name}_{p}_{q}"]) for p, q in powers if f"{name}_{p}_{q}" in keywords}
    if not found:
        raise CameraError(
            f"no SIP coefficients {name}_p_q among these keywords; take a header whose CTYPE ends in -SIP."
        )
    return found


@dataclass(frozen=True, slots=True, eq=False)
class LegendreDistortion(InverseDistortion):
    """Legendre series in coordinates scaled to -1..1, as published for New Horizons' MVIC.

    With X = x / half_width, Y = y / half_height on the detector, the ideal coordinates are

        x_ideal = half_width (X + sum over k of c_x[k] P_i(X) P_j(Y))
        y_ideal = half_height (Y + sum over k of c_y[k] P_i(X) P_j(Y))

    over the 20 pairs of degrees (i, j) = (0,1) (1,0) (0,2) (1,1) (2,0) (0,3) ... (5,0). Beyond the
    calibrated area the correction of the nearest point of its edge applies: polynomials run away there.

    Parameters
    ----------
    half_size_mm : (2,) array
        Half width and half height of the calibrated area, mm; negative where the series' axis runs against
        the detector's (MVIC: its y axis points to decreasing line).
    x_coefficients, y_coefficients : (20,) arrays
        Dimensionless (fractions of half width and half height).

    References
    ----------
    Instrument addendum kernel mvicAddendum004.ti (``INS-98900_DISTORTION_COEF_X`` and ``_Y``), after
    "Calculation of distortion in MVIC frame images"; order, scale and direction as in the ISIS camera model
    NewHorizonsMvicFrameCameraDistortionMap.
    """

    half_size_mm: FloatArray
    x_coefficients: FloatArray
    y_coefficients: FloatArray

    def __post_init__(self) -> None:
        count = len(LEGENDRE_TERMS)
        for name, shape in (
            ("half_size_mm", (2,)),
            ("x_coefficients", (count,)),
            ("y_coefficients", (count,)),
        ):
            try:
                object.__setattr__(self, name, readonly(getattr(self, name), shape, name))
            except ValueError as error:
                raise CameraError(f"Legendre distortion: {error}; give as many values as that.") from error
        if not np.all(self.half_size_mm != 0.0):
            raise CameraError(
                "Legendre distortion: half_size_mm has a zero; give the calibrated area's half size in mm."
            )

    def _series(self) -> tuple[FloatArray, FloatArray]:
        """Coefficients of both axes as matrices [degree in x, degree in y]."""
        matrices = np.zeros((2, LEGENDRE_DEGREE + 1, LEGENDRE_DEGREE + 1))
        for k, (i, j) in enumerate(LEGENDRE_TERMS):
            matrices[:, i, j] = self.x_coefficients[k], self.y_coefficients[k]
        return matrices[0], matrices[1]

    def undistort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the ideal coordinates (..., 2) mm, of points on the detector (..., 2) mm."""
        xy = np.asarray(xy_mm, dtype=np.float64)
        x, y = np.moveaxis(np.clip(xy / self.half_size_mm, -1.0, 1.0), -1, 0)
        shift = np.stack([legendre.legval2d(x, y, c) for c in self._series()], axis=-1)
        return np.asarray(xy + self.half_size_mm * shift)

    def undistort_jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(ideal)/d(distorted) (..., 2, 2) at points on the detector (..., 2) mm."""
        scaled = np.asarray(xy_mm, dtype=np.float64) / self.half_size_mm
        x, y = np.moveaxis(np.clip(scaled, -1.0, 1.0), -1, 0)
        slopes = np.stack(
            [
                np.stack([legendre.legval2d(x, y, legendre.legder(c, axis=axis)) for axis in (0, 1)], axis=-1)
                for c in self._series()
            ],
            axis=-2,
        )
        inside = (np.abs(scaled) <= 1.0)[..., None, :]  # clipped: no slope along that axis
        scale = self.half_size_mm[:, None] / self.half_size_mm
        return np.asarray(np.eye(2) + np.where(inside, slopes, 0.0) * scale)
