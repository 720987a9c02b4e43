"""One simulated picture: stars and bodies through optics and detector, and what it really shows.

Flow   `PictureInputs` -> true places of stars and bodies -> electrons without noise -> detector -> `SimulatedPicture`
Units  px as (pixel, line), electrons

`PictureInputs` holds everything that a picture is made of, as values: from there on no kernels and no files are
needed. Stars are points, or trails where the camera moves: boxes of the PSF's shares, all stars at once, are added
to the electrons in place.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.camera.distortion import NoDistortion
from opnav_workbench.catalog import StarTable
from opnav_workbench.errors import CameraError
from opnav_workbench.psf.protocol import Psf, add_sources
from opnav_workbench.psf.trailed import TrailedPsf
from opnav_workbench.render import BodyModel, Rendering, render_bodies, render_one
from opnav_workbench.scene import (
    Observer,
    StarPrediction,
    following,
    predict_stars,
    seen_at_its_lines,
    turned_meanwhile,
)
from opnav_workbench.simulation.attitude_path import AttitudePath
from opnav_workbench.simulation.detector import Exposure, expose
from opnav_workbench.simulation.detector_properties import Level
from opnav_workbench.simulation.effects import DetectorEffects
from opnav_workbench.simulation.scenario import ApparentPlaceEffects
from opnav_workbench.targets import TargetState

__all__ = ["PictureInputs", "SimulatedPicture", "Trails", "add_stars", "expose_picture", "trails"]


# ---- Everything one picture is made of, as values: from here on no kernels and no files are needed.


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PictureInputs:
    """What is true of one picture, and what its header will say.

    Attributes
    ----------
    name
        File name stem.
    et
        Mid-exposure, TDB s past J2000.
    observer
        True barycentric state of the spacecraft.
    predicted_camera_from_j2000 : (3, 3) array
        What the header says.
    path
        How the camera really stood during the exposure.
    stars
        Catalog stars around the field.
    bodies
        True states of the bodies, and how they look.
    body_tracks_px : tuple of (k, 2) array or None
        For each body how it moves on the detector in equal parts of the exposure, from mid-exposure; None: as
        `path` moves the sky. Empty: that for all.
    place_effects
        Those on places that are not switched off.
    level : {"calibrated", "raw"}
    dark_columns
        Covered columns that a raw picture has at its right end.
    seed
        Of this picture.
    header
        Further header cards.
    without_law
        Bodies whose scattering law nobody gave.
    """

    name: str
    camera: Camera
    et: float
    exposure_s: float
    observer: Observer
    predicted_camera_from_j2000: FloatArray
    path: AttitudePath
    stars: StarTable
    psf: Psf
    bodies: tuple[BodyModel, ...] = ()
    body_tracks_px: tuple[FloatArray | None, ...] = ()
    effects: DetectorEffects = field(default_factory=DetectorEffects)
    place_effects: ApparentPlaceEffects = field(default_factory=ApparentPlaceEffects)
    level: Level = "calibrated"
    dark_columns: int = 0
    seed: int = 0
    header: Mapping[str, str | int | float] = field(default_factory=lambda: MappingProxyType({}))
    without_law: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self)


# ---- Stars in a picture: points, or trails where the camera moves.


@dataclass(frozen=True, slots=True, eq=False)
class Trails:
    """Where stars were during the exposure, in a few numbers; arrays are read-only.

    Attributes
    ----------
    middle_px : (n, 2) array
        At mid-exposure.
    mean_px : (n, 2) array
        Weighted mean: where the light's center is.
    length_px : (n,) array
        Length of the path.
    """

    middle_px: FloatArray
    mean_px: FloatArray
    length_px: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def trails(places_px: ArrayLike, weights: ArrayLike | None = None) -> Trails:
    """Summarise the places of stars during an exposure.

    Parameters
    ----------
    places_px : (n, 2) or (n, k, 2) array_like
        k is odd; the middle sample is at mid-exposure, and the samples stand in the middle of equal times.
    weights : (k,) array_like, optional

    Examples
    --------
    >>> trails([[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]]).length_px  # three thirds of the exposure
    array([3.])
    """
    places, shares = _checked_places(places_px, weights)
    steps = np.linalg.norm(np.diff(places, axis=1), axis=-1)
    k = places.shape[1]
    return Trails(
        middle_px=places[:, k // 2],
        mean_px=np.einsum("nkj,k->nj", places, shares),
        length_px=steps.sum(axis=1) * (k / max(k - 1, 1)),  # half a step more at either end
    )


def add_stars(
    electrons: FloatArray,
    places_px: ArrayLike,
    flux_e: ArrayLike,
    psf: Psf,
    weights: ArrayLike | None = None,
) -> None:
    """Add stars to a picture, in place.

    Parameters
    ----------
    electrons : (n_line, n_pixel) array
    places_px : (n, 2) or (n, k, 2) array_like
        Of each star, or of each star at k times; stars beside the detector whose light reaches it count, and
        places that are not finite (behind the camera) are left out.
    flux_e : (n,) array_like
        Electrons of each star over the whole exposure.
    weights : (k,) array_like, optional
        Share of the exposure at each time; equal ones unless given.

    Raises
    ------
    CameraError
        Numbers of stars, places and weights that do not fit, or a flux that is negative or not finite.

    Examples
    --------
    >>> from opnav_workbench.psf import GaussianPsf
    >>> picture = np.zeros((20, 30))
    >>> add_stars(picture, [[[10.0, 9.0], [12.0, 9.0]]], [100.0], GaussianPsf(0.7, 0.7))
    >>> round(float(picture.sum()), 3), round(float(picture[9, 10] / picture[9, 12]), 3)
    (100.0, 1.0)
    """
    places, shares = _checked_places(places_px, weights)
    flux = np.asarray(flux_e, dtype=np.float64)
    if flux.shape != places.shape[:1]:
        raise CameraError(f"{len(places)} places but fluxes of shape {flux.shape}; give one flux per star.")
    if not (np.isfinite(flux) & (flux >= 0.0)).all():
        raise CameraError(
            f"{np.sum(~(flux >= 0.0) | np.isinf(flux))} stars with a flux that is negative or not finite; leave out "
            "stars without a magnitude."
        )
    add_sources(electrons, psf, places.reshape(-1, 2), (flux[:, None] * shares).ravel())


def _checked_places(places_px: ArrayLike, weights: ArrayLike | None) -> tuple[FloatArray, FloatArray]:
    """Return places (n, k, 2) and weights (k,)."""
    places = np.asarray(places_px, dtype=np.float64)
    if places.ndim == 2:
        places = places[:, None]
    if places.ndim != 3 or places.shape[-1] != 2:
        raise CameraError(f"places of shape {places.shape}; give (n, 2) or (n, k, 2) pixels and lines.")
    k = places.shape[1]
    shares = np.full(k, 1.0 / k) if weights is None else np.asarray(weights, dtype=np.float64)
    if shares.shape != (k,):
        raise CameraError(f"{k} places per star but weights of shape {shares.shape}; give one per place.")
    return places, shares


# ---- One simulated picture: stars and bodies through optics and detector, and what it really shows.


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedPicture:
    """A picture and its truth; arrays are read-only and indexed ``[line, pixel]``.

    Attributes
    ----------
    exposure
        The picture in DN, and the electrons before and after the detector's effects.
    stars
        True places of the stars in or just outside the picture.
    star_flux_e : (n,) array
        Electrons of each star over the exposure; 0 without a magnitude.
    star_occulted : (n,) array of bool
        Behind a body, and therefore not drawn.
    rendering
        The bodies: true centers, sizes and light.
    """

    inputs: PictureInputs
    exposure: Exposure
    stars: StarPrediction
    star_flux_e: FloatArray
    star_occulted: BoolArray
    star_trails: Trails
    rendering: Rendering

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def image_dn(self) -> FloatArray:
        """The picture as the file has it (n_line, n_pixel)."""
        return self.exposure.image_dn

    @property
    def noiseless_electrons(self) -> FloatArray:
        """The light of stars and bodies, without detector (n_line, n_pixel)."""
        return self.exposure.noiseless_electrons

    @property
    def camera_from_j2000(self) -> FloatArray:
        """The true attitude (3, 3) at mid-exposure."""
        return self.inputs.path.middle

    @property
    def body_trails(self) -> Trails:
        """How each body moves, as offsets from its place at mid-exposure."""
        each = [trails(track[None]) for track in _body_tracks(self.inputs)]
        return Trails(
            middle_px=np.zeros((len(each), 2)),
            mean_px=np.reshape([t.mean_px for t in each], (-1, 2)),
            length_px=np.ravel([t.length_px for t in each]),
        )

    @property
    def star_drawn(self) -> BoolArray:
        """Which stars (n,) are on the detector and not hidden."""
        return np.asarray(self.stars.on_detector & ~self.star_occulted & (self.star_flux_e > 0.0))


def expose_picture(inputs: PictureInputs) -> SimulatedPicture:
    """Simulate one picture.

    The same inputs give the same picture, bit for bit.

    Raises
    ------
    CameraError
        The camera does not know a number that is needed.
    """
    optics, observer = (
        _optics(inputs.camera, inputs.place_effects),
        _observer(inputs.observer, inputs.place_effects),
    )
    stars = _stars(inputs, optics, observer)
    if optics.sweep is None or not inputs.bodies:
        rendering = _bodies(inputs, optics, observer)
        hidden = rendering.occults(stars.directions)
    else:
        rendering, hidden = _swept_bodies(inputs, optics, observer, stars.directions)
    places = inputs.path.places(optics, stars.directions)
    flux = np.nan_to_num(inputs.camera.electrons(stars.mag, inputs.exposure_s))
    electrons = np.array(rendering.electrons)
    seen = ~hidden
    add_stars(electrons, places[seen], flux[seen], inputs.psf, inputs.path.weights)
    exposure = expose(
        electrons,
        inputs.camera,
        inputs.effects,
        exposure_s=inputs.exposure_s,
        seed=inputs.seed,
        level=inputs.level,
        dark_columns=inputs.dark_columns,
    )
    return SimulatedPicture(
        inputs, exposure, stars, flux, hidden, trails(places, inputs.path.weights), rendering
    )


def _optics(camera: Camera, effects: ApparentPlaceEffects) -> Camera:
    return camera if effects.distortion else replace(camera, distortion=NoDistortion())


def _observer(observer: Observer, effects: ApparentPlaceEffects) -> Observer:
    """Return the observer that aberration is computed with."""
    return observer if effects.aberration else replace(observer, velocity_km_s=np.zeros(3))


def _stars(inputs: PictureInputs, optics: Camera, observer: Observer) -> StarPrediction:
    """Predict the stars whose light reaches the detector."""
    moved = np.abs(inputs.path.offsets_px(optics)).max()
    margin = float(inputs.psf.half_size_px + moved + 1.0)
    table = _switched(inputs.stars, inputs.place_effects)
    return predict_stars(table, inputs.et, observer, optics, inputs.path.middle, margin_px=margin)


def _switched(stars: StarTable, effects: ApparentPlaceEffects) -> StarTable:
    """Take parallax or motion from the stars where they are switched off."""
    zero = np.zeros(len(stars))
    update: dict[str, Any] = {} if effects.parallax else {"parallax_rad": zero}
    if not effects.proper_motion:
        update |= {"pmra_rad_yr": zero, "pmdec_rad_yr": zero, "rv_km_s": np.full(len(stars), np.nan)}
    return replace(stars, **update) if update else stars


def _bodies(inputs: PictureInputs, optics: Camera, observer: Observer) -> Rendering:
    return render_bodies(
        inputs.bodies,
        optics,
        inputs.path.middle,
        observer.velocity_km_s,
        psf=_body_psfs(inputs),
        sunlight_e=inputs.camera.sunlight_e(inputs.exposure_s),
    )


# ---- Bodies while lines are exposed one after the other: each as it stands at several times, mixed line by line.

TURN_STEP_PX = (
    0.5  # of a surface from drawing to drawing: mixed, its light is off by a thirtieth of a pixel's curvature
)
STILL_TURN_PX = 0.05
MOST_DRAWINGS = 65


def _swept_bodies(
    inputs: PictureInputs, optics: Camera, observer: Observer, directions: FloatArray
) -> tuple[Rendering, BoolArray]:
    """Draw the bodies, each as the camera sees it move, turn and show another side; and tell which stars (n,) they hide."""
    attitude, psfs = inputs.path.middle, _body_psfs(inputs)
    places = optics.standing(attitude).project(directions @ attitude.T)
    drawn, hidden = [], np.zeros(len(directions), dtype=bool)
    for index, model in enumerate(inputs.bodies):
        at = _drawing_times_s(optics, model.target, observer, attitude)
        drawn.append(_over_its_lines(inputs, optics, observer, psfs, index, at))
        middle = model.target.at_time(float(np.median(at)))
        seen = following(optics, middle, observer.velocity_km_s, attitude).unproject(places)
        known = np.isfinite(seen[:, 0])
        hidden[known] |= drawn[-1].occults(seen[known] @ attitude)
    electrons = np.sum([one.electrons for one in drawn], axis=0)
    return replace(drawn[0], electrons=electrons, bodies=tuple(one.bodies[0] for one in drawn)), hidden


def _drawing_times_s(
    optics: Camera, target: TargetState, observer: Observer, attitude: FloatArray
) -> FloatArray:
    """Return at which times (k,) of the picture a body is drawn, an odd number: the middle one is of its center's line."""
    velocity = observer.velocity_km_s
    middle_s = seen_at_its_lines(optics, target, velocity, attitude).epoch_s
    turned_px, half_s = turned_meanwhile(optics, target, velocity, attitude)
    steps = (
        min(int(np.ceil(turned_px / TURN_STEP_PX)), MOST_DRAWINGS // 2) if turned_px > STILL_TURN_PX else 0
    )
    return (
        np.asarray(middle_s + half_s * np.linspace(-1.0, 1.0, 2 * steps + 1))
        if steps
        else np.array([middle_s])
    )


def _over_its_lines(
    inputs: PictureInputs,
    optics: Camera,
    observer: Observer,
    psfs: Sequence[Psf],
    index: int,
    times_s: FloatArray,
) -> Rendering:
    """Draw one body at some times, mixed by the times of the lines; what is told of it is of the middle drawing."""
    assert optics.sweep is not None
    line_s = optics.sweep.times_s(np.arange(optics.n_line))
    electrons = np.zeros((optics.n_line, optics.n_pixel))
    for number, time_s in enumerate(times_s):
        models = [replace(model, target=model.target.at_time(float(time_s))) for model in inputs.bodies]
        followed = models[index].target
        drawing = render_one(
            models,
            index,
            following(optics, followed, observer.velocity_km_s, inputs.path.middle),
            inputs.path.middle,
            observer.velocity_km_s,
            psf=psfs,
            sunlight_e=inputs.camera.sunlight_e(inputs.exposure_s),
        )
        electrons += (
            np.interp(line_s, times_s, np.arange(len(times_s)) == number)[:, None] * drawing.electrons
        )
        if number == len(times_s) // 2:
            middle = drawing
    return replace(middle, electrons=electrons)


def _body_psfs(inputs: PictureInputs) -> list[Psf]:
    """Return each body's PSF, smeared by its own way."""
    return [_smeared(inputs.psf, track) for track in _body_tracks(inputs)]


def _smeared(psf: Psf, track_px: FloatArray) -> Psf:
    """Return the PSF, drawn out along the way that a body takes during the exposure."""
    return psf if len(track_px) == 1 else TrailedPsf(psf, track_px, np.ones(len(track_px)))


def _body_tracks(inputs: PictureInputs) -> list[FloatArray]:
    """Return where each body is in equal parts of the exposure (k, 2), px from mid-exposure."""
    given = inputs.body_tracks_px or (None,) * len(inputs.bodies)
    if len(given) != len(inputs.bodies):
        raise CameraError(f"{len(given)} tracks for {len(inputs.bodies)} bodies; give one for each, or none.")
    sky = inputs.path.offsets_px(_optics(inputs.camera, inputs.place_effects))
    return [sky if track is None else track for track in given]
