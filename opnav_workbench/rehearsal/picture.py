"""A simple renderer: point stars and small Lambert bodies through a Gaussian PSF, then the detector's noise.

Flow   true places and magnitudes -> electrons per pixel -> shot noise, read noise, quantisation -> DN
Units  electrons, DN, px

A body is a set of points spread over the visible disk of its triaxial ellipsoid, each as bright as Lambert's law makes
it; the sum has the body's magnitude. That is exact enough up to a few pixels of diameter.
"""

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import TargetState
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import apparent_direction
from opnav_workbench.scene import Observer, StarPrediction
from opnav_workbench.starcenters.psf import box_integrals

__all__ = ["body_points", "electrons_from_magnitude", "render_picture"]

BOX_SIGMAS = 6.0  # the flux outside is below 1e-8
DISK_RINGS = 24  # of 48 cells each: center of light good to 1.5e-3 radii, below 30 deg of phase to 3e-4


def electrons_from_magnitude(camera: Camera, mag: FloatArray, exposure_s: float) -> FloatArray:
    """Electrons that sources of magnitude `mag` leave in an exposure.

    Raises
    ------
    CameraError
        The camera has no zero point or gain.
    """
    rate_dn = 10.0 ** (0.4 * (camera.require("zero_point_mag") - np.asarray(mag, dtype=np.float64)))
    return rate_dn * exposure_s * camera.require("gain_e_per_dn")


def body_points(
    target: TargetState, observer: Observer, camera: Camera, camera_from_j2000: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the places (n, 2) px of a body's lit surface cells and their share (n,) of its light."""
    range_km = np.linalg.norm(target.position_km)
    toward = np.asarray(target.position_km) / range_km
    if target.radii_km is None or target.body_from_j2000 is None or target.sun_position_km is None:
        return _project(toward[None], observer, camera, camera_from_j2000), np.ones(1)
    radii, rotation = np.asarray(target.radii_km), np.asarray(target.body_from_j2000)
    sun = np.asarray(target.sun_position_km) / np.linalg.norm(target.sun_position_km)
    # On the unit sphere of the scaled body the visible half is a disk seen along the scaled line of sight.
    view = rotation @ -toward / radii
    view /= np.linalg.norm(view)
    unit, area = _visible_half(view)
    normal = unit / radii
    cos_emission = normal @ (rotation @ -toward) / np.linalg.norm(normal, axis=1)
    cos_incidence = normal @ (rotation @ sun) / np.linalg.norm(normal, axis=1)
    stretch = np.linalg.norm(normal, axis=1)  # area of the ellipsoid per area of the sphere, up to a constant
    light = area * stretch * np.clip(cos_incidence, 0.0, None) * np.clip(cos_emission, 0.0, None)
    surface = (unit * radii) @ rotation + np.asarray(target.position_km)
    directions = surface / np.linalg.norm(surface, axis=1, keepdims=True)
    lit = light > 0.0
    places = _project(directions[lit], observer, camera, camera_from_j2000)
    return places, light[lit] / light.sum()


def _visible_half(view: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors over the half sphere toward `view`, and the area each stands for."""
    cosine = (np.arange(DISK_RINGS) + 0.5) / DISK_RINGS
    angle = 2.0 * np.pi * (np.arange(2 * DISK_RINGS) + 0.5) / (2 * DISK_RINGS)
    c, a = (g.ravel() for g in np.meshgrid(cosine, angle, indexing="ij"))
    helper = np.eye(3)[np.argmin(np.abs(view))]
    x = np.cross(view, helper)
    x /= np.linalg.norm(x)
    y = np.cross(view, x)
    s = np.sqrt(1.0 - c * c)
    unit = c[:, None] * view + (s * np.cos(a))[:, None] * x + (s * np.sin(a))[:, None] * y
    return unit, np.full(len(c), 1.0 / len(c))


def _project(
    geometric: FloatArray, observer: Observer, camera: Camera, camera_from_j2000: FloatArray
) -> FloatArray:
    apparent = apparent_direction(geometric, observer.velocity_km_s)
    return camera.project(apparent @ camera_from_j2000.T)


def render_picture(
    camera: Camera,
    stars: StarPrediction,
    bodies: list[tuple[FloatArray, FloatArray, float]],
    exposure_s: float,
    sigma_px: float,
    sky_dn: float,
    seed: int,
) -> FloatArray:
    """Render a picture.

    Parameters
    ----------
    camera : Camera
    stars : StarPrediction
        True places and magnitudes.
    bodies : list of (places (n, 2), shares (n,), magnitude)
        See `body_points`.
    exposure_s : float
    sigma_px : float
        Round Gaussian PSF.
    sky_dn : float
        Background level.
    seed : int
        The same seed gives the same picture, bit for bit.

    Returns
    -------
    (n_line, n_pixel) array
        Calibrated DN, in whole numbers, clipped at saturation.
    """
    electrons = np.zeros((camera.n_line, camera.n_pixel))
    _add_points(
        electrons, stars.pixel_line, electrons_from_magnitude(camera, stars.mag, exposure_s), sigma_px
    )
    for places, shares, mag in bodies:
        total = float(electrons_from_magnitude(camera, np.array(mag), exposure_s))
        _add_points(electrons, places, shares * total, sigma_px)
    return _detect(camera, electrons, sky_dn, seed)


def _add_points(electrons: FloatArray, places: FloatArray, flux_e: FloatArray, sigma_px: float) -> None:
    seen = np.isfinite(places).all(axis=1)  # nan: behind the camera
    places, flux_e = places[seen], flux_e[seen]
    size = 2 * int(np.ceil(BOX_SIGMAS * sigma_px)) + 3
    first = np.rint(places) - size // 2
    shape = np.tile([np.log(sigma_px), 0.0, 0.0], (len(places), 1))
    light = box_integrals(places, shape, first, size).value * flux_e[:, None, None]
    step = np.arange(size)
    line = (first[:, 1, None, None] + step[:, None]).astype(int)
    pixel = (first[:, 0, None, None] + step).astype(int)
    line, pixel = np.broadcast_arrays(line, pixel)
    inside = (line >= 0) & (line < electrons.shape[0]) & (pixel >= 0) & (pixel < electrons.shape[1])
    np.add.at(electrons, (line[inside], pixel[inside]), light[inside])


def _detect(camera: Camera, electrons: FloatArray, sky_dn: float, seed: int) -> FloatArray:
    """Shot noise, read noise (each with its own seed), gain, quantisation and clipping."""
    gain, read_noise = camera.require("gain_e_per_dn"), camera.require("read_noise_dn")
    shot, read = (np.random.default_rng([seed, effect]) for effect in (1, 2))
    collected = shot.poisson(electrons + sky_dn * gain) / gain
    picture = np.rint(collected + read.normal(0.0, read_noise, collected.shape))
    return picture if camera.saturation_dn is None else np.minimum(picture, camera.saturation_dn)
