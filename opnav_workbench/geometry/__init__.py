"""Vector geometry of a camera in space: pure functions of arrays, without state and without kernels.

Come in by the functions that the package exports, such as `apparent_direction`, `propagate` and `pointing_angles`.

``aberration``
    Stellar aberration and its exact inverse.
``aiming``
    Attitudes that put a direction at a place on the detector; turns about a camera's own axes.
``conics``
    Limb and terminator of a triaxial ellipsoid, and the ellipse that a limb draws.
``differences``
    Derivatives by central differences that choose their own step.
``few_rotations``
    Single rotations between matrices, quaternions and rotation vectors, to the bit as SciPy's.
``light_time``
    Where a body was seen that is elsewhere by now, and the derivative of that.
``near_places``
    Which places are near which others, few or many.
``rotations``
    Directions, attitudes, RA/Dec/twist, quaternions, rotation vectors.
``spacemotion``
    A star's direction at an epoch and from a place, with its covariance.
``times``
    UTC and TDB seconds past J2000 without kernels.
"""

from opnav_workbench.geometry.aberration import (
    Convention,
    aberration_jacobian,
    apparent_direction,
    geometric_direction,
)
from opnav_workbench.geometry.conics import (
    Ellipse,
    ellipse_from_conic,
    limb_cone,
    limb_on_surface,
    limb_points,
    sphere_center_offset,
    terminator_points,
)
from opnav_workbench.geometry.rotations import (
    angle_between,
    camera_from_j2000,
    checked_rotation,
    least_turn,
    matrix_from_quaternion,
    pointing_angle_arrays,
    pointing_angles,
    quaternion_from_matrix,
    radec_from_unit,
    rotation_from_vector,
    tangent_basis,
    tangent_offset,
    unit,
    unit_from_radec,
    vector_from_rotation,
    wrapped,
)
from opnav_workbench.geometry.spacemotion import et_from_jyear, jyear_from_et, propagate, propagate_covariance

__all__ = [
    "Convention",
    "Ellipse",
    "aberration_jacobian",
    "angle_between",
    "apparent_direction",
    "camera_from_j2000",
    "checked_rotation",
    "ellipse_from_conic",
    "et_from_jyear",
    "geometric_direction",
    "jyear_from_et",
    "least_turn",
    "limb_cone",
    "limb_on_surface",
    "limb_points",
    "matrix_from_quaternion",
    "pointing_angle_arrays",
    "pointing_angles",
    "propagate",
    "propagate_covariance",
    "quaternion_from_matrix",
    "radec_from_unit",
    "rotation_from_vector",
    "sphere_center_offset",
    "tangent_basis",
    "tangent_offset",
    "terminator_points",
    "unit",
    "unit_from_radec",
    "vector_from_rotation",
    "wrapped",
]
