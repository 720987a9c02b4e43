"""A rehearsal's flyby by the filter: what it allows for beside the batch, and how what passes through it is delivered.

`estimation.filter_estimate` does the work. Here noise and considered constants are made of few words, and residuals and
states on their way through the filter become rows of the solution's file.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.constants import DAY_S
from opnav_workbench.errors import EstimationError
from opnav_workbench.estimation import (
    Acceleration,
    CenterBias,
    FilterEstimate,
    FilterResidual,
    FilterStep,
    ModelParameter,
    Pointing,
    focal_length,
    gravity,
)
from opnav_workbench.files import plain_values
from opnav_workbench.mission import load_mission
from opnav_workbench.observables import Observable

if TYPE_CHECKING:
    from opnav_workbench.rehearsal.package import OrtPackage

__all__ = ["FilterOptions", "filter_residual_row", "filter_rows"]

GM, FOCAL_LENGTH = "gm", "focal_length"
PUSHED = {"spacecraft_position", "spacecraft_velocity"}  # what an acceleration acts on
CONSTANTS = {GM: "km^3/s^2", FOCAL_LENGTH: "of itself"}  # what has no sigma in a package


@dataclass(frozen=True, slots=True)
class FilterOptions:
    """What the filter allows for beside the batch's parameters; with nothing it is the batch, picture by picture.

    Attributes
    ----------
    acceleration
        Stochastic, of the spacecraft.
    pointing
        Errors of attitudes beyond their covariance.
    bias
        Of centers, beyond theirs.
    consider : mapping of str to float or None
        Not solved for, but in every covariance: parameters of the rehearsal, with their own a priori sigmas (None), and the
        constants ``gm`` (of the B-plane's body, km^3/s^2) and ``focal_length`` (a share), with a sigma.
    """

    acceleration: Acceleration | None = None
    pointing: Pointing | None = None
    bias: CenterBias | None = None
    consider: Mapping[str, float | None] = field(default_factory=dict)

    @property
    def words(self) -> tuple[str, ...]:
        """Return what is allowed for, in words."""
        parts: list[str] = []
        if (a := self.acceleration) is not None:
            parts.append(f"acceleration of {a.sigmas[0]:g} km/s^2{_lasting(a.correlation_s)}")
        if (p := self.pointing) is not None:
            parts.append(
                f"pointing of {np.degrees(p.sigmas[0]) * 3600.0:g} arcsec{_lasting(p.correlation_s)}"
            )
        if (b := self.bias) is not None:
            parts.append(f"centers of {b.sigma_px:g} px{_lasting(b.correlation_s)}")
        for name, sigma in self.consider.items():
            parts.append(f"{name} considered" + ("" if sigma is None else f", {sigma:g} {CONSTANTS[name]}"))
        return tuple(parts)

    def keywords(self, package: "OrtPackage", state: FloatArray, until_et: float) -> dict[str, Any]:
        """Return the options of `filter_estimate`.

        Parameters
        ----------
        state : (6,) array
            Spacecraft relative to the B-plane's body at the epoch, km and km/s.
        until_et
            The encounter: accelerations act until then.

        Raises
        ------
        EstimationError
            What is considered is neither a parameter of the package nor a constant, or has a sigma where it must not; or an
            acceleration has no state of the package's to act on.
        """
        if self.acceleration is not None and not set(package.parameters) >= PUSHED:
            raise EstimationError(
                f"{package.name} estimates {', '.join(package.parameters)}: an acceleration of the spacecraft needs its "
                "position and velocity among them; leave it out."
            )
        model = []
        for name, sigma in self.consider.items():
            if name not in package.parameters and name not in CONSTANTS:
                known = ", ".join((*package.parameters, *CONSTANTS))
                raise EstimationError(f"{name!r} cannot be considered; choose among {known}.")
            if (name in CONSTANTS) != (sigma is not None):
                how = (
                    f"a sigma, {name}=SIGMA" if sigma is None else "none: its a priori sigma is the package's"
                )
                raise EstimationError(f"{name}, which is to be considered, needs {how}.")
            if sigma is not None:
                model.append(_constant(name, sigma, package, state))
        return {
            "accelerations": () if self.acceleration is None else (self.acceleration,),
            "pointing": self.pointing,
            "biases": () if self.bias is None else (self.bias,),
            "model": tuple(model),
            "consider": tuple(self.consider),
            "until_et": until_et,
        }


def _lasting(correlation_s: float) -> str:
    if correlation_s == 0.0:
        return ", each picture its own"
    return ", the same always" if np.isinf(correlation_s) else f" for {correlation_s / DAY_S:g} days"


def _constant(name: str, sigma: float, package: "OrtPackage", state: FloatArray) -> ModelParameter:
    if name == GM:
        assert package.b_plane is not None
        return gravity(state, package.b_plane.gm_km3_s2, sigma, GM)
    mission = load_mission(package.mission)
    of_camera = {
        camera: focal_length(mission.camera_named(camera), sigma)
        for camera in dict.fromkeys(picture.camera for picture in package.pictures)
    }
    of_picture = {picture.name: of_camera[picture.camera].pixels for picture in package.pictures}

    def pixels(o: Observable) -> Any:
        moved = of_picture[Path(o.image).stem]
        assert moved is not None
        return moved(o)

    return ModelParameter(FOCAL_LENGTH, sigma, pixels=pixels)


def filter_rows(found: FilterEstimate, options: FilterOptions) -> dict[str, Any]:
    """Return what passed through a filter as plain values: its noise, its parameters, a row a picture, its edits.

    Before pictures determine the parameters, values are None.
    """
    return {
        "allowed_for": options.words,
        "labels": found.labels,
        "units": found.units,
        "considered": found.considered,
        "steps": [_step_row(step) for step in found.steps],
        "edits": [asdict(edit) for edit in found.edits],
    }


def _step_row(step: FilterStep) -> dict[str, Any]:
    row: dict[str, Any] = {"image": step.image, "et": step.et}
    for name in ("predicted", "filtered", "smoothed"):
        covariance = getattr(step, f"{name}_covariance")
        row |= {name: getattr(step, name), f"{name}_sigma": np.sqrt(np.diag(covariance))}
    filled: dict[str, Any] = plain_values(row)
    return filled


def filter_residual_row(r: FilterResidual) -> dict[str, Any]:
    """Return a residual with the batch's names: before is without a correction, after with all pictures.

    What it was before the filter took its picture in stands beside, as predicted.
    """
    same = {
        name: getattr(r, name)
        for name in ("image", "body", "kind", "et", "covariance", "sigmas", "used", "reason")
    }
    predicted = {"predicted": plain_values(r.before), "predicted_sigmas": plain_values(r.before_sigmas)}
    return same | {"before": r.a_priori, "after": r.smoothed} | predicted
