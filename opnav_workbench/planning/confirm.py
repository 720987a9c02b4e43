"""Pictures simulated to confirm a plan: noise realisations of what was planned.

What the plan counts as an error is one here: the noise of the detector, and the catalog's errors, which a simulated
sky otherwise does not have. The attitude may be off from the planned one, as in flight.
"""

from dataclasses import replace

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.catalog import StarTable
from opnav_workbench.planning.desk import Desk
from opnav_workbench.planning.sequence_parts import PlannedPicture
from opnav_workbench.simulation import PictureInputs
from opnav_workbench.simulation.true_attitude import shifted

__all__ = ["confirming_inputs"]

CATALOG_STREAM = 1001  # no stream of the simulation's own effects has this number


def confirming_inputs(
    desk: Desk,
    picture: PlannedPicture,
    number: int,
    *,
    shift_px: tuple[float, float] = (0.0, 0.0),
    twist_deg: float = 0.0,
) -> PictureInputs:
    """Return the inputs of a simulated picture that confirms a planned one, for `expose_picture`.

    Parameters
    ----------
    desk : Desk
    picture : PlannedPicture
    number : int
        Of the trial: noise and catalog errors are drawn anew for each; the same number gives the same picture.
    shift_px : (float, float)
        How the true attitude differs from the planned one: where the boresight's sky moves on the detector.
    twist_deg : float
        The same about the boresight.

    Raises
    ------
    OpNavError
        As `Desk.inputs`.
    """
    inputs = desk.inputs(picture, seed_name=f"{picture.name}_{number:04d}")
    planned = inputs.predicted_camera_from_j2000
    true = shifted(planned, inputs.camera, shift_px, twist_deg)
    return replace(
        inputs,
        name=f"{picture.name}_{number:04d}",
        stars=_displaced(inputs.stars, inputs.et, inputs.observer.position_km, inputs.seed),
        path=inputs.path.turned(true @ planned.T),
    )


def _displaced(stars: StarTable, et: float, observer_km: FloatArray, seed: int) -> StarTable:
    """Move each star by a draw from its catalog covariance at the picture's time, its unknown parallax included."""
    draws = np.random.default_rng([seed, CATALOG_STREAM]).normal(size=(len(stars), 2))
    value, vector = np.linalg.eigh(stars.sky_covariance(et, observer_km))
    scale: FloatArray = np.sqrt(np.maximum(value, 0.0))
    east, north = np.einsum("nij,nj->ni", vector, scale * draws).T
    ra = np.asarray(stars.ra_rad) + east / np.cos(stars.dec_rad)
    return replace(stars, ra_rad=ra, dec_rad=np.asarray(stars.dec_rad) + north)
