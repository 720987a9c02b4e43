"""Other bodies near one in the picture: where they likely stand, and which pixels they light."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import binary_dilation

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.picture import BodyPicture, model_picture
from opnav_workbench.bodies.subarray import PSF_REACH, RIM_PX, Cutout, cut_out

__all__ = ["edge_reach", "near_bodies", "without_others"]

OTHERS_SHARE = 1.0  # light of other bodies, in units of the noise, from which on a pixel does not count
OTHERS_ERROR_PX = 3  # of their places


def edge_reach(picture: BodyPicture) -> float:
    """Return how far to each side of an edge the picture shows it, px."""
    return PSF_REACH * float(np.max(picture.psf.sigma_px)) + RIM_PX


def near_bodies(picture: BodyPicture, name: str, center_px: FloatArray) -> dict[str, FloatArray]:
    """Return the likely places (2,) of bodies close to one that stands at a place: their prediction has the same error."""
    shift = center_px - picture.center_px(name)
    reach = 0.5 * picture.diameter_px(name) + 2.0 * edge_reach(picture)
    places = {}
    for other in picture.models:
        key = other.target.name
        if key != name:
            place = picture.center_px(key) + shift
            if np.hypot(*(place - center_px)) < reach + 0.5 * picture.diameter_px(key):
                places[key] = place
    return places


def without_others(
    picture: BodyPicture, name: str, center_px: FloatArray, window: tuple[int, int, int, int]
) -> Cutout:
    """Return the data of a window, with pixels left out that other bodies light."""
    cutout = cut_out(picture, window)
    others = near_bodies(picture, name, center_px)
    if not others:
        return cutout
    light = model_picture(picture, window, others, only=tuple(others))
    if picture.sunlight_e is None:  # without a calibration the others are as bright as anything here
        light = light * (float(np.nanmax(cutout.data_dn)) / max(float(light.max()), np.finfo(float).tiny))
    lit = binary_dilation(light > OTHERS_SHARE * cutout.noise_dn, iterations=OTHERS_ERROR_PX)
    return replace(cutout, use=cutout.use & ~lit)
