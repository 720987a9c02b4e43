"""Which numbers of a camera are solved for, and the camera that has other values of them.

focal_length_mm               with Brown's model its coefficients act on tangents, whatever the focal length
center_pixel, center_line     px; acts as a turn of the camera but for the distortion, so rarely determined
line_scale                    factor on the line axis of ``pixel_from_mm``: pixels that are not square
e1_per_mm ... e6_per_mm       Owen's terms            k1 ... k6, p1, p2, s1 ... s4    Brown's
mounting_pixel_rad, mounting_line_rad, mounting_boresight_rad
                              turn of the camera against its SPICE frame, about its pixel, line and boresight axes:
                              what all pictures' attitudes differ alike from the a priori ones
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.camera import BrownDistortion, Camera, Distortion, NoDistortion, OwenDistortion
from opnav_workbench.errors import CameraError

__all__ = ["MOUNTING", "CameraParameters", "solvable", "with_distortion"]

MOUNTING = ("mounting_pixel_rad", "mounting_line_rad", "mounting_boresight_rad")
OPTICS = ("focal_length_mm", "center_pixel", "center_line", "line_scale")
MODELS = ("keep", "none", "owen", "brown")


@dataclass(frozen=True, slots=True, eq=False)
class CameraParameters:
    """The parameters of one solution; `camera` gives their starting values.

    Raises
    ------
    CameraError
        A name that this camera does not have (those it has are listed), or one given twice.
    """

    camera: Camera
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        known = solvable(self.camera)
        unknown = sorted(set(self.names) - set(known))
        if unknown:
            raise CameraError(
                f"{self.camera.name}: cannot solve for {', '.join(unknown)}; with its distortion model the parameters "
                f"are {', '.join(known)}."
            )
        if len(set(self.names)) < len(self.names):
            raise CameraError(f"a parameter is given twice: {', '.join(self.names)}.")

    @property
    def optical(self) -> tuple[str, ...]:
        """Names of those that change where a direction falls."""
        return tuple(name for name in self.names if name not in MOUNTING)

    @property
    def ordered(self) -> tuple[str, ...]:
        """All names as they stand in results: optical, then mounting."""
        return (*self.optical, *(name for name in self.names if name in MOUNTING))

    @property
    def mounting(self) -> tuple[int, ...]:
        """Focal axes (0 pixel, 1 line, 2 boresight) whose mounting angle is solved."""
        return tuple(MOUNTING.index(name) for name in self.names if name in MOUNTING)

    def values(self) -> FloatArray:
        """Starting values of the optical parameters."""
        return np.array([_value(self.camera, name) for name in self.optical])

    def camera_with(self, values: FloatArray) -> Camera:
        """Return the camera with these values of the optical parameters.

        Raises
        ------
        CameraError
            No camera can have them.
        """
        return replace(self.camera, **self._fields(values))

    def camera_near(self, values: FloatArray) -> Camera:
        """Return the same camera unchecked: for differences about values that a camera was seen to have."""
        return self.camera.varied(**self._fields(values))

    def _fields(self, values: FloatArray) -> dict[str, Any]:
        """Return the fields of the camera that these values change."""
        given = dict(zip(self.optical, (float(v) for v in values), strict=True))
        camera = self.camera
        center = np.array(camera.center_pixel_line)
        center[0], center[1] = given.get("center_pixel", center[0]), given.get("center_line", center[1])
        matrix = np.array(camera.pixel_from_mm)
        matrix[1] *= given.get("line_scale", 1.0)
        focal = given.get("focal_length_mm", camera.focal_length_mm)
        return {
            "focal_length_mm": focal,
            "center_pixel_line": center,
            "pixel_from_mm": matrix,
            "distortion": _distortion(camera.distortion, given, focal),
        }


def solvable(camera: Camera) -> tuple[str, ...]:
    """Return the names of the parameters that can be solved for.

    Examples
    --------
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> camera = Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_4x4.yaml")
    >>> solvable(camera)[3:6]
    ('line_scale', 'e1_per_mm', 'e2_per_mm2')
    """
    return (*OPTICS, *_terms(camera.distortion), *MOUNTING)


def with_distortion(camera: Camera, model: str) -> Camera:
    """Return the camera with another distortion model, all of its terms zero; ``keep`` changes nothing.

    Raises
    ------
    CameraError
        An unknown model.
    """
    if model not in MODELS:
        raise CameraError(f"unknown distortion model {model!r}; choose one of {', '.join(MODELS)}.")
    fresh: dict[str, Distortion] = {
        "keep": camera.distortion,
        "none": NoDistortion(),
        "owen": OwenDistortion(),
        "brown": BrownDistortion(camera.focal_length_mm),
    }
    if type(fresh[model]) is type(camera.distortion):
        return camera
    return replace(camera, distortion=fresh[model])


def _terms(distortion: Distortion) -> tuple[str, ...]:
    if not isinstance(distortion, OwenDistortion | BrownDistortion):
        return ()
    return tuple(field.name for field in fields(distortion) if field.name != "focal_mm")


def _value(camera: Camera, name: str) -> float:
    values = {
        "focal_length_mm": camera.focal_length_mm,
        "center_pixel": camera.center_pixel_line[0],
        "center_line": camera.center_pixel_line[1],
        "line_scale": 1.0,
    }
    return float(values[name] if name in values else getattr(camera.distortion, name))


def _distortion(distortion: Distortion, given: dict[str, float], focal_mm: float) -> Distortion:
    changes: dict[str, Any] = {name: given[name] for name in _terms(distortion) if name in given}
    if isinstance(distortion, BrownDistortion):
        return replace(distortion, focal_mm=focal_mm, **changes)
    if isinstance(distortion, OwenDistortion):
        return replace(distortion, **changes)
    return distortion
