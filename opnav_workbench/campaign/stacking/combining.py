"""The stack: repointed pictures brought onto one grid, hits masked, and averaged with their best weights.

Every stacked pixel is a linear combination of the pictures' pixels, and `Stacked.operators` says which: a model of the
target goes the same way, and so does the noise.  The target stands at the stack's mean epoch, interpolated between the
pictures.

Cosmic rays, and whatever else is in one picture only, are found by comparing each picture with the median of all.  The
median of the resampled pictures is laid back on each picture's own pixels; what exceeds it by more than noise and the
median's slope allow (undersampled stars differ from phase to phase) is masked before the final resampling.

Reference: AstroDrizzle's ``driz_cr``; Fruchter & Hook (2002), doi:10.1086/338393.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage, sparse

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.campaign.stacking.grid import Follow, Grid, resample, resampling_rows
from opnav_workbench.campaign.stacking.pictures import StackPicture, check_pictures, weights_of
from opnav_workbench.campaign.stacking.subtraction import SLOPE_PART, Subtraction, subtract_stars
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.geometry import apparent_direction
from opnav_workbench.targets import TargetState

__all__ = ["Stacked", "average", "stack_pictures"]


# ---- The target at a stack's epoch: its state interpolated between the pictures that were stacked.

MAX_DEGREE = 3  # of the polynomial in time: orbits bend slowly over a stack


def mean_state(pictures: Sequence[StackPicture], et: float) -> TargetState:
    """Return the target at `et`; its other properties are those of the nearest picture."""
    times = np.array([picture.et for picture in pictures])
    states = [picture.target for picture in pictures]
    known = [state for state in states if state is not None]
    nearest = known[int(np.argmin(np.abs(times - et)))]
    span = float(np.ptp(times))
    if span == 0.0:
        return nearest
    x = (times - et) / span
    degree = min(MAX_DEGREE, len(np.unique(times)) - 1)
    powers = np.vander(x, degree + 1, increasing=True)
    position = np.linalg.lstsq(powers, np.array([s.position_km for s in known]), rcond=None)[0][0]
    return replace(nearest, position_km=position)


# ---- Cosmic rays, and whatever else is in one picture only.

MIN_PICTURES = 3  # of two that differ nobody knows which one is right
HIT_SIGMAS = 5.0  # one pixel in two million by noise alone
SKIRT_SIGMAS = 3.0  # beside a hit: charge that went astray
EIGHT_NEIGHBOURS = np.ones((3, 3), dtype=bool)


def mask_hits(
    pictures: Sequence[StackPicture], grid: Grid, cube: FloatArray, response: FloatArray
) -> tuple[list[StackPicture], list[int]]:
    """Return the pictures with hits masked, and how many pixels of each.

    Parameters
    ----------
    cube : (n, n_line, n_pixel) array
        The pictures resampled on the grid, light divided by `response`; nan where unusable.
    response : (n,) array
    """
    if len(pictures) < MIN_PICTURES:
        return list(pictures), [0] * len(pictures)
    with np.errstate(invalid="ignore"):
        known = np.isfinite(cube).sum(axis=0) >= MIN_PICTURES
        median = np.where(known, _median(cube), np.nan)
    slope = _slope(median)
    masked, counts = [], []
    for picture, gain in zip(pictures, response, strict=True):
        hit = _hits_of_picture(picture, grid, median, slope, float(gain))
        counts.append(int((hit & ~picture.bad).sum()))
        masked.append(picture.replace(bad=picture.bad | hit))
    return masked, counts


def _median(cube: FloatArray) -> FloatArray:
    """Median of the usable values, 0 where there are none (no warning on the way)."""
    filled = np.sort(np.where(np.isfinite(cube), cube, np.inf), axis=0)
    count = np.isfinite(filled).sum(axis=0)
    low, high = np.maximum((count - 1) // 2, 0), np.minimum(count // 2, len(cube) - 1)
    pair = [np.take_along_axis(filled, index[None], axis=0)[0] for index in (low, high)]
    return np.where(count > 0, 0.5 * (pair[0] + pair[1]), 0.0)


def _slope(median: FloatArray) -> FloatArray:
    """Largest difference to a neighbour."""
    known = np.isfinite(median)
    filled = np.where(known, median, 0.0)
    high = ndimage.maximum_filter(
        np.where(known, median, -np.inf), footprint=EIGHT_NEIGHBOURS, mode="nearest"
    )
    low = ndimage.minimum_filter(np.where(known, median, np.inf), footprint=EIGHT_NEIGHBOURS, mode="nearest")
    steep = np.maximum(np.where(known, high, 0.0) - filled, filled - np.where(known, low, 0.0))
    return np.where(known, steep, np.nan)


def _hits_of_picture(
    picture: StackPicture, grid: Grid, median: FloatArray, slope: FloatArray, response: float
) -> BoolArray:
    cut = _covered_part(picture, grid)
    line, pixel = np.indices(picture.bad.shape)[(slice(None), *cut)]
    own = np.stack([pixel.ravel(), line.ravel()], axis=1).astype(np.float64)
    there = grid.index(grid.from_picture(own, picture))
    expected, steep = (_interpolated(values, there).reshape(line.shape) for values in (median, slope))
    off = np.abs(picture.signal_dn[cut] / response - expected) - SLOPE_PART * steep
    sigmas = np.nan_to_num(off * response / picture.noise_dn[cut], nan=0.0)
    core = sigmas > HIT_SIGMAS
    hit = np.zeros(picture.bad.shape, dtype=bool)
    hit[cut] = core | (ndimage.binary_dilation(core, EIGHT_NEIGHBOURS) & (sigmas > SKIRT_SIGMAS))
    return hit


def _covered_part(picture: StackPicture, grid: Grid) -> tuple[slice, slice]:
    """Lines and pixels of a picture that the grid lies on."""
    places = grid.to_picture(grid.centers(), picture)
    seen = places[np.asarray(np.isfinite(places).all(axis=1))]
    if not len(seen):
        return slice(0), slice(0)
    left, top = (max(round(float(edge)), 0) for edge in seen.min(axis=0))
    right, bottom = (max(round(float(edge)), -1) for edge in seen.max(axis=0))
    return slice(top, bottom + 1), slice(left, right + 1)


def _interpolated(values: FloatArray, places: FloatArray) -> FloatArray:
    """Values at places (n, 2) of a picture, bilinear; nan outside and beside unknown pixels."""
    known = np.asarray(np.isfinite(places).all(axis=1))
    coordinates = np.where(known[:, None], places, -1e6).T[::-1]
    return np.asarray(ndimage.map_coordinates(values, coordinates, order=1, mode="constant", cval=np.nan))


# ---- The stack: repointed pictures brought onto one grid, hits masked, and averaged with their best weights.

DEFAULT_WINDOW_PX = 64  # about the target: room for its search and for the stars that are to be matched


@dataclass(frozen=True, slots=True, eq=False)
class Stacked:
    """Many pictures as one; arrays are read-only and indexed [line, pixel] of the grid.

    Attributes
    ----------
    image_dn, noise_dn
        DN of the longest exposure, and 1 sigma of each pixel by itself; nan where no picture has a usable pixel.
        Neighbouring pixels are correlated, see `covariance_dn2`.
    count : array of int
        Pictures in each pixel.
    pictures
        With hits masked and, in a subtracted stack, the star field taken away.
    before_subtraction
        The same before subtraction.
    weights, response : (n,) array
        Of the pictures: weights sum to 1; light against the longest exposure's.
    et
        Weighted mean epoch, TDB seconds past J2000.
    target
        The target at that epoch, interpolated between the pictures.
    hits
        Pixels masked in each picture.
    """

    image_dn: FloatArray
    noise_dn: FloatArray
    count: IntArray
    grid: Grid
    pictures: tuple[StackPicture, ...]
    before_subtraction: tuple[StackPicture, ...]
    weights: FloatArray
    response: FloatArray
    et: float
    target: TargetState | None
    subtractions: tuple[Subtraction, ...] | None
    hits: tuple[int, ...]
    messages: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def predicted_px(self) -> FloatArray:
        """Where the target is expected, (pixel, line) of the reference camera; nan without a target."""
        if self.target is None:
            return np.full(2, np.nan)
        apparent = apparent_direction(self.target.direction, self.grid.observer_velocity_km_s)
        return np.asarray(self.grid.camera.project((self.grid.camera_from_j2000 @ apparent)[None])[0])

    def neighbours_px(self) -> FloatArray:
        """Return where other bodies lie in the grid's reference camera (k, 2), each in every picture."""
        places = [
            self.grid.from_picture(
                picture.camera.project(picture.neighbours @ picture.camera_from_j2000.T), picture
            )
            for picture in self.pictures
        ]
        return np.concatenate(places)

    def operators(self, pixel_line: FloatArray) -> list[sparse.csr_array]:
        """Return for each picture the matrix (m, n_line * n_pixel) that makes of it its part of grid pixels (m, 2).

        The stack at these pixels is the sum of all products with the pictures' signals.
        """
        rows = [resampling_rows(self.grid, pixel_line, picture) for picture in self.pictures]
        share = self.weights[:, None] * np.array([row.usable for row in rows])
        total = share.sum(axis=0)
        share = share / np.where(total > 0.0, total, 1.0)
        direct = [
            sparse.csr_array(sparse.diags_array(part / gain) @ row.matrix)
            for part, gain, row in zip(share, self.response, rows, strict=True)
        ]
        if self.subtractions is None:
            return direct
        return self._with_templates(direct)

    def _with_templates(self, direct: list[sparse.csr_array]) -> list[sparse.csr_array]:
        """What a picture gives by way of the others' star-field templates goes off."""
        assert self.subtractions is not None
        total = list(direct)
        for rows, subtraction in zip(direct, self.subtractions, strict=True):
            for j, part in subtraction.parts(rows, self.before_subtraction):
                total[j] = sparse.csr_array(total[j] - part)
        return total

    def covariance_dn2(self, pixel_line: FloatArray) -> FloatArray:
        """Return the covariance (m, m) of grid pixels (m, 2): exact, for pictures whose own pixels are independent."""
        covariance = np.zeros((len(pixel_line),) * 2)
        for operator, picture in zip(self.operators(pixel_line), self.before_subtraction, strict=True):
            weighted = operator @ sparse.diags_array(picture.variance_dn2.ravel())
            covariance += (weighted @ operator.T).toarray()
        return covariance

    def noise_correlation(self) -> float:
        """Return the mean correlation of neighbouring pixels in the middle of the grid, along pixel and along line."""
        n_line, n_pixel = self.grid.shape
        middle = np.array([n_pixel // 2, n_line // 2]) + self.grid.first
        points = middle + np.array([[0, 0], [1, 0], [0, 1]])
        covariance = self.covariance_dn2(points)
        sigma = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
        return float(np.mean((covariance / np.outer(sigma, sigma))[0, 1:]))


def stack_pictures(
    pictures: Sequence[StackPicture],
    follow: Follow = "target",
    *,
    window_px: int | None = None,
    reject_hits: bool = True,
    subtract: bool = False,
) -> Stacked:
    """Stack solved pictures on the stars, or on the target's motion.

    Parameters
    ----------
    pictures
        Of one camera, two at least; three for hits to be found.
    follow : {"stars", "target"}
    window_px
        Side of the part about the target that is stacked; default 64 for a target, the whole field for stars.
    reject_hits
        Mask what is in one picture only.
    subtract
        Take the star field away before, as the other pictures show it where the target has moved on.

    Raises
    ------
    CenterfindingError
        Pictures that no stack can be made of, or a target that has not moved enough for the stars to be told from it.
    """
    check_pictures(pictures, follow=follow)
    if subtract and follow != "target":
        raise CenterfindingError("only a stack that follows the target can have its star field subtracted.")
    response, weights = weights_of(pictures)
    et = float(weights @ [picture.et for picture in pictures])
    state = mean_state(pictures, et) if all(picture.target is not None for picture in pictures) else None
    grid = _grid(pictures, follow, state, et, window_px)
    before, chosen, subtractions, messages = list(pictures), list(pictures), None, []
    if subtract:
        before, chosen, subtractions = subtract_stars(pictures, grid, weights, response)
    hits = [int((a.bad & ~b.bad).sum()) for a, b in zip(chosen, pictures, strict=True)]
    if reject_hits and len(pictures) >= MIN_PICTURES:
        cube = np.stack([resample(grid, f, float(g))[0] for f, g in zip(chosen, response, strict=True)])
        chosen, more = mask_hits(chosen, grid, cube, response)
        hits = [a + b for a, b in zip(hits, more, strict=True)]
    elif reject_hits:
        messages.append(f"{len(pictures)} pictures: hits cannot be told from stars, none is masked")
    image, noise, count = average(chosen, grid, weights, response)
    return Stacked(
        image_dn=image,
        noise_dn=noise,
        count=count,
        grid=grid,
        pictures=tuple(chosen),
        before_subtraction=tuple(before),
        weights=weights,
        response=response,
        et=et,
        target=state,
        subtractions=None if subtractions is None else tuple(subtractions),
        hits=tuple(hits),
        messages=tuple(messages),
    )


def _grid(
    pictures: Sequence[StackPicture],
    follow: Follow,
    state: TargetState | None,
    et: float,
    window_px: int | None,
) -> Grid:
    """Pixels of the picture nearest to the mean epoch, all of them or those about the target."""
    middle = min(pictures, key=lambda picture: (abs(picture.et - et), picture.name))
    times = np.array([picture.et for picture in pictures])
    velocity = np.array([picture.observer_velocity_km_s for picture in pictures])
    spread = float(np.ptp(times))
    # Between the pictures the velocity changes evenly, by far less than matters.
    mean = (
        velocity[0]
        if spread == 0.0
        else np.array([np.interp(et, np.sort(times), v[np.argsort(times)]) for v in velocity.T])
    )
    camera = middle.camera
    first, shape = np.zeros(2), (camera.n_line, camera.n_pixel)
    apparent = None if state is None else apparent_direction(state.direction, mean)
    side = window_px or (DEFAULT_WINDOW_PX if follow == "target" else 0)
    if side:
        if apparent is None:
            raise CenterfindingError(
                "a window needs a target to lie about; name one, or stack the whole field."
            )
        place = camera.project((middle.camera_from_j2000 @ apparent)[None])[0]
        if not camera.on_detector(place):
            raise CenterfindingError(
                f"{middle.name}: the target is not on its detector; leave that picture out."
            )
        first, shape = np.round(place) - side // 2, (side, side)
    return Grid(camera, middle.camera_from_j2000, mean, follow, apparent, first, shape)


def average(
    pictures: Sequence[StackPicture], grid: Grid, weights: FloatArray, response: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return weighted mean, its 1-sigma noise, and the number of pictures in each pixel of the grid."""
    total, light, noise = (np.zeros(grid.shape) for _ in range(3))
    count = np.zeros(grid.shape, dtype=np.int64)
    for picture, weight, gain in zip(pictures, weights, response, strict=True):
        image, variance = resample(grid, picture, float(gain))
        usable = np.isfinite(image)
        total += np.where(usable, weight, 0.0)
        light += np.where(usable, weight * image, 0.0)
        noise += np.where(usable, weight**2 * variance, 0.0)
        count += usable
    safe = np.where(count > 0, total, np.nan)
    return light / safe, np.sqrt(noise) / safe, count
