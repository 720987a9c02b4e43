"""A stack's center as an observable: at the mean epoch, against the place predicted for it."""

from collections.abc import Sequence

import numpy as np

from opnav_workbench.arrays import FloatArray, symmetric
from opnav_workbench.bodycenters import BodyCenter
from opnav_workbench.campaign.stacking.combining import Stacked
from opnav_workbench.campaign.stacking.frames import StackFrame
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.observables import Observable, observe

__all__ = ["stack_attitude_covariance", "stack_observable"]


def stack_observable(
    stacked: Stacked, center: BodyCenter, *, image: str, utc: str, reference_body: str
) -> Observable:
    """Return the observable of a stack that follows its target.

    Parameters
    ----------
    stacked : Stacked
    center : BodyCenter
        As `find_in_stack` gives it.
    image, utc, reference_body : str
        Name of the stack, its epoch in UTC, and the body that the partials refer to.

    Raises
    ------
    CenterfindingError
        A stack without a target.
    """
    if stacked.target is None:
        raise CenterfindingError(
            "a stack without a target makes no observable; stack on the target's motion."
        )
    return observe(
        stacked.target,
        center,
        stacked.grid.camera,
        stacked.grid.camera_from_j2000,
        stack_attitude_covariance(stacked.frames, stacked.weights),
        observer_velocity_km_s=stacked.grid.observer_velocity_km_s,
        a_priori_px=stacked.predicted_px,
        diameter_px=np.nan,
        image=image,
        et=stacked.et,
        utc=utc,
        reference_body=reference_body,
    )


def stack_attitude_covariance(frames: Sequence[StackFrame], weights: FloatArray) -> FloatArray:
    """Return the covariance (3, 3) of the stack's attitude: errors of centers average out, the catalog's do not."""
    own = [frame.attitude_covariance_rad2 - frame.catalog_covariance_rad2 for frame in frames]
    common = [frame.catalog_covariance_rad2 for frame in frames]
    averaged = np.einsum("n,nij->ij", weights**2, np.array(own))
    return symmetric(averaged + np.einsum("n,nij->ij", weights, np.array(common)))
