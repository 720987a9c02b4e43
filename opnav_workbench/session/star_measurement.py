"""Stars measured at the places where they are expected, and the status that each measurement earns.

Centers come coarse from correlation, then from least squares; for all stars of a picture at once, with the PSF they
agree on, or for a few with a known PSF, their neighbors fitted along.  A star has the status of the first rule that
concerns it: off the detector, behind a body, saturated, too faint, too far from its place, not converged, cosmic ray,
blended, of the wrong brightness; else it is used.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, get_args
from weakref import WeakKeyDictionary

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray
from opnav_workbench.errors import CenterfindingError, SessionError
from opnav_workbench.session.context import Context, zero_point_mag
from opnav_workbench.session.star_field import star_detections, unusable
from opnav_workbench.session.state import FieldMatch, StarStatus
from opnav_workbench.stars import (
    ExpectedPlaces,
    ShapePrior,
    StarCenters,
    StarFlag,
    StarImages,
    StarTemplate,
    correlate,
    default_box_px,
    extract_template,
    fit_gaussian,
    fit_psf,
    fit_stars,
    fit_wings,
    gaussian_template,
    shape_from_stars,
    strange_images,
    with_companions,
)

__all__ = [
    "FINAL_METHODS",
    "FinalMethod",
    "InitialMethod",
    "StarFitOptions",
    "centers_with_rows",
    "fit_all",
    "fit_some",
    "star_statuses",
    "told_apart",
]


InitialMethod = Literal["matched_filter", "cross_correlation"]
INITIAL_METHODS: tuple[InitialMethod, ...] = get_args(InitialMethod)
LEAST_SQUARES = "least_squares"
FITTED_METHODS = ("least_squares", "psf_fit")  # neighbors are fitted together
FinalMethod = Literal["least_squares", "psf_fit", "matched_filter", "cross_correlation"]
FINAL_METHODS: tuple[FinalMethod, ...] = get_args(FinalMethod)
FIELD_STARS = 3  # whose first centers tell where the field lies
STRAY_PX = 1.5  # a first center farther off the field than this may be that of a hit beside the star
MOST_TEMPLATES = 4  # stars tried as a template, brightest first
TEMPLATE_ANSWER = 0.85  # of the other stars' SNR with a Gaussian that a template must give them
TEMPLATE_SNR = 50.0  # a template's own noise must not matter beside that of the stars it finds


@dataclass(frozen=True, slots=True)
class StarFitOptions:
    """How stars are measured.

    Attributes
    ----------
    initial, final : str
    radius_px
        How far from its expected place a star may lie.
    template
        Row of the star that the matched filter takes as its template; None: a well-exposed one.
    """

    initial: InitialMethod
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
    def coarse(self) -> InitialMethod:
        """The correlation that comes first."""
        return next((method for method in INITIAL_METHODS if method == self.final), self.initial)


def fit_all(
    context: Context,
    match: FieldMatch,
    prior: ShapePrior,
    options: StarFitOptions,
    place_sigma_px: FloatArray,
) -> tuple[StarCenters, ShapePrior]:
    """Measure all stars of a match at once; return the PSF that they agree on, too.

    `place_sigma_px` (n,) tells how well the catalog knows the stars' places, up to a shift of all; infinite: not at all.
    """
    coarse = _coarse(context, match, match.expected_px, prior, options)
    if options.final not in FITTED_METHODS:
        return coarse, prior
    start = np.where(np.isfinite(coarse.pixel_line), coarse.pixel_line, match.expected_px)
    if options.final == "psf_fit":
        return with_flanks(context, _psf_fit(context, start), start, prior), prior
    centers, psf = fit_stars(
        context.signal_dn,
        context.noise_dn,
        unusable(context),
        start,
        prior,
        saturated=context.picture.saturated,
        noise_model=context.noise_model,
        places=ExpectedPlaces(match.expected_px, place_sigma_px),
        kept=context.camera.effective_psf,
    )
    return with_flanks(context, centers, start, psf), psf


def fit_some(
    context: Context,
    match: FieldMatch,
    rows: IntArray,
    psf: ShapePrior,
    psf_error: float,
    options: StarFitOptions,
) -> StarCenters:
    """Measure the stars `rows` (k,) of a match with a known PSF; neighbors are fitted with them, but not returned."""
    near = _with_neighbors(match.expected_px, rows, 2.0 * default_box_px(psf.sigma_px))
    expected = match.expected_px[near]
    coarse = _coarse(context, match, expected, psf, options)
    if options.final in FITTED_METHODS:
        start = np.where(np.isfinite(coarse.pixel_line), coarse.pixel_line, expected)
        coarse = (
            _psf_fit(context, start)
            if options.final == "psf_fit"
            else fit_gaussian(
                context.signal_dn,
                context.noise_dn,
                unusable(context),
                start,
                psf,
                saturated=context.picture.saturated,
                noise_model=context.noise_model,
                psf_error=psf_error,
            )
        )
        coarse = with_flanks(context, coarse, start, psf)
    return center_rows(coarse, np.arange(len(rows)))


def with_flanks(context: Context, centers: StarCenters, start: FloatArray, psf: ShapePrior) -> StarCenters:
    """Return centers in which stars with saturated cores are measured by the flanks and wings of their images.

    Those that cannot be keep the center of the ordinary fit, which nobody uses unless the analyst accepts it.
    """
    rows = np.flatnonzero(_has(centers.flags, StarFlag.SATURATED))
    if len(rows) == 0:
        return centers
    found = np.isfinite(centers.pixel_line[rows])
    wings = fit_wings(
        context.signal_dn,
        context.noise_dn,
        unusable(context),
        context.picture.saturated,
        np.where(found, centers.pixel_line[rows], start[rows]),
        psf,
        noise_model=context.noise_model,
        neighbors_px=start[np.isfinite(start).all(axis=1)],
    )
    rows, wings = rows[wings.measured], wings.take(wings.measured)
    columns = {
        "pixel_line": wings.pixel_line,
        "covariance_px2": wings.covariance_px2,
        "flux_dn": wings.flux_dn,
        "flux_sigma_dn": wings.flux_sigma_dn,
        "snr": wings.flux_dn / wings.flux_sigma_dn,
        "flags": (centers.flags[rows] & int(StarFlag.EDGE)) | int(StarFlag.SATURATED | StarFlag.FLANKS),
    }
    changed: dict[str, Any] = {name: np.array(getattr(centers, name)) for name in columns}
    for name, values in columns.items():
        changed[name][rows] = values
    if centers.common_px is not None:
        changed["common_px"] = np.array(centers.common_px)
        changed["common_px"][rows] = 0.0
    return replace(centers, **changed)


def told_apart(
    context: Context, mag: FloatArray, centers: StarCenters, rows: IntArray, psf: ShapePrior
) -> StarCenters:
    """Return centers of which those of `rows` (k,) that may be two images, one in no catalog, say so.

    `mag` (n,) are those of the catalog, `psf` is what the picture's stars agree on.
    """
    if centers.method != LEAST_SQUARES:
        return centers
    return with_companions(
        context.signal_dn,
        context.noise_dn,
        unusable(context),
        centers,
        rows,
        mag,
        lambda: _psf_of_unlisted(context, centers),
        psf,
        saturated=context.picture.saturated,
        noise_model=context.noise_model,
        zero_point_mag=zero_point_mag(context),
    )


WITNESSES = 12  # detections that tell the PSF where the catalog lists few stars
_TOLD_BY: WeakKeyDictionary[Context, dict[bytes, ShapePrior]] = WeakKeyDictionary()


def _psf_of_unlisted(context: Context, centers: StarCenters) -> ShapePrior:
    """Return the camera's PSF with what the picture's brightest detections that no catalog lists say of it."""
    prior, detections = context.camera_psf, star_detections(context)
    listed = centers.pixel_line[np.isfinite(centers.pixel_line).all(axis=1)]
    apart = np.hypot(*(detections.pixel_line[:, None] - listed).transpose(2, 0, 1)).min(
        axis=1, initial=np.inf
    )
    unlisted = (apart > default_box_px(prior.sigma_px)) & ((detections.flags & int(StarFlag.COSMIC_RAY)) == 0)
    places = detections.pixel_line[unlisted][:WITNESSES]
    if len(places) == 0:
        return prior
    told = _TOLD_BY.setdefault(context, {})
    witnesses = places.tobytes()
    if (
        witnesses not in told
    ):  # a picture's stars are found again once its pointing is known, with the same witnesses
        fitted = fit_gaussian(
            context.signal_dn,
            context.noise_dn,
            unusable(context),
            places,
            prior,
            saturated=context.picture.saturated,
            noise_model=context.noise_model,
        )
        told[witnesses] = shape_from_stars(fitted, prior)
    return told[witnesses]


def _with_neighbors(places: FloatArray, rows: IntArray, reach_px: float) -> IntArray:
    """Return `rows`, then the rows of all stars near one of them."""
    distance = np.hypot(*(places[:, None] - places[rows][None]).transpose(2, 0, 1))
    with np.errstate(invalid="ignore"):
        near = np.flatnonzero((distance < reach_px).any(axis=1))
    return np.concatenate([rows, np.setdiff1d(near, rows)])


def _coarse(
    context: Context, match: FieldMatch, expected: FloatArray, prior: ShapePrior, options: StarFitOptions
) -> StarCenters:
    """First centers: the brightest within reach, but where the field as a whole lies for stars that have one there."""
    template = _template(context, match, prior, options)
    first = _correlated(context, expected, template, options.radius_px, options.coarse)
    offset = np.where(first.usable[:, None], first.pixel_line - expected, np.nan)
    if np.count_nonzero(first.usable) < FIELD_STARS:
        return first
    middle = np.nanmedian(offset, axis=0)
    strays = np.flatnonzero(np.hypot(*(offset - middle).T) > STRAY_PX)
    if len(strays) == 0:
        return first
    near = _correlated(context, expected[strays] + middle, template, STRAY_PX, options.coarse)
    seen = near.usable & (near.snr >= context.settings.min_snr)
    return centers_with_rows(first, len(first), strays[seen], center_rows(near, np.flatnonzero(seen)))


def _correlated(
    context: Context,
    places: FloatArray,
    template: StarTemplate,
    radius_px: float,
    method: InitialMethod = "matched_filter",
) -> StarCenters:
    return correlate(
        context.signal_dn,
        context.noise_dn,
        unusable(context),
        places,
        template,
        search_radius_px=radius_px,
        method=method,
        saturated=context.picture.saturated,
    )


def _psf_fit(context: Context, start: FloatArray) -> StarCenters:
    return fit_psf(
        context.signal_dn,
        context.noise_dn,
        unusable(context),
        start,
        context.camera.psf_model,
        saturated=context.picture.saturated,
        noise_model=context.noise_model,
    )


def _template(
    context: Context, match: FieldMatch, prior: ShapePrior, options: StarFitOptions
) -> StarTemplate:
    """A Gaussian for cross-correlation; for the matched filter a well-exposed star of this picture, if there is one."""
    gaussian = gaussian_template(prior.sigma_px, default_box_px(prior.sigma_px))
    chosen: BoolArray = match.visible
    if options.template is not None:
        chosen = np.arange(len(match.visible)) == options.template
    if options.coarse == "cross_correlation" or not chosen.any():
        return gaussian
    centers = _correlated(context, match.expected_px[chosen], gaussian, match.radius_px)
    clean = centers.usable & (centers.flags == 0)
    if options.template is None:
        clean &= centers.snr > TEMPLATE_SNR
    radius = default_box_px(prior.sigma_px) / 2.0
    for best in sorted(np.flatnonzero(clean), key=lambda star: -centers.snr[star])[:MOST_TEMPLATES]:
        try:
            template = extract_template(
                context.signal_dn, unusable(context), centers.pixel_line[best], radius
            )
        except CenterfindingError:  # pixels around it are masked
            if options.template is not None:
                raise
            continue
        others = np.setdiff1d(np.flatnonzero(clean), [best])
        if options.template is not None or _is_like(context, template, center_rows(centers, others), match):
            return template
    return gaussian


def _is_like(context: Context, template: StarTemplate, others: StarCenters, match: FieldMatch) -> bool:
    """Tell whether stars that a Gaussian found answer to a star's image as well: a hit beside it is in no other."""
    if len(others) == 0:
        return True
    again = _correlated(context, others.pixel_line, template, match.radius_px)
    return bool(np.nanmedian(again.snr / others.snr) >= TEMPLATE_ANSWER)


# -- rows of centers -----------------------------------------------------------------------------------------------

NOT_MEASURED = {"flags": int(StarFlag.NOT_FINITE), "degrees_of_freedom": 0.0}
PER_STAR = tuple(
    field.name
    for field in fields(StarCenters)
    if field.name not in ("method", "psf_error", "images", "common_px")
)


def center_rows(centers: StarCenters, rows: IntArray) -> StarCenters:
    """Return some rows of centers."""
    images = centers.images
    if images is not None:
        images = replace(
            images, **{f.name: v[rows] for f in fields(images) if (v := getattr(images, f.name)) is not None}
        )
    common = None if centers.common_px is None else centers.common_px[rows]
    columns = {name: getattr(centers, name)[rows] for name in PER_STAR}
    return replace(centers, images=images, common_px=common, **columns)


def centers_with_rows(base: StarCenters | None, n: int, rows: IntArray, fresh: StarCenters) -> StarCenters:
    """Return the centers of n stars: `fresh` in `rows`, those of `base` (its rows come first) elsewhere, else none."""
    columns: dict[str, Any] = {}
    for name in PER_STAR:
        new = getattr(fresh, name)
        column = np.full((n, *new.shape[1:]), NOT_MEASURED.get(name, np.nan)).astype(new.dtype)
        if base is not None:
            column[: len(base)] = getattr(base, name)
        column[rows] = new
        columns[name] = column
    images = _images_with_rows(None if base is None else base.images, n, rows, fresh.images)
    kept = fresh if base is None else base
    common = _common_with_rows(None if base is None else base.common_px, n, rows, fresh.common_px)
    return replace(kept, images=images, common_px=common, **columns)


def _common_with_rows(
    base: FloatArray | None, n: int, rows: IntArray, fresh: FloatArray | None
) -> FloatArray | None:
    """Errors that stars share: those measured now have them only if theirs are of the same PSF."""
    if base is None:
        return None
    column = np.zeros((n, *base.shape[1:]))
    column[: len(base)] = base
    column[rows] = fresh if fresh is not None and fresh.shape[1:] == base.shape[1:] else 0.0
    return column


def _images_with_rows(
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


# ---- What is to be thought of each star's center: its status, and why.

UNSEPARATED_SIGMAS = (
    1.5  # a joint fit tells stars apart that are farther from each other than this, in sigmas of the PSF
)
MIN_STARS_FOR_ZERO_POINT = 4  # a median of fewer follows a single wrong star
SATURATED_CORE = "its core is saturated and too little of the star around it; accept_stars takes it as fitted"
StatusRule = tuple[BoolArray, str, Callable[[int], str]]  # whom it concerns, status, and why
NOT_CONVERGED = StarFlag.NOT_CONVERGED | StarFlag.NOT_FINITE


def star_statuses(
    context: Context,
    mag: FloatArray,
    match: FieldMatch,
    centers: StarCenters,
    psf: ShapePrior,
    options: StarFitOptions,
    occulting: Sequence[str],
) -> tuple[StarStatus, ...]:
    """Give every star its status, the first that applies.

    Parameters
    ----------
    mag : (n,) array
        Predicted magnitudes.
    match
        Where the stars were expected.
    centers
        (n,) measured with `psf` as `options` say.
    occulting : (n,) sequence of str
        Body that stands before each star; empty for none.
    """
    settings, radius_px = context.settings, options.radius_px
    blend_px = (
        UNSEPARATED_SIGMAS * psf.sigma_px if options.final in FITTED_METHODS else settings.blend_radius_px
    )
    blended = _blended(match.expected_px, mag, blend_px, settings.blend_magnitude)
    moved = np.hypot(*(centers.pixel_line - match.expected_px).T)
    magnitude_error = _magnitude_error(context, mag, centers, match)
    snr, flags = centers.snr, centers.flags
    with np.errstate(invalid="ignore"):
        faint = ~(np.isfinite(snr) & (snr >= settings.min_snr))
        far = moved > radius_px + 1.0
    saturated, flanks = _has(flags, StarFlag.SATURATED), _has(flags, StarFlag.FLANKS)
    # Of a saturated star a part of the light is known: it may be brighter than measured.
    fainter = np.where(saturated, 0.0, magnitude_error)
    fitted = options.final in FITTED_METHODS  # a correlation leaves what it leaves: it fits no PSF
    strange = fitted & strange_images(centers) & ~saturated & ~_has(flags, StarFlag.PAIR)
    unlike = np.maximum(fainter, -magnitude_error) > settings.max_magnitude_error
    rules: tuple[StatusRule, ...] = (
        (~match.visible, "off_detector", lambda _: "outside the detector with the pointing found"),
        (_on_bodies(context, match), "not_detected", lambda _: "behind a body, or lost in its light"),
        (saturated & ~flanks, "saturated", lambda _: SATURATED_CORE),
        (faint & _occulted(occulting), "not_detected", lambda i: f"behind {occulting[i]}"),
        (faint, "not_detected", lambda i: f"SNR {snr[i]:.1f} is below {settings.min_snr:g}"),
        (far, "not_detected", lambda _: f"nothing within {radius_px:.1f} px of its expected place"),
        (_has(flags, NOT_CONVERGED), "rejected", lambda _: "the fit did not converge"),
        (_has(flags, StarFlag.COSMIC_RAY), "rejected", lambda _: "sharper than a star can be: a cosmic ray"),
        (
            strange,
            "rejected",
            lambda _: "its image is not that of the other stars: a cosmic ray on it, or taken for it",
        ),
        (blended, "blended", lambda _: f"another star within {blend_px:.1f} px"),
        (unlike, "rejected", lambda i: f"{magnitude_error[i]:+.1f} mag off its catalog brightness"),
    )
    return tuple(_first_rule(rules, i) for i in range(len(mag)))


def _first_rule(rules: Sequence[StatusRule], i: int) -> StarStatus:
    for holds, status, reason in rules:
        if holds[i]:
            return StarStatus(status, reason(i))
    return StarStatus("used")


def _occulted(occulting: Sequence[str]) -> BoolArray:
    return np.array([bool(name) for name in occulting], dtype=bool)


def _has(flags: IntArray, wanted: StarFlag) -> BoolArray:
    return np.asarray((flags & int(wanted)) != 0)


def _on_bodies(context: Context, match: FieldMatch) -> BoolArray:
    """Tell which stars are expected where a body's light covers the picture."""
    n_line, n_pixel = context.extended.shape
    seen = match.visible & np.isfinite(match.expected_px).all(axis=1)
    pixel, line = np.rint(np.where(seen[:, None], match.expected_px, 0.0)).astype(int).T
    covered = context.extended[np.clip(line, 0, n_line - 1), np.clip(pixel, 0, n_pixel - 1)]
    return np.asarray(seen & covered)


def _blended(pixel_line: FloatArray, mag: FloatArray, radius_px: float, fainter_by: float) -> BoolArray:
    distance = np.hypot(*(pixel_line[:, None] - pixel_line[None]).transpose(2, 0, 1))
    near = (distance < radius_px) & ~np.eye(len(mag), dtype=bool)
    matters: BoolArray = (near & (mag[None, :] < mag[:, None] + fainter_by)).any(axis=1)
    return matters


def _magnitude_error(
    context: Context, mag: FloatArray, centers: StarCenters, match: FieldMatch
) -> FloatArray:
    """Magnitude from the fitted flux minus the catalog's, about the frame's median (or the camera's zero point)."""
    exposure_s = context.picture.exposure_s
    timed = exposure_s > 0.0  # where no word tells it, the frame's median does without
    with np.errstate(invalid="ignore"):
        good = match.visible & (centers.snr > context.settings.min_snr) & (centers.flux_dn > 0.0)
        rate = np.where(centers.flux_dn > 0.0, centers.flux_dn, np.nan) / (exposure_s if timed else 1.0)
    error = -2.5 * np.log10(rate) - mag
    whole = good & ~_has(centers.flags, StarFlag.SATURATED)
    if whole.sum() >= MIN_STARS_FOR_ZERO_POINT:
        error = error - np.median(error[whole])
    elif timed and context.camera.zero_point_mag is not None:
        error = error + context.camera.zero_point_mag
    else:
        error = np.zeros_like(error)
    return np.where(np.isfinite(error), error, np.inf)
