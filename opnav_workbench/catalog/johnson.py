"""Johnson V and B-V of stars, each with its 1 sigma, from the passbands of star catalogs.

Every function takes columns (n,) with nan where a magnitude is unknown and returns a `Johnson`. Without a color the
mean color of catalog stars is taken for V, with its scatter in the sigma, and B-V stays nan. Outside the range of
colors for which a relation was made it is held at the end of the range and the sigma grows.

=====================  =============================================================================================
from                   source
=====================  =============================================================================================
Tycho BT, VT           Mamajek, Meyer & Liebert (2002), AJ 124, 1670, appendix C, with the sign of their erratum (2006,
                       AJ 131, 2360); beyond -0.25 < BT-VT < 2.0: V = VT - 0.090 (BT-VT), B-V = 0.850 (BT-VT) (ESA 1997,
                       SP-1200 vol. 1, section 1.3; Hog et al. 2000, A&A 355, L27)
Hipparcos Hp, B-V      Harmanec (1998), A&A 335, 173, without its small term in U-B
Gaia G, BP, RP         V: Riello et al. (2021), A&A 649, A3, doi:10.1051/0004-6361/202039587, table C.2. B-V: a polynomial
                       fitted here to 55,564 single, constant Hipparcos stars with sigma(B-V) < 0.02 and Gaia DR3 colors;
                       its 68 % residuals are 0.016 (A stars) to 0.043 (K giants)
UCAC (579-642 nm)      V - UCAC = 0.556 (V-Rc), by the effective wavelengths 551, 610.5 and 658 nm; V-Rc from 2MASS J-K by
                       D. West (39 standard stars, scatter 0.03 mag). The zero point of the UCAC magnitude is good to
                       0.1 mag (note 2 of the UCAC4 documentation)
APASS B, V             Johnson by construction; where UCAC4 puts Tycho magnitudes in their place, as Tycho
2MASS J, K             B-V = 1.55 (J-K) + 0.05, a line through the intrinsic colors of dwarfs and giants from A0 to M0
                       (Bessell & Brett 1988, PASP 100, 1134; Pecaut & Mamajek 2013, ApJS 208, 9); they scatter by
                       0.08 about it
=====================  =============================================================================================
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray

__all__ = [
    "Johnson",
    "johnson_from_2mass_color",
    "johnson_from_bands",
    "johnson_from_gaia",
    "johnson_from_hipparcos",
    "johnson_from_standard",
    "johnson_from_tycho",
    "johnson_from_ucac",
]


# ---- Johnson V and B-V of stars, as far as they are known: what `bands` makes and `StarTable` holds.


class Johnson(NamedTuple):
    """Johnson V and B-V with 1 sigma, columns (n,) as `StarTable` has them; nan where unknown."""

    v_mag: FloatArray
    v_sigma: FloatArray
    b_v: FloatArray
    b_v_sigma: FloatArray

    @classmethod
    def unknown(cls, n: int) -> "Johnson":
        """Return n stars of which nothing is known."""
        return cls(*np.full((4, n), np.nan))

    @classmethod
    def concatenate(cls, parts: Sequence["Johnson"]) -> "Johnson":
        """Return the stars of all parts one after the other."""
        return cls(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def columns(self) -> dict[str, Any]:
        """Return the columns by name, for `StarTable`."""
        return self._asdict()

    def or_else(self, other: "Johnson") -> "Johnson":
        """Return these values, and those of `other` where V or B-V is unknown here."""
        no_v, no_color = np.isnan(self.v_mag), np.isnan(self.b_v)
        if not (no_v.any() or no_color.any()):
            return self
        return Johnson(
            np.where(no_v, other.v_mag, self.v_mag),
            np.where(no_v, other.v_sigma, self.v_sigma),
            np.where(no_color, other.b_v, self.b_v),
            np.where(no_color, other.b_v_sigma, self.b_v_sigma),
        )

    def or_at(self, rows: IntArray, other: "Johnson") -> "Johnson":
        """Return these values, and in some rows, where V or B-V is unknown here, those of `other`, one a row."""
        columns = [column.copy() for column in self]
        for column, values in zip(columns, self.take(rows).or_else(other), strict=True):
            column[rows] = values
        return Johnson(*columns)

    def better_of(self, other: "Johnson") -> "Johnson":
        """Return, of each star and quantity, the value of the smaller sigma."""
        worse_v = ~(self.v_sigma <= np.nan_to_num(other.v_sigma, nan=np.inf))
        worse_color = ~(self.b_v_sigma <= np.nan_to_num(other.b_v_sigma, nan=np.inf))
        return Johnson(
            np.where(worse_v, other.v_mag, self.v_mag),
            np.where(worse_v, other.v_sigma, self.v_sigma),
            np.where(worse_color, other.b_v, self.b_v),
            np.where(worse_color, other.b_v_sigma, self.b_v_sigma),
        )

    def take(self, rows: IntArray | BoolArray) -> "Johnson":
        """Return the chosen rows."""
        return Johnson(*(column[rows] for column in self))


# ---- Johnson V and B-V from the passbands of star catalogs, each with its 1 sigma.

# B-V of the 482,000 Gaia stars to G = 10: 68 % within 0.9 +- 0.6; of them follow the mean differences to V.
MEAN_V_MINUS = {
    "G": (0.28, 0.30),
    "Hp": (-0.11, 0.07),
    "VT": (-0.09, 0.06),
    "BT": (-1.15, 0.65),
    "UCAC": (0.27, 0.17),
}
MEAN_V_MINUS |= {"V": (0.0, 0.02), "B": (-0.9, 0.55), "J": (1.6, 0.8), "RP": (0.9, 0.5), "BP": (-0.15, 0.15)}

TYCHO_RANGE, TYCHO_SPLIT = (-0.25, 2.0), 0.5  # BT-VT
TYCHO_V = (9.7e-4, -0.1334, 0.05486, -0.01998)  # V - VT
TYCHO_BLUE = (-0.006, 1.0 - 0.1069, 0.1459)  # B-V below the split
TYCHO_RED = (0.0, 1.0 - 0.007813, -0.1489, 0.03384)  # and above
# V, B-V: "errors below 0.015 mag in V and 0.05 in B-V" for stars without reddening
TYCHO_SCATTER = 0.015, 0.05

HP_MINUS_V = (0.0072, 0.2964, -0.1110, -0.0157)  # polynomial in B-V
HP_RANGE, HP_SCATTER = (-0.25, 2.0), 0.012

G_MINUS_V = (-0.02704, 0.01424, -0.2156, 0.01426)  # polynomial in BP-RP
G_RANGE, G_SCATTER = (-0.5, 5.0), 0.03017
BV_FROM_GAIA = (-0.00385, 0.71469, -0.03967, 0.28145, -0.11784)  # polynomial in BP-RP
BV_GAIA_RANGE, BV_GAIA_SCATTER = (-0.5, 2.3), 0.03
GAIA_COLORS = (-1.0, 6.0)  # beyond: the BP or RP of a faint or blended source, no star's color

VR_FROM_JK = (0.0313, 0.8567)
UCAC_SHARE = 0.556  # of the way from V to Rc
UCAC_SCATTER = 0.10
JK_RANGE = (-0.1, 1.0)
BV_FROM_JK, BV_JK_SCATTER = (0.05, 1.55), 0.08

BEYOND_RANGE = 0.5  # what is added to a sigma, in mag per mag beyond the range of colors


def johnson_from_standard(b: ArrayLike, b_sigma: ArrayLike, v: ArrayLike, v_sigma: ArrayLike) -> Johnson:
    """Return V and B-V of magnitudes that are Johnson's already, such as those of APASS.

    Examples
    --------
    >>> johnson_from_standard([10.6], [0.03], [10.0], [0.04]).b_v.round(2)
    array([0.6])
    """
    blue, visual, b_err, v_err = _columns(b, v, b_sigma, v_sigma)
    return _johnson(visual, v_err, blue - visual, np.sqrt(b_err * b_err + v_err * v_err))


def johnson_from_tycho(bt: ArrayLike, bt_sigma: ArrayLike, vt: ArrayLike, vt_sigma: ArrayLike) -> Johnson:
    """Return V and B-V of Tycho magnitudes; one of BT and VT may be nan.

    Valid for -0.25 < BT-VT < 2.0 and unreddened stars; the linear relations with a larger sigma beyond.

    Examples
    --------
    TYC 1-13-1, a K star:

    >>> star = johnson_from_tycho([10.488], [0.038], [8.670], [0.015])
    >>> star.v_mag.round(3), star.b_v.round(3)
    (array([8.49]), array([1.515]))
    """
    blue, visual, b_err, v_err = _columns(bt, vt, bt_sigma, vt_sigma)
    color = blue - visual
    held, beyond = _within(color, TYCHO_RANGE)
    v = visual + _poly(held, TYCHO_V)
    b_v = np.where(held < TYCHO_SPLIT, _poly(held, TYCHO_BLUE), _poly(held, TYCHO_RED))
    outside = beyond > 0.0
    if outside.any():
        v = np.where(outside, visual - 0.090 * color, v)
        b_v = np.where(outside, 0.850 * color, b_v)
    color_variance = b_err**2 + v_err**2
    # V - VT changes by 0.1 a magnitude of color, B-V by 0.85.
    v_sigma = np.sqrt(v_err**2 + 0.01 * color_variance + TYCHO_SCATTER[0] ** 2) + 0.2 * beyond
    b_v_sigma = np.sqrt(0.7225 * color_variance + TYCHO_SCATTER[1] ** 2) + BEYOND_RANGE * beyond
    full = _johnson(v, v_sigma, b_v, b_v_sigma)
    return _or_mean_color(_or_mean_color(full, visual, v_err, "VT"), blue, b_err, "BT")


def johnson_from_hipparcos(
    hp: ArrayLike, hp_sigma: ArrayLike, b_v: ArrayLike, b_v_sigma: ArrayLike
) -> Johnson:
    """Return V of Hipparcos magnitudes Hp with the Johnson B-V that the catalog gives beside them.

    Valid for -0.25 < B-V < 2.0; the neglected term in U-B is below 0.008 mag. B-V is returned as given.

    Examples
    --------
    HIP 1:

    >>> johnson_from_hipparcos([9.2043], [0.002], [0.482], [0.025]).v_mag.round(2)
    array([9.08])
    """
    mag, color, mag_err, color_err = _columns(hp, b_v, hp_sigma, b_v_sigma)
    held, beyond = _within(color, HP_RANGE)
    v_sigma = np.sqrt(mag_err**2 + (0.2 * color_err) ** 2 + HP_SCATTER**2) + BEYOND_RANGE * beyond
    full = _johnson(mag - _poly(held, HP_MINUS_V), v_sigma, color, color_err)
    return _or_mean_color(full, mag, mag_err, "Hp")


def johnson_from_gaia(g: ArrayLike, bp: ArrayLike, rp: ArrayLike) -> Johnson:
    """Return V and B-V of Gaia magnitudes; BP and RP may be nan. Gaia's own errors are negligible here.

    V is valid for -0.5 < BP-RP < 5 (scatter 0.03; compared with Hipparcos' V it is 0.01 to 0.03 fainter up to BP-RP
    = 2), B-V for -0.5 < BP-RP < 2.3: beyond, giants and dwarfs of one B-V = 1.5 differ in Gaia's color.

    Examples
    --------
    A star like the Sun:

    >>> sun = johnson_from_gaia([10.0], [10.33], [9.51])
    >>> sun.v_mag.round(2), sun.b_v.round(2)
    (array([10.15]), array([0.66]))
    """
    mag, blue, red, _ = _columns(g, bp, rp, np.nan)
    color = blue - red
    color = np.where((color > GAIA_COLORS[0]) & (color < GAIA_COLORS[1]), color, np.nan)
    held, beyond = _within(color, G_RANGE)
    late = np.maximum(held - 2.0, 0.0)  # measured against Hipparcos: 0.05 mag off at 2.25, 0.18 beyond 2.5
    held_bv, beyond_bv = _within(color, BV_GAIA_RANGE)
    full = _johnson(
        mag - _poly(held, G_MINUS_V),
        G_SCATTER + 0.1 * late + BEYOND_RANGE * beyond,
        _poly(held_bv, BV_FROM_GAIA),
        BV_GAIA_SCATTER + 0.15 * np.clip(color - 1.8, 0.0, 1.0) + 0.1 * np.minimum(beyond_bv, 2.0),
    )
    return _or_mean_color(full, mag, np.zeros_like(mag), "G")


def johnson_from_ucac(mag: ArrayLike, mag_sigma: ArrayLike, j: ArrayLike, k: ArrayLike) -> Johnson:
    """Return V and B-V of UCAC magnitudes (579 to 642 nm) with 2MASS J and K, which may be nan.

    Valid for -0.1 < J-K < 1.0; sigma of V not below 0.1 mag, the uncertainty of the UCAC zero point.

    Examples
    --------
    >>> star = johnson_from_ucac([12.0], [0.02], [10.9], [10.5])
    >>> star.v_mag.round(2), star.b_v.round(2)
    (array([12.21]), array([0.67]))
    """
    red, mag_err, near, far = _columns(mag, mag_sigma, j, k)
    held, beyond = _within(near - far, JK_RANGE)
    v_sigma = np.sqrt(mag_err * mag_err + UCAC_SCATTER**2) + BEYOND_RANGE * beyond
    v_minus_r = VR_FROM_JK[0] + VR_FROM_JK[1] * held
    full = _johnson(red + UCAC_SHARE * v_minus_r, v_sigma, *_b_v_of_jk(held, beyond))
    return _or_mean_color(full, red, mag_err, "UCAC")


def johnson_from_2mass_color(j: ArrayLike, k: ArrayLike) -> Johnson:
    """Return B-V of 2MASS J-K, valid for -0.1 < J-K < 1.0 and stars of little reddening; V stays nan.

    Examples
    --------
    >>> johnson_from_2mass_color([10.9, 9.0], [10.53, np.nan]).b_v.round(2)
    array([0.62,  nan])
    """
    near, far, unknown, _ = _columns(j, k, np.nan, np.nan)
    return _johnson(unknown, unknown, *_b_v_of_jk(*_within(near - far, JK_RANGE)))


def johnson_from_bands(mag: ArrayLike, band: NDArray[np.str_]) -> Johnson:
    """Return V of magnitudes in named bands (n,) without any color; nan for a band that is not known here.

    Known are V, B, G, BP, RP, VT, BT, Hp, J and UCAC. The sigma is the spread of star colors.

    Examples
    --------
    >>> johnson_from_bands([9.0, 9.0], np.array(["V", "G"])).v_mag.tolist()
    [9.0, 9.28]
    """
    mags = np.asarray(mag, dtype=np.float64)
    shift, sigma = np.full(mags.shape, np.nan), np.full(mags.shape, np.nan)
    names, which = np.unique(np.asarray(band), return_inverse=True)
    for number, name in enumerate(names.tolist()):
        if name in MEAN_V_MINUS:
            shift[which == number], sigma[which == number] = MEAN_V_MINUS[name]
    unknown = np.full(mags.shape, np.nan)
    return _johnson(mags + shift, sigma, unknown, unknown)


def _or_mean_color(found: Johnson, mag: FloatArray, mag_sigma: FloatArray, band: str) -> Johnson:
    """Return `found`, with V by the mean color where it is unknown."""
    if not np.isnan(found.v_mag).any():
        return found
    shift, scatter = MEAN_V_MINUS[band]
    unknown = np.full(mag.shape, np.nan)
    return found.or_else(_johnson(mag + shift, np.asarray(np.hypot(mag_sigma, scatter)), unknown, unknown))


def _b_v_of_jk(held: FloatArray, beyond: FloatArray) -> tuple[FloatArray, FloatArray]:
    return BV_FROM_JK[0] + BV_FROM_JK[1] * held, BV_JK_SCATTER + BEYOND_RANGE * beyond


def _within(color: FloatArray, limits: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Return the color held within `limits` and how far beyond them it was."""
    held = np.clip(color, *limits)
    return held, np.abs(color - held)


def _columns(*values: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    arrays = [np.asarray(value, dtype=np.float64) for value in values]
    shape = max((array.shape for array in arrays), key=len)
    a, b, c, d = (array if array.shape == shape else np.full(shape, array) for array in arrays)
    return a, b, c, d


def _poly(x: FloatArray, coefficients: tuple[float, ...]) -> FloatArray:
    """Return the polynomial, constant term first; numpy's takes twice as long for a field of stars."""
    value = np.full(x.shape, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value *= x
        value += coefficient
    return value


def _johnson(v: FloatArray, v_sigma: FloatArray, b_v: FloatArray, b_v_sigma: FloatArray) -> Johnson:
    """Return a Johnson in which a value and its sigma are known together or not at all."""
    no_v: FloatArray = (v + v_sigma) * 0.0  # nan where either is
    no_color: FloatArray = (b_v + b_v_sigma) * 0.0
    return Johnson(v + no_v, v_sigma + no_v, b_v + no_color, b_v_sigma + no_color)
