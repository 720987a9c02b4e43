"""Level and noise of the sky in every pixel, from the tiles of a coarse mesh.

Flow      picture -> tiles -> clipped level and noise of each -> tiles that show the sky -> every pixel
Bodies    a robust surface through the tiles tells the sky from a resolved body, whose tiles take its value
Cost      one sort per tile; after it, clipping only moves two indices, and sums come from running totals
Noise     `pixel_noise` raises the measured noise to what the detector must have at least
Columns   `column_level`: light that a bright body leaves all along its columns while a frame-transfer CCD is read out
          without a shutter

Why not photutils' Background2D: it knows no bodies. With 3 DN of noise its level errs by 0.8 DN in a field of stars and by
hundreds of DN beside a disk half as wide as the picture, where this one errs by 0.07 and 0.05 DN.

Sources: the mesh is SExtractor's, Bertin & Arnouts (1996), doi:10.1051/aas:1996164; the surface is fitted by least trimmed
squares, which bears nearly half of wrong values, Rousseeuw & Van Driessen (2006), "Computing LTS Regression for Large Data
Sets", doi:10.1007/s10618-005-0024-4.
"""

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.constants import MAD_TO_SIGMA, PIXEL_VARIANCE_PX2
from opnav_workbench.errors import ImageError

__all__ = [
    "Background",
    "column_level",
    "contained_bias_dn",
    "darkest_sky",
    "estimate_background",
    "pixel_noise",
]


# ---- The sky of a picture that a body fills: where it is darkest.

BLOCK_PX = 16
DARKEST_SHARE = 0.02  # of the blocks: sky, if there is any
FLATTEST = 0.01  # of the noise expected: blocks that scatter less have been painted over


def darkest_sky(image_dn: FloatArray, bad: BoolArray, noise_dn: float) -> tuple[float, float]:
    """Return level and noise of the darkest part of a picture, which is sky if anything is.

    For pictures of a body so large that a mesh takes its disk for background.

    Parameters
    ----------
    image_dn, bad : (n_line, n_pixel) arrays
    noise_dn
        Expected: the least that is believed is a hundredth of it, or what the picture's steps hide.

    Examples
    --------
    >>> image = np.full((64, 64), 200.0)
    >>> image[:16] = np.random.default_rng(1).normal(7.0, 2.0, (16, 64))
    >>> level, noise = darkest_sky(image, np.zeros((64, 64), dtype=bool), 3.0)
    >>> round(level), round(noise)
    (7, 2)
    """
    usable = np.isfinite(image_dn) & ~bad
    side = max(1, min(BLOCK_PX, *(n // 2 for n in image_dn.shape)))
    n_line, n_pixel = (n // side for n in image_dn.shape)
    blocks = np.where(usable, image_dn, np.nan)[: n_line * side, : n_pixel * side]
    blocks = blocks.reshape(n_line, side, n_pixel, side).swapaxes(1, 2).reshape(n_line * n_pixel, -1)
    blocks = np.nan_to_num(blocks[np.isfinite(blocks).mean(axis=1) > 0.5])
    if not len(blocks):
        return 0.0, noise_dn
    level = np.median(blocks, axis=1)
    dark = float(np.quantile(level, DARKEST_SHARE))
    sky = blocks[level <= dark] - level[level <= dark, None]
    spread = MAD_TO_SIGMA * float(np.median(np.abs(sky)))
    return dark, max(spread, _rounding_sigma_dn(blocks[level <= dark], image_dn[usable]), FLATTEST * noise_dn)


def _rounding_sigma_dn(sky_dn: FloatArray, image_dn: FloatArray) -> float:
    """Return the sigma of what rounding to the picture's steps has taken: where the sky is all of one step, its noise."""
    levels = np.unique(sky_dn)
    if len(levels) == 1:  # the finest step of the picture: coarser ones are of brighter light
        steps = np.diff(np.unique(image_dn))
        return float(steps.min() * np.sqrt(PIXEL_VARIANCE_PX2)) if steps.size else 0.0
    place = np.clip(int(np.searchsorted(levels, np.median(sky_dn))), 1, len(levels) - 1)
    return float((levels[place] - levels[place - 1]) * np.sqrt(PIXEL_VARIANCE_PX2))


# ---- A coarse mesh over a picture: tiles, their clipped statistics, and the way back to every pixel.

TILES_ACROSS = 8  # fewer cannot follow a gradient and lose a body at the same time
SMALLEST_TILE_PX = 16  # 256 pixels give a level to 0.08 sigma; smaller tiles are noise
CLIP_PASSES = 12  # each pass only moves indices; a bright limb in the tile takes the most
LEVEL_CLIP_SIGMA = 2.0  # a narrow window keeps the wings of stars out of the mean
NOISE_CLIP_SIGMA = 3.0
# Standard deviation of a unit Gaussian cut at +-3: sqrt(1 - 2 k phi(k) / (2 Phi(k) - 1)).
NOISE_CLIP_FACTOR = 0.986578
SHARE_BELOW_ONE_SIGMA = 0.158655
STEPS_IN_WINDOW = 1.5  # whole numbers: the neighbours on both sides stay in, wherever the level lies between
CLIP_TOLERANCE = 1e-3  # of the noise: a tenth of the error of a tile's level
SMALLEST_SAMPLE_PX = 32  # fewer usable pixels than this: the tile says nothing
SMALLEST_SHARE = 0.1  # nor does a tile with less than a tenth of its pixels left


@dataclass(frozen=True, slots=True)
class Mesh:
    """Where the tiles of one axis pair lie.

    Attributes
    ----------
    line_start, pixel_start : (k,) int arrays
        First line and pixel of each row and column of tiles.
    tile_line, tile_pixel
        Height and width of every tile; neighbours may overlap by a pixel so that all are equal.
    shape : (n_line, n_pixel)
    """

    line_start: IntArray
    pixel_start: IntArray
    tile_line: int
    tile_pixel: int
    shape: tuple[int, int]

    @property
    def tiles(self) -> tuple[int, int]:
        """Rows and columns of tiles."""
        return len(self.line_start), len(self.pixel_start)

    def centers(self) -> FloatArray:
        """Return the tile centers (k, 2) as (pixel, line), scaled to -1..1 over the picture."""
        line = _unit_interval(self.line_start + (self.tile_line - 1) / 2.0, self.shape[0])
        pixel = _unit_interval(self.pixel_start + (self.tile_pixel - 1) / 2.0, self.shape[1])
        grid_line, grid_pixel = np.meshgrid(line, pixel, indexing="ij")
        return np.column_stack([grid_pixel.ravel(), grid_line.ravel()])

    def upsample(self, values: FloatArray) -> FloatArray:
        """Spread tile values (k,) over the picture, bilinear and linear beyond the outer centers."""
        along_line = _linear_weights(self.line_start + (self.tile_line - 1) / 2.0, self.shape[0])
        along_pixel = _linear_weights(self.pixel_start + (self.tile_pixel - 1) / 2.0, self.shape[1])
        return np.asarray(along_line @ values.reshape(self.tiles) @ along_pixel.T)


def make_mesh(shape: tuple[int, int], box_px: int) -> Mesh:
    """Divide a picture into tiles of about `box_px`, smaller where fewer than eight would fit across."""
    (line_start, tile_line), (pixel_start, tile_pixel) = (_divide(n, box_px) for n in shape)
    return Mesh(line_start, pixel_start, tile_line, tile_pixel, shape)


def _divide(length: int, box_px: int) -> tuple[IntArray, int]:
    side = min(box_px, max(length // TILES_ACROSS, min(SMALLEST_TILE_PX, box_px)))
    count = max(1, round(length / side))
    size = -(-length // count)
    return np.linspace(0, length - size, count).round().astype(np.int64), size


def _unit_interval(position: NDArray[np.floating[Any]], length: int) -> FloatArray:
    return np.asarray((2.0 * position - (length - 1)) / max(length - 1, 1))


def _linear_weights(nodes: NDArray[np.floating[Any]], length: int) -> FloatArray:
    """Return the matrix (length, k) that interpolates node values at 0..length-1, linearly extended."""
    weights = np.zeros((length, len(nodes)))
    if len(nodes) == 1:
        return weights + 1.0
    at = np.arange(length)
    left = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 2)
    fraction = (at - nodes[left]) / (nodes[left + 1] - nodes[left])
    weights[at, left] = 1.0 - fraction
    weights[at, left + 1] = fraction
    return weights


def tiles_of(image: FloatArray, mesh: Mesh) -> FloatArray:
    """Cut a picture into tiles: (k_line * k_pixel, tile_line * tile_pixel), a copy."""
    k_line, k_pixel = mesh.tiles
    if k_line * mesh.tile_line == mesh.shape[0] and k_pixel * mesh.tile_pixel == mesh.shape[1]:
        gathered = image
    else:
        lines = (mesh.line_start[:, None] + np.arange(mesh.tile_line)).ravel()
        pixels = (mesh.pixel_start[:, None] + np.arange(mesh.tile_pixel)).ravel()
        gathered = image[np.ix_(lines, pixels)]
    blocks = gathered.reshape(k_line, mesh.tile_line, k_pixel, mesh.tile_pixel)
    return blocks.transpose(0, 2, 1, 3).reshape(k_line * k_pixel, mesh.tile_line * mesh.tile_pixel)


def clipped_statistics(tiles: FloatArray, step_dn: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Return level and noise (k,) of tiles (k, n); nan marks a masked pixel, and a tile with too few others.

    The level is the mean of what lies within two sigma of itself, the noise the standard deviation within
    three, corrected for the cut: both hold where stars or a limb add a bright tail. `step_dn` is the step of
    a whole-number picture; no window leaves out the neighbours, or a quiet sky would show no noise at all.
    """
    ordered = np.sort(tiles, axis=1)  # nan goes last
    count = np.asarray(np.count_nonzero(~np.isnan(ordered), axis=1), np.int64)
    usable = (count >= SMALLEST_SAMPLE_PX) & (count >= SMALLEST_SHARE * tiles.shape[1])
    if not usable.any():
        return np.full(len(tiles), np.nan), np.full(len(tiles), np.nan)
    level, noise = (np.full(len(tiles), np.nan) for _ in range(2))
    level[usable], noise[usable] = _clip_tiles(_SortedTiles(ordered[usable], count[usable]), step_dn)
    return level, noise


def _clip_tiles(tiles: "_SortedTiles", step_dn: float) -> tuple[FloatArray, FloatArray]:
    level, noise = tiles.start()
    narrowest = STEPS_IN_WINDOW * step_dn
    for _ in range(CLIP_PASSES):
        before = level, noise
        level = tiles.moments(level, np.maximum(LEVEL_CLIP_SIGMA * noise, narrowest))[0]
        noise = tiles.moments(level, np.maximum(NOISE_CLIP_SIGMA * noise, narrowest))[1] / NOISE_CLIP_FACTOR
        moved = np.abs(level - before[0]) + np.abs(noise - before[1])
        if np.all(moved <= CLIP_TOLERANCE * noise):
            break
    return level, noise


class _SortedTiles:
    """Sorted tiles with running sums: the moments within any window cost two binary searches a tile."""

    def __init__(self, ordered: FloatArray, count: IntArray) -> None:
        self.ordered = ordered
        self.count = count
        self.rows = np.arange(len(ordered))
        self.median = ordered[self.rows, (count - 1) // 2]
        shifted = ordered - self.median[:, None]  # sums of small numbers keep their digits
        shifted[np.isnan(shifted)] = 0.0
        self.sums = _running_sums(shifted)
        self.squares = _running_sums(np.square(shifted, out=shifted))

    def start(self) -> tuple[FloatArray, FloatArray]:
        """Return the median, and the scale of the fainter half, which a bright tail inflates least."""
        one_sigma_below = self.ordered[self.rows, (self.count * SHARE_BELOW_ONE_SIGMA).astype(np.int64)]
        return self.median, np.asarray(self.median - one_sigma_below)

    def moments(self, center: FloatArray, half_width: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation of the values within `half_width` of `center`."""
        low = np.minimum(self._position(center - half_width, "left"), self.count - 1)
        high = np.maximum(self._position(center + half_width, "right"), low + 1)
        n = high - low
        mean = (self.sums[self.rows, high] - self.sums[self.rows, low]) / n
        square = (self.squares[self.rows, high] - self.squares[self.rows, low]) / n
        return self.median + mean, np.sqrt(np.maximum(square - mean * mean, 0.0))

    def _position(self, bounds: FloatArray, side: Literal["left", "right"]) -> IntArray:
        found = (
            row[:n].searchsorted(b, side) for row, n, b in zip(self.ordered, self.count, bounds, strict=True)
        )
        return np.fromiter(found, np.int64, len(bounds))


def _running_sums(values: FloatArray) -> FloatArray:
    sums = np.zeros((values.shape[0], values.shape[1] + 1))
    np.cumsum(values, axis=1, out=sums[:, 1:])
    return sums


# ---- A smooth surface through scattered values of which up to nearly half may be wrong.

RANDOM_STARTS = 100  # with 40 % wrong values, 1 - (1 - 0.6^6)^100 = 0.99 that one start of six is clean
CONCENTRATION_STEPS = 6  # the fit hardly moves after four
SURFACE_SEED = 20_150_714  # the same picture gives the same background
VALUES_PER_TERM = 3  # fewer values a coefficient than this would follow the noise
# Standard deviation of the inner half of a unit Gaussian: sqrt(1 - 2 q phi(q) / 0.5) with q = 0.6745.
INNER_HALF_FACTOR = 0.377617
SURFACE_RIDGE = 1e-9  # keeps the normal equations of values on one line solvable


def robust_surface(positions: FloatArray, values: FloatArray) -> tuple[FloatArray, float]:
    """Fit a quadratic surface to the better half of `values`; a plane or a constant where they are few.

    Parameters
    ----------
    positions : (n, 2) array
        Coordinates within about -1..1.
    values : (n,) array
        May hold nan, which is left out.

    Returns
    -------
    surface : (n,) array
        The surface at every position.
    scatter : float
        Standard deviation of the good values about it.
    """
    known = np.flatnonzero(np.isfinite(values))
    basis = _quadratic_basis(positions, known)
    fitted, scatter = _least_trimmed_squares(basis[known], values[known])
    return np.asarray(basis @ fitted), scatter


def _quadratic_basis(positions: FloatArray, known: IntArray) -> FloatArray:
    """Return the columns 1, x, y, x2, xy, y2 that `known` can determine."""
    x, y = positions.T
    distinct_x, distinct_y = (len(np.unique(axis[known])) for axis in (x, y))
    columns = [np.ones(len(x))]
    if len(known) >= 3 * VALUES_PER_TERM:
        columns += [axis for axis, distinct in ((x, distinct_x), (y, distinct_y)) if distinct > 1]
    if len(known) >= 6 * VALUES_PER_TERM:
        columns += [axis * axis for axis, distinct in ((x, distinct_x), (y, distinct_y)) if distinct > 3]
        columns += [x * y] if min(distinct_x, distinct_y) > 1 else []
    return np.stack(columns, axis=1)


def _least_trimmed_squares(basis: FloatArray, values: FloatArray) -> tuple[FloatArray, float]:
    n, terms = basis.shape
    kept = (n + terms + 1) // 2
    subsets = _start_subsets(values, terms)
    fits = np.stack([_solve_subsets(basis[s][None], values[s][None])[0] for s in subsets])
    for _ in range(CONCENTRATION_STEPS):
        best = np.argpartition((values - fits @ basis.T) ** 2, min(kept, n) - 1, axis=1)[:, :kept]
        fits = _solve_subsets(basis[best], values[best])
    squares = np.sort((values - fits @ basis.T) ** 2, axis=1)[:, :kept].mean(axis=1)
    winner = int(np.argmin(squares))
    return fits[winner], float(np.sqrt(squares[winner])) / INNER_HALF_FACTOR


def _start_subsets(values: FloatArray, terms: int) -> list[IntArray]:
    """Return subsets to begin with: everything, the fainter half (bodies are bright), and random ones."""
    rng = np.random.default_rng(SURFACE_SEED)
    order = np.argsort(values)
    random = np.argsort(rng.random((RANDOM_STARTS, len(values))), axis=1)[:, :terms]
    return [order, order[: max(terms, len(values) // 2)], *random]


def _solve_subsets(basis: FloatArray, values: FloatArray) -> FloatArray:
    """Solve many subsets at once: basis (s, h, terms) and values (s, h) to coefficients (s, terms)."""
    transposed = np.swapaxes(basis, 1, 2)
    normal = transposed @ basis + SURFACE_RIDGE * np.eye(basis.shape[2])
    return np.asarray(np.linalg.solve(normal, transposed @ values[..., None])[..., 0])


# ---- Sky background and its noise, from the tiles of a coarse mesh.

DEFAULT_BOX_PX = 64
# A tile this far from the surface (in the sky's noise per pixel) shows a body, a data gap or a dark column;
# what is fainter than that is stray light, and the background follows it.
SKY_TOLERANCE_SIGMA = 0.5
# ... unless the tiles scatter more by themselves: then five times their scatter about the surface.
SKY_TOLERANCE_SCATTER = 5.0
NOISE_SMOOTHING_TILES = 3  # median filter: a tile's noise is known to 2 %, its neighbours share it
# DN: of a value rounded to a whole number; no picture of whole numbers is quieter
UNIFORM_SIGMA = math.sqrt(PIXEL_VARIANCE_PX2)
NOISE_FREE_SHARE = 1e-6  # of the range of values: keeps the weights of a simulation without noise finite


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """The sky level and its noise, in every pixel; arrays are read-only.

    Attributes
    ----------
    level_dn : (n_line, n_pixel) array
        Sky level, without stars and without a resolved body.
    noise_dn : (n_line, n_pixel) array
        Standard deviation of one pixel about that level: what an empty pixel shows.
    smear_dn : (n_line, n_pixel) array, or 0
        Of that level, what bodies left along their columns in a readout without a shutter.
    """

    level_dn: FloatArray
    noise_dn: FloatArray
    smear_dn: FloatArray | float = 0.0

    def __post_init__(self) -> None:
        freeze_arrays(self)


def estimate_background(
    image_dn: ArrayLike, bad: ArrayLike | None = None, box_px: int = DEFAULT_BOX_PX
) -> Background:
    """Estimate the sky level and its noise in every pixel of a picture.

    Parameters
    ----------
    image_dn : (n_line, n_pixel) array_like
        Picture; non-finite pixels are masked by themselves.
    bad : (n_line, n_pixel) array_like of bool, optional
        Pixels to leave out.
    box_px
        Side of a tile; smaller pictures get smaller tiles, so that about eight fit across.

    Raises
    ------
    ImageError
        The picture is not two-dimensional, has no usable pixel, or has the same value in all of them.

    Notes
    -----
    Bodies may fill about a third of the picture. Where more than half of the tiles show a body, the body
    is taken for the sky: mask it with `bad`.

    Examples
    --------
    >>> picture = 20.0 + np.random.default_rng(1).normal(0.0, 2.0, (128, 128))
    >>> background = estimate_background(picture)
    >>> bool(abs(background.level_dn.mean() - 20.0) < 0.05)
    True
    """
    image, step_dn, floor_dn = _masked(image_dn, bad)
    mesh = make_mesh(image.shape, box_px)
    first = mesh.upsample(_smooth_sky(mesh, *_tile_statistics(image, mesh, step_dn)))
    # The second look is at a picture whose slope is gone; a slope would otherwise count as noise.
    level, noise = _tile_statistics(image - first, mesh, step_dn)
    surface, sky = _sky_tiles(mesh, level, noise)
    level = np.where(sky, level, surface)
    return Background(first + mesh.upsample(level), mesh.upsample(_noise_mesh(mesh, noise, sky, floor_dn)))


def _masked(image_dn: ArrayLike, bad: ArrayLike | None) -> tuple[FloatArray, float, float]:
    """Return a copy with nan in masked pixels, the step of its values (whole numbers: 1), the least noise."""
    image = np.array(image_dn, dtype=np.float64)
    if image.ndim != 2 or image.size == 0:
        raise ImageError(
            f"a background needs a picture of lines and pixels, not an array of shape {image.shape}."
        )
    masked = ~np.isfinite(image)
    if bad is not None:
        masked |= np.asarray(bad, dtype=bool)
    if masked.all():
        raise ImageError(
            f"all {image.size} pixels are masked: no background; check the bad-pixel mask and the file."
        )
    values = image[~masked]
    if values.min() == values.max():
        raise ImageError(
            f"all {values.size} usable pixels hold the value {values[0]:g}: an empty or lost picture."
        )
    image[masked] = np.nan
    if np.array_equal(values, np.rint(values)):
        return image, 1.0, UNIFORM_SIGMA
    return image, 0.0, NOISE_FREE_SHARE * float(np.ptp(values))


def _tile_statistics(image: FloatArray, mesh: Mesh, step_dn: float) -> tuple[FloatArray, FloatArray]:
    level, noise = clipped_statistics(tiles_of(image, mesh), step_dn)
    if np.isnan(level).all():  # a few pixels here and there: they speak for the whole picture
        values = image[np.isfinite(image)]
        level = np.full_like(level, np.median(values))
        noise = np.full_like(noise, MAD_TO_SIGMA * np.median(np.abs(values - level[0])))
    return level, noise


def _smooth_sky(mesh: Mesh, level: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the tiles' levels (k,), those of body tiles replaced by the surface."""
    surface, sky = _sky_tiles(mesh, level, noise)
    return np.where(sky, level, surface)


def _sky_tiles(mesh: Mesh, level: FloatArray, noise: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the surface through the sky's tiles, and which tiles (k,) show the sky."""
    surface, scatter = robust_surface(mesh.centers(), level)
    distance = np.abs(level - surface)
    nearest = distance <= np.nanmedian(distance)
    tolerance = max(SKY_TOLERANCE_SIGMA * float(np.median(noise[nearest])), SKY_TOLERANCE_SCATTER * scatter)
    return surface, np.asarray(distance <= tolerance)


def _noise_mesh(mesh: Mesh, noise: FloatArray, sky: BoolArray, floor_dn: float) -> FloatArray:
    """Return the tiles' noise (k,), smoothed; tiles without a sky of their own take the median."""
    measured = sky & (noise > floor_dn)
    typical = float(np.median(noise[measured])) if measured.any() else floor_dn
    filled = np.where(measured, noise, typical).reshape(mesh.tiles)
    smooth = ndimage.median_filter(filled, NOISE_SMOOTHING_TILES, mode="nearest")
    return np.maximum(smooth.ravel(), floor_dn)


# ---- Noise of every pixel: what the sky shows, and what the detector must have at least.


BIAS_SHARE = 0.9  # of the camera's bias that a level must reach to contain it: biases drift


def pixel_noise(
    background: Background,
    read_noise_dn: float | None,
    gain_e_per_dn: float | None,
    *,
    bias_dn: float = 0.0,
    signal_dn: ArrayLike | None = None,
) -> FloatArray:
    """Combine the measured noise of the background with the detector's read and shot noise.

    ``variance = max(measured^2, read^2 + (level - bias) / gain) + signal / gain``: the measurement holds read
    noise and the sky's shot noise already, so it is raised to the model, not added to it. It exceeds the
    model where faint stars or pattern noise add to it, and falls below in smoothed pictures.

    Parameters
    ----------
    read_noise_dn, gain_e_per_dn
        Of the camera; None or nan where they are unknown, and that part of the model is left out.
    bias_dn
        Electronic offset still contained in the level, which has no shot noise.
    signal_dn : (n_line, n_pixel) array_like, optional
        Model of stars and bodies above the level. Not the picture itself: its noise would steer the weights.

    Returns
    -------
    (n_line, n_pixel) array
        One standard deviation, DN.

    Raises
    ------
    ImageError
        A negative read noise, or a gain that is not positive.

    Examples
    --------
    >>> sky = Background(np.full((2, 2), 44.0), np.full((2, 2), 1.0))
    >>> float(pixel_noise(sky, read_noise_dn=1.1, gain_e_per_dn=22.0)[0, 0]) == (1.1**2 + 2.0) ** 0.5
    True
    """
    read = _known_or(read_noise_dn, 0.0)
    gain = _known_or(gain_e_per_dn, np.inf)
    if read < 0.0 or gain <= 0.0:
        raise ImageError(
            f"read noise {read:g} DN and gain {gain:g} e/DN: expected at least 0 and more than 0."
        )
    model = read**2 + np.maximum(background.level_dn - bias_dn, 0.0) / gain
    variance = np.maximum(background.noise_dn**2, model)
    if signal_dn is not None:
        variance = variance + np.maximum(np.asarray(signal_dn, dtype=np.float64), 0.0) / gain
    return np.asarray(np.sqrt(variance))


def contained_bias_dn(
    background: Background,
    read_noise_dn: float | None,
    gain_e_per_dn: float | None,
    bias_dn: float | None,
) -> float:
    """Return the electronic offset that a picture's level still contains: the camera's, or 0 where it was taken off.

    Told by the noise, which light has and an offset has not: with the right one of both, read noise and shot noise come
    nearest to what the sky shows.

    Parameters
    ----------
    read_noise_dn, gain_e_per_dn, bias_dn
        Of the camera; 0 is returned where one is unknown.

    Examples
    --------
    >>> raw = Background(np.full((2, 2), 505.0), np.full((2, 2), 2.1))
    >>> contained_bias_dn(raw, 2.0, 10.0, 500.0), contained_bias_dn(raw, 2.0, 10.0, 900.0)
    (500.0, 0.0)
    """
    read, gain = _known_or(read_noise_dn, 0.0), _known_or(gain_e_per_dn, np.inf)
    bias, level = _known_or(bias_dn, 0.0), float(np.median(background.level_dn))
    measured = float(np.median(background.noise_dn)) ** 2
    if bias <= 0.0 or level < BIAS_SHARE * bias or not np.isfinite(gain) or measured <= 0.0:
        return 0.0
    with_light, with_bias = (read**2 + max(level - offset, 0.0) / gain for offset in (0.0, bias))
    nearer = abs(np.log(max(with_bias, np.finfo(float).tiny) / measured)) < abs(np.log(with_light / measured))
    return bias if nearer else 0.0


def _known_or(value: float | None, otherwise: float) -> float:
    return otherwise if value is None or np.isnan(value) else float(value)


# ---- Light that a bright body leaves along its columns while a frame-transfer CCD is read out.

LEAST_COLUMN_LINES = 8  # of a column, to tell its level from


def column_level(image_dn: FloatArray, leave_out: ArrayLike = False) -> FloatArray:
    """Return the level (n_line, n_pixel) of a picture's columns: the median of each, body and stars left aside.

    A body's charge is shifted under its own light on its way to the store: every pixel of its columns gets the same
    share of it.

    Parameters
    ----------
    image_dn : (n_line, n_pixel) array
    leave_out : (n_line, n_pixel) array_like of bool
        Pixels of the body, and bad ones.

    Raises
    ------
    ImageError
        The picture has no usable line; a column with fewer than 8 takes the level of its neighbours.

    Examples
    --------
    >>> picture = np.full((32, 3), 5.0)
    >>> picture[:, 1] = 9.0
    >>> picture[10, 1] = 500.0
    >>> column_level(picture)[0].tolist()
    [5.0, 9.0, 5.0]
    """
    out = np.broadcast_to(np.asarray(leave_out, dtype=bool), image_dn.shape)
    usable = ~out & np.isfinite(image_dn)
    enough = usable.sum(axis=0) >= min(LEAST_COLUMN_LINES, len(image_dn))
    if not enough.any():
        raise ImageError("no column of the picture has usable lines beside the body; leave less of it out.")
    level = np.nanmedian(np.where(usable, image_dn, np.nan)[:, enough], axis=0)
    columns = np.arange(image_dn.shape[1])
    return np.broadcast_to(np.interp(columns, columns[enough], level), image_dn.shape).copy()
