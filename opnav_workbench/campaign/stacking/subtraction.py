"""Star-field subtraction: what the other pictures show where the target is not, taken away from each picture.

The others are resampled onto the picture's own pixels, star on star, with the target's place left out of each; their
weighted mean is the template. A small kernel, fitted to the picture's stars, matches its PSF (wider by the resampling, or by
another smear) to the picture's; what the match still leaves at bright stars goes into the noise.

Reference: Alard & Lupton (1998), doi:10.1086/305984; Bramich (2008), doi:10.1111/j.1745-3933.2008.00464.x (a kernel of
free pixels).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, sparse

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.campaign.stacking.grid import Grid, resampling_rows, target_direction
from opnav_workbench.campaign.stacking.pictures import StackPicture
from opnav_workbench.errors import CenterfindingError

__all__ = ["SLOPE_PART", "Subtraction", "subtract_stars"]

MIN_SOURCES = (
    2  # pictures in each pixel of a template: one alone is as noisy as the picture, and shows its hits
)
MARGIN_PX = 6  # of the template about the stack's window: the kernel and the resampling reach there
PROTECT_SIGMAS, PROTECT_PX = 4.0, 3.0  # the target's light, and where ephemeris may miss it
KERNEL_HALF = 1  # 3 x 3: as far as resampling and differences of smear spread light
KERNEL_FOOTPRINT = np.ones((2 * KERNEL_HALF + 1,) * 2, dtype=bool)
KERNEL_PRIOR = (
    0.3  # of each element, against a kernel that does nothing: where no star tells, none is made up
)
CLIP_SIGMAS = 5.0
SLOPE_PART = 1.2  # of the steepest slope, driz_cr's own value: undersampled stars differ from phase to phase
STAR_SIGMAS = 5.0  # pixels of a template that show how well the PSFs match


@dataclass(frozen=True, slots=True, eq=False)
class Subtraction:
    """How one picture's template was made, so that noise and target can be sent the same way; arrays are read-only.

    Attributes
    ----------
    number
        Of the picture.
    grid
        The picture's own pixels about its target, following the stars.
    pixels : (m,) array of int
        Those pixels in the picture's flat array.
    share : (n, m) array
        Part of each picture in each pixel of the template.
    kernel : (3, 3) array
        Applied to the template.
    misfit
        Part of the template's light that the match leaves.
    response : (n,) array
    """

    number: int
    grid: Grid
    pixels: IntArray
    share: FloatArray
    kernel: FloatArray
    misfit: float
    response: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def parts(
        self, rows: sparse.csr_array, pictures: Sequence[StackPicture]
    ) -> Iterator[tuple[int, sparse.csr_array]]:
        """Yield (j, matrix): what the template takes off by way of picture j, for rows (k, n_line * n_pixel)."""
        matched = sparse.csr_array(rows[:, self.pixels] @ convolution_matrix(self.kernel, self.grid.shape))
        used = np.unique(matched.indices)
        if not used.size:
            return
        matched = sparse.csr_array(matched[:, used] * self.response[self.number])
        centers = self.grid.centers()[used]
        for j, picture in enumerate(pictures):
            share = self.share[j, used] / self.response[j]
            if share.any():
                there = resampling_rows(self.grid, centers, picture.replace(bad=np.zeros_like(picture.bad)))
                yield j, sparse.csr_array(matched @ (sparse.diags_array(share) @ there.matrix))


def convolution_matrix(kernel: FloatArray, shape: tuple[int, int]) -> sparse.csr_array:
    """Return the matrix (m, m) that convolves a picture of `shape`, flattened; no light from outside."""
    n_line, n_pixel = shape
    half = len(kernel) // 2
    parts = []
    for (i, j), value in np.ndenumerate(kernel):
        by_line = sparse.diags_array(
            np.ones(n_line - abs(half - i)), offsets=half - i, shape=(n_line, n_line)
        )
        by_pixel = sparse.diags_array(
            np.ones(n_pixel - abs(half - j)), offsets=half - j, shape=(n_pixel, n_pixel)
        )
        parts.append(value * sparse.kron(by_line, by_pixel, format="csr"))
    return sparse.csr_array(sum(parts[1:], start=parts[0]))


def subtract_stars(
    pictures: Sequence[StackPicture], grid: Grid, weights: FloatArray, response: FloatArray
) -> tuple[list[StackPicture], list[StackPicture], list[Subtraction]]:
    """Return the pictures with the noise of what is left of their stars, the same without star fields, and how.

    The second are bad outside their templates.

    Raises
    ------
    CenterfindingError
        The target has not moved enough: no template of its place can be made.
    """
    places = [_target_place(picture) for picture in pictures]
    hidden = [
        picture.replace(bad=picture.bad | _disc(picture, place))
        for picture, place in zip(pictures, places, strict=True)
    ]
    known, subtracted, ways = [], [], []
    for number, picture in enumerate(pictures):
        own = _own_grid(picture, places[number], grid.shape)
        template, variance, share = _template(number, own, hidden, weights, response)
        _check_moved(picture, own, share, places)
        noisier, done, way = _subtract(
            number, picture, hidden[number], own, template, variance, share, response
        )
        known.append(noisier)
        subtracted.append(done)
        ways.append(way)
    return known, subtracted, ways


def _target_place(picture: StackPicture) -> FloatArray:
    apparent = target_direction(picture)
    return np.asarray(picture.camera.project((picture.camera_from_j2000 @ apparent)[None])[0])


def _radius_px(picture: StackPicture) -> float:
    return float(PROTECT_SIGMAS * picture.psf.sigma_px.max() + PROTECT_PX)


def _disc(picture: StackPicture, place: FloatArray) -> BoolArray:
    line, pixel = np.ogrid[: picture.bad.shape[0], : picture.bad.shape[1]]
    return np.asarray(np.hypot(pixel - place[0], line - place[1]) <= _radius_px(picture))


def _own_grid(picture: StackPicture, place: FloatArray, shape: tuple[int, int]) -> Grid:
    """The picture's own pixels about its target, as far as the detector goes."""
    if not picture.camera.on_detector(place):
        raise CenterfindingError(
            f"{picture.name}: the target is not on its detector; leave that picture out."
        )
    half = np.array([shape[1], shape[0]]) // 2 + MARGIN_PX
    size = np.array([picture.camera.n_pixel, picture.camera.n_line])
    first = np.maximum(np.round(place) - half, 0.0)
    last = np.minimum(np.round(place) + half, size - 1)
    n_pixel, n_line = (last - first + 1).astype(int).tolist()
    return Grid(
        picture.camera,
        picture.camera_from_j2000,
        picture.observer_velocity_km_s,
        "stars",
        None,
        first,
        (n_line, n_pixel),
    )


def _template(
    number: int, own: Grid, hidden: Sequence[StackPicture], weights: FloatArray, response: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weighted mean (m,) of the others, nan where too few show a pixel, its variance, and their shares (n, m)."""
    centers = own.centers()
    values, variances = np.full((2, len(hidden), len(centers)), np.nan)
    for j, picture in enumerate(hidden):
        if j != number:
            rows = resampling_rows(own, centers, picture)
            blank = np.where(rows.usable, 1.0, np.nan) / response[j]
            values[j] = blank * (rows.matrix @ picture.signal_dn.ravel())
            variances[j] = blank**2 * (rows.matrix.power(2) @ picture.variance_dn2.ravel())
    usable = np.isfinite(values) & ~_hits_in_template(values, variances, own.shape)
    share = np.where(usable, weights[:, None], 0.0)
    enough = usable.sum(axis=0) >= MIN_SOURCES
    share = np.where(enough, share / np.where(enough, share.sum(axis=0), 1.0), 0.0)
    blank = np.where(enough, 1.0, np.nan)
    mean = blank * np.sum(share * np.where(usable, values, 0.0), axis=0)
    return mean, blank * np.sum(share**2 * np.where(usable, variances, 0.0), axis=0), share


def _hits_in_template(values: FloatArray, variances: FloatArray, shape: tuple[int, int]) -> BoolArray:
    """Hits of the other pictures: far from the median of all."""
    known = np.isfinite(values)
    filled = np.where(known.any(axis=0), values, 0.0)
    median = np.nanmedian(filled, axis=0)
    picture = np.reshape(median, shape)
    slope = ndimage.maximum_filter(picture, 3) - ndimage.minimum_filter(picture, 3)
    off = np.abs(values - median) - SLOPE_PART * slope.ravel()
    far = np.nan_to_num(off / np.sqrt(variances)) > CLIP_SIGMAS
    return np.asarray(far & (known.sum(axis=0) > MIN_SOURCES))


def _check_moved(picture: StackPicture, own: Grid, share: FloatArray, places: Sequence[FloatArray]) -> None:
    if not share[:, _nearest(own, _target_place(picture))].any():
        raise CenterfindingError(
            f"{picture.name}: fewer than {MIN_SOURCES} other pictures show the sky behind the target, which must move by "
            f"{2.0 * _radius_px(picture):.0f} px against the stars; stack without subtraction, or add pictures of other "
            f"times (of {len(places)})."
        )


def _nearest(own: Grid, place: FloatArray) -> int:
    """Index of the grid pixel nearest to a place of the picture."""
    pixel, line = np.round(own.index(place)).astype(int)
    return int(line * own.shape[1] + pixel)


def _subtract(
    number: int,
    picture: StackPicture,
    hidden: StackPicture,
    own: Grid,
    template: FloatArray,
    variance: FloatArray,
    share: FloatArray,
    response: FloatArray,
) -> tuple[StackPicture, StackPicture, Subtraction]:
    pixel, line = own.centers().astype(int).T
    flat = line * picture.camera.n_pixel + pixel
    signal = picture.signal_dn.ravel()[flat] / response[number]
    noise2 = picture.variance_dn2.ravel()[flat] / response[number] ** 2
    unknown = ~np.isfinite(template)
    filled = np.where(unknown, 0.0, template).reshape(own.shape)
    reached = ndimage.binary_dilation(unknown.reshape(own.shape), KERNEL_FOOTPRINT).ravel()
    teaches = ~reached & ~hidden.bad.ravel()[flat]
    kernel, level = _match(filled, signal, noise2, teaches)
    matched = ndimage.convolve(filled, kernel, mode="constant").ravel()
    spread = ndimage.convolve(
        np.where(unknown, 0.0, variance).reshape(own.shape), kernel**2, mode="constant"
    ).ravel()
    rest = signal - matched - level
    misfit = _misfit(rest, matched, noise2 + spread, teaches)
    # What the pictures' noise maps leave out: light that was not matched, and the stars' own shot noise.
    left = (
        noise2
        + (misfit * matched) ** 2
        + np.maximum(matched, 0.0) / (picture.gain_e_per_dn * response[number])
    )
    noisier = picture.replace(
        noise_dn=_with_pixels(picture, flat, np.sqrt(left) * response[number], picture.noise_dn.ravel()),
    )
    done = noisier.replace(
        signal_dn=_with_pixels(picture, flat, rest * response[number], 0.0),
        noise_dn=_with_pixels(
            picture, flat, np.sqrt(left + spread) * response[number], picture.noise_dn.ravel()
        ),
        bad=_with_pixels(picture, flat, (reached | picture.bad.ravel()[flat]).astype(np.float64), 1.0) > 0.5,
    )
    return noisier, done, Subtraction(number, own, flat, share, kernel, misfit, response)


def _match(
    template: FloatArray, signal: FloatArray, noise2: FloatArray, teaches: BoolArray
) -> tuple[FloatArray, float]:
    """Kernel and level that make the picture of the template, by weighted least squares with a weak prior."""
    size = 2 * KERNEL_HALF + 1
    steps = [
        (i, j) for i in range(-KERNEL_HALF, KERNEL_HALF + 1) for j in range(-KERNEL_HALF, KERNEL_HALF + 1)
    ]
    shifted = [ndimage.shift(template, step, order=0, mode="constant").ravel() for step in steps]
    design = np.stack([*shifted, np.ones(template.size)], axis=1)[teaches]
    weight = 1.0 / np.sqrt(noise2[teaches])
    delta = np.zeros(size**2)
    delta[size**2 // 2] = 1.0
    prior = np.zeros((size**2, size**2 + 1))
    np.fill_diagonal(prior, 1.0 / KERNEL_PRIOR)
    rows = np.concatenate([design * weight[:, None], prior])
    values = np.concatenate([signal[teaches] * weight, delta / KERNEL_PRIOR])
    answer = np.linalg.lstsq(rows, values, rcond=None)[0]
    return answer[:-1].reshape(size, size), float(answer[-1])


def _misfit(rest: FloatArray, matched: FloatArray, variance: FloatArray, teaches: BoolArray) -> float:
    """Part of the light of stars that the match leaves beyond the noise."""
    stars = teaches & (matched > STAR_SIGMAS * np.sqrt(variance))
    if not stars.any():
        return 0.0
    excess = np.sum(rest[stars] ** 2 - variance[stars]) / np.sum(matched[stars] ** 2)
    return float(np.sqrt(max(excess, 0.0)))


def _with_pixels(
    picture: StackPicture, flat: IntArray, values: FloatArray, elsewhere: float | FloatArray
) -> FloatArray:
    whole = np.array(np.broadcast_to(elsewhere, picture.bad.size), dtype=np.float64)
    whole[flat] = values
    return whole.reshape(picture.bad.shape)
