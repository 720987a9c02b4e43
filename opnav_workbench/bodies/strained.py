"""A body with another figure than its model: strained by a matrix, as a picture can tell it.

The outline of an ellipsoid is what the strains of x and y make of it, whatever the others are: those move its points along
the line of sight. Every ellipsoid is one of them.

Frame  x along pixel, y along line, z toward the camera
Units  strains relative
"""

from dataclasses import replace

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies.picture import BodyPicture
from opnav_workbench.geometry import unit
from opnav_workbench.render import AlbedoMap, BodyModel
from opnav_workbench.scene import picture_axes

__all__ = ["STRAINS", "can_be_strained", "strain_axes", "strain_matrix", "strained_picture"]

# The last five planes of `opnav_workbench.bodies.disk.limb_light`; of a sphere as symmetric xx = -yy, xy, zz, xz and yz.
STRAINS = np.array(
    [
        [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 0.0]],
        [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
        [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [2.0, 0.0, 0.0]],
        [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 2.0, 0.0]],
    ]
)


def can_be_strained(model: BodyModel) -> bool:
    """Whether a body stays what it is under a strain: an ellipsoid without a pattern of its own."""
    return model.shape is None and not isinstance(model.albedo, AlbedoMap)


def strained_picture(picture: BodyPicture, name: str, strain: FloatArray) -> BodyPicture:
    """Return the picture with one body strained by the (5,) shares of `STRAINS`; that of other bodies as it is."""
    model = picture.model(name)
    if not can_be_strained(model) or not np.any(strain):
        return picture
    other = _strained_model(picture, model, strain_matrix(strain))
    return picture.with_model(other)


def strain_matrix(strain: FloatArray) -> FloatArray:
    """Return what (5,) shares of `STRAINS` make of the body's points: (3, 3)."""
    return np.asarray(np.eye(3) + np.tensordot(strain, STRAINS, axes=1))


def _strained_model(picture: BodyPicture, model: BodyModel, strain: FloatArray) -> BodyModel:
    """Return an ellipsoid whose points a matrix (3, 3) has moved: its axes are those of the product of both."""
    target = model.target
    assert target.radii_km is not None
    turn = np.eye(3) if target.body_from_j2000 is None else target.body_from_j2000
    axes = strain_axes(picture, picture.center_px(model.target.name))
    whole = (axes.T @ strain @ axes) @ turn.T * np.asarray(target.radii_km)
    square, vectors = np.linalg.eigh(whole @ whole.T)
    vectors = vectors * np.sign(np.linalg.det(vectors))
    figure = replace(target, radii_km=np.sqrt(square), body_from_j2000=np.ascontiguousarray(vectors.T))
    return replace(model, target=figure)


def strain_axes(picture: BodyPicture, place_px: FloatArray) -> FloatArray:
    """Return x, y and z at a place (2,) of the picture as rows (3, 3), J2000."""
    sight = np.asarray(picture.camera.unproject(place_px[None])[0])
    along = unit(picture_axes(picture.camera, place_px, sight))
    across = unit(along[1] - (along[1] @ along[0]) * along[0])
    return np.asarray(np.stack([along[0], across, -sight]) @ picture.camera_from_j2000)
