"""Near stars for a triangulation: their places in space, and which two of them fix a spacecraft's position best.

    s = (AU / parallax) (r0 + (p mu_ra* + q mu_dec + r0 mu_r) t)

as in `opnav_workbench.geometry.spacemotion`. Across the line of sight a near star is known to a thousandth of an
astronomical unit, along it to some ten of them; that matters little, for a spacecraft in the solar system looks almost along
it.

A pair is judged by the covariance that `triangulate` would state, with a camera of a given error: errors of direction and
catalog at the stars' distances, from where the spacecraft roughly is. Near stars far apart on the sky win; Lauer et al.
(2025), AJ 170, 22, doi:10.3847/1538-3881/addabe, section 5, find that one such pair beats many farther stars.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from astropy import units as u
from astropy.table import QTable
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays, symmetric
from opnav_workbench.catalog import StarTable, open_catalog
from opnav_workbench.catalog.quality import StarQuality
from opnav_workbench.constants import ARCSEC_PER_RAD, AU_KM, KM_S_PER_AU_YEAR, SPEED_OF_LIGHT_KM_S
from opnav_workbench.errors import EstimationError
from opnav_workbench.geometry import (
    angle_between,
    et_from_jyear,
    jyear_from_et,
    propagate,
    propagate_covariance,
    radec_from_unit,
    tangent_basis,
    unit,
    unit_from_radec,
)

__all__ = ["StarPositions", "best_pairs", "nearest_stars", "star_positions"]


# ---- Places of catalog stars in space, with what the catalog does not know of them.


@dataclass(frozen=True, slots=True, eq=False)
class StarPositions:
    """Stars in space; arrays are read-only.

    Attributes
    ----------
    position_km : (m, 3) array
        From the solar-system barycenter, J2000.
    covariance_km2 : (m, 3, 3) array
        From the catalog's errors of place, motion and parallax.
    """

    position_km: FloatArray
    covariance_km2: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def star_positions(
    stars: StarTable, et: ArrayLike, observer_position_km: ArrayLike | None = None
) -> StarPositions:
    """Return where catalog stars stand in space, with covariance.

    Parameters
    ----------
    stars
        m stars with parallaxes.
    et : float or (m,) array_like
        When they are seen, TDB seconds past J2000.
    observer_position_km : (3,) array_like, optional
        Roughly from where: a nearer observer sees a star later in its life. Left out, from the barycenter; 47 au, or six
        hours of proper motion, are 3 milliarcseconds for the fastest stars.

    Raises
    ------
    EstimationError
        A star whose parallax is not known to be positive.

    Examples
    --------
    >>> from opnav_workbench.catalog import read_star_list
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> stars = read_star_list(kernels_meta_dir() / "new_horizons" / "stars.yaml")
    >>> places = star_positions(stars, 640822038.0)  # Proxima Centauri and Wolf 359 in April 2020
    >>> print((np.linalg.norm(places.position_km, axis=1) / 3.0856775815e13).round(4))
    [1.3019 2.4087]
    """
    known = stars.parallax_rad > 0.0
    if not known.all():
        raise EstimationError(
            f"star {stars.id[~known][0]} has no parallax, so no place in space; take stars with a parallax."
        )
    observer = np.zeros(3) if observer_position_km is None else np.asarray(observer_position_km, float)
    toward = unit_from_radec(stars.ra_rad, stars.dec_rad)
    seen_et = np.asarray(et, float) + toward @ observer / SPEED_OF_LIGHT_KM_S
    direction = propagate(
        stars.ra_rad,
        stars.dec_rad,
        stars.pmra_rad_yr,
        stars.pmdec_rad_yr,
        stars.parallax_rad,
        stars.rv_km_s,
        stars.epoch_jyear,
        seen_et,
    )
    distance = _distance_km(stars, seen_et)[:, None]
    tangent = np.stack(tangent_basis(*radec_from_unit(direction)), axis=1)
    across = np.swapaxes(tangent, 1, 2) @ _sky_covariance(stars, seen_et) @ tangent
    along = (stars.sigma[:, 2] / stars.parallax_rad)[:, None] * direction
    spread = across + along[:, :, None] * along[:, None]
    return StarPositions(direction * distance, symmetric(spread * distance[:, None] ** 2))


def _distance_km(stars: StarTable, et: FloatArray) -> FloatArray:
    """Return the distances (m,), grown since the catalog epoch by radial velocity and proper motion."""
    years = jyear_from_et(et) - stars.epoch_jyear
    outward = np.nan_to_num(stars.rv_km_s) / KM_S_PER_AU_YEAR * stars.parallax_rad
    across = np.hypot(stars.pmra_rad_yr, stars.pmdec_rad_yr)
    return np.asarray(AU_KM / stars.parallax_rad * np.hypot(1.0 + outward * years, across * years))


def _sky_covariance(stars: StarTable, et: FloatArray) -> FloatArray:
    """Return the covariance (m, 2, 2) of the barycentric directions toward east and north."""
    return propagate_covariance(
        stars.covariance,
        stars.epoch_jyear,
        et,
        stars.ra_rad,
        stars.dec_rad,
        pmra_rad_yr=stars.pmra_rad_yr,
        pmdec_rad_yr=stars.pmdec_rad_yr,
        parallax_rad=stars.parallax_rad,
        rv_km_s=stars.rv_km_s,
    )


# ---- Which two stars fix a spacecraft's position best, with a camera of a given error.

NEAREST_COUNT = 60
# A star of the list this near a catalog star, after motion, is the same
SAME_STAR_RAD = 60.0 / ARCSEC_PER_RAD
# An unresolved companion moves the light by more than a camera's error: such stars are no landmarks.
NOT_LANDMARKS = StarQuality.DOUBLE | StarQuality.BAD_ASTROMETRY

# Hipparcos numbers, and what people call these stars.
NEAR_STAR_NAMES: Mapping[str, str] = MappingProxyType(
    {
        "HIP 70890": "Proxima Cen",
        "HIP 71683": "alpha Cen A",
        "HIP 71681": "alpha Cen B",
        "HIP 87937": "Barnard's Star",
        "HIP 54035": "Lalande 21185",
        "HIP 32349": "Sirius",
        "HIP 92403": "Ross 154",
        "HIP 16537": "epsilon Eri",
        "HIP 114046": "Lacaille 9352",
        "HIP 57548": "Ross 128",
        "HIP 104214": "61 Cyg A",
        "HIP 104217": "61 Cyg B",
        "HIP 37279": "Procyon",
        "HIP 1475": "Groombridge 34",
        "HIP 108870": "epsilon Ind",
        "HIP 8102": "tau Cet",
        "HIP 36208": "Luyten's Star",
        "HIP 24186": "Kapteyn's Star",
        "HIP 105090": "Lacaille 8760",
    }
)


def nearest_stars(
    extra: StarTable | None = None, *, count: int = NEAREST_COUNT, catalog: str = "bundled"
) -> StarTable:
    """Return the nearest stars of a catalog, by parallax, for `best_pairs`.

    Parameters
    ----------
    extra
        Stars to add, such as those of a mission's star list; they take the place of the catalog's where it has them too.
        The bundled catalog has its parallaxes from Hipparcos, which lacks stars fainter than magnitude 12.
    catalog
        Catalog spec.

    Raises
    ------
    CatalogError
        The catalog cannot be opened.

    Examples
    --------
    >>> nearest_stars(count=2).id.tolist()
    ['alpha Cen B', 'Proxima Cen']
    """
    stars = open_catalog(catalog).cone(0.0, 0.0, np.pi)
    stars = stars.take(
        np.argsort(-stars.parallax_rad, kind="stable")[: count + (0 if extra is None else len(extra))]
    )
    stars = _with_common_names(stars)
    if extra is not None:
        known = np.array([_is_among(stars, row, extra) for row in range(len(stars))], dtype=bool)
        stars = StarTable.concatenate([extra, stars.take(~known)])
    return stars.take(np.argsort(-stars.parallax_rad, kind="stable")[:count])


def _with_common_names(stars: StarTable) -> StarTable:
    columns = {name: getattr(stars, name) for name in StarTable.__slots__}
    return StarTable(**columns | {"id": np.array([NEAR_STAR_NAMES.get(s, s) for s in stars.id.tolist()])})


def _is_among(stars: StarTable, row: int, others: StarTable) -> bool:
    """Whether a star is one of the others, at the epoch of each."""
    one = stars.take([row])
    et = et_from_jyear(others.epoch_jyear)
    places = np.concatenate([one.directions(float(t)) for t in et])
    there = np.concatenate([others.take([i]).directions(float(t)) for i, t in enumerate(et)])
    return bool((angle_between(places, there) < SAME_STAR_RAD).any())


def best_pairs(
    stars: StarTable,
    et: float,
    position_km: ArrayLike,
    error_arcsec: float,
    *,
    mag_limit: float = np.inf,
    min_elongation_deg: float = 20.0,
    landmarks_only: bool = True,
    count: int = 20,
) -> QTable:
    """Rank pairs of stars by how well they fix a position.

    Parameters
    ----------
    stars
        Stars with parallaxes: see `nearest_stars`.
    et
        TDB seconds past J2000.
    position_km : (3,) array_like
        Spacecraft from the solar-system barycenter, J2000, roughly.
    error_arcsec
        Error of one measured direction, 1 sigma an axis.
    mag_limit
        Faintest magnitude, in the stars' own band, that the camera sees.
    min_elongation_deg
        Least angle from the Sun that the camera bears.
    landmarks_only
        Leave out stars with a companion or poor astrometry by the catalog's flags.
    count
        Rows, best first.

    Returns
    -------
    QTable
        ``star_1, star_2``; ``mag_1, mag_2``; ``distance_1, distance_2`` (pc); ``separation`` of the two on the sky and
        ``elongation_1, elongation_2`` from the Sun (deg); ``sigma`` of the position (au and km, root of the trace) and the
        semi-axes ``major, middle, minor`` of its ellipsoid (au).

    Raises
    ------
    EstimationError
        Fewer than two stars are left, or an error that is not positive.

    Examples
    --------
    >>> from opnav_workbench.geometry import et_from_jyear
    >>> position = np.array([13.55, -42.02, -16.46]) * AU_KM
    >>> table = best_pairs(nearest_stars(), float(et_from_jyear(2020.31)), position, 0.1, count=1)
    >>> print(*table["star_1", "star_2"][0], table["sigma"][0].round(2))
    Proxima Cen Barnard's Star 0.32 AU
    """
    if not error_arcsec > 0.0:
        raise EstimationError(
            f"an error of {error_arcsec:g} arcsec ranks nothing; give one larger than zero."
        )
    place = np.asarray(position_km, float)
    fit = _usable_stars(stars, place, et, mag_limit, min_elongation_deg, landmarks_only)
    if fit.sum() < 2:
        raise EstimationError(
            f"{int(fit.sum())} of {len(stars)} stars with a parallax are brighter than {mag_limit:g} and more than "
            f"{min_elongation_deg:g} deg from the Sun; two are needed: widen the limits."
        )
    chosen = stars.take(fit)
    return _pair_table(
        chosen, _ranked_pairs(chosen, et, place, error_arcsec / ARCSEC_PER_RAD, count), place, et
    )


def _usable_stars(
    stars: StarTable,
    place: FloatArray,
    et: float,
    mag_limit: float,
    min_elongation_deg: float,
    landmarks: bool,
) -> BoolArray:
    near = stars.parallax_rad > 0.0
    elongation = np.degrees(angle_between(stars.directions(et, place), -place))
    sound = (stars.flags & int(NOT_LANDMARKS)) == 0 if landmarks else np.ones(len(stars), dtype=bool)
    return np.asarray(near & (stars.mag <= mag_limit) & (elongation >= min_elongation_deg) & sound)


class _RankedPairs(NamedTuple):
    first: IntArray
    second: IntArray
    semi_axes_km: FloatArray  # (k, 3), largest first


def _ranked_pairs(
    stars: StarTable, et: float, place: FloatArray, error_rad: float, count: int
) -> _RankedPairs:
    """Order all pairs by the trace of the position's covariance; the nearer star of a pair comes first."""
    known = star_positions(stars, et, place)
    line = known.position_km - place
    distance = np.linalg.norm(line, axis=1)[:, None, None]
    across = np.stack(tangent_basis(*radec_from_unit(unit(line))), axis=1) / distance
    spread = error_rad**2 * np.eye(2) + across @ known.covariance_km2 @ np.swapaxes(across, 1, 2)
    information = np.swapaxes(across, 1, 2) @ np.linalg.solve(spread, across)
    near = np.argsort(distance[:, 0, 0], kind="stable")
    first, second = (near[i] for i in np.triu_indices(len(stars), 1))
    values = np.linalg.eigvalsh(information[first] + information[second])
    with np.errstate(divide="ignore"):
        axes = 1.0 / np.sqrt(np.maximum(values, 0.0))
    best = np.argsort(np.sum(axes**2, axis=1), kind="stable")[:count]
    return _RankedPairs(first[best], second[best], axes[best])


def _pair_table(stars: StarTable, ranked: _RankedPairs, place: FloatArray, et: float) -> QTable:
    direction = stars.directions(et, place)
    elongation = np.degrees(angle_between(direction, -place))
    table = QTable()
    pair = {"1": ranked.first, "2": ranked.second}
    for name, rows in pair.items():
        table[f"star_{name}"] = stars.id[rows]
    for name, rows in pair.items():
        table[f"mag_{name}"] = stars.mag[rows] * u.mag
        table[f"distance_{name}"] = 1.0 / (stars.parallax_rad[rows] * ARCSEC_PER_RAD) * u.pc
        table[f"elongation_{name}"] = elongation[rows] * u.deg
    table["separation"] = np.degrees(angle_between(direction[ranked.first], direction[ranked.second])) * u.deg
    sigma = np.sqrt(np.sum(ranked.semi_axes_km**2, axis=1))
    table["sigma"], table["sigma_km"] = sigma / AU_KM * u.au, sigma * u.km
    for axis, name in enumerate(("major", "middle", "minor")):
        table[name] = ranked.semi_axes_km[:, axis] / AU_KM * u.au
    for name in table.colnames[2:]:
        table[name].info.format = ".3e" if name == "sigma_km" else ".3f" if name in SEMI_AXES else ".2f"
    for name, words in PAIR_DESCRIPTIONS.items():
        table[name].info.description = words
    return table


SEMI_AXES = ("sigma", "major", "middle", "minor")
PAIR_DESCRIPTIONS = {
    "separation": "angle between the two stars",
    "elongation_1": "angle of star_1 from the Sun",
    "elongation_2": "angle of star_2 from the Sun",
    "sigma": "position error, root of the covariance's trace",
    "sigma_km": "the same in km",
    "major": "largest semi-axis of the one-sigma ellipsoid",
    "middle": "middle semi-axis",
    "minor": "smallest semi-axis",
}
