"""The picture of bodies as the centerfinders take it: signal, noise, attitude, and a model of every body of the scene."""

from collections.abc import Sequence

from opnav_workbench.bodycenters import BodyCenter, BodyPicture, displaced_model
from opnav_workbench.errors import CameraError, CenterfindingError
from opnav_workbench.psf import GaussianPsf, Psf
from opnav_workbench.render import BodyModel
from opnav_workbench.session.context import Context
from opnav_workbench.session.observing import attitude
from opnav_workbench.session.state import BodyRequest, Inputs, SessionState
from opnav_workbench.session.surfaces import body_model, drawn

__all__ = ["best_center", "body_picture", "frame_psf", "scene_names"]

TRUSTED = ("ok", "uncertain")  # statuses of centers that say where a body is


def scene_names(inputs: Inputs, state: SessionState, request: BodyRequest) -> tuple[str, ...]:
    """Return the bodies and target stars of the scene: those expected, and those that stand in the request."""
    names = dict.fromkeys((*state.targets, *request.scene, *request.together, request.name))
    return tuple(name for name in names if name in inputs.targets)


def body_picture(
    context: Context, inputs: Inputs, state: SessionState, wanted: Sequence[str], scene: Sequence[str]
) -> BodyPicture:
    """Return the picture with the models of a scene.

    Bodies that are looked for stand where they are predicted; the others, where they were found, if they were.

    Raises
    ------
    OpNavError
        One that is looked for cannot be drawn; others that cannot are left out.
    """
    models = [
        body_model(context, inputs, name) if name in wanted else drawn(context, inputs, name)
        for name in scene
    ]
    picture = _picture(context, inputs, state, tuple(model for model in models if model is not None))
    moved = [_as_found(picture, state, model, wanted) for model in picture.models]
    if all(new is old for new, old in zip(moved, picture.models, strict=True)):
        return picture
    return _picture(context, inputs, state, tuple(moved))


def _picture(
    context: Context, inputs: Inputs, state: SessionState, models: tuple[BodyModel, ...]
) -> BodyPicture:
    return BodyPicture(
        signal_dn=context.signal_dn,
        noise_dn=context.noise_dn,
        bad=context.bad,
        saturated=context.frame.saturated,
        camera=context.camera,
        camera_from_j2000=attitude(inputs, state),
        observer_velocity_km_s=inputs.observer.velocity_km_s,
        models=models,
        psf=frame_psf(context, state),
        sunlight_e=_sunlight(context),
        noise_model=context.noise_model,
        excess_sigma_px=0.0 if state.pointing is None else state.pointing.excess_sigma_px,
    )


def _as_found(
    picture: BodyPicture, state: SessionState, model: BodyModel, wanted: Sequence[str]
) -> BodyModel:
    center = best_center(state, model.target.name)
    if model.target.name in wanted or center is None or center.pixel_line is None:
        return model
    try:
        return displaced_model(picture, model.target.name, center.pixel_line)
    except CenterfindingError:
        return model


def best_center(state: SessionState, name: str) -> BodyCenter | None:
    """Return a body's center that is to be trusted most: the last that is ok, else the last uncertain one."""
    found = [body for body in state.bodies if body.name == name and body.status in TRUSTED]
    return next((body for body in reversed(found) if body.status == "ok"), found[-1] if found else None)


def _sunlight(context: Context) -> float | None:
    try:
        return context.camera.sunlight_e(context.frame.exposure_s)
    except CameraError:
        return None


def frame_psf(context: Context, state: SessionState) -> Psf:
    """Return the PSF of this frame: a calibrated one, else that of its stars, else the camera file's."""
    if context.camera.psf_shape is not None or state.psf is None:
        return context.camera.psf_model
    shape = state.psf.shape
    return GaussianPsf(shape.sigma_major_px, shape.sigma_minor_px, shape.angle_rad)
