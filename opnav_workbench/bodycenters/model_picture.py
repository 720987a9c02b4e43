"""Bodies moved to where the picture may show them, and rendered there."""

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.geometry import geometric_direction
from opnav_workbench.render import BodyModel, render_bodies

__all__ = ["displaced_model", "model_picture", "placed_models", "sunlight_electrons"]

RELATIVE_SUNLIGHT_E = (
    1e15  # where the camera's response is unknown: any number will do, brightness is then fitted
)


def displaced_model(
    picture: BodyPicture, name: str, center_px: ArrayLike, range_scale: float = 1.0
) -> BodyModel:
    """Return a body's model, moved so that its center of figure is seen at a place.

    Orientation and the Sun's place stay; so does the range, unless scaled.

    Parameters
    ----------
    picture : BodyPicture
    name : str
    center_px : (2,) array_like
        (pixel, line).
    range_scale : float
        Range over that of the a priori model.

    Raises
    ------
    CenterfindingError
        The place lies beyond what the camera model covers.
    """
    model = picture.model(name)
    place = np.asarray(center_px, dtype=np.float64)
    apparent = picture.camera.unproject(place[None])[0] @ picture.camera_from_j2000
    if not np.isfinite(apparent).all():
        raise CenterfindingError(
            f"{name}: pixel {place[0]:.1f}, line {place[1]:.1f} lies beyond what the model of {picture.camera.name} covers."
        )
    direction = geometric_direction(apparent, picture.observer_velocity_km_s)
    target = model.target
    position = direction * (target.range_km * range_scale)
    sun = target.sun_position_km
    if sun is not None:
        sun = sun + target.position_km - position
    return replace(model, target=replace(target, position_km=position, sun_position_km=sun))


def placed_models(
    picture: BodyPicture,
    places_px: Mapping[str, ArrayLike],
    range_scale: float | Mapping[str, float] = 1.0,
    only: Collection[str] | None = None,
) -> tuple[BodyModel, ...]:
    """Return the scene's models, those with a place moved there; `range_scale` applies to them."""
    for name in places_px:
        picture.model(name)  # raises for a name that is not there

    def placed(name: str) -> BodyModel:
        if name not in places_px:
            return picture.model(name)
        scale = range_scale.get(name, 1.0) if isinstance(range_scale, Mapping) else range_scale
        return displaced_model(picture, name, places_px[name], scale)

    names = (model.target.name for model in picture.models)
    return tuple(placed(name) for name in names if only is None or name in only)


def sunlight_electrons(picture: BodyPicture) -> float:
    """Return the sunlight to render with; a stand-in where the camera's response is unknown."""
    return RELATIVE_SUNLIGHT_E if picture.sunlight_e is None else picture.sunlight_e


def model_picture(
    picture: BodyPicture,
    window: tuple[int, int, int, int],
    places_px: Mapping[str, ArrayLike],
    *,
    range_scale: float | Mapping[str, float] = 1.0,
    only: Collection[str] | None = None,
) -> FloatArray:
    """Render the scene's bodies with the camera's PSF, with some of them moved.

    Parameters
    ----------
    picture : BodyPicture
    window : (int, int, int, int)
        First pixel, first line, pixels, lines.
    places_px : mapping of str to (2,) array_like
        Centers of figure (pixel, line) of bodies; the others stand where they are predicted.
    range_scale : float or mapping of str to float
        Range over the a priori one, of the bodies in `places_px`.
    only : collection of str, optional
        Leave out all other bodies.

    Returns
    -------
    (n_line, n_pixel) array
        DN where the camera's response is known, else relative.

    Raises
    ------
    CenterfindingError
        A name that is not in the scene, or a place beyond what the camera model covers.
    """
    models = placed_models(picture, places_px, range_scale, only)
    rendering = render_bodies(
        models,
        picture.camera,
        picture.camera_from_j2000,
        picture.observer_velocity_km_s,
        psf=picture.psf,
        sunlight_e=sunlight_electrons(picture),
        window=window,
    )
    return np.asarray(rendering.electrons / picture.gain_e_per_dn)
