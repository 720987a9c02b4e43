"""Templates of a star image for the matched filter and the cross-correlation."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.psf import box_integrals
from opnav_workbench.starcenters.boxes import check_image, check_points, cut_boxes

__all__ = ["Template", "extract_template", "gaussian_template"]

MIN_SIGMA_PX = 0.15  # noise can make a second moment of an undersampled star negative
MAX_UNUSABLE_FRACTION = 0.1  # a template with more masked pixels than this is no image of a star


@dataclass(frozen=True, slots=True, eq=False)
class Template:
    """A star image of unit flux, and where in it the star's center lies."""

    values: FloatArray  # (size, size) [line, pixel]
    center: FloatArray  # (2,) pixel, line in the template's own coordinates
    ellipse: FloatArray  # (3,) sigma_major_px, sigma_minor_px, angle_rad before integration over pixels

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def size(self) -> int:
        """Pixels along a side."""
        return int(self.values.shape[0])


def gaussian_template(sigma_px: float, size: int) -> Template:
    """Return a pixel-integrated round Gaussian centered in `size` x `size` pixels.

    Raises
    ------
    CenterfindingError
        A sigma or size that is not positive.

    Examples
    --------
    >>> template = gaussian_template(0.8, 9)
    >>> template.center.tolist(), round(float(template.values.sum()), 4)
    ([4.0, 4.0], 1.0)
    """
    if not 0.0 < sigma_px < np.inf or size < 1:
        raise CenterfindingError(f"a template needs a positive sigma and size, got {sigma_px} px and {size}.")
    center = np.full((1, 2), (size - 1) / 2.0)
    shape = np.array([[np.log(sigma_px), 0.0, 0.0]])
    return Template(
        box_integrals(center, shape, np.zeros((1, 2)), size).value[0],
        center[0],
        np.array([sigma_px, sigma_px, 0.0]),
    )


def extract_template(
    image_dn: ArrayLike, bad: ArrayLike | None, pixel_line: ArrayLike, radius_px: float
) -> Template:
    """Cut a well-exposed star out of a real image: a circle about its center, background removed, unit flux.

    Parameters
    ----------
    image_dn : (n_line, n_pixel) array_like
        Image; the median of the rim of the circle is taken as its background.
    bad : (n_line, n_pixel) array_like of bool, optional
        Pixels to leave out (also saturated ones); they count as empty.
    pixel_line : (2,) array_like
        Center of the star, sub-pixel: what is found with the template refers to it.
    radius_px : float
        Radius of the circle: large enough for the wings, too small for another star.

    Raises
    ------
    CenterfindingError
        The circle leaves the detector, is masked, or holds no star.
    """
    pixels = check_image(image_dn, 1.0, bad)
    center = check_points(pixel_line, "pixel_line")
    if len(center) != 1 or not 1.0 <= radius_px < np.inf:
        raise CenterfindingError(
            f"a template needs one star and a radius of at least 1 px, got {radius_px} px."
        )
    boxes = cut_boxes(pixels, center, 2 * int(np.ceil(radius_px)) + 3)
    dx, dy = boxes.offsets(center)
    distance = np.hypot(dx[0][None, :], dy[0][:, None])
    usable, circle = np.isfinite(boxes.variance_dn2[0]), distance <= radius_px
    rim = usable & (distance > radius_px - 1.0) & (distance <= radius_px + 1.0)
    if np.mean(~usable[circle]) > MAX_UNUSABLE_FRACTION or not rim.any():
        raise CenterfindingError(
            f"{np.mean(~usable[circle]):.0%} of the circle of {radius_px} px about "
            f"{center[0].round(2).tolist()} is masked or off the detector; choose another star."
        )
    values = np.where(circle & usable, boxes.data_dn[0] - np.median(boxes.data_dn[0][rim]), 0.0)
    if not values.sum() > 0.0:
        raise CenterfindingError(f"no star at {center[0].round(2).tolist()}: its flux is not positive.")
    values /= values.sum()
    middle = center[0] - boxes.first[0]
    return Template(values, middle, _ellipse(values, middle))


def _ellipse(values: FloatArray, center: FloatArray) -> FloatArray:
    """Second moments of a star image, pixel integration taken out, as an ellipse; (3,)."""
    line, pixel = np.indices(values.shape) - center[::-1, None, None]
    weight = np.maximum(values, 0.0) / np.maximum(values, 0.0).sum()
    uu, uv, vv = (float(np.sum(weight * product)) for product in (pixel * pixel, pixel * line, line * line))
    value, vector = np.linalg.eigh(np.array([[uu, uv], [uv, vv]]) - np.eye(2) / 12.0)
    sigma = np.sqrt(np.maximum(value, MIN_SIGMA_PX**2))
    return np.array([sigma[1], sigma[0], np.arctan2(vector[1, 1], vector[0, 1])])
