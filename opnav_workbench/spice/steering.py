"""Attitudes of a pointing plan: the camera held on targets or a fixed direction, as predicted and as flown.

Frames  ``camera_from_j2000``; places on the detector are counted in pixels of the boresight's scale, without
        distortion: a plan does not need more.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.geometry.rotations import (
    camera_from_j2000,
    pointing_angles,
    radec_from_unit,
    unit,
    unit_from_radec,
)
from opnav_workbench.spice.scenario import Scenario
from opnav_workbench.spice.scenario_pointing import AttitudeError, Window
from opnav_workbench.spice.states import state
from opnav_workbench.spice.trajectories import utc_to_et

__all__ = ["aim", "disturbed", "window_attitudes"]

ROUNDING = 1e-12  # rad


def aim(
    direction: ArrayLike,
    twist_rad: float,
    focal_from_camera: ArrayLike,
    offset_rad: tuple[float, float] = (0.0, 0.0),
) -> FloatArray:
    """Return the attitude (3, 3) in which a J2000 direction appears at an offset from the boresight.

    Parameters
    ----------
    direction : (3,) array_like
        J2000, of any length.
    twist_rad : float
        Position angle of increasing line, east of J2000 north, at the boresight.
    focal_from_camera : (3, 3) array_like
        Rows: increasing pixel, increasing line and boresight, unit vectors in the camera frame.
    offset_rad : (2,) tuple
        Tangents of the offset along pixel and line.

    Raises
    ------
    ValueError
        `focal_from_camera` is not orthonormal; or the direction is so near a celestial pole that no boresight
        has it at that offset with that twist.

    Examples
    --------
    >>> focal = np.diag([1.0, 1.0, -1.0])
    >>> seen = focal @ aim([1.0, 0.0, 0.0], 0.3, focal, (1e-3, -2e-3)) @ [1.0, 0.0, 0.0]
    >>> (seen[:2] / seen[2]).round(12).tolist()
    [0.001, -0.002]
    """
    focal = np.asarray(focal_from_camera, float)
    offset = unit([*offset_rad, 1.0])
    ra, dec = (float(angle) for angle in radec_from_unit(direction))
    boresight_dec = _boresight_dec(dec, twist_rad, offset, float(np.sign(np.linalg.det(focal))))
    at_zero = camera_from_j2000(0.0, boresight_dec, twist_rad, focal)
    ra_of_offset, _ = radec_from_unit(at_zero.T @ focal.T @ offset)  # its declination is right already
    return camera_from_j2000(ra - float(ra_of_offset), boresight_dec, twist_rad, focal)


def _boresight_dec(dec_rad: float, twist_rad: float, offset: FloatArray, handedness: float) -> float:
    """Return the boresight's declination at which the offset direction (3,) has the declination `dec_rad`.

    In focal axes the celestial pole is ``(-h sin t cos d, cos t cos d, sin d)``, with handedness h, twist t
    and boresight declination d; its product with the offset, ``a cos d + b sin d``, is the sine of `dec_rad`.
    The root is taken from ``cos(dec)``, which keeps its digits at the pole.
    """
    sine, cosine = math.sin(twist_rad), math.cos(twist_rad)
    a, b = offset[1] * cosine - handedness * offset[0] * sine, offset[2]
    across = abs(offset[1] * sine + handedness * offset[0] * cosine)
    reach = math.cos(dec_rad)
    if reach > across - ROUNDING:
        half = math.atan2(math.sqrt(max(0.0, (reach - across) * (reach + across))), math.sin(dec_rad))
        roots = (math.remainder(math.atan2(b, a) + side * half, math.tau) for side in (-1.0, 1.0))
        best = min(roots, key=lambda d: abs(d - dec_rad))
        if abs(best) <= math.pi / 2 + ROUNDING:
            return min(math.pi / 2, max(-math.pi / 2, best))
    raise ValueError(
        f"declination {math.degrees(dec_rad):.4f} deg cannot be held at that offset with twist "
        f"{math.degrees(twist_rad):.4f} deg: too close to the pole; change offset or twist"
    )


def window_attitudes(scenario: Scenario, window: Window) -> tuple[FloatArray, FloatArray]:
    """Return epochs (n,) and predicted ``camera_from_j2000`` (n, 3, 3) of one window of a pointing plan.

    Needs an active `KernelSet` with the scenario's LSK and SPK. Targets are taken where they appear, with
    light time and stellar aberration.

    Raises
    ------
    KernelError
        A target's state is not covered.
    """
    camera = scenario.pointed_instrument
    pixel, line = window.offset_px
    offset = (pixel * camera.pixel_scale_rad, line * camera.pixel_scale_rad)
    start, end = utc_to_et(window.start), utc_to_et(window.end)
    et = np.append(np.arange(start, end, window.step_s), end)
    if len(et) > 2 and et[-1] - et[-2] < 1e-3 * window.step_s:  # rounding left a sliver
        et = np.delete(et, -2)
    attitudes = [
        aim(_direction(scenario, window, t), math.radians(window.twist_deg), camera.focal_from_camera, offset)
        for t in et
    ]
    return et, np.array(attitudes)


def _direction(scenario: Scenario, window: Window, et: float) -> FloatArray:
    if window.ra_deg is not None and window.dec_deg is not None:
        return unit_from_radec(math.radians(window.ra_deg), math.radians(window.dec_deg))
    observer = scenario.spacecraft.id
    seen = [state(scenario.body_id(b), et, observer, "J2000", "CN+S").position_km for b in window.track]
    return np.asarray(np.sum(unit(seen), axis=0))


def disturbed(predicted: FloatArray, error: AttitudeError, scenario: Scenario) -> FloatArray:
    """Return flown attitudes (n, 3, 3): predicted ones, sky shifted on the detector and twist added."""
    camera = scenario.pointed_instrument
    pixel, line = error.shift_px
    offset = (pixel * camera.pixel_scale_rad, line * camera.pixel_scale_rad)
    flown = []
    for attitude in predicted:
        ra, dec, twist = pointing_angles(attitude, camera.focal_from_camera)
        turned = twist + math.radians(error.twist_deg)
        flown.append(aim(unit_from_radec(ra, dec), turned, camera.focal_from_camera, offset))
    return np.array(flown)
