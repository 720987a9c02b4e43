"""Distortion given by polynomials: the SIP convention of FITS headers, and Legendre series of New Horizons' MVIC."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.polynomial import legendre, polynomial
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays, readonly
from opnav_workbench.camera.distortion import Distortion, InverseDistortion, undistort
from opnav_workbench.errors import CameraError

__all__ = ["LegendreDistortion", "SipDistortion"]

LEGENDRE_DEGREE = 5
# Powers (of x, of y) of the 20 MVIC coefficients, as they stand in the kernel: total degree 1 to 5, x degree rising.
LEGENDRE_ORDER = tuple((i, n - i) for n in range(1, LEGENDRE_DEGREE + 1) for i in range(n + 1))
SIP_MAX_ORDER = 9  # the SIP convention's own limit
Coefficients = Mapping[tuple[int, int], float]


@dataclass(frozen=True, slots=True, eq=False)
class SipDistortion(InverseDistortion):
    """The SIP convention: polynomials of pixel offsets from the boresight.

    Reverse coefficients (AP, BP) give distorted from ideal offsets, forward ones (A, B) ideal from distorted:

        u' = u + sum over p, q of a[p, q] u^p v^q,     v' = v + sum of b[p, q] u^p v^q

    One pair defines the model, and its inverse is numerical: the two pairs of a header agree to their fit error only.

    Parameters
    ----------
    pixel_from_mm : (2, 2) array
        The camera's matrix, px/mm.
    a, b : (order + 1, order + 1) arrays
        Coefficients of u^p v^q at [p, q], px^(1 - p - q).
    reverse : bool
        True: `a`, `b` are AP, BP; False: they are A, B.

    References
    ----------
    Shupe et al. (2005), ADASS XIV, ASP Conf. Ser. 347, 491.
    """

    pixel_from_mm: FloatArray
    a: FloatArray
    b: FloatArray
    reverse: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixel_from_mm", readonly(self.pixel_from_mm, (2, 2), "pixel_from_mm"))
        freeze_arrays(self)

    @classmethod
    def from_reverse(cls, pixel_from_mm: ArrayLike, ap: Coefficients, bp: Coefficients) -> Self:
        """Return the model of reverse coefficients AP, BP, keyed by powers (p, q)."""
        return cls(np.asarray(pixel_from_mm, dtype=np.float64), _matrix("AP", ap), _matrix("BP", bp), reverse=True)

    @classmethod
    def from_forward(cls, pixel_from_mm: ArrayLike, a: Coefficients, b: Coefficients) -> Self:
        """Return the model of forward coefficients A, B, keyed by powers (p, q); `distort` inverts them."""
        return cls(np.asarray(pixel_from_mm, dtype=np.float64), _matrix("A", a), _matrix("B", b), reverse=False)

    @classmethod
    def from_keywords(cls, keywords: Mapping[str, Any], pixel_from_mm: ArrayLike, *, reverse: bool = True) -> Self:
        """Return the model of FITS keywords ``AP_3_0``, ``BP_0_2`` (or ``A_..``, ``B_..``) of a header.

        Raises
        ------
        CameraError
            The keywords do not hold such coefficients.
        """
        build = cls.from_reverse if reverse else cls.from_forward
        names = ("AP", "BP") if reverse else ("A", "B")
        first, second = (_from_keywords(keywords, name) for name in names)
        if not first or not second:
            raise CameraError(f"no SIP coefficients {names[0]}_p_q and {names[1]}_p_q in these keywords; check the header.")
        return build(pixel_from_mm, first, second)

    def distort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the point on the detector (..., 2) mm, of ideal coordinates (..., 2) mm."""
        return self._map(xy_mm) if self.reverse else InverseDistortion.distort(self, xy_mm)

    def undistort(self, xy_mm: ArrayLike) -> FloatArray:
        """Return the ideal coordinates (..., 2) mm, of points on the detector (..., 2) mm."""
        return undistort(_Turned(self), xy_mm) if self.reverse else self._map(xy_mm)

    def jacobian(self, xy_mm: ArrayLike) -> FloatArray:
        """Return d(distorted)/d(ideal) (..., 2, 2) at ideal coordinates (..., 2) mm."""
        return self._map_jacobian(xy_mm) if self.reverse else InverseDistortion.jacobian(self, xy_mm)
