"""Everything that finding a body in a picture needs: the picture, its noise, its camera, and the bodies of the scene.

Frame  J2000; (pixel, line) on the detector
Units  DN above the background, km, px
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.bodies import TargetState
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.psf import Psf
from opnav_workbench.render import BodyModel
from opnav_workbench.scene import BodyPrediction, Observer, predict_body
from opnav_workbench.starcenters import NoiseModel

__all__ = ["BodyPicture", "sized_target"]


@dataclass(frozen=True, slots=True, eq=False)
class BodyPicture:
    """A picture, and what is expected in it.

    Attributes
    ----------
    signal_dn : (n_line, n_pixel) array
        Picture with its background removed; pixels that are not finite count as bad.
    noise_dn : (n_line, n_pixel) array
        Noise of each pixel without the bodies' own shot noise, which `noise_model` adds.
    bad, saturated : (n_line, n_pixel) arrays of bool
        Pixels to leave out.
    camera : Camera
    camera_from_j2000 : (3, 3) array
        The attitude, solved or a priori.
    observer_velocity_km_s : (3,) array
        With respect to the solar-system barycenter, J2000.
    models : tuple of BodyModel
        Every body of the scene at its a priori state; they hide and shade each other.
    psf : Psf
    sunlight_e : float or None
        Electrons of the Sun at 1 au as a point, see `opnav_workbench.render.render_bodies`; None where the camera's
        response is not known, and brightnesses are then relative.
    noise_model : NoiseModel or None
        Its gain turns light into shot noise.
    excess_sigma_px : float
        Centering error of the frame's stars beyond their covariances; a body suffers it too.

    Raises
    ------
    CenterfindingError
        Arrays of different shapes, two bodies of one name.
    """

    signal_dn: FloatArray
    noise_dn: FloatArray
    bad: BoolArray
    saturated: BoolArray
    camera: Camera
    camera_from_j2000: FloatArray
    observer_velocity_km_s: FloatArray
    models: tuple[BodyModel, ...]
    psf: Psf
    sunlight_e: float | None = None
    noise_model: NoiseModel | None = None
    excess_sigma_px: float = 0.0

    def __post_init__(self) -> None:
        signal = np.asarray(self.signal_dn, dtype=np.float64)
        shape = (self.camera.n_line, self.camera.n_pixel)
        if signal.shape != shape:
            raise CenterfindingError(
                f"the picture has shape {signal.shape}, its camera {self.camera.name} {shape} (lines, pixels)."
            )
        for field in ("noise_dn", "bad", "saturated"):
            kind = np.float64 if field == "noise_dn" else np.bool_
            try:
                plane: Any = np.broadcast_to(np.asarray(getattr(self, field), dtype=kind), shape)
            except ValueError as error:
                raise CenterfindingError(
                    f"{field} does not have the picture's shape {shape}: {error}."
                ) from error
            object.__setattr__(self, field, plane)
        object.__setattr__(self, "signal_dn", signal)
        object.__setattr__(self, "models", tuple(self.models))
        names = [model.target.name for model in self.models]
        if len(set(names)) != len(names):
            raise CenterfindingError(f"two bodies of the scene have one name: {', '.join(sorted(names))}.")
        freeze_arrays(self)

    def model(self, name: str) -> BodyModel:
        """Return the model of a body.

        Raises
        ------
        CenterfindingError
            No such body in the scene.
        """
        for model in self.models:
            if model.target.name == name:
                return model
        known = ", ".join(model.target.name for model in self.models) or "none"
        raise CenterfindingError(f"no model of {name!r} in this picture; it has {known}.")

    @property
    def observer(self) -> Observer:
        """The observer, of whom predictions use the velocity alone."""
        return Observer(np.zeros(3), self.observer_velocity_km_s, "body picture")

    @property
    def gain_e_per_dn(self) -> float:
        """Electrons per data number: the noise model's, else the camera's, else 1."""
        if self.noise_model is not None:
            return self.noise_model.gain_e_per_dn
        gain = self.camera.gain_e_per_dn
        return 1.0 if gain is None or not np.isfinite(gain) else float(gain)

    def prediction(self, name: str) -> BodyPrediction:
        """Return where and how large a body is expected."""
        return predict_body(
            sized_target(self.model(name)), self.observer, self.camera, self.camera_from_j2000
        )

    def center_px(self, name: str) -> FloatArray:
        """Return a body's predicted center of figure (pixel, line); nan behind the camera."""
        return self.prediction(name).pixel_line

    def diameter_px(self, name: str) -> float:
        """Return a body's predicted diameter: that of the circle with the area of its outline; 0 for a point."""
        diameter = self.prediction(name).diameter_px
        return diameter if np.isfinite(diameter) else 0.0

    def phase_rad(self, name: str) -> float:
        """Return the angle Sun - body - spacecraft; nan where the Sun is not known."""
        return self.prediction(name).phase_rad


def sized_target(model: BodyModel) -> TargetState:
    """Return a model's target with the extent of its shape, which its diameter and outline are predicted from."""
    if model.shape is None:
        return model.target
    return replace(model.target, radii_km=model.shape.radii_km)
