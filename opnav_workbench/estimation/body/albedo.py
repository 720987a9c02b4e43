"""The albedo map of a body, from the pictures that told its figure and rotation.

Flow    an even body drawn as each picture would see it -> data over its light, pixel by pixel, given to the cells that each
        pixel looks at -> smoothed over a cell -> drawn again with the map, what is left given to the cells -> ...

The law is the one of the mission, or a mixture of Lambert's and Lommel-Seeliger's, under which pictures that see a place at
other angles agree best on it: what a wrong law makes of limb and terminator would stand in the map.

Drawing through the PSF and giving back what is left undoes the blur as far as the noise allows (simultaneous iterative
reconstruction). Every picture has a gain of its own, so that exposure times and phase functions need not be true: places
that two pictures show tell the ratio of their gains, all at once, and how well is in the sigmas; the map is relative to the
body's mean where the camera's response is not known. What no picture shows has the mean, and a sigma that says so.

Frame   body-fixed, planetocentric; rows from north to south, columns eastward from longitude 0
Units   albedo as `opnav_workbench.render.AlbedoMap` has it; relative to its mean without a calibrated camera

Reference: Gilbert (1972), Journal of Theoretical Biology 36, 105, doi:10.1016/0022-5193(72)90180-4.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from astropy.io import fits
from scipy import fft, ndimage

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.bodies import BodyPicture
from opnav_workbench.bodies.neighbours import without_others
from opnav_workbench.bodies.picture import model_picture, pixel_rays
from opnav_workbench.errors import EstimationError
from opnav_workbench.estimation.body.pictures import SequencePicture, solved_picture
from opnav_workbench.estimation.body.solution import BodySolution
from opnav_workbench.estimation.state_transition import Transition, straight_line
from opnav_workbench.files import atomic_path
from opnav_workbench.render import AlbedoMap, LunarLambert, ScatteringLaw
from opnav_workbench.render.body import PlacedBody

__all__ = ["SurfaceMap", "albedo_from_pictures"]

LEAST_DIAMETER_PX = 20.0  # smaller bodies show hemispheres alone
LEAST_COS_EMISSION, LEAST_COS_INCIDENCE = 0.3, 0.2  # beyond, figure and law tell more than albedo does
MODEL_SHARE = 0.03  # of the light: what law, relief and figure are off by, in every pixel for itself
PASSES = 2  # of giving back what is left; more sharpen the noise
SHARES = np.linspace(0.0, 1.0, 11)  # of Lommel-Seeliger's law
LAW_ROWS = 36  # cells in which pictures are compared
SMOOTH_CELLS = 0.7  # a sample is as wide as its pixel
SEEN_CELLS = 0.85  # what a PSF of 0.8 px with its pixel is as wide as
CONTRAST = 0.3  # relative, of albedo beforehand: what is not seen is known so well
VIEW_SIGMA = 0.15  # relative, of the mean albedo of what a picture shows, beforehand: half of the contrast
BELIEVED_CELLS = 10.0  # seen twice, that `MODEL_SHARE` is worth where pictures tell otherwise
ROWS = (8, 720)
LEAST_SAMPLES = 30


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMap:
    """An albedo map with what is known of it; arrays are read-only.

    Attributes
    ----------
    albedo
        The map.
    sigma : (n, 2 n) array
        Of each cell, relative to the map's mean: noise, law and relief, and where the body's rotation puts it.
    pictures : (n, 2 n) array of int
        How many pictures show a cell.
    images, gains
        Pictures that took part; each one's light over that of the map.
    absolute
        Whether values are albedos; else relative, with mean 1.
    law
        Under which the pictures agree.
    """

    albedo: AlbedoMap
    sigma: FloatArray
    pictures: IntArray
    images: tuple[str, ...]
    gains: FloatArray
    absolute: bool
    law: ScatteringLaw

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def seen_share(self) -> float:
        """Share of the body's surface that a picture shows."""
        weight = _row_areas(len(self.pictures))
        return float(np.sum(weight * (self.pictures > 0).mean(axis=1)) / weight.sum())

    def write(self, path: str | Path) -> Path:
        """Write it as FITS: the map as `AlbedoMap.from_file` reads it, then SIGMA and PICTURES.

        Raises
        ------
        SessionError
            The file cannot be written.
        """
        first = fits.PrimaryHDU(self.albedo.values.astype(np.float32))
        cards = (
            ("BUNIT", "albedo" if self.absolute else "relative"),
            ("CTYPE1", "longitude east, deg"), ("CTYPE2", "latitude, deg"),
            ("COMMENT", "First row: north pole; first column begins at longitude 0; planetocentric."),
        )  # fmt: skip
        for name, value in cards:
            first.header[name] = value
        planes = [("SIGMA", self.sigma.astype(np.float32)), ("PICTURES", self.pictures.astype(np.int16))]
        with atomic_path(Path(path)) as temporary, temporary.open("wb") as stream:
            fits.HDUList([first, *(fits.ImageHDU(plane, name=name) for name, plane in planes)]).writeto(
                stream
            )
        return Path(path)


def albedo_from_pictures(
    pictures: Sequence[SequencePicture],
    name: str,
    solution: BodySolution,
    *,
    transition: Transition = straight_line,
    passes: int = PASSES,
) -> SurfaceMap:
    """Return the albedo map of a body whose figure, rotation and place a sequence of pictures has told.

    Parameters
    ----------
    pictures, name, solution, transition
        As given to `solve_body_from_pictures`, and what it returned.
    passes
        How often the map is drawn and what is left given back to it.

    Raises
    ------
    EstimationError
        No picture shows enough of the body.
    """
    used = [one for one in pictures if one.image in solution.images]
    views = [view for one in used if (view := _view(one, name, solution, transition)) is not None]
    if not views:
        raise EstimationError(
            f"no picture shows enough of {name} for a map: it has to be {LEAST_DIAMETER_PX:g} px wide or more."
        )
    views, agreed = _agreed(views)
    finest = min(view.pixel_rad for view in views)
    rows = int(np.clip(2 * round(0.5 * np.pi / finest), *ROWS))
    fed = [_Feed.of(view, rows) for view in views]
    shown = [view.data_dn for view in views]
    values, gains, weight = _mapped(fed, shown, agreed.gains, rows, passes)
    sigma = _sigma(values, weight, agreed, _place_sigma_rad(solution), passes)
    # What the same passes lose of the map itself, they lost of the surface before.
    drawn = [gain * feed.view.drawn_dn(AlbedoMap(values)) for feed, gain in zip(fed, gains, strict=True)]
    lost = _mapped(fed, drawn, gains, rows, passes)[0] - values
    sigma = np.sqrt(sigma**2 + np.maximum(_smoothed(lost**2), 0.0))
    absolute = all(view.picture.sunlight_e is not None for view in views)
    counts = np.sum([feed.seen(rows) for feed in fed], axis=0)
    scale = float(np.median(gains)) if absolute else 1.0
    images = tuple(view.image for view in views)
    return SurfaceMap(AlbedoMap(values * scale), sigma, counts, images, gains / scale, absolute, agreed.law)


def _mapped(
    fed: Sequence["_Feed"], shown: Sequence[FloatArray], gains: FloatArray, rows: int, passes: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the map (n, 2 n) of mean 1 that views with these gains show, gains for it, and its smoothed weights."""
    values = np.ones((rows, 2 * rows))
    for _ in range(max(passes, 1)):
        total, weight = np.zeros_like(values), np.zeros_like(values)
        for feed, data, gain in zip(fed, shown, gains, strict=True):
            feed.give(values, data, float(gain), total, weight)
        smooth = [_smoothed(plane) for plane in (total, weight)]
        values = np.maximum(values + smooth[0] / (smooth[1] + CONTRAST**-2), 0.0)
        mean = _mean(values, weight > 0.0)
        values, gains = values / mean, gains * mean
    return values, gains, smooth[1]


def _sigma(
    values: FloatArray, weight: FloatArray, agreed: "_Agreement", place_sigma_rad: float, passes: int
) -> FloatArray:
    """Return sigmas (n, 2 n): pixels' errors, the gains', and what the body's rotation moves."""
    pixels = 1.0 / (weight / (_noise_share(passes) * agreed.disagreement) + CONTRAST**-2)
    at = np.arange(len(values)) * LAW_ROWS // len(values)
    along = np.arange(values.shape[1]) * LAW_ROWS // len(values)
    gains = agreed.cell_variance().reshape(LAW_ROWS, 2 * LAW_ROWS)[at[:, None], along]
    return np.asarray(np.sqrt(pixels + gains + (place_sigma_rad * _slope(values)) ** 2))


def _noise_share(passes: int) -> float:
    """Return the variance of a cell's value over that of its own pixels' mean.

    Smoothing takes its neighbors in; every further pass sharpens what is left. k and h are what smoothing and the picture's
    PSF with its pixel keep of a wave.
    """
    wave = np.linspace(0.0, np.pi, 200)
    k, h = (np.exp(-0.5 * (wide * wave) ** 2) for wide in (SMOOTH_CELLS, SEEN_CELLS))
    kept = sum(k * (1.0 - k * h) ** done for done in range(max(passes, 1)))
    return float(np.trapezoid(kept**2 * wave, wave) / (2.0 * np.pi))


def _place_sigma_rad(solution: BodySolution) -> float:
    """Return how far places on the surface may be off along each axis, as the rotation is known."""
    return float(np.sqrt(np.mean(solution.pole_sigma_rad**2) + solution.phase_sigma_rad**2))


def _slope(values: FloatArray) -> FloatArray:
    """Return the root mean square change of a map (n, 2 n) along an axis, per rad, of each cell's surroundings."""
    cell = np.pi / len(values)
    down, along = np.gradient(values, cell)
    along = along / np.maximum(_row_areas(len(values))[:, None], cell)
    square = _smoothed(0.5 * (down**2 + along**2))
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


# ---- What pictures that overlap say of their gains, and of the law.


@dataclass(frozen=True, slots=True, eq=False)
class _Agreement:
    """Logarithms of light of k views in coarse cells, and the gains under which they agree best.

    Attributes
    ----------
    covariance : (k, k) array
        Of the gains' logarithms.
    share : (k, cells) array
        Of each view in what is known of a cell.
    lost
        Squares of what is left, over what law, relief and figure are held to be off by, and of how far the views' means are
        apart.
    disagreement
        Of what is left, the mean of those squares: 1 as expected.
    """

    law: ScatteringLaw
    gains: FloatArray
    covariance: FloatArray
    share: FloatArray
    lost: float
    disagreement: float

    def cell_variance(self) -> FloatArray:
        """Return what gains make of cells (cells,), relative to the mean of all that are seen."""
        seen = self.share.sum(axis=0) > 0.0
        area = np.repeat(_row_areas(LAW_ROWS), 2 * LAW_ROWS) * seen
        moved = self.share - (self.share @ area / area.sum())[:, None]
        variance = np.einsum("kc,kl,lc->c", moved, self.covariance, moved)
        return np.where(seen, np.maximum(variance, 0.0), 0.0)


def _agreed(views: Sequence["_View"]) -> tuple[list["_View"], _Agreement]:
    """Return views under the law with which they agree best, their own or a mixture, and their gains."""
    own = views[0].picture.model(views[0].name).law
    cells = [_coarse_cells(view) for view in views]
    laws = [own, *(LunarLambert(float(share)) for share in SHARES)]
    best = min((_agreement(views, cells, law) for law in laws), key=lambda one: one.lost)
    return [view.with_law(best.law) for view in views], best


def _coarse_cells(view: "_View") -> IntArray:
    """Return the cell (n,) of `LAW_ROWS` that each pixel looks at."""
    even = AlbedoMap(np.ones((LAW_ROWS, 2 * LAW_ROWS)))
    cells, share = even.corners(view.longitude_rad, view.latitude_rad)
    return np.asarray(np.take_along_axis(cells, share.argmax(axis=0)[None], axis=0)[0])


def _agreement(views: Sequence["_View"], cells: Sequence[IntArray], law: ScatteringLaw) -> _Agreement:
    """Return the most probable gains of all views at once: cells that two of them see tell their ratio.

    Where none is seen twice, what is known is that the mean albedos of views are alike within `VIEW_SIGMA`.
    """
    seen = [_cell_light(view, cell, law) for view, cell in zip(views, cells, strict=True)]
    light, weight = (np.array([one[k] for one in seen]) for k in range(2))
    whole = weight.sum(axis=0)
    share = weight / np.maximum(whole, np.finfo(float).tiny)
    own = (weight * light).sum(axis=1) / weight.sum(axis=1)
    normal = np.diag(weight.sum(axis=1)) - share @ weight.T
    side = (weight * (light - (share * light).sum(axis=0))).sum(axis=1)
    freedom = int(np.count_nonzero(weight)) - int(np.count_nonzero(whole)) - (len(views) - 1)
    disagreement = 1.0
    for _ in range(2):  # the second time with the size of errors that the first has found
        covariance = np.linalg.inv(normal / disagreement + np.eye(len(views)) / VIEW_SIGMA**2)
        gains = covariance @ (side / disagreement + own / VIEW_SIGMA**2)
        left = light - gains[:, None]
        left = left - (share * left).sum(axis=0)
        square = float(np.sum(weight * left**2))
        disagreement = (square + BELIEVED_CELLS) / (max(freedom, 0) + BELIEVED_CELLS)
    lost = square + float(np.sum((gains - own) ** 2)) / VIEW_SIGMA**2
    return _Agreement(law, np.exp(gains), covariance, share, lost, disagreement)


def _cell_light(view: "_View", cell: IntArray, law: ScatteringLaw) -> tuple[FloatArray, FloatArray]:
    """Return the mean logarithm of a view's light over that of an even body, by cell, and its weight; 0: not seen."""
    size = 2 * LAW_ROWS**2
    tiny = np.finfo(float).tiny
    one = np.log(np.maximum(view.data_dn / (view.even_dn * view.law_factor(law)), tiny))
    noise = view.variance_dn2 / view.data_dn**2
    pixel = 1.0 / (noise + MODEL_SHARE**2)
    total = np.bincount(cell, pixel, size)
    light = np.bincount(cell, pixel * one, size) / np.maximum(total, tiny)
    # What a cell's law, relief and figure are off by is alike in its pixels; their noise is not.
    noise = 1.0 / np.maximum(np.bincount(cell, 1.0 / noise, size), tiny)
    return light, np.where(total > 0.0, 1.0 / (MODEL_SHARE**2 + noise), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """What a picture shows of the body: n pixels of a window and the places that they look at."""

    image: str
    picture: BodyPicture  # with the body as solved
    name: str
    window: tuple[int, int, int, int]
    used: BoolArray  # (n_line, n_pixel) of the window
    data_dn: FloatArray  # (n,)
    variance_dn2: FloatArray  # (n,)
    even_dn: FloatArray  # (n,) light of a body of albedo 1
    longitude_rad: FloatArray
    latitude_rad: FloatArray
    cos_incidence: FloatArray
    cos_emission: FloatArray
    pixel_rad: float  # on the body, from its center

    def drawn_dn(self, albedo: AlbedoMap | float) -> FloatArray:
        """Return the light (n,) of the body with an albedo."""
        return _light(self.picture, self.name, albedo, self.window)[self.used]

    def law_factor(self, law: ScatteringLaw) -> FloatArray:
        """Return the light (n,) that another law makes, over that of the model's."""
        angles = self.cos_incidence, self.cos_emission, self.picture.phase_rad(self.name)
        return np.asarray(law.reflectance(*angles) / self.picture.model(self.name).law.reflectance(*angles))

    def with_law(self, law: ScatteringLaw) -> "_View":
        """Return the same view of a body of another law."""
        own = self.picture.model(self.name)
        models = tuple(replace(m, law=law) if m is own else m for m in self.picture.models)
        return replace(
            self, picture=replace(self.picture, models=models), even_dn=self.even_dn * self.law_factor(law)
        )


def _view(one: SequencePicture, name: str, solution: BodySolution, transition: Transition) -> _View | None:
    """Return what a picture shows; None where that is too little."""
    picture = solved_picture(one, name, solution, transition)
    diameter, center = picture.diameter_px(name), picture.center_px(name)
    if not (diameter >= LEAST_DIAMETER_PX and np.isfinite(center).all()):
        return None
    window = _window(picture, center, diameter)
    if window is None:
        return None
    cutout = without_others(picture, name, center, window)
    even = _light(picture, name, 1.0, window)
    line, pixel = np.indices(even.shape)
    rays = pixel_rays(picture, np.stack([pixel.ravel() + window[0], line.ravel() + window[1]], axis=-1))
    body = PlacedBody(replace(picture.model(name), flux_e=None), picture.camera.pixel_scale_rad)
    met = body.surface.first_hits(body.to_body(rays))
    cos_e, cos_i = (
        np.einsum("in,in->n", met.normal, _toward(place, met.point))
        for place in (body.camera_km, body.sun_km)
    )
    good = (
        (cutout.use & (cutout.data_dn > 0.0)).ravel()[met.ray]
        & (cos_e > LEAST_COS_EMISSION)
        & (cos_i > LEAST_COS_INCIDENCE)
    )
    if np.count_nonzero(good) < LEAST_SAMPLES:
        return None
    used = np.zeros(even.shape, dtype=bool)
    used.ravel()[met.ray[good]] = True  # rays, and what they meet, are in the order of the pixels
    order = np.flatnonzero(good)[np.argsort(met.ray[good])]
    x, y, z = met.point[:, order]
    variance = cutout.noise_dn[used] ** 2 + np.maximum(cutout.data_dn[used], 0.0) / cutout.gain_e_per_dn
    return _View(
        one.image, picture, name, window, used, cutout.data_dn[used], variance, even[used], np.arctan2(y, x),
        np.arctan2(z, np.hypot(x, y)), cos_i[order], cos_e[order], 2.0 / diameter,
    )  # fmt: skip


def _toward(place: FloatArray, point: FloatArray) -> FloatArray:
    away = place[:, None] - point
    return np.asarray(away / np.sqrt(np.einsum("in,in->n", away, away)))


def _window(picture: BodyPicture, center: FloatArray, diameter: float) -> tuple[int, int, int, int] | None:
    half = 0.75 * diameter + 4.0  # an outline of any axes
    size = np.array([picture.camera.n_pixel, picture.camera.n_line])
    first = np.clip(np.floor(center - half), 0, size).astype(int)
    last = np.clip(np.ceil(center + half), 0, size).astype(int)
    wide, high = (last - first).tolist()
    return None if min(wide, high) < 1 else (int(first[0]), int(first[1]), wide, high)


def _light(
    picture: BodyPicture, name: str, albedo: AlbedoMap | float, window: tuple[int, int, int, int]
) -> FloatArray:
    own = picture.model(name)
    shown = replace(own, albedo=albedo, flux_e=None)
    models = tuple(shown if model is own else model for model in picture.models)
    return model_picture(replace(picture, models=models), window, {}, only=(name,))


@dataclass(frozen=True, slots=True, eq=False)
class _Feed:
    """The cells that a view's pixels look at, each with its four neighbors' shares."""

    view: _View
    cells: IntArray  # (4, n)
    shares: FloatArray  # (4, n)

    @classmethod
    def of(cls, view: _View, rows: int) -> "_Feed":
        corners = AlbedoMap(np.ones((rows, 2 * rows))).corners(view.longitude_rad, view.latitude_rad)
        return cls(view, *corners)

    def give(
        self, values: FloatArray, data_dn: FloatArray, gain: float, total: FloatArray, weight: FloatArray
    ) -> None:
        """Add what a map leaves of the data, weighted, and the weights (n, 2 n)."""
        even = gain * self.view.even_dn
        left = (data_dn - gain * self.view.drawn_dn(AlbedoMap(values))) / even
        known = 1.0 / (self.view.variance_dn2 / even**2 + MODEL_SHARE**2)
        for cells, share in zip(self.cells, self.shares, strict=True):
            total += np.bincount(cells, share * known * left, total.size).reshape(total.shape)
            weight += np.bincount(cells, share * known, weight.size).reshape(weight.shape)

    def seen(self, rows: int) -> IntArray:
        """Return 1 for the cells (n, 2 n) that the picture shows, within a cell."""
        hit = np.bincount(self.cells.ravel(), minlength=2 * rows * rows).reshape(rows, 2 * rows) > 0
        return (_smoothed(hit.astype(np.float64)) > 0.25).astype(np.int64)


def _row_areas(rows: int) -> FloatArray:
    """Return the cosine of the latitude of each row."""
    return np.asarray(np.cos(np.pi * ((np.arange(rows) + 0.5) / rows - 0.5)))


def _mean(values: FloatArray, seen: BoolArray) -> float:
    weight = _row_areas(len(values))[:, None] * seen
    return float(np.sum(weight * values) / max(float(weight.sum()), np.finfo(float).tiny))


def _smoothed(plane: FloatArray) -> FloatArray:
    """Return a plane (n, 2 n) smoothed over the same length on the body everywhere: wider in longitude near the poles."""
    down = ndimage.gaussian_filter1d(plane, SMOOTH_CELLS, axis=0, mode="nearest")
    return np.asarray(fft.irfft(fft.rfft(down, axis=1) * _along_rows(len(plane)), plane.shape[1], axis=1))


@lru_cache(maxsize=2)
def _along_rows(rows: int) -> FloatArray:
    """Return what smoothing along each row does to its waves (n, n + 1): of samples of a Gaussian, none below zero.

    The Gaussian's own spectrum would be cut off at the finest wave, and weights ring below zero beside what is seen.
    """
    column = np.arange(2 * rows)
    away = np.minimum(column, 2 * rows - column) * _row_areas(rows)[:, None] / SMOOTH_CELLS
    kernel = np.exp(-0.5 * away**2)
    return np.asarray(fft.rfft(kernel / kernel.sum(axis=1, keepdims=True), axis=1).real)
