"""Scattering laws: how bright a surface element looks, by incidence, emission and phase angle; laws by name.

Every law gives ``I/F`` (pi times radiance over solar irradiance; 1 for a white Lambert surface under the Sun at the
zenith) **per unit albedo**, and is normalised to 1 at cos i = cos e = 1 and zero phase. A body's `albedo` is therefore
its *normal albedo*: the I/F of a patch that is lit and seen from straight above. The geometric albedo of a sphere
(its brightness at zero phase over that of a white Lambert disk of its size) is `albedo` times the law's
`geometric_ratio`:

law             I/F per unit albedo (mu0 = cos i, mu = cos e)              geometric over normal albedo
Lambert         mu0                                                        2/3
LommelSeeliger  2 mu0 / (mu0 + mu)                                         1
LunarLambert    2 L mu0 / (mu0 + mu) + (1 - L) mu0                         (2 + L(0)) / 3
Minnaert        mu0^k mu^(k-1)                                             2 / (2 k + 1)
Hapke           w/4 mu0/(mu0+mu) [(1+B(g)) p(g) + H(mu0) H(mu) - 1] S / its value at mu0 = mu = 1, g = 0   (numeric)

Sources: Lambert, Lommel-Seeliger, Minnaert: Hapke, "Theory of reflectance and emittance spectroscopy" (2012);
lunar-Lambert: McEwen, Icarus 92, 298 (1991), doi:10.1016/0019-1035(91)90053-V, polynomial of the Moon as in McEwen,
LPSC 27, 841 (1996); Hapke: JGR 86, 3039 (1981), doi:10.1029/JB086iB04p03039, with the sign and names of its
Henyey-Greenstein lobes as in ISIS; macroscopic roughness (effective angles and the shadowing S of many small slopes):
Hapke, Icarus 59, 41 (1984), doi:10.1016/0019-1035(84)90054-X, equations 46 to 64.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, gauss_legendre
from opnav_workbench.errors import MissionError

__all__ = [
    "AdjustedLaw",
    "Hapke",
    "Lambert",
    "LommelSeeliger",
    "LunarLambert",
    "Minnaert",
    "ScatteringLaw",
    "law_from_mapping",
]


# ---- Macroscopic roughness: effective angles and shadowing of a surface of many small slopes.

SMALLEST_SINE = 1e-9  # keeps cot(angle) finite for straight-down light; exp(-cot) is zero long before


def rough_angles(
    mu0: FloatArray, mu: FloatArray, phase_rad: FloatArray, mean_slope_rad: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return effective cos i and cos e, and the shadowing function, for positive cosines.

    A mean slope of zero gives the cosines back, and 1.

    Examples
    --------
    >>> rough_angles(np.array([0.5]), np.array([0.8]), np.array([0.4]), 0.0)
    (array([0.5]), array([0.8]), array([1.]))
    """
    if mean_slope_rad == 0.0:
        return mu0, mu, np.ones(np.broadcast_shapes(mu0.shape, mu.shape))
    mu0, mu, phase_rad = np.broadcast_arrays(mu0, mu, phase_rad)
    tan_slope = np.tan(mean_slope_rad)
    chi = 1.0 / np.sqrt(1.0 + np.pi * tan_slope**2)
    azimuth = _azimuth(mu0, mu, phase_rad)
    hidden = np.exp(-2.0 * np.tan(np.minimum(0.5 * azimuth, 0.5 * np.pi - SMALLEST_SINE)))
    # The equations treat the steeper of the two directions apart; with it as "far" one form serves both cases.
    near, far = np.maximum(mu0, mu), np.minimum(mu0, mu)
    bend = _bend(near, far, azimuth, tan_slope)
    near_e = chi * (near + _sine(near) * tan_slope * bend[0])
    far_e = chi * (far + _sine(far) * tan_slope * bend[1])
    sun_steeper = mu0 < mu
    mu0_e, mu_e = np.where(sun_steeper, far_e, near_e), np.where(sun_steeper, near_e, far_e)
    eta0, eta = _eta(mu0, tan_slope, chi), _eta(mu, tan_slope, chi)
    nearer = np.where(sun_steeper, mu / eta, mu0 / eta0)
    shade = mu_e / eta * (mu0 / eta0) * chi / (1.0 - hidden + hidden * chi * nearer)
    return mu0_e, mu_e, shade


def _bend(
    near: FloatArray, far: FloatArray, azimuth: FloatArray, tan_slope: float
) -> tuple[FloatArray, FloatArray]:
    """Return what tilts the effective angles: of the direction nearer the normal, and of the other."""
    half = np.sin(0.5 * azimuth) ** 2
    e1_near, e2_near = _exponentials(near, tan_slope)
    e1_far, e2_far = _exponentials(far, tan_slope)
    below = 2.0 - e1_far - azimuth / np.pi * e1_near
    return (np.cos(azimuth) * e2_far + half * e2_near) / below, (e2_far - half * e2_near) / below


def _azimuth(mu0: FloatArray, mu: FloatArray, phase_rad: FloatArray) -> FloatArray:
    """Return the angle between the planes of incidence and emission, 0..pi."""
    sines = np.maximum(_sine(mu0) * _sine(mu), SMALLEST_SINE**2)
    return np.asarray(np.arccos(np.clip((np.cos(phase_rad) - mu0 * mu) / sines, -1.0, 1.0)))


def _eta(mu: FloatArray, tan_slope: float, chi: float) -> FloatArray:
    e1, e2 = _exponentials(mu, tan_slope)
    return np.asarray(chi * (mu + _sine(mu) * tan_slope * e2 / (2.0 - e1)))


def _exponentials(mu: FloatArray, tan_slope: float) -> tuple[FloatArray, FloatArray]:
    cot = mu / np.maximum(_sine(mu), SMALLEST_SINE) / tan_slope
    return np.exp(-2.0 / np.pi * cot), np.exp(-(cot**2) / np.pi)


def _sine(mu: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.maximum(1.0 - mu * mu, 0.0)))


# ---- Scattering laws: how bright a surface element looks, by incidence, emission and phase angle.

# McEwen (1996): L of the Moon against phase angle in degrees, lowest power first; good to about 130 deg.
MCEWEN_MOON = (1.0, -0.019, 2.42e-4, -1.46e-6)
DISK_NODES = (
    64  # Gauss-Legendre nodes of the geometric albedo; Lambert's 2/3 to rounding, rough Hapke to 1e-6
)


@dataclass(frozen=True, slots=True)
class ScatteringLaw(ABC):
    """What all laws share; arguments broadcast against each other.

    Examples
    --------
    >>> LommelSeeliger().reflectance([1.0, 0.5, -0.1], 0.5, 0.3).round(4)
    array([1.3333, 1.    , 0.    ])
    """

    uses_phase: ClassVar[bool] = False  # whether the phase angle matters

    def reflectance(self, cos_i: ArrayLike, cos_e: ArrayLike, phase_rad: ArrayLike) -> FloatArray:
        """Return I/F per unit albedo; 0 where the surface is not lit or turned away.

        Parameters
        ----------
        cos_i, cos_e : array_like
            Cosines of the incidence and emission angles.
        phase_rad : array_like
            Angle Sun - surface - observer.
        """
        mu0, mu = np.asarray(cos_i, dtype=np.float64), np.asarray(cos_e, dtype=np.float64)
        seen = (mu0 > 0.0) & (mu > 0.0)
        bright = self._lit(np.where(seen, mu0, 1.0), np.where(seen, mu, 1.0), np.asarray(phase_rad, float))
        return np.asarray(np.where(seen, bright, 0.0))

    @property
    def geometric_ratio(self) -> float:
        """Geometric albedo of a sphere over its normal albedo."""
        node, weight = gauss_legendre(DISK_NODES)
        mu = 0.5 * (node + 1.0)
        return float(np.sum(weight * mu * self.reflectance(mu, mu, 0.0)))

    @abstractmethod
    def _lit(self, mu0: FloatArray, mu: FloatArray, phase_rad: FloatArray) -> FloatArray:
        """Return I/F per unit albedo where both cosines are positive."""

    def _require(self, valid: bool, name: str, allowed: str) -> None:
        if not valid:
            raise MissionError(f"{type(self).__name__}: {name} is {getattr(self, name)}; {allowed}.")

    def _require_finite(self) -> None:
        for field in fields(self):
            self._require(bool(np.isfinite(getattr(self, field.name)).all()), field.name, "give a number")


@dataclass(frozen=True, slots=True)
class Lambert(ScatteringLaw):
    """Equally bright from all sides: icy, multiply scattering surfaces."""

    def _lit(self, mu0: FloatArray, mu: FloatArray, phase_rad: FloatArray) -> FloatArray:  # noqa: ARG002
        return mu0


@dataclass(frozen=True, slots=True)
class LommelSeeliger(ScatteringLaw):
    """Single scattering in a dark medium: no limb darkening at full phase."""

    def _lit(self, mu0: FloatArray, mu: FloatArray, phase_rad: FloatArray) -> FloatArray:  # noqa: ARG002
        return np.asarray(2.0 * mu0 / (mu0 + mu))


@dataclass(frozen=True, slots=True)
class LunarLambert(ScatteringLaw):
    """A mixture of Lommel-Seeliger (share L) and Lambert.

    Attributes
    ----------
    lunar_weight
        L: a constant, or a polynomial of the phase angle in degrees, lowest power first, kept within 0..1 (a cubic
        fit runs out of it beyond the data it was made from). Default McEwen's for the Moon.

    Raises
    ------
    MissionError
        L is not finite, empty, or a constant outside 0..1.

    Examples
    --------
    >>> law = LunarLambert(0.5)
    >>> float(law.reflectance(0.5, 1.0, 1.0).round(4)), round(law.geometric_ratio, 4)
    (0.5833, 0.8333)
    """

    lunar_weight: float | tuple[float, ...] = MCEWEN_MOON
    uses_phase: ClassVar[bool] = True

    def __post_init__(self) -> None:
        self._require_finite()
        powers = np.atleast_1d(self.lunar_weight)
        self._require(len(powers) > 0, "lunar_weight", "give a number or a polynomial")
        if np.ndim(self.lunar_weight) == 0:
            self._require(0.0 <= powers[0] <= 1.0, "lunar_weight", "a constant lies within 0..1")

    def share(self, phase_rad: float | FloatArray) -> FloatArray:
        """Return Lommel-Seeliger's share at phase angles."""
        powers = np.atleast_1d(np.asarray(self.lunar_weight, dtype=np.float64))
        return np.asarray(np.clip(np.polynomial.polynomial.polyval(np.degrees(phase_rad), powers), 0.0, 1.0))

    def _lit(self, mu0: FloatArray, mu: FloatArray, phase_rad: FloatArray) -> FloatArray:
        share = self.share(phase_rad)
        return np.asarray(mu0 * (2.0 * share / (mu0 + mu) + 1.0 - share))


@dataclass(frozen=True, slots=True)
class Minnaert(ScatteringLaw):
    """An empirical law with limb-darkening exponent `k`; k = 1 is Lambert.

    Below k = 1 the law grows without bound toward the limb where the surface there is lit; the light of the whole disk
    stays finite for k > 0.

    Raises
    ------
    MissionError
        `k` is not positive.
    """

    k: float = 0.9

    def __post_init__(self) -> None:
        self._require(0.0 < self.k < np.inf, "k", "give a positive number, such as 0.9")

    def _lit(self, mu0: FloatArray, mu: FloatArray, phase_rad: FloatArray) -> FloatArray:  # noqa: ARG002
        return np.asarray(mu0**self.k * mu ** (self.k - 1.0))


@dataclass(frozen=True, slots=True)
class Hapke(ScatteringLaw):
    """Hapke's function with a double Henyey-Greenstein phase function and, if wanted, macroscopic roughness.

    Attributes
    ----------
    w
        Single-scattering albedo.
    b0, h
        Height and angular width of the opposition surge, ``B = b0 / (1 + tan(g/2) / h)``.
    asymmetry
        b of the lobes: p = (1-c) (1-b^2) / (1 + 2 b cos g + b^2)^1.5 + c (1-b^2) / (1 - 2 b cos g + b^2)^1.5, so that
        with c = 0 a negative b scatters back.
    second_share
        c, the second lobe's share.
    roughness_deg
        Mean slope; 0 for a smooth surface.

    Raises
    ------
    MissionError
        A parameter outside its range.

    Examples
    --------
    >>> dark = Hapke(w=0.03, asymmetry=-0.35, b0=1.0, h=0.1)
    >>> round(dark.normal_albedo, 4), float(dark.reflectance(1.0, 1.0, 0.0))
    (0.024, 1.0)
    """

    w: float = 0.3
    b0: float = 0.0
    h: float = 0.05
    asymmetry: float = -0.3
    second_share: float = 0.0
    roughness_deg: float = 0.0
    uses_phase: ClassVar[bool] = True

    def __post_init__(self) -> None:
        self._require_finite()
        self._require(0.0 < self.w <= 1.0, "w", "it lies in 0..1, above 0")
        self._require(self.b0 >= 0.0, "b0", "it is not negative")
        self._require(self.h > 0.0, "h", "give a positive number")
        self._require(-1.0 < self.asymmetry < 1.0, "asymmetry", "it lies between -1 and 1")
        self._require(0.0 <= self.second_share <= 1.0, "second_share", "it lies within 0..1")
        self._require(0.0 <= self.roughness_deg < 60.0, "roughness_deg", "it lies within 0..60")

    @property
    def normal_albedo(self) -> float:
        """I/F that the parameters themselves give at normal incidence and emission and zero phase."""
        one = np.ones(1)
        return float(self._absolute(one, one, np.zeros(1))[0])

    def _lit(self, mu0: FloatArray, mu: FloatArray, phase_rad: FloatArray) -> FloatArray:
        return self._absolute(mu0, mu, phase_rad) / self.normal_albedo

    def _absolute(self, mu0: FloatArray, mu: FloatArray, phase_rad: FloatArray) -> FloatArray:
        mu0_e, mu_e, shade = rough_angles(mu0, mu, phase_rad, np.radians(self.roughness_deg))
        surge = self.b0 / (1.0 + np.tan(0.5 * phase_rad) / self.h)
        single = (1.0 + surge) * self._phase_function(np.cos(phase_rad))
        multiple = self._h_function(mu0_e) * self._h_function(mu_e) - 1.0
        return np.asarray(0.25 * self.w * mu0_e / (mu0_e + mu_e) * (single + multiple) * shade)

    def _phase_function(self, cos_g: FloatArray) -> FloatArray:
        b, c = self.asymmetry, self.second_share
        first = (1.0 + 2.0 * b * cos_g + b * b) ** -1.5
        second = (1.0 - 2.0 * b * cos_g + b * b) ** -1.5
        return np.asarray((1.0 - b * b) * ((1.0 - c) * first + c * second))

    def _h_function(self, mu: FloatArray) -> FloatArray:
        return np.asarray((1.0 + 2.0 * mu) / (1.0 + 2.0 * mu * np.sqrt(1.0 - self.w)))


# ---- Scattering laws by name, as scenario files give them.

LAWS: dict[str, type[ScatteringLaw]] = {
    "lambert": Lambert,
    "lommel_seeliger": LommelSeeliger,
    "lunar_lambert": LunarLambert,
    "minnaert": Minnaert,
    "hapke": Hapke,
}


def law_from_mapping(values: Mapping[str, Any] | str) -> ScatteringLaw:
    """Return the law that a mapping describes: its name under ``law``, and the parameters that differ from the defaults.

    Parameters
    ----------
    values
        Such as ``{"law": "minnaert", "k": 0.8}``; a bare name stands for a law with its defaults. A parameter that is
        None keeps its default.

    Raises
    ------
    MissionError
        An unknown law or parameter, or a value outside its range; the message says what is allowed.

    Examples
    --------
    >>> law_from_mapping({"law": "minnaert", "k": 0.8})
    Minnaert(k=0.8)
    >>> law_from_mapping("oren_nayar")
    Traceback (most recent call last):
    opnav_workbench.errors.MissionError: scattering law 'oren_nayar' is unknown; use lambert, lommel_seeliger, ...
    """
    given = {"law": values} if isinstance(values, str) else dict(values)
    name = given.pop("law", None)
    if name not in LAWS:
        raise MissionError(f"scattering law {name!r} is unknown; use {', '.join(LAWS)}.")
    law = LAWS[name]
    known = [field.name for field in fields(law)]
    for key in given:
        if key not in known:
            allowed = f"it takes {', '.join(known)}" if known else "it takes none"
            raise MissionError(f"scattering law {name}: unknown parameter {key!r}; {allowed}.")
    chosen = {key: tuple(v) if isinstance(v, list) else v for key, v in given.items() if v is not None}
    try:
        return law(**chosen)
    except TypeError as error:
        raise MissionError(
            f"scattering law {name}: {chosen} is not all numbers; check its values."
        ) from error


# ---- A law made to fit: darkened toward the limb by more or less.

DARKEST_SUM = 0.02  # of mu0 + mu: bounds the factor near the cusps


@dataclass(frozen=True, slots=True)
class AdjustedLaw(ScatteringLaw):
    """A law times ``(2 / (mu0 + mu))^share``.

    Examples
    --------
    >>> law = AdjustedLaw(Lambert(), 1.0)
    >>> law.reflectance(0.5, 0.3, 0.2) == LommelSeeliger().reflectance(0.5, 0.3, 0.2)
    np.True_
    """

    law: ScatteringLaw
    share: float
    uses_phase: ClassVar[bool] = True

    def _lit(self, mu0: FloatArray, mu: FloatArray, phase_rad: FloatArray) -> FloatArray:
        factor = 2.0 / np.maximum(mu0 + mu, DARKEST_SUM)
        return np.asarray(self.law.reflectance(mu0, mu, phase_rad) * factor**self.share)
