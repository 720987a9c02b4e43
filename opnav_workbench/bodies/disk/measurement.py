"""A disk in the picture, measured: what every method that reads a limb begins from.

Flow   place (`opnav_workbench.bodies.place`) -> usable pixels -> fit -> cosmic rays and stars out, fit again
"""

from dataclasses import dataclass, replace

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodies.disk.fit import DiskFit, DiskPixels, Unknown, fit_disk
from opnav_workbench.bodies.neighbours import without_others
from opnav_workbench.bodies.picture import BodyPicture, Circle
from opnav_workbench.bodies.place import BodyPlace, find_place
from opnav_workbench.bodies.results import BodyCenter
from opnav_workbench.bodies.subarray import find_hit_pixels
from opnav_workbench.errors import CenterfindingError

__all__ = ["MeasuredDisk", "measure_disk"]

LEAST_DIAMETER_PX = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredDisk:
    """A fitted disk, and what was looked for.

    Attributes
    ----------
    circle
        An analyst's, if there was one.
    search_px
        How far from the expected place to look; None: anywhere.
    hits : (n_line, n_pixel) array of bool
        Pixels whose light is not the body's.
    """

    picture: BodyPicture
    name: str
    circle: Circle | None
    search_px: float | None
    fit: DiskFit
    pixels: DiskPixels
    hits: BoolArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def radius_px(self) -> float:
        """Of the disk."""
        return 0.5 * self.fit.outline.diameter_px

    @property
    def expected_px(self) -> FloatArray:
        """Where the body was looked for (2,)."""
        return self.picture.center_px(self.name) if self.circle is None else self.circle.center_px


def measure_disk(
    picture: BodyPicture, name: str, method: str, circle: Circle | None, search_px: float | None
) -> MeasuredDisk | BodyCenter:
    """Find a body and fit its disk; a `BodyCenter` of the method without a center where that cannot be.

    Raises
    ------
    CenterfindingError
        No such body in the picture.
    """
    if (why := _unsuitable(picture, name)) is not None:
        return BodyCenter.without_center(name, method, "failed", why)
    try:
        place = find_place(picture, name, circle, search_px)
        if place is None:
            nothing = "nothing of its size and phase stands out of the sky"
            return BodyCenter.without_center(name, method, "not_detected", nothing)
        pixels = _usable(picture, name, place)
        fit = fit_disk(picture, name, place, pixels)
        hits = _hits(fit, pixels)
        if hits.any():
            pixels = replace(pixels, use=pixels.use & ~hits)
            fit = fit_disk(picture, name, place, pixels, fit)
    except CenterfindingError as error:
        return BodyCenter.without_center(name, method, "failed", str(error))
    return MeasuredDisk(picture, name, circle, search_px, fit, pixels, hits)


def _unsuitable(picture: BodyPicture, name: str) -> str | None:
    if picture.model(name).is_point:
        return "it has neither radii nor a shape; give them, or use method 'unresolved'"
    diameter = picture.diameter_px(name)
    if 0.0 < diameter < LEAST_DIAMETER_PX:
        return f"it is {diameter:.1f} px wide, too small for a limb (at least {LEAST_DIAMETER_PX:g} px); use 'least_squares'"
    return None


def _usable(picture: BodyPicture, name: str, place: BodyPlace) -> DiskPixels:
    """Return the picture's planes, without pixels that are bad, saturated, or lit by other bodies."""
    whole = (0, 0, picture.camera.n_pixel, picture.camera.n_line)
    cutout = without_others(picture, name, place.center_px, whole)
    return DiskPixels(cutout.data_dn, cutout.noise_dn, cutout.use, cutout.gain_e_per_dn)


def _hits(fit: DiskFit, pixels: DiskPixels) -> BoolArray:
    """Return the pixels (n_line, n_pixel) of the strip whose light is not the body's."""
    near = fit.pixels
    residual, weight = np.zeros(pixels.use.shape), np.zeros(pixels.use.shape)
    here = (near.line, near.pixel)
    model = fit.model_dn()
    residual[here] = pixels.data_dn[here] - model
    light = np.maximum(model - fit.solution.theta[Unknown.LEVEL], 0.0)
    variance = pixels.noise_dn[here] ** 2 + light / pixels.gain_e_per_dn + (fit.prior.grain * light) ** 2
    weight[here] = np.where(pixels.use[here], 1.0 / variance, 0.0)
    if not len(near.line):
        return np.zeros(pixels.use.shape, dtype=bool)
    part = np.s_[near.line.min() : near.line.max() + 1, near.pixel.min() : near.pixel.max() + 1]
    out = np.zeros(pixels.use.shape, dtype=bool)
    out[part] = find_hit_pixels(residual[part], weight[part])
    return out
