"""Observables as one vector of residuals with its Jacobian and covariance, for any correction of the states.

The prediction is recomputed for each correction, exactly: relative position, light time, direction. It is compared with
the observed direction, aberration removed, on the plane that touches the sky there, in pixels through the camera's partials
at that very place. So nothing is linearised but the camera about the place where the body was seen, and a system that is
thousands of kilometers from its ephemeris needs no camera to be iterated.

    rho(x) = rho_0 + dr_target(et - tau) - dr_spacecraft(et) - v (tau(x) - tau_0),   tau = |rho| / c
    offset = T n / (n . n_obs) + T dv_spacecraft / c,  n = rho / |rho|               T: east and north at n_obs
    residual = -K offset                                                             K: d(pixel, line)/d(east, north)

Centers of one picture share its pointing error; ranges are independent of each other but for a common scale (the body's
radius), which can be a parameter.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from opnav_workbench.arrays import BoolArray, FloatArray, IntArray, freeze_arrays
from opnav_workbench.constants import SPEED_OF_LIGHT_KM_S
from opnav_workbench.errors import EstimationError
from opnav_workbench.estimation.parameters import ParameterGroup, parameter_count
from opnav_workbench.estimation.state_transition import Transition
from opnav_workbench.geometry import tangent_basis, tangent_offset, unit_from_radec
from opnav_workbench.geometry.light_time import light_time_jacobian, where_light_left
from opnav_workbench.observables import Observable, joint_covariance_px2

__all__ = ["Dynamics", "Measurements", "measurements_of"]

# Partials that older tables do not hold; without them nothing can be weighted or recomputed.
NEEDED_FIELDS = ("position_km", "sky_partials_px_per_rad")


@dataclass(frozen=True, slots=True)
class Dynamics:
    """Epoch of the corrections, and how they grow from there."""

    epoch_et: float
    target: Transition
    spacecraft: Transition


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """m observables, p of them with a range, and how they depend on n parameters; arrays are read-only.

    Rows are pixel 0, line 0, pixel 1, ... and then the ranges.

    Attributes
    ----------
    position_km, velocity_km_s : (m, 3) arrays
        Predicted relative position; the target's velocity (zero where not known).
    observed : (m, 3) array
        Observed directions, aberration removed.
    tangent, to_px : (m, 2, 3), (m, 2, 2) arrays
        East and north there; d(pixel, line)/d(east, north).
    by_target, by_spacecraft, by_velocity : (m, 3, n) arrays
        d(target's place when the light left, spacecraft's place, spacecraft's velocity)/d(parameters).
    range_of, range_km : (p,) arrays
        Observable of each range, and the measured range.
    range_scale : (p, n) array
        1 for the parameter that scales a range.
    covariance : (2 m + p, 2 m + p) array
        px^2, km^2.
    """

    position_km: FloatArray
    velocity_km_s: FloatArray
    observed: FloatArray
    tangent: FloatArray
    to_px: FloatArray
    by_target: FloatArray
    by_spacecraft: FloatArray
    by_velocity: FloatArray
    range_of: IntArray
    range_km: FloatArray
    range_scale: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def residuals(self, correction: FloatArray) -> FloatArray:
        """Return observed minus computed, (2 m + p,), for a correction (n,)."""
        return self.evaluate(correction)[0]

    def evaluate(self, correction: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return residuals (2 m + p,) and d(computed)/d(parameters) (2 m + p, n)."""
        rho, by_rho = self._relative(correction)
        distance = np.linalg.norm(rho, axis=1)
        n = rho / distance[:, None]
        offset, of_n = tangent_offset(n, self.observed, self.tangent)
        across = (np.eye(3) - n[:, :, None] * n[:, None]) / distance[:, None, None]
        aberration = self.tangent @ self.by_velocity / SPEED_OF_LIGHT_KM_S
        jacobian = self.to_px @ (of_n @ across @ by_rho + aberration)
        computed = np.einsum("mij,mj->mi", self.to_px, offset + aberration @ correction)
        ranges, by_range = self._ranges(correction, n, distance, by_rho)
        residual = np.concatenate([-computed.ravel(), self.range_km - ranges])
        return residual, np.concatenate([jacobian.reshape(-1, len(correction)), by_range])

    def _relative(self, correction: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where the light left, relative to the spacecraft (m, 3), and its derivative (m, 3, n)."""
        by_place = self.by_target - self.by_spacecraft
        moved = self.position_km + by_place @ correction
        before = np.linalg.norm(self.position_km, axis=1)
        rho = where_light_left(moved, before, self.velocity_km_s)
        return rho, light_time_jacobian(rho, self.velocity_km_s) @ by_place

    def _ranges(
        self, correction: FloatArray, n: FloatArray, distance: FloatArray, by_rho: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        scale = 1.0 + self.range_scale @ correction
        of = self.range_of
        by_distance = np.einsum("pi,pin->pn", n[of], by_rho[of])
        return scale * distance[of], scale[:, None] * by_distance + distance[of, None] * self.range_scale

    def rows_of(self, centers: BoolArray, ranges: BoolArray) -> IntArray:
        """Return the rows of the chosen centers (m,) and ranges (p,)."""
        return np.flatnonzero(np.concatenate([np.repeat(centers, 2), ranges]))


def measurements_of(
    observables: Sequence[Observable], groups: Sequence[ParameterGroup], dynamics: Dynamics
) -> Measurements:
    """Prepare observables that have a center.

    Raises
    ------
    EstimationError
        An observable without the partials that this needs, or a body twice in one picture.
    """
    _check_observables(observables)
    directions = unit_from_radec(
        np.radians([o.ra_deg for o in observables]), np.radians([o.dec_deg for o in observables])
    )
    east, north = tangent_basis(
        np.radians([o.ra_deg for o in observables]), np.radians([o.dec_deg for o in observables])
    )
    ranged = [i for i, o in enumerate(observables) if _has_range(o)]
    sigma = np.array([observables[i].range_sigma_km for i in ranged])
    by_target, by_spacecraft, by_velocity = _state_maps(observables, groups, dynamics)
    return Measurements(
        position_km=np.array([o.position_km for o in observables]),
        velocity_km_s=np.array([_or_zero(o.target_velocity_km_s) for o in observables]),
        observed=directions,
        tangent=np.stack([east, north], axis=1),
        to_px=np.array([o.sky_partials_px_per_rad for o in observables]),
        by_target=by_target,
        by_spacecraft=by_spacecraft,
        by_velocity=by_velocity,
        range_of=np.array(ranged, dtype=np.int64),
        range_km=np.array([observables[i].measured_range_km for i in ranged]),
        range_scale=np.reshape(
            [_range_scale_row(observables[i], groups) for i in ranged], (len(ranged), parameter_count(groups))
        ),
        covariance=np.asarray(block_diag(joint_covariance_px2(observables), np.diag(sigma**2))),
    )


def _check_observables(observables: Sequence[Observable]) -> None:
    seen = set()
    for o in observables:
        lacking = [name for name in NEEDED_FIELDS if getattr(o, name) is None]
        if lacking:
            raise EstimationError(
                f"{o.name} in {o.image} has no {', '.join(lacking)}; process the picture again with this version."
            )
        if (o.image, o.name) in seen:
            raise EstimationError(
                f"{o.name} in {o.image} is given twice, by several methods; choose one, for they use the same pixels."
            )
        seen.add((o.image, o.name))


def _has_range(o: Observable) -> bool:
    return bool(np.isfinite(o.measured_range_km) and o.range_sigma_km > 0.0)


def _or_zero(velocity: FloatArray | None) -> FloatArray:
    return np.zeros(3) if velocity is None else velocity


def _range_scale_row(o: Observable, groups: Sequence[ParameterGroup]) -> FloatArray:
    row = np.zeros(parameter_count(groups))
    for group in groups:
        if group.kind == "range_scale" and group.moves(o.name):
            row[group.columns] = 1.0
    return row


def _state_maps(
    observables: Sequence[Observable], groups: Sequence[ParameterGroup], dynamics: Dynamics
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """d(target place, spacecraft place, spacecraft velocity)/d(parameters), (m, 3, n) each."""
    maps = np.zeros((3, len(observables), 3, parameter_count(groups)))
    for i, o in enumerate(observables):
        light_time_s = float(np.linalg.norm(o.position_km)) / SPEED_OF_LIGHT_KM_S  # type: ignore[arg-type]
        target = dynamics.target(dynamics.epoch_et, o.et - light_time_s)
        spacecraft = dynamics.spacecraft(dynamics.epoch_et, o.et)
        for group in groups:
            body, _, quantity = group.kind.partition("_")
            columns = slice(0, 3) if quantity == "position" else slice(3, 6)
            if body == "target" and group.moves(o.name):
                maps[0, i, :, group.columns] = target[:3, columns]
            elif body == "spacecraft":
                maps[1, i, :, group.columns] = spacecraft[:3, columns]
                maps[2, i, :, group.columns] = spacecraft[3:, columns]
    return maps[0], maps[1], maps[2]
