"""The part of a picture in which a body is looked for."""

from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.bodycenters.circle import Circle
from opnav_workbench.bodycenters.picture import BodyPicture

__all__ = ["SubArray", "choose_subarray", "search_radius"]

SEARCH_SHARE = 1.2  # of the radius: a body may lie beside its prediction by as much as it is wide
MIN_SEARCH_PX = 12.0  # room for attitude and ephemeris errors that nobody announced
CIRCLE_SEARCH_SHARE = 0.5  # an analyst's circle holds most of the body
MIN_CIRCLE_SEARCH_PX = 5.0
PSF_REACH = 4.0  # sigma of the PSF around the outline, and
RIM_PX = 4.0  # a rim that shows the background


@dataclass(frozen=True, slots=True, eq=False)
class SubArray:
    """A window of the detector about a body.

    Attributes
    ----------
    window : (int, int, int, int)
        First pixel, first line, pixels, lines; it lies on the detector, and has no pixels where the body does not.
    center_px : (2,) array
        Expected center.
    radius_px : float
        Expected radius: of an analyst's circle, else of the circle that holds the predicted outline.
    clipped : bool
        Whether the detector's edge cuts the expected body.
    """

    window: tuple[int, int, int, int]
    center_px: FloatArray
    radius_px: float
    clipped: bool = False

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def empty(self) -> bool:
        """Whether no pixel is left."""
        return min(self.window[2:]) < 1

    @property
    def slices(self) -> tuple[slice, slice]:
        """Slices that cut the window out of an array [line, pixel]."""
        pixel, line, n_pixel, n_line = self.window
        return slice(line, line + max(n_line, 0)), slice(pixel, pixel + max(n_pixel, 0))


def search_radius(radius_px: float, circle: Circle | None, given_px: float | None = None) -> float:
    """Return how far from its expected center a body of `radius_px` may be, px."""
    if given_px is not None:
        return max(float(given_px), 1.0)
    if circle is not None:
        return max(CIRCLE_SEARCH_SHARE * circle.radius_px, MIN_CIRCLE_SEARCH_PX)
    return max(SEARCH_SHARE * radius_px, MIN_SEARCH_PX)


def choose_subarray(
    picture: BodyPicture, name: str, circle: Circle | None = None, margin: float | None = None
) -> SubArray:
    """Choose the window about a body's expected place, clipped to the detector.

    Parameters
    ----------
    picture : BodyPicture
    name : str
    circle : Circle, optional
        An analyst's; None: predicted center and size.
    margin : float, optional
        Pixels around the expected outline; None: the PSF's reach and a rim of background.
    """
    prediction = picture.prediction(name)
    limb = prediction.limb_px - prediction.pixel_line
    radius = float(np.hypot(*limb.T).max()) if len(limb) and np.isfinite(limb).all() else 0.0
    center = prediction.pixel_line
    if circle is not None:
        center, radius = circle.center_px, circle.radius_px
    if not np.isfinite(center).all():
        return SubArray((0, 0, 0, 0), center, radius)
    if margin is None:
        margin = PSF_REACH * float(np.max(picture.psf.sigma_px)) + RIM_PX
    size = np.array([picture.camera.n_pixel, picture.camera.n_line])
    first = np.clip(np.floor(center - radius - margin), 0, size).astype(int)
    last = np.clip(np.ceil(center + radius + margin), -1, size - 1).astype(int)
    clipped = bool(np.any(center - radius < -0.5) or np.any(center + radius > size - 0.5))
    n_pixel, n_line = (int(n) for n in np.maximum(last - first + 1, 0))
    return SubArray((int(first[0]), int(first[1]), n_pixel, n_line), center, radius, clipped)
