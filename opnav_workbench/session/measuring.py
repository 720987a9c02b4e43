"""Star centers at expected places: coarse by correlation, then least squares; for all stars of a frame or for a few."""

from dataclasses import dataclass, fields, replace
from typing import Any, Literal, get_args

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.errors import SessionError
from opnav_workbench.session.context import Context
from opnav_workbench.session.identify import FieldMatch
from opnav_workbench.starcenters import (
    ShapePrior,
    StarCenters,
    StarFlag,
    StarImages,
    Template,
    correlate,
    default_box_px,
    extract_template,
    fit_gaussian,
    fit_psf,
    fit_stars,
    gaussian_template,
)

__all__ = ["FINAL_METHODS", "FITTED", "INITIAL_METHODS", "StarFit", "fit_all", "fit_some", "scattered"]

Initial = Literal["matched_filter", "cross_correlation"]
INITIAL_METHODS: tuple[Initial, ...] = get_args(Initial)
FITTED = ("least_squares", "psf_fit")  # neighbors are fitted together
FINAL_METHODS = (*FITTED, *INITIAL_METHODS)
TEMPLATE_SNR = 50.0  # a template's own noise must not matter beside that of the stars it finds


@dataclass(frozen=True, slots=True)
class StarFit:
    """How stars are measured.

    Attributes
    ----------
    initial, final : str
    radius_px : float
        How far from its expected place a star may lie.
    template : int or None
        Row of the star that the matched filter takes as its template; None: a well-exposed one.
    """

    initial: Initial
    final: str
    radius_px: float
    template: int | None = None

    def __post_init__(self) -> None:
        if self.initial not in INITIAL_METHODS or self.final not in FINAL_METHODS:
            raise SessionError(
                f"unknown method {self.initial!r} / {self.final!r}: initial is one of {', '.join(INITIAL_METHODS)}, "
                f"final one of {', '.join(FINAL_METHODS)}."
            )

    @property
    def coarse(self) -> Initial:
        """The correlation that comes first."""
        return next((method for method in INITIAL_METHODS if method == self.final), self.initial)


def fit_all(
    context: Context, match: FieldMatch, prior: ShapePrior, how: StarFit
) -> tuple[StarCenters, ShapePrior]:
    """Measure all stars of a match at once; return the PSF that they agree on, too."""
    coarse = _coarse(context, match, match.expected_px, prior, how)
    if how.final not in FITTED:
        return coarse, prior
    start = np.where(np.isfinite(coarse.pixel_line), coarse.pixel_line, match.expected_px)
    if how.final == "psf_fit":
        return _psf_fit(context, start), prior
    return fit_stars(
        context.signal_dn,
        context.noise_dn,
        context.not_stars,
        start,
        prior,
        saturated=context.frame.saturated,
        noise_model=context.noise_model,
    )


def fit_some(
    context: Context, match: FieldMatch, rows: IntArray, psf: ShapePrior, psf_error: float, how: StarFit
) -> StarCenters:
    """Measure the stars `rows` (k,) of a match with a known PSF; neighbors are fitted with them, but not returned."""
    near = _with_neighbors(match.expected_px, rows, 2.0 * default_box_px(psf.sigma_px))
    expected = match.expected_px[near]
    coarse = _coarse(context, match, expected, psf, how)
    if how.final in FITTED:
        start = np.where(np.isfinite(coarse.pixel_line), coarse.pixel_line, expected)
        coarse = (
            _psf_fit(context, start)
            if how.final == "psf_fit"
            else fit_gaussian(
                context.signal_dn,
                context.noise_dn,
                context.not_stars,
                start,
                psf,
                saturated=context.frame.saturated,
                noise_model=context.noise_model,
                psf_error=psf_error,
            )
        )
    return taken(coarse, np.arange(len(rows)))


def _with_neighbors(places: FloatArray, rows: IntArray, reach_px: float) -> IntArray:
    """Return `rows`, then the rows of all stars near one of them."""
    distance = np.hypot(*(places[:, None] - places[rows][None]).transpose(2, 0, 1))
    with np.errstate(invalid="ignore"):
        near = np.flatnonzero((distance < reach_px).any(axis=1))
    return np.concatenate([rows, np.setdiff1d(near, rows)])


def _coarse(
    context: Context, match: FieldMatch, expected: FloatArray, prior: ShapePrior, how: StarFit
) -> StarCenters:
    return correlate(
        context.signal_dn,
        context.noise_dn,
        context.not_stars,
        expected,
        _template(context, match, prior, how),
        search_radius_px=how.radius_px,
        method=how.coarse,
        saturated=context.frame.saturated,
    )


def _psf_fit(context: Context, start: FloatArray) -> StarCenters:
    return fit_psf(
        context.signal_dn,
        context.noise_dn,
        context.not_stars,
        start,
        context.camera.psf_model,
        saturated=context.frame.saturated,
        noise_model=context.noise_model,
    )


def _template(context: Context, match: FieldMatch, prior: ShapePrior, how: StarFit) -> Template:
    """A Gaussian for cross-correlation; for the matched filter a well-exposed star of this picture, if there is one."""
    gaussian = gaussian_template(prior.sigma_px, default_box_px(prior.sigma_px))
    chosen: BoolArray = match.visible
    if how.template is not None:
        chosen = np.arange(len(match.visible)) == how.template
    if how.coarse == "cross_correlation" or not chosen.any():
        return gaussian
    centers = correlate(
        context.signal_dn,
        context.noise_dn,
        context.not_stars,
        match.expected_px[chosen],
        gaussian,
        search_radius_px=match.radius_px,
        saturated=context.frame.saturated,
    )
    clean = centers.usable & (centers.flags == 0)
    if how.template is None:
        clean &= centers.snr > TEMPLATE_SNR
    if not clean.any():
        return gaussian
    best = int(np.argmax(np.where(clean, centers.snr, -np.inf)))
    radius = default_box_px(prior.sigma_px) / 2.0
    return extract_template(context.signal_dn, context.not_stars, centers.pixel_line[best], radius)


# -- rows of centers -----------------------------------------------------------------------------------------------

NOT_MEASURED = {"flags": int(StarFlag.NOT_FINITE), "degrees_of_freedom": 0.0}
PER_STAR = tuple(
    field.name for field in fields(StarCenters) if field.name not in ("method", "psf_error", "images")
)


def taken(centers: StarCenters, rows: IntArray) -> StarCenters:
    """Return some rows of centers."""
    images = centers.images
    if images is not None:
        images = replace(
            images, **{f.name: v[rows] for f in fields(images) if (v := getattr(images, f.name)) is not None}
        )
    return replace(centers, images=images, **{name: getattr(centers, name)[rows] for name in PER_STAR})


def scattered(base: StarCenters | None, n: int, rows: IntArray, fresh: StarCenters) -> StarCenters:
    """Return the centers of n stars: `fresh` in `rows`, those of `base` (its rows come first) elsewhere, else none."""
    columns: dict[str, Any] = {}
    for name in PER_STAR:
        new = getattr(fresh, name)
        column = np.full((n, *new.shape[1:]), NOT_MEASURED.get(name, np.nan)).astype(new.dtype)
        if base is not None:
            column[: len(base)] = getattr(base, name)
        column[rows] = new
        columns[name] = column
    images = _scattered_images(None if base is None else base.images, n, rows, fresh.images)
    kept = fresh if base is None else base
    return replace(kept, images=images, **columns)


def _scattered_images(
    base: StarImages | None, n: int, rows: IntArray, fresh: StarImages | None
) -> StarImages | None:
    if fresh is None:
        return None
    size = max(fresh.size, 0 if base is None else base.size)
    first = np.zeros((n, 2), dtype=np.int64)
    planes = {name: np.full((n, size, size), empty) for name, empty in (("data_dn", np.nan), ("model_dn", np.nan),
              ("sigma_dn", np.inf))}  # fmt: skip
    for images, at in ((base, np.arange(0 if base is None else len(base))), (fresh, rows)):
        if images is None:
            continue
        first[at] = images.first
        for name, plane in planes.items():
            plane[at] = {"sigma_dn": np.inf}.get(name, np.nan)
            plane[at, : images.size, : images.size] = getattr(images, name)
    return StarImages(first=first, **planes)
