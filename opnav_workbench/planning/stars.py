"""Stars of a planned picture: which of them a navigator can use, and how well their centers will be known.

Flow   expected light -> background and noise at each star -> Cramer-Rao bound of its center and flux -> status
Units  DN, px, mag

The bound is that of `opnav_workbench.stars.cramer_rao`, which the star centerfinders reach: the PSF known,
free are flux, center and background level. How deep the catalog goes around a field is told too: pictures show
fainter stars than a shallow one has.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.catalog import Catalog
from opnav_workbench.geometry import radec_from_unit
from opnav_workbench.planning.light import ExpectedLight, star_psf
from opnav_workbench.psf import Psf
from opnav_workbench.scene import StarPrediction
from opnav_workbench.stars import NoiseModel, cramer_rao, default_box_px, flux_at_snr

__all__ = ["StarPlan", "catalog_depth_mag", "limiting_magnitude", "plan_stars", "star_bounds"]


# ---- Stars of a planned picture: which of them a navigator can use, and how well their centers will be known.

STAR_STATUSES = ("usable", "faint", "saturated", "blended", "in_body_light", "hidden", "near_edge")
NOISE_STEP = 0.05  # stars whose noise is the same to so much (relative) share one computation
CORE_PX = 3  # a star is saturated where a pixel of its core is
BLEND_SIGMAS = 1.5  # nearer stars than this, in sigmas of the PSF, are not told apart
BLEND_MAG = 4.0  # ... unless the neighbour is so much fainter
EDGE_SIGMAS = 3.0  # of the PSF, that a star keeps from the edge
# Light of a body that is brighter than so many sigmas of the sky's noise hides where the star's own begins.
BODY_LIGHT_SIGMAS = 5.0
MAX_STARS = 300  # as many as processing uses


@dataclass(frozen=True, slots=True, eq=False)
class StarPlan:
    """Stars on the detector, brightest first.

    Attributes
    ----------
    id : (n,) array of str
    mag : (n,) array
        In the camera's band.
    pixel_line : (n, 2) array
    directions : (n, 3) array
        Apparent, J2000.
    flux_dn, snr : (n,) arrays
        Expected flux, and over its sigma.
    covariance_px2, catalog_covariance_px2 : (n, 2, 2) arrays
        Of the center from the picture's noise, and of the predicted place.
    status : (n,) array of str
        One of `STAR_STATUSES`.
    """

    id: NDArray[np.str_]
    mag: FloatArray
    pixel_line: FloatArray
    directions: FloatArray
    flux_dn: FloatArray
    snr: FloatArray
    covariance_px2: FloatArray
    catalog_covariance_px2: FloatArray
    status: NDArray[np.str_]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.mag)

    @property
    def usable(self) -> BoolArray:
        """Which stars (n,) the pointing can come from."""
        return np.asarray(self.status == "usable")

    def count(self, status: str) -> int:
        """Return how many stars have a status."""
        return int(np.sum(self.status == status))


def plan_stars(light: ExpectedLight, min_snr: float) -> StarPlan:
    """Return the stars of a picture with their bounds and statuses.

    Parameters
    ----------
    min_snr
        Below this a star is too faint to be used.
    """
    rows, stars = _on_detector(light)
    flux_e = light.picture.star_flux_e[rows]
    psf = star_psf(light.inputs)
    places = stars.pixel_line
    noise = np.sqrt(light.variance_dn2(_values_at(light.without_stars_e, places)))
    flux = flux_e / light.values.gain_e_per_dn
    covariance, snr = star_bounds(places, flux, noise, psf, light.noise_model)
    return StarPlan(
        id=np.asarray(stars.id),
        mag=stars.mag,
        pixel_line=places,
        directions=stars.directions,
        flux_dn=flux,
        snr=snr,
        covariance_px2=covariance,
        catalog_covariance_px2=stars.covariance_px2,
        status=_statuses(light, rows, stars, psf, snr, min_snr),
    )


def _on_detector(light: ExpectedLight) -> tuple[IntArray, StarPrediction]:
    """Return rows and predictions of the stars on the detector that shine, brightest first."""
    stars = light.picture.stars
    rows = np.flatnonzero(stars.on_detector & (light.picture.star_flux_e > 0.0))
    rows = rows[np.argsort(stars.mag[rows], kind="stable")]
    return rows, stars.take(rows)


def star_bounds(
    places_px: FloatArray, flux_dn: FloatArray, noise_dn: FloatArray, psf: Psf, model: NoiseModel
) -> tuple[FloatArray, FloatArray]:
    """Return covariances (n, 2, 2), px^2, of star centers and signal-to-noise ratios (n,).

    Parameters
    ----------
    places_px : (n, 2) array
    flux_dn, noise_dn : (n,) arrays
        Flux of each star, and noise of a pixel there without it.
    """
    covariance, snr = np.zeros((len(places_px), 2, 2)), np.zeros(len(places_px))
    box = default_box_px(float(psf.sigma_px.max()))
    step = np.rint(np.log(noise_dn) / NOISE_STEP)
    for level in np.unique(step):
        group = step == level
        local = psf.at(places_px[group].mean(axis=0))
        noise = float(np.median(noise_dn[group]))
        bound = cramer_rao(places_px[group], flux_dn[group], local, noise, box_px=box, noise_model=model)
        covariance[group], snr[group] = bound.center_covariance_px2, bound.snr
    return covariance, snr


def limiting_magnitude(light: ExpectedLight, min_snr: float) -> float:
    """Return the magnitude, in the camera's band, of a star of this signal-to-noise ratio on the bare sky."""
    camera, exposure_s = light.inputs.camera, light.inputs.exposure_s
    psf = star_psf(light.inputs).at(camera.center_pixel_line)
    noise = float(np.sqrt(np.median(light.variance_dn2(light.without_stars_e))))
    box = default_box_px(float(psf.sigma_px.max()))
    flux = flux_at_snr(min_snr, psf, noise, box_px=box, noise_model=light.noise_model)
    return camera.require("zero_point_mag") - 2.5 * float(np.log10(flux / exposure_s))


def _statuses(
    light: ExpectedLight,
    rows: IntArray,
    stars: StarPrediction,
    psf: Psf,
    snr: FloatArray,
    min_snr: float,
) -> NDArray[np.str_]:
    """Return each star's status: the first reason that holds."""
    camera, places, sigma = light.inputs.camera, stars.pixel_line, float(psf.sigma_px.max())
    body_e = maximum_filter(light.picture.rendering.electrons, CORE_PX)
    sky = np.sqrt(np.median(light.variance_dn2(light.without_stars_e))) * light.values.gain_e_per_dn
    near_edge = ~camera.on_detector(places, -EDGE_SIGMAS * sigma)
    faint = (snr < min_snr) | (np.arange(len(places)) >= MAX_STARS)
    reasons = (
        ("hidden", light.picture.star_occulted[rows]),
        ("in_body_light", _values_at(body_e, places) > BODY_LIGHT_SIGMAS * sky),
        ("saturated", _values_at(maximum_filter(light.saturated, CORE_PX), places)),
        ("near_edge", near_edge),
        ("faint", faint),
        ("blended", _blended(places, stars.mag, BLEND_SIGMAS * sigma)),
    )
    names, holds = zip(*reasons, strict=True)
    return np.select([np.asarray(h, dtype=bool) for h in holds], list(names), "usable")


def _blended(places: FloatArray, mag: FloatArray, radius_px: float) -> BoolArray:
    distance = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    near = (distance < radius_px) & ~np.eye(len(mag), dtype=bool)
    return np.asarray((near & (mag[None, :] < mag[:, None] + BLEND_MAG)).any(axis=1))


def _values_at(plane: NDArray[Any], places: FloatArray) -> NDArray[Any]:
    """Return the values of a plane [line, pixel] in the pixels that hold points (n, 2)."""
    pixel, line = np.rint(places).astype(np.int64).reshape(-1, 2).T
    n_line, n_pixel = plane.shape
    return plane[np.clip(line, 0, n_line - 1), np.clip(pixel, 0, n_pixel - 1)]


# ---- How deep a catalog goes around a field: pictures show fainter stars than a shallow one has.

DEPTH_CONE_DEG = 3.0  # some hundred stars of a catalog to magnitude 10
# Star counts grow by a factor of 2 to 3 a magnitude, up to where a catalog ends: 95 % of its stars are brighter than
# 0.1 mag before that.
DEPTH_PERCENTILE = 95.0
DEPTH_MIN_STARS = 20


def catalog_depth_mag(catalog: Catalog, direction: FloatArray, mag_limit: float = math.inf) -> float:
    """Return the magnitude, in the catalog's own band, to which it goes around a direction (3,), J2000.

    nan where it has too few stars to tell.
    """
    ra, dec = (float(a) for a in radec_from_unit(direction))
    stars = catalog.cone(ra, dec, math.radians(DEPTH_CONE_DEG), mag_limit=mag_limit)
    known = stars.mag[np.isfinite(stars.mag)]
    return float(np.percentile(known, DEPTH_PERCENTILE)) if len(known) >= DEPTH_MIN_STARS else float("nan")
