"""A disk in the picture, measured: what every method that reads a limb begins from.

Flow   sky and clipped pixels made sure of -> place (`opnav_workbench.bodies.place`) -> usable pixels -> fit -> cosmic rays
       and stars out, fit again -> limb crossed with the fitted light -> from there fit again, where both differ -> along its
       own light, where that was extrapolated -> a small one with other sizes
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import softmax

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodies.crossings import (
    HALF_PX,
    INTERPOLATED_VARIANCE,
    CrossingFit,
    Profiles,
    cross_limb,
    fit_crossings,
)
from opnav_workbench.bodies.disk.columns import Unknown
from opnav_workbench.bodies.disk.fit import WANDERED_SHARE
from opnav_workbench.bodies.disk.fitted import DiskFit
from opnav_workbench.bodies.disk.limb_light import PLANES, psf_variance
from opnav_workbench.bodies.disk.pixel_by_pixel import likelier, seen_about
from opnav_workbench.bodies.disk.problem import PLACE_SIGMAS
from opnav_workbench.bodies.disk.starts import START_SIZES, fit_disk, is_wider
from opnav_workbench.bodies.neighbours import without_others
from opnav_workbench.bodies.picture import BodyPicture, Circle
from opnav_workbench.bodies.place import BodyPlace, find_place, is_pointlike, without_stars
from opnav_workbench.bodies.results import BodyCenter, BodyFlag
from opnav_workbench.bodies.silhouette import Outline
from opnav_workbench.bodies.spilled import without_filled, without_spilled
from opnav_workbench.bodies.subarray import (
    Cutout,
    choose_subarray,
    edge_reach,
    find_hit_pixels,
    outline_radius_px,
    search_radius,
)
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.image import darkest_sky
from opnav_workbench.threads import one_thread

__all__ = [
    "MeasuredDisk",
    "alike",
    "crossing_covariance",
    "disk_at",
    "measure_disk",
    "placed_body",
    "same_center",
    "sigmas_apart",
    "with_true_sky",
]

FAR_SIZES = 10.0  # detectors
LEAST_DIAMETER_PX = 0.5  # the method of choice begins at 1 px of another measure of the size


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredDisk:
    """A fitted disk, and what was looked for.

    Attributes
    ----------
    circle
        An analyst's, if there was one.
    search_px
        How far from the expected place to look; None: anywhere.
    place
        From which the fit began.
    hits : (n_line, n_pixel) array of bool
        Pixels whose light is not the body's.
    crossing
        Step, size and strain from the fit to where rays cross the limb; None where too few do.
    """

    picture: BodyPicture
    name: str
    circle: Circle | None
    search_px: float | None
    place: BodyPlace
    fit: DiskFit
    pixels: Cutout
    hits: BoolArray
    crossing: CrossingFit | None

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def radius_px(self) -> float:
        """Of the disk."""
        return 0.5 * self.fit.outline.diameter_px

    @property
    def log_size(self) -> tuple[float, float]:
        """Logarithm of the size over the model's, and its sigma."""
        return self.fit.shape.log_size, self.fit.sigma(Unknown.SIZE)

    @property
    def relief_share(self) -> float:
        """How far most of the limb is from any outline of the model's kind, beyond noise and pattern, over the radius."""
        return 0.0 if self.crossing is None else self.crossing.relief_px / self.radius_px

    @property
    def is_rough(self) -> bool:
        """Whether the limb is rougher by far than was stated of the body."""
        return self.relief_share > ROUGHER * self.picture.model(self.name).figure.limb_roughness

    @property
    def relief_px2(self) -> FloatArray:
        """Covariance (2, 2) of the center by a limb that is not the model's, which no fit with the model knows of."""
        return np.zeros((2, 2)) if self.crossing is None else self.crossing.relief_px2

    @property
    def hidden_px2(self) -> FloatArray:
        """Covariance (2, 2) of the center by what charge hides of an overexposed body."""
        return _hidden_px2(self.picture, self.fit)

    @property
    def expected_px(self) -> FloatArray:
        """Where the body was looked for (2,)."""
        return self.picture.center_px(self.name) if self.circle is None else self.circle.center_px


@one_thread()
def measure_disk(
    picture: BodyPicture,
    name: str,
    method: str,
    circle: Circle | None,
    search_px: float | None,
    *,
    quick: bool = False,
) -> MeasuredDisk | BodyCenter:
    """Find a body and fit its disk; a `BodyCenter` of the method without a center where that cannot be.

    Parameters
    ----------
    quick
        Leave out the fits that begin elsewhere than where the body is found.

    Raises
    ------
    CenterfindingError
        No such body in the picture.
    """
    picture = with_true_sky(picture)
    place = placed_body(picture, name, method, circle, search_px)
    if isinstance(place, BodyCenter):
        return place
    return disk_at(picture, place, name, method, circle, search_px, quick=quick)


@one_thread()
def disk_at(
    picture: BodyPicture,
    place: BodyPlace,
    name: str,
    method: str,
    circle: Circle | None,
    search_px: float | None,
    *,
    quick: bool = False,
) -> MeasuredDisk | BodyCenter:
    """Fit the disk of a body that `placed_body` has found; parameters as of `measure_disk`.

    A limb that is rougher than anybody has stated is asked once more: what lay too far off an outline to be believed is
    its relief.
    """
    seen = without_spilled(picture, picture.diameter_px(name) * place.size_ratio)
    try:
        disk = MeasuredDisk(seen, name, circle, search_px, place, *_fitted(seen, name, place, quick=quick))
    except CenterfindingError as error:
        return BodyCenter.without_center(name, method, "failed", str(error))
    return disk if quick or not disk.is_rough else _as_rough_as_it_shows(disk, method)


def _fitted(
    picture: BodyPicture, name: str, place: BodyPlace, *, quick: bool
) -> tuple[DiskFit, Cutout, BoolArray, CrossingFit | None]:
    """Fit a disk whose limb is as rough as its model has it; the last fields of a `MeasuredDisk`."""
    pixels = _usable(picture, name, place)
    fit = fit_disk(picture, name, place, pixels, elsewhere=not quick)
    hits = _hits(fit, pixels)
    if hits.any():
        pixels = replace(pixels, use=pixels.use & ~hits)
        fit = fit_disk(picture, name, place, pixels, fit, elsewhere=not quick)
    crossing = read_crossings(picture, fit)
    if not quick:
        if crossing is not None and not (fit.converged and alike(fit, crossing)):
            fit, crossing = _from_crossings(picture, name, pixels, fit, crossing)
        if fit.extrapolated:
            fit, crossing = _along_its_light(picture, name, pixels, fit, crossing)
        fit = _over_sizes(picture, name, place, pixels, fit)
    return fit.less_sure(_hidden_px2(picture, fit)), pixels, hits, crossing


# Of a turn; of the radius, where no limb is seen at all.
HIDDEN_LIMB, HIDDEN_PLACE = 0.15, 0.6


def _hidden_px2(picture: BodyPicture, fit: DiskFit) -> FloatArray:
    """Return what charge hides of the center (2, 2) of an overexposed body of which it leaves hardly any limb.

    The body lies in that charge, its wings tell about where; no reading of a few pixels beside it knows anything of that.
    """
    if picture.spilled is None or fit.lit_share > HIDDEN_LIMB:
        return np.zeros((2, 2))
    share = HIDDEN_PLACE * (1.0 - 0.5 * fit.lit_share / HIDDEN_LIMB)
    return np.asarray((share * 0.5 * fit.outline.diameter_px) ** 2 * np.eye(2))


def _as_rough_as_it_shows(disk: MeasuredDisk, method: str) -> MeasuredDisk:
    """Return the disk found and fitted anew, half of the difference in its covariance; as it is where that cannot be."""
    picture, name = disk.picture, disk.name
    model = picture.model(name)
    figure = replace(model.figure, limb_roughness=min(disk.relief_share, ROUGHEST))
    rough = picture.with_model(replace(model, figure=figure))
    place = placed_body(rough, name, method, disk.circle, disk.search_px)
    if isinstance(place, BodyCenter):
        return disk
    try:
        fit, pixels, hits, crossing = _fitted(rough, name, place, quick=False)
    except CenterfindingError:
        return disk
    away = WANDERED_SHARE * (fit.center_px - disk.fit.center_px)
    fit = fit.less_sure(np.outer(away, away))
    return replace(disk, place=place, fit=fit, pixels=pixels, hits=hits, crossing=crossing)


def placed_body(
    picture: BodyPicture, name: str, method: str, circle: Circle | None, search_px: float | None
) -> BodyPlace | BodyCenter:
    """Find where a body stands in a picture as of `with_true_sky`; a `BodyCenter` without a center where it is not seen.

    Parameters as of `measure_disk`.
    """
    if (why := _unsuitable(picture, name)) is not None:
        return BodyCenter.without_center(name, method, "failed", why)
    if (beside := _beside_the_detector(picture, name, circle, search_px)) is not None:
        return BodyCenter.without_center(name, method, "off_detector", beside)
    try:
        place = find_place(picture, name, circle, search_px)
    except CenterfindingError as error:
        return BodyCenter.without_center(name, method, "failed", str(error))
    if place is not None:
        return place
    seen = picture.shown(choose_subarray(picture, name, circle, 0.0).slices)
    if (
        seen.size and not seen.any()
    ):  # beside the detector, where a body may end, there are none to be unusable
        nowhere = "no usable pixels where it is expected"
        return BodyCenter.without_center(name, method, "failed", nowhere, flags=int(BodyFlag.EMPTY))
    if (hidden := _hidden_by_charge(picture, name, circle, search_px)) is not None:
        return BodyCenter.without_center(name, method, "saturated", hidden, flags=int(BodyFlag.OVEREXPOSED))
    nothing = "nothing of its size and phase stands out of the sky"
    if circle is not None or search_px is not None:
        nothing += f" within {search_radius(0.0, circle, search_px):.0f} px of its expected place"
    if circle is None and search_px is None and is_pointlike(picture, name):
        nothing += (
            " near its expected place; farther off it may be any of the lights in the picture, give a circle"
        )
    return BodyCenter.without_center(name, method, "not_detected", nothing)


HIDDEN_SHARE = 0.25  # of a body's diameter: what an overexposed one fills is wider


def _hidden_by_charge(
    picture: BodyPicture, name: str, circle: Circle | None, search_px: float | None
) -> str | None:
    """Say that charge of overexposed pixels fills the place where a body is expected; None: it does not."""
    radius = outline_radius_px(picture, name)
    window = choose_subarray(picture, name, circle, search_radius(radius, circle, search_px)).slices
    spilled = without_spilled(picture, 2.0 * (radius if circle is None else circle.radius_px)).spilled
    if spilled is None:
        return None
    spilled = spilled[window]
    columns, lines = (int(np.count_nonzero(spilled.any(axis=axis))) for axis in (0, 1))
    wide, what = min((columns, "columns"), (lines, "lines"))
    if wide <= HIDDEN_SHARE * 2.0 * radius:
        return None
    return f"charge of overexposed pixels fills {wide} {what} where it is expected; take a shorter exposure"


def _unsuitable(picture: BodyPicture, name: str) -> str | None:
    if picture.model(name).is_point:
        return "it has neither radii nor a shape; give them, or use method 'unresolved'"
    diameter = picture.diameter_px(name)
    if 0.0 < diameter < LEAST_DIAMETER_PX:
        return f"it is {diameter:.1f} px wide, too small for a disk (at least {LEAST_DIAMETER_PX:g} px); use 'unresolved'"
    return None


def _beside_the_detector(
    picture: BodyPicture, name: str, circle: Circle | None, search_px: float | None
) -> str | None:
    """Say that a body is expected beside the detector, farther than it is looked for; None: it is not."""
    radius = outline_radius_px(picture, name)
    center = picture.center_px(name) if circle is None else circle.center_px
    size = np.array([picture.camera.n_pixel, picture.camera.n_line])
    if not np.isfinite(center).all():
        return "it is not in front of the camera"
    away = float(np.hypot(*np.maximum(np.maximum(-0.5 - center, center - size + 0.5), 0.0)))
    if away <= radius + search_radius(radius, circle, search_px):
        return None
    where = f"expected at pixel {center[0]:.1f}, line {center[1]:.1f}"
    if np.abs(center).max() > FAR_SIZES * size.max():
        where = "expected far outside the field"
    return f"{where}, {away:.0f} px off the {size[0]} x {size[1]} detector"


STARS_REACHES = 3.0  # a smaller disk may be what was taken for a star, and is none without its pixels


def _usable(picture: BodyPicture, name: str, place: BodyPlace) -> Cutout:
    """Return the picture's planes, without pixels that are bad, saturated, or lit by other bodies or known stars."""
    whole = (0, 0, picture.camera.n_pixel, picture.camera.n_line)
    if picture.diameter_px(name) * place.size_ratio > STARS_REACHES * edge_reach(picture):
        picture = without_stars(picture)
    return without_others(picture, name, place.center_px, whole)


def _hits(fit: DiskFit, pixels: Cutout) -> BoolArray:
    """Return the pixels (n_line, n_pixel) of the strip whose light is not the body's."""
    near = fit.pixels
    residual, weight = np.zeros(pixels.use.shape), np.zeros(pixels.use.shape)
    here = line, pixel = near.index
    model = fit.model_dn()
    residual[here] = pixels.data_dn[here] - model
    light = np.maximum(model - fit.solution.theta[Unknown.LEVEL], 0.0)
    variance = pixels.variance_dn2(light, here) + (fit.prior.grain * light) ** 2
    weight[here] = np.where(pixels.use[here], 1.0 / variance, 0.0)
    if not len(line):
        return np.zeros(pixels.use.shape, dtype=bool)
    part = np.s_[line.min() : line.max() + 1, pixel.min() : pixel.max() + 1]
    out = np.zeros(pixels.use.shape, dtype=bool)
    out[part] = find_hit_pixels(residual[part], weight[part])
    return out


ROUGHER = 3.0  # than stated
ROUGHEST = 0.2  # of the radius


# ---- Where rays cross the limb, with the light that was fitted: a reading that knows neither weights nor albedo.

FEWEST_CROSSINGS = 12
ALIKE_SIGMAS = 3.5  # of two coordinates: 0.2 % of right answers differ by more
# Farther from crossings than so many sigmas a fit's albedo is asked for what it explains of them; so near, by its own sigmas
# alone, it has to have the limb with it.
EXPLAINED_SIGMAS = 2.0
ALIKE_PX = 0.3  # half of the brightness may lie so far beside the limb; what it is goes into the covariance
UNSURE = (
    "blur",
    "law",
    "law_2",
    "strain_zz",
    "strain_xz",
    "strain_yz",
)  # of the light: near a cusp it moves a crossing
# Of the rays that should cross the limb; where fewer do, it is not where it is expected, and looked for so much of the
# radius farther.
MOSTLY_CROSSED, FAR_SHARE = 0.7, 0.1


def read_crossings(picture: BodyPicture, fit: DiskFit) -> CrossingFit | None:
    """Fit center and outline to where rays cross the limb; None where too few do.

    What the fitted albedo explains of their scatter is no relief, and no other center: patches beside the limb move where
    half of the brightness lies. A fit that stands elsewhere leaves crossings that its albedo does not explain: there is no
    limb where it has one, or light beyond it.
    """
    outline, profiles = fit.smooth_outline, _limb_profiles(fit)
    reach = 3.0 + 3.0 * float(np.max(picture.psf.sigma_px))
    crossings = cross_limb(picture, outline, reach, profiles)
    if np.count_nonzero(crossings.known) < MOSTLY_CROSSED * np.count_nonzero(crossings.expected):
        reach += FAR_SHARE * 0.5 * outline.diameter_px
        crossings = cross_limb(picture, outline, reach, profiles)
    if np.count_nonzero(crossings.known) < FEWEST_CROSSINGS:
        return None
    expected = -np.array([fit.shape.log_size, *fit.shape.strain[:2]])
    rough = fit.prior.rough_px
    read = fit_crossings(crossings, outline, fit.figure, rough, expected, 1.0, far=True)
    agree = alike(fit, read, EXPLAINED_SIGMAS)
    if read.relief_px == 0.0 and agree:
        return read
    patterned = replace(picture, signal_dn=_patterned_dn(picture, fit))
    beyond = crossings.beyond(cross_limb(patterned, outline, reach, profiles))
    if np.count_nonzero(beyond.known) < FEWEST_CROSSINGS:
        return read
    left = fit_crossings(beyond, outline, fit.figure, rough, expected, 1.0)
    # Where even its own light has the limb elsewhere, a fit is not right, and its center may be off in any direction.
    relief = min(left, read, key=lambda each: each.relief_px)
    relief_px2 = relief.relief_px2 + 0.5 * WANDERED_SHARE**2 * float(left.step_px @ left.step_px) * np.eye(2)
    apart = sigmas_apart(left.step_px, fit.covariance_px2)
    # That of a disk of a few widths of the PSF, one for all pieces, would explain anything.
    by_pieces = len(fit.solution.albedo) > 1
    explained = by_pieces and same_center(left.step_px, apart, EXPLAINED_SIGMAS)
    believed = replace(left, patterned=True) if explained and not agree else read
    return replace(believed, relief_px=relief.relief_px, relief_px2=relief_px2)


def _limb_profiles(fit: DiskFit) -> Profiles:
    """Return the fitted light along rays, and with more or less of what is `UNSURE` of it."""
    planes = [PLANES.index(name) for name in UNSURE]
    beyond, modes = _unsure_of(fit)

    def profiles(_: Outline, angle: FloatArray, depth: FloatArray) -> FloatArray:
        places = np.broadcast_arrays(angle[:, None], depth)
        tables = fit.made.light.at(places[0].ravel(), places[1].ravel(), max(planes) + 1)
        light = tables[0] + beyond @ tables[planes]
        light += INTERPOLATED_VARIANCE * tables[planes[0]]  # as the data are, between pixels
        each = [light, *(light + modes @ tables[planes])]
        return np.asarray(np.stack(each).reshape(len(each), *places[0].shape))

    return profiles


def _patterned_dn(picture: BodyPicture, fit: DiskFit) -> FloatArray:
    """Return the picture (n_line, n_pixel) as it would be with the albedo of a fit, and without heights of its limb.

    A patch beside the limb moves where half of the brightness lies as relief does: here it stands by itself.
    """
    here = fit.pixels.index
    smooth = np.array(picture.signal_dn)
    model = seen_about(fit, here, fit.smooth_outline).model_dn()
    smooth[here] = np.minimum(model, picture.saturation_dn)
    return smooth


def _unsure_of(fit: DiskFit) -> tuple[FloatArray, FloatArray]:
    """Return what a solution has of `UNSURE` (p,) beyond its tables, and changes (k, p) of it.

    Of the changes each is one sigma, independent of the others.
    """
    own = [Unknown[name.upper()] for name in UNSURE]
    variance, modes = np.linalg.eigh(fit.solution.covariance[np.ix_(own, own)])
    return (fit.solution.theta - fit.made.tabulated)[own], (modes * np.sqrt(np.maximum(variance, 0.0))).T


def crossing_covariance(scatter_px2: FloatArray) -> FloatArray:
    """Return the covariance (2, 2), px^2, of a center by crossings: scatter, and what half of the brightness may be off."""
    return np.asarray(scatter_px2 + HALF_PX**2 * np.eye(2))


def alike(fit: DiskFit, crossing: CrossingFit | None, most: float = ALIKE_SIGMAS) -> bool:
    """Tell whether two readings of a center are the same, `most` sigmas apart; a missing one is not."""
    if crossing is None:
        return False
    covariance = crossing_covariance(crossing.covariance[:2, :2]) + fit.covariance_px2
    return same_center(crossing.step_px, sigmas_apart(crossing.step_px, covariance), most)


def sigmas_apart(step_px: FloatArray, covariance_px2: FloatArray) -> float:
    """Return the Mahalanobis length of a difference (2,) of two centers with the sum of their covariances."""
    return float(np.sqrt(step_px @ np.linalg.solve(covariance_px2, step_px)))


def same_center(step_px: FloatArray, sigmas: float, most: float = ALIKE_SIGMAS) -> bool:
    """Tell whether two readings that differ by so many px and sigmas are of one center."""
    return sigmas < most or float(np.hypot(*step_px)) < ALIKE_PX


def _from_crossings(
    picture: BodyPicture, name: str, pixels: Cutout, fit: DiskFit, crossing: CrossingFit
) -> tuple[DiskFit, CrossingFit | None]:
    """Return the likelier of a fit and of another that begins where the crossings put the body."""
    size = fit.smooth_outline.diameter_px * np.exp(crossing.log_size) / picture.diameter_px(name)
    sigma = np.sqrt(np.linalg.eigvalsh(crossing_covariance(crossing.covariance[:2, :2]))[-1])
    # It has to stay there: light that one fit was led away by would lead the other.
    place = BodyPlace(
        fit.center_px + crossing.step_px,
        float(np.clip(size, *START_SIZES)),
        1.0,
        center_sigma_px=float(sigma) / PLACE_SIGMAS,
        strain=fit.shape.strain[:2] + crossing.strain,
    )
    return _likelier_one(picture, name, place, pixels, fit, follows_light=False) or (fit, crossing)


def _along_its_light(
    picture: BodyPicture, name: str, pixels: Cutout, fit: DiskFit, crossing: CrossingFit | None
) -> tuple[DiskFit, CrossingFit | None]:
    """Return a fit that goes along its own light, if that explains more and the crossings confirm it; else the fit.

    Where it explains more and is not confirmed, neither is known to be right: half of the way to it is uncertain. One that
    is led away by light of no model explains more as well, but hardly knows the center any longer.
    """
    found = _likelier_one(picture, name, fit.place, pixels, fit, follows_light=True)
    if found is None:
        return fit, crossing
    other, reading = found
    if is_wider(other.known_px2, fit.known_px2) or not other.converged:
        return fit, crossing
    if alike(other, reading):
        return found
    away = WANDERED_SHARE * (other.center_px - fit.center_px)
    return fit.less_sure(np.outer(away, away)), crossing


def _fit_from(
    picture: BodyPicture, name: str, place: BodyPlace, pixels: Cutout, followed: DiskFit | None = None
) -> DiskFit | None:
    """Return a fit, one that goes on along its own light from another if that is given; None where there can be none."""
    try:
        return fit_disk(picture, name, place, pixels, followed, follows_light=followed is not None)
    except CenterfindingError:
        return None


def _likelier_one(
    picture: BodyPicture,
    name: str,
    place: BodyPlace,
    pixels: Cutout,
    fit: DiskFit,
    *,
    follows_light: bool,
) -> tuple[DiskFit, CrossingFit | None] | None:
    """Return another fit, and its crossings, if it explains the picture better than the one there is.

    One that follows its light goes on from there.
    """
    other = _fit_from(picture, name, place, pixels, fit if follows_light else None)
    if other is None or likelier(pixels, fit, other) is fit:
        return None
    return other, read_crossings(picture, other)


# Of a disk that is not much wider than the PSF, size, law, patches and place explain each other along a bent valley; a
# solution knows its slope where it stands. Sizes, in sigmas of what is known of them:
SIZES = (-1.5, -0.5, 0.5, 1.5)
SMALL_WIDTHS = 8.0  # of the PSF, radius: larger disks have a limb that tells their size
LEAST_GROWTH_PX = 0.02  # of the radius, for a size that is not known
# Likelihoods of two fits differ by some units for their cells alone; and by the more for patches, which are no Gaussian
# field, the stronger they are (by the albedo of the fit: of 300 disks of 1 to 9 px and 100 of 5 to 14).
LEVELED, LEVELED_BY_ALBEDO = 2.0, 50.0


def _over_sizes(picture: BodyPicture, name: str, place: BodyPlace, pixels: Cutout, fit: DiskFit) -> DiskFit:
    """Return a small disk's fit with what its center may be with other sizes in its covariance, as likely as each is."""
    sigma, radius = fit.figure.size_sigma, 0.5 * fit.outline.diameter_px
    small = radius < SMALL_WIDTHS * np.sqrt(psf_variance(picture.psf))
    if not small or sigma * radius < LEAST_GROWTH_PX:
        return fit
    others = []
    for log_size in sigma * np.array(SIZES):
        there = replace(
            place, center_px=fit.center_px, size_ratio=float(np.exp(log_size)), strain=fit.shape.strain[:2]
        )
        try:
            others.append(fit_disk(picture, name, there, pixels, held_log_size=float(log_size)))
        except CenterfindingError:
            continue  # such a size is none of this body's
    likelihood = np.array([each.solution.log_likelihood for each in (fit, *others)])
    weight = softmax(likelihood / (LEVELED + LEVELED_BY_ALBEDO * fit.prior.albedo))
    away = np.array([each.center_px - fit.center_px for each in (fit, *others)])
    wider = np.array([each.covariance_px2 - fit.covariance_px2 for each in (fit, *others)])
    more, axes = np.linalg.eigh((weight * away.T) @ away + np.tensordot(weight, wider, axes=1))
    return fit.less_sure((axes * np.maximum(more, 0.0)) @ axes.T)


# ---- What a background or a converter may have done to the picture of a large or bright body.

SUNK_SIGMAS = 3.0  # a sky this far below zero was none: the body itself was taken for background
# Of the noise at the top: where light goes on beyond, noise leaves fewer and fewer pixels in steps as wide as this; an even
# surface without noise leaves as many in each.
CROWD_SIGMAS, CROWDED, FEWEST_CLIPPED = 0.3, 3.0, 20


def with_true_sky(picture: BodyPicture) -> BodyPicture:
    """Return the picture with its sky at zero, and pixels that a converter has clipped named as saturated.

    Columns that charge fills from edge to edge show nothing.
    """
    usable = np.isfinite(picture.signal_dn) & ~picture.bad
    if not usable.any():
        return picture
    signal, noise = picture.signal_dn, picture.noise_dn
    middle = float(np.median(noise[usable]))
    dark, spread = darkest_sky(signal, ~usable, middle)
    if dark < -SUNK_SIGMAS * middle:
        signal, noise, middle = signal - dark, np.full_like(noise, spread), spread
    clipped = _clipped(signal, middle, picture.shot_gain_e_per_dn, usable & ~picture.saturated)
    clean = replace(picture, signal_dn=signal, noise_dn=noise, saturated=picture.saturated | clipped)
    return without_filled(clean)


def _clipped(signal: FloatArray, noise_dn: float, gain: float, usable: BoolArray) -> BoolArray:
    """Return the pixels (n_line, n_pixel) that crowd at the top of the picture, closer than noise would have them."""
    top = float(np.max(signal, where=usable, initial=0.0))
    step = CROWD_SIGMAS * float(np.sqrt(noise_dn**2 + top / gain))
    clipped = usable & (signal > top - step)
    crowd = np.count_nonzero(clipped)
    next_to_it = np.count_nonzero(usable & (signal > top - 2.0 * step)) - crowd
    return clipped & (crowd > max(FEWEST_CLIPPED, CROWDED * next_to_it))
