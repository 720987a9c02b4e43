"""Other bodies near one in the picture: where they likely stand, and which pixels they light."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.ndimage import binary_dilation

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.bodies.picture import BodyPicture, model_picture
from opnav_workbench.bodies.subarray import Cutout, cut_out, edge_reach

__all__ = ["likely_place", "near_bodies", "without_bodies", "without_others"]

OTHERS_SHARE = 1.0  # light of other bodies, in units of the noise, from which on a pixel does not count
OTHERS_ERROR_PX = 3  # of their places


def likely_place(picture: BodyPicture, name: str, shift_px: FloatArray) -> FloatArray:
    """Return where a body likely stands (2,), if others are `shift_px` beside where they were expected."""
    return picture.center_px(name) + (0.0 if name in picture.found else shift_px)


def near_bodies(picture: BodyPicture, name: str, center_px: FloatArray) -> dict[str, FloatArray]:
    """Return the likely places (2,) of bodies close to one that stands at a place: their prediction has the same error."""
    shift = center_px - picture.center_px(name)
    reach = 0.5 * picture.diameter_px(name) + 2.0 * edge_reach(picture)
    places = {}
    for other in picture.models:
        key = other.target.name
        if key != name:
            place = likely_place(picture, key, shift)
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
    return replace(cutout, use=cutout.use & ~_lit_by(picture, others, cutout))


def without_bodies(picture: BodyPicture, places_px: Mapping[str, FloatArray]) -> BodyPicture:
    """Return the picture without the pixels that bodies at their places (2,) light, saturated or not."""
    if not places_px:
        return picture
    whole = (0, 0, picture.camera.n_pixel, picture.camera.n_line)
    return picture.without(_lit_by(picture, places_px, cut_out(picture, whole)))


def _lit_by(picture: BodyPicture, places_px: Mapping[str, FloatArray], cutout: Cutout) -> BoolArray:
    light = model_picture(picture, cutout.window, places_px, only=tuple(places_px))
    if picture.sunlight_e is None:  # without a calibration they are as bright as anything here
        light = light * (float(np.nanmax(cutout.data_dn)) / max(float(light.max()), np.finfo(float).tiny))
    lit = binary_dilation(light > OTHERS_SHARE * cutout.noise_dn, iterations=OTHERS_ERROR_PX)
    return np.asarray(lit)
