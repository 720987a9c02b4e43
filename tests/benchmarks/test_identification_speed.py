"""Speed of identification and pointing of a frame with 300 detections, as a ratio against a search by brute force."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from opnav_workbench.camera import Camera
from opnav_workbench.geometry import rotation_from_vector
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.stars import Detections, identify_sky
from opnav_workbench.stars.pointing import solve_pointing

CAMERA = Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml")
DETECTIONS, COSMIC_RAYS = 300, 60
MAX_SHIFT_PX, MAX_TWIST_DEG = 60.0, 0.5
TOLERANCE_PX = 2.0
LEAST_GAIN = 10.0  # measured: 34
PEER_PART = 20  # the loop is timed on one of so many stars and scaled


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(300)
    turn = rotation_from_vector([2e-4, -1.5e-4, 0.0]) @ rotation_from_vector([0.0, 0.0, 0.006])
    places = rng.uniform(0.0, CAMERA.n_pixel - 1.0, (DETECTIONS - COSMIC_RAYS, 2))
    mag = 12.0 + np.log10(rng.uniform(1e-3, 1.0, len(places))) / 0.35
    stars = CAMERA.unproject(places) @ turn  # a priori = turn^-1 of the truth
    xy = np.vstack([places, rng.uniform(0.0, CAMERA.n_pixel - 1.0, (COSMIC_RAYS, 2))])
    seen_mag = np.r_[mag + rng.normal(0.0, 0.3, len(mag)), rng.uniform(3.0, 12.0, COSMIC_RAYS)]
    order = np.argsort(seen_mag)
    ones = np.ones(len(xy))
    seen = Detections(xy, 10.0 ** (-0.4 * (seen_mag - 20.0)), 30.0 * ones, ones, np.zeros(len(xy), int))
    return stars, mag, seen.take(order), turn


def identified_and_pointed(stars, mag, seen):
    found = identify_sky(
        stars, mag, seen, CAMERA, max_shift_px=MAX_SHIFT_PX, max_twist_rad=np.radians(MAX_TWIST_DEG)
    )
    star, detection = found.pairs.T
    covariance = np.tile(0.01 * np.eye(2), (len(star), 1, 1))
    return solve_pointing(seen.pixel_line[detection], covariance, stars[star], CAMERA, np.eye(3))


def brute_force(predicted, seen):
    """Every shift of a star onto a detection, for every twist: how many stars then meet a detection?"""
    tree, center, best = cKDTree(seen), np.asarray(CAMERA.center_pixel_line), (0, None)
    steps = int(np.ceil(np.radians(MAX_TWIST_DEG) * np.hypot(*center) / TOLERANCE_PX))
    for twist in np.linspace(-1.0, 1.0, 2 * steps + 1) * np.radians(MAX_TWIST_DEG):
        c, s = np.cos(twist), np.sin(twist)
        turned = (predicted - center) @ np.array([[c, s], [-s, c]]) + center
        for place in turned[: max(1, len(turned) // PEER_PART)]:
            for shift in seen[np.hypot(*(seen - place).T) <= MAX_SHIFT_PX] - place:
                count = np.isfinite(tree.query(turned + shift, distance_upper_bound=TOLERANCE_PX)[0]).sum()
                best = max(best, (count, shift), key=lambda item: item[0])
    return best


def test_identification_and_pointing_against_brute_force(benchmark, fastest, scene):
    stars, mag, seen, turn = scene
    (part_s, _), (ours_s, solution) = fastest(
        lambda: brute_force(CAMERA.project(stars), np.asarray(seen.pixel_line)),
        lambda: identified_and_pointed(stars, mag, seen),
        enough=lambda part_s, ours_s: part_s * PEER_PART > LEAST_GAIN * ours_s,
    )
    loop_s = part_s * PEER_PART
    benchmark(identified_and_pointed, stars, mag, seen)
    benchmark.extra_info["times_faster_than_brute_force"] = loop_s / ours_s
    np.testing.assert_allclose(solution.camera_from_j2000, turn, atol=1e-8)
    assert loop_s / ours_s > LEAST_GAIN
