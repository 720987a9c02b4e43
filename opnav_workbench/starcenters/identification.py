"""Which detection is which star, whatever the pointing error within given limits, and how sure that is.

Pairs of stars and of detections vote for rotations (`voting`), the best are refined (`matching`) and weighed
(`evidence`); `judging` turns the weights into a confidence.
"""

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import IntArray
from opnav_workbench.camera import Camera
from opnav_workbench.starcenters.detections import Detections
from opnav_workbench.starcenters.evidence import log_evidence
from opnav_workbench.starcenters.judging import SURE, Identification, in_camera, judge, nothing
from opnav_workbench.starcenters.matching import most_promising, refine
from opnav_workbench.starcenters.single_stars import single_stars
from opnav_workbench.starcenters.sky_scene import (
    Hypothesis,
    Limits,
    Scene,
    camera_scene,
    checked_limits,
    plane_scene,
    shift_and_twist,
)
from opnav_workbench.starcenters.voting import KEPT_HYPOTHESES, vote

__all__ = ["MAX_SHIFT_PX", "TOLERANCE_PX", "Identification", "identify", "identify_scene", "identify_sky"]

MAX_SHIFT_PX = 60.0  # attitude errors of 40 px are usual (AAS 13-443)
MAX_TWIST_RAD = float(np.radians(0.5))  # headers are off by 0.2 deg (LORRI, 2020)
TOLERANCE_PX = 2.0  # unmodeled proper motion and distortion, coarse centers
REFINED = 12  # hypotheses refined, those that bring most stars near detections


def identify_sky(
    directions: ArrayLike,
    magnitude: ArrayLike,
    detections: Detections,
    camera: Camera,
    *,
    max_shift_px: float = MAX_SHIFT_PX,
    max_twist_rad: float = MAX_TWIST_RAD,
    tolerance_px: float = TOLERANCE_PX,
    zero_point_mag: float | None = None,
) -> Identification:
    """Match stars with detections through the camera's own geometry; for errors up to any shift and twist.

    Parameters
    ----------
    directions : (n, 3) array_like
        Apparent unit vectors of the catalog stars in the camera frame of the a priori attitude, on the detector and as
        far around it as the pointing may be off.
    magnitude : (n,) array_like
        Their magnitudes; nan where unknown.
    detections : Detections
        From `detect`; cosmic rays among them are expected.
    camera : Camera
    max_shift_px, max_twist_rad : float
        Limits of the pointing error; a twist of pi is any twist.
    tolerance_px : float
        Largest distance between a star and its detection, once the rotation is right.
    zero_point_mag : float, optional
        Magnitude of a star of 1 DN total flux in this exposure; without it brightness only ranks.

    Returns
    -------
    Identification
        Without a match: no pairs, confidence 0, and a message that says why.

    Raises
    ------
    CenterfindingError
        Arrays of the wrong shape, directions that are not finite, or limits that are negative.

    Examples
    --------
    A picture turned by a quarter and 100 px off:

    >>> from opnav_workbench.geometry import rotation_from_vector
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    >>> places = np.random.default_rng(1).uniform(0.0, 1000.0, (8, 2))
    >>> turn = rotation_from_vector(camera.focal_from_camera.T @ [0.0, 100.0 * camera.pixel_scale_rad, np.pi / 2])
    >>> seen = Detections(places, *np.ones((3, 8)), np.zeros(8, int))
    >>> stars = camera.unproject(places) @ turn
    >>> found = identify_sky(stars, np.full(8, 9.0), seen, camera, max_shift_px=200.0, max_twist_rad=np.pi)
    >>> len(found.pairs), found.sure, bool(np.allclose(found.rotation, turn, atol=1e-6))
    (8, True, True)
    """
    scene, kept = camera_scene(directions, magnitude, detections, camera, zero_point_mag)
    found = identify_scene(scene, checked_limits(max_shift_px, max_twist_rad, tolerance_px))
    return in_camera(found, kept, camera.focal_from_camera)


def identify(
    predicted_px: ArrayLike,
    magnitude: ArrayLike,
    detections: Detections,
    *,
    center_px: ArrayLike,
    max_shift_px: float = MAX_SHIFT_PX,
    max_twist_rad: float = MAX_TWIST_RAD,
    tolerance_px: float = TOLERANCE_PX,
    zero_point_mag: float | None = None,
) -> Identification:
    """Match predicted stars with detections in the plane of the picture, where distortion is small.

    Parameters
    ----------
    predicted_px : (n, 2) array_like
        A priori (pixel, line) of the catalog stars on and around the detector.
    magnitude, detections, max_shift_px, max_twist_rad, tolerance_px, zero_point_mag
        As in `identify_sky`.
    center_px : (2,) array_like
        Center of the detector (pixel, line), about which the twist turns; the detector ends at twice that.

    Returns
    -------
    Identification
        Without a match: no pairs, confidence 0, and a message that says why.

    Raises
    ------
    CenterfindingError
        Arrays of the wrong shape or limits that are negative.

    Examples
    --------
    >>> stars = np.array([[20.0, 30.0], [200.0, 80.0], [90.0, 210.0], [150.0, 150.0]])
    >>> seen = Detections(stars + [12.0, -7.0], *np.ones((3, 4)), np.zeros(4, int))
    >>> found = identify(stars, np.full(4, 9.0), seen, center_px=(127.5, 127.5))
    >>> found.shift_px.round(3).tolist(), len(found.pairs), found.sure
    ([12.0, -7.0], 4, True)
    """
    scene = plane_scene(predicted_px, magnitude, detections, center_px, zero_point_mag)
    return identify_scene(scene, checked_limits(max_shift_px, max_twist_rad, tolerance_px))


def identify_scene(
    scene: Scene, limits: Limits, voting: IntArray | None = None, kept: int = KEPT_HYPOTHESES
) -> Identification:
    """Return the likeliest rotation; all detections vote for it, or only some."""
    if len(scene.stars) == 0:
        return nothing(scene, "no predicted star near the detector: nothing to identify")
    if len(scene.detected) == 0:
        return nothing(scene, "no star detected in the image")
    rotations = most_promising(scene, limits, vote(scene, limits, voting, kept), REFINED)
    hypotheses = [refine(scene, limits, rotation) for rotation in rotations]
    hypotheses = [h for h in hypotheses if len(h.pairs) > 1 and _within(scene, limits, h)]
    evidence = [log_evidence(scene, limits, h) for h in hypotheses]
    if voting is None and max(evidence, default=-np.inf) < np.log(1.0 / (1.0 - SURE)):
        singles = [h for h in single_stars(scene, limits) if _within(scene, limits, h)]
        hypotheses += singles
        evidence += [log_evidence(scene, limits, h) for h in singles]
    if not hypotheses:
        within = f"{limits.max_shift_px:g} px and {np.degrees(limits.max_twist_rad):.3g} deg"
        return nothing(scene, f"no detection has place and brightness of a star within {within}")
    return judge(scene, limits, hypotheses, np.array(evidence))


def _within(scene: Scene, limits: Limits, h: Hypothesis) -> bool:
    shift, _ = shift_and_twist(h.rotation, scene.focal_px)
    return bool(np.hypot(*shift) <= limits.max_shift_px + limits.tolerance_px)
