"""How the bodies of the scene look: the model of each, and the picture with all of them as the centerfinders take it.

Surface, shape and light of a body come from mission file and kernels.  In the picture, bodies stand where they were found,
those that are looked for where that makes them expected.
"""

from collections.abc import Collection, Sequence
from dataclasses import fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import (
    MEASURED_PSF_SIGMA,
    BodyFlag,
    BodyPicture,
    standing_at,
    stated_psf_sigma,
)
from opnav_workbench.constants import SUN_RADIUS_KM
from opnav_workbench.errors import CameraError, MissionError, OpNavError
from opnav_workbench.image import darkest_sky
from opnav_workbench.mission import AlbedoMapFile, TargetSurface
from opnav_workbench.photometry import SUN_B_V
from opnav_workbench.psf import GaussianPsf, Psf
from opnav_workbench.render import (
    AlbedoMap,
    BodyModel,
    FigureUncertainty,
    ScatteringLaw,
    ShapeModel,
    law_from_mapping,
)
from opnav_workbench.scene import following, predict_body, seen_at_its_lines
from opnav_workbench.session.context import Context
from opnav_workbench.session.inputs import Inputs
from opnav_workbench.session.pointing import best_attitude
from opnav_workbench.session.state import MEASURED_STATUSES, BodyRequest, SessionState, best_center
from opnav_workbench.targets import TargetState

__all__ = [
    "above_sky",
    "body_model_if_known",
    "body_picture",
    "common_shift_px",
    "has_albedo_map",
    "has_scattering_law",
    "picture_psf",
    "scene_names",
    "shape_model",
]


# ---- The model of a target's surface and light.

UNKNOWN_SURFACE = TargetSurface()
# The axes of a first shape model, where the mission does not say: the radar shape of Bennu gave its equatorial ones to 2 %
# (Nolan et al. 2013, doi 10.1016/j.icarus.2013.05.028).
SHAPE_AXES_SIGMA = 0.02
MAPPED_ALBEDO_SIGMA = 0.05
STATED_LAW_SIGMA = 0.3  # of a law that the mission states: one of a kind of bodies
OTHER_SIZE = 10.0  # times its radii: meters are a thousand; first guesses of radii were 3 times off
MAX_AXES_SIGMA = 0.9  # of a body ten times as long as wide; an axis cannot vanish


def body_model(context: Context, inputs: Inputs, name: str) -> BodyModel:
    """Return how a target looks.

    A body of unknown orientation, of which no map or shape is known, is drawn as a sphere of the same volume.

    Raises
    ------
    OpNavError
        It cannot be drawn: no size, no Sun, a map or shape whose file is not there.
    """
    target = inputs.targets[name]
    surface = context.mission.target_surfaces.get(name, UNKNOWN_SURFACE)
    photometry = context.mission.target_photometry.get(name)
    albedo: float | AlbedoMap = 1.0 if photometry is None else photometry.geometric_albedo or 1.0
    if surface.albedo_map is not None:
        albedo = _albedo_map(surface.albedo_map)
    shape = _shape_of_target(inputs, name, surface)
    if shape is not None:
        _check_size(name, shape, target.radii_km)
    law = _scattering_law(context, name, surface)
    flux = _flux_e(context, target, SUN_B_V if photometry is None else photometry.b_v)
    figure = _figure(surface, shape, law_stated=has_scattering_law(context, name))
    try:
        return BodyModel(target, law, albedo, shape, flux, figure)
    except MissionError:
        round_already = target.radii_km is None or np.ptp(target.radii_km) == 0.0
        if shape is not None or isinstance(albedo, AlbedoMap) or round_already:
            raise
    radii = np.asarray(target.radii_km)
    sphere = replace(target, radii_km=np.full(3, np.cbrt(np.prod(radii))))
    return BodyModel(sphere, law, albedo, None, flux, _turned_at_random(figure, radii))


def has_albedo_map(context: Context, name: str) -> bool:
    """Tell whether the albedo pattern of a body is known, so that its whole disk counts."""
    return context.mission.target_surfaces.get(name, UNKNOWN_SURFACE).albedo_map is not None


def has_scattering_law(context: Context, name: str) -> bool:
    """Tell whether the mission states how a body's surface scatters light."""
    surface, photometry = (
        context.mission.target_surfaces.get(name),
        context.mission.target_photometry.get(name),
    )
    return bool((surface and surface.law) or (photometry and photometry.law))


def _scattering_law(context: Context, name: str, surface: TargetSurface) -> ScatteringLaw:
    """Return the mission's scattering law; else the one of its phase function; else Lambert's."""
    photometry = context.mission.target_photometry.get(name)
    given: dict[str, Any] | None = surface.law
    try:
        return law_from_mapping(given or (photometry and photometry.law) or "lambert")
    except MissionError as error:
        raise MissionError(f"{context.mission.path}: target_surfaces: {name}: {error}") from error


def _shape_of_target(inputs: Inputs, name: str, surface: TargetSurface) -> ShapeModel | None:
    if name in inputs.shapes:
        return shape_model(inputs.shapes[name], inputs.shape_units.get(name, "km"))
    return None if surface.shape is None else shape_model(surface.shape, surface.shape_unit)


def _check_size(name: str, shape: ShapeModel, known_km: FloatArray | None) -> None:
    """Refuse a shape that is another body's, or in another unit, by the radii that kernels or mission state."""
    if known_km is None:
        return
    ratio = float(np.max(shape.radii_km) / np.max(known_km))
    if not 1.0 / OTHER_SIZE < ratio < OTHER_SIZE:
        raise MissionError(
            f"the shape of {name} reaches {np.max(shape.radii_km):.4g} km, its radii are stated as "
            f"{np.max(known_km):.4g} km; give the shape's unit ({name}:FILE:m), its own shape, or correct the radii."
        )


def _figure(surface: TargetSurface, shape: ShapeModel | None, *, law_stated: bool) -> FigureUncertainty:
    """Return how far the figure may be wrong: as the mission says; where it does not, as on a first approach."""
    stated = surface.model_dump(
        include={field.name for field in fields(FigureUncertainty)}, exclude_none=True
    )
    default = FigureUncertainty() if shape is None else FigureUncertainty(axes_sigma=SHAPE_AXES_SIGMA)
    if surface.albedo_map is not None:
        default = replace(default, albedo_sigma=MAPPED_ALBEDO_SIGMA)
    if law_stated:
        default = replace(default, law_sigma=STATED_LAW_SIGMA)
    return replace(default, **stated)


def _turned_at_random(figure: FigureUncertainty, radii_km: FloatArray) -> FigureUncertainty:
    """Return the figure of the sphere that stands for a body of unknown orientation: its axes differ as the radii do."""
    unequal = float(np.std(np.log(radii_km)))
    return replace(figure, axes_sigma=min(float(np.hypot(figure.axes_sigma, unequal)), MAX_AXES_SIGMA))


@lru_cache(maxsize=8)
def shape_model(path: Path, unit: str) -> ShapeModel:
    """Read a shape model; the same again, as long as it is one of the last few."""
    return ShapeModel.from_file(path, unit)


@lru_cache(maxsize=8)
def _albedo_map(file: AlbedoMapFile) -> AlbedoMap:
    return AlbedoMap.from_file(file.file, **file.model_dump(exclude={"file"}))


def _flux_e(context: Context, target: TargetState, b_v: float) -> float | None:
    """Return the electrons of a body of known magnitude; None where camera or magnitude are not known."""
    if target.magnitude is None:
        return None
    in_band = target.magnitude + float(context.camera.color.offset(b_v))
    try:
        return float(context.camera.electrons(in_band, context.picture.exposure_s))
    except CameraError:
        return None


def body_model_if_known(context: Context, inputs: Inputs, name: str) -> BodyModel | None:
    """Return how a target looks, None where it cannot be drawn."""
    try:
        return body_model(context, inputs, name)
    except OpNavError:
        return None


# ---- The picture as the centerfinders take it.


def scene_names(inputs: Inputs, state: SessionState, request: BodyRequest) -> tuple[str, ...]:
    """Return the bodies and target stars of the scene: those expected, and those that stand in the request."""
    names = dict.fromkeys((*state.targets, *request.scene, *request.together, request.name))
    return tuple(name for name in names if name in inputs.targets)


def body_picture(
    context: Context, inputs: Inputs, state: SessionState, wanted: Sequence[str], scene: Sequence[str]
) -> BodyPicture:
    """Return the picture with the models of a scene.

    Bodies that were found stand there, but for those that are looked for; these and the others stand as far from their
    predictions as the largest that was found.

    Raises
    ------
    OpNavError
        One that is looked for cannot be drawn; others that cannot are left out.
    """
    models = [
        body_model(context, inputs, name) if name in wanted else _scenery(context, inputs, name)
        for name in scene
    ]
    looked_for = inputs.targets[wanted[0]]
    drawn = tuple(model for model in models if model is not None)
    picture = _picture(context, inputs, state, drawn, looked_for)
    places = {name: picture.center_px(name) for name in (model.target.name for model in drawn)}
    centers = {name: best_center(state, name) for name in places if name not in wanted}
    found = {name: c for name, c in centers.items() if c is not None}
    seen = {name: c.pixel_line for name, c in found.items() if c.pixel_line is not None}
    shift = common_shift_px(context, inputs, state, wanted)
    if not seen and not shift.any():
        return picture
    expected = {name: at + shift for name, at in places.items() if not inputs.targets[name].is_star}
    sure = [name for name in seen if not found[name].flags & MISPLACED]
    return standing_at(picture, expected | seen, sure)


# What says of a center that it may be another body's, or none.
MISPLACED = (
    BodyFlag.POOR_FIT | BodyFlag.CIRCLE_MISFIT | BodyFlag.AT_LIMIT | BodyFlag.EMPTY | BodyFlag.NOT_CONVERGED
)


def common_shift_px(
    context: Context, inputs: Inputs, state: SessionState, wanted: Collection[str]
) -> FloatArray:
    """Return how far (2,) the largest other body surely found stands from its prediction; zero where none is.

    What ephemeris or attitude are off by is theirs in common.
    """
    found = []
    for name in {body.name for body in state.bodies} - set(wanted):
        center, target = best_center(state, name), inputs.targets.get(name)
        if center is None or center.pixel_line is None or center.status != "ok":
            continue
        if target is None or target.is_star:
            continue
        there = predict_body(target, inputs.observer, context.camera, best_attitude(inputs, state))
        found.append((np.nan_to_num(there.diameter_px), name, center.pixel_line - there.pixel_line))
    shift = max(found, key=lambda one: one[:2])[2] if found else np.zeros(2)
    return shift if np.isfinite(shift).all() else np.zeros(2)


def _scenery(context: Context, inputs: Inputs, name: str) -> BodyModel | None:
    """Return how a body that is not looked for looks; None where it cannot be drawn, as the Sun, which no Sun lights."""
    model = body_model_if_known(context, inputs, name)
    sun_km = None if model is None else model.target.sun_position_km
    is_the_sun = sun_km is not None and float(np.linalg.norm(sun_km)) < SUN_RADIUS_KM
    return None if is_the_sun else model


def _picture(
    context: Context,
    inputs: Inputs,
    state: SessionState,
    models: tuple[BodyModel, ...],
    looked_for: TargetState,
) -> BodyPicture:
    signal, noise = above_sky(context)
    attitude, velocity = best_attitude(inputs, state), inputs.observer.velocity_km_s
    looked_for = seen_at_its_lines(context.camera, looked_for, velocity, attitude)
    models = tuple(replace(m, target=m.target.at_time(looked_for.epoch_s)) for m in models)
    return BodyPicture(
        signal_dn=signal,
        noise_dn=noise,
        bad=context.bad,
        saturated=context.picture.saturated,
        camera=following(context.camera, looked_for, velocity, attitude),
        camera_from_j2000=attitude,
        observer_velocity_km_s=velocity,
        models=models,
        psf=picture_psf(context, state),
        psf_width_sigma=_psf_width_sigma(context, state),
        sunlight_e=_sunlight(context),
        noise_model=context.noise_model,
        excess_sigma_px=0.0 if state.pointing is None else state.pointing.excess_sigma_px,
        stars_px=_star_places(context, state, attitude),
        stars_known_dn=_faintest_dn(state),
    )


def _star_places(context: Context, state: SessionState, attitude: FloatArray) -> FloatArray | None:
    """Return where the stars (n, 2) stand that are seen; None before the pointing tells."""
    if state.pointing is None or state.a_priori is None:
        return None
    places = state.a_priori.places(context.camera, attitude)
    return np.asarray(places[state.mask(*MEASURED_STATUSES)])


def _faintest_dn(state: SessionState) -> float:
    """Return the light of the faintest star that is used: whatever is brighter the catalog knows; infinite without any."""
    used = state.mask("used")
    return float(state.centers.flux_dn[used].min()) if state.centers is not None and used.any() else np.inf


SPARSE = 4  # pixels between those of the sky that are looked at
SUNK_SIGMAS = 3.0
SWALLOWED_SIGMAS = 10.0  # a sky that differs by more from place to place is not one


def above_sky(context: Context) -> tuple[FloatArray, FloatArray]:
    """Return the light above the sky, and its noise; above its darkest part where a body was taken for sky."""
    smear = context.background.smear_dn
    level = context.background.level_dn - smear
    usual = float(np.median(context.noise_dn))
    image, bad = context.picture.image_dn - smear, context.bad | ~np.isfinite(context.picture.image_dn)
    low, high = np.quantile(level[::SPARSE, ::SPARSE], [0.02, 0.98])
    if high - low < SWALLOWED_SIGMAS * usual:
        return context.signal_dn, context.noise_dn
    dark, noise = darkest_sky(image, bad, usual)
    if low - dark < SUNK_SIGMAS * noise and high - low < SWALLOWED_SIGMAS * noise:
        return context.signal_dn, context.noise_dn
    return np.where(bad, 0.0, image - dark), np.full_like(context.noise_dn, noise)


def _sunlight(context: Context) -> float | None:
    try:
        return context.camera.sunlight_e(context.picture.exposure_s)
    except CameraError:
        return None


def _psf_width_sigma(context: Context, state: SessionState) -> float:
    """Return how well the width of the picture's PSF is known: without calibration and stars, as the camera file says."""
    measured = context.camera.psf_shape is not None or state.psf is not None
    return MEASURED_PSF_SIGMA if measured else stated_psf_sigma(context.camera)


def picture_psf(context: Context, state: SessionState) -> Psf:
    """Return the PSF of this picture: a calibrated one, else that of its stars, else the camera file's."""
    if context.camera.psf_shape is not None or state.psf is None:
        return context.camera.psf_model
    shape = state.psf.shape
    return GaussianPsf(shape.sigma_major_px, shape.sigma_minor_px, shape.angle_rad)
