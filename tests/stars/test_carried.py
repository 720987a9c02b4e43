"""Attitudes carried between pictures: truth of its own with gyro noise, turned cameras, neighbors that disagree."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, kstest

from opnav_workbench.errors import PointingError
from opnav_workbench.geometry import rotation_from_vector, vector_from_rotation
from opnav_workbench.stars.pointing import AttitudeMotion, SolvedAttitude, carry_attitude

MOTION = AttitudeMotion(jitter_rad=2e-6, walk_rad=5e-7, drift_rad_s=3e-8)
STARS = np.diag([1e-6, 2e-6, 4e-5]) ** 2  # the third axis is the boresight


def sequence(rng, times, target_s):
    """Pictures of a camera that turns by tens of degrees, their stars, and the true attitude at one more time."""
    all_times = np.append(times, target_s)
    order = np.argsort(all_times)
    walk = np.zeros((len(all_times), 3))
    steps = np.sqrt(np.diff(all_times[order]))[:, None] * rng.normal(size=(len(times), 3)) * MOTION.walk_rad
    walk[order[1:]] = np.cumsum(steps, axis=0)
    common, rate = 5e-4 * rng.normal(size=3), MOTION.drift_rad_s * rng.normal(size=3)
    believed = Rotation.random(len(all_times), random_state=rng).as_matrix()
    jitter = MOTION.jitter_rad * rng.normal(size=(len(all_times), 3))
    true = [
        axes @ rotation_from_vector(common + t * rate + w + j)
        for axes, t, w, j in zip(believed, all_times, walk, jitter, strict=True)
    ]
    solved = [
        rotation_from_vector(-np.sqrt(np.diag(STARS)) * rng.normal(size=3)) @ attitude
        for attitude in true[:-1]
    ]
    neighbors = [
        SolvedAttitude(f"p{k}", t, s, b, STARS)
        for k, (t, s, b) in enumerate(zip(times, solved, believed[:-1], strict=True))
    ]
    return neighbors, believed[-1], true[-1]


@pytest.mark.parametrize("times", [[-8.0], [-30.0, 12.0], [-400.0, -60.0, 25.0, 300.0]])
def test_errors_over_sigmas(times):
    """One neighbor, one on either side, several; every camera turned otherwise."""
    rng, sizes, alone = np.random.default_rng(len(times)), [], []
    for _ in range(300):
        neighbors, believed, true = sequence(rng, np.array(times), 0.0)
        carried = carry_attitude(believed, 0.0, neighbors, MOTION)
        error = vector_from_rotation(true @ carried.camera_from_j2000.T)
        sizes.append(error @ np.linalg.solve(carried.covariance_rad2, error))
        alone.append(carried.chi2)
    assert kstest(sizes, chi2(3).cdf).pvalue > 1e-3
    if len(times) > 1:
        assert kstest(alone, chi2(3 * (len(times) - 1)).cdf).pvalue > 1e-3


def test_near_neighbors_count_most_and_each_makes_it_surer():
    rng = np.random.default_rng(9)
    neighbors, believed, _ = sequence(rng, np.array([-400.0, -60.0, 25.0, 300.0]), 0.0)
    all_of_them = carry_attitude(believed, 0.0, neighbors, MOTION)
    assert all_of_them.images == ("p2", "p1", "p3", "p0")
    assert all_of_them.after_s.tolist() == [-25.0, 60.0, -300.0, 400.0]
    alone = [np.trace(carry_attitude(believed, 0.0, [n], MOTION).covariance_rad2) for n in neighbors]
    assert int(np.argmin(alone)) == 2
    assert np.trace(all_of_them.covariance_rad2) < min(alone)


def test_neighbors_that_disagree_make_it_less_sure():
    rng = np.random.default_rng(10)
    neighbors, believed, true = sequence(rng, np.array([-20.0, 20.0]), 0.0)
    first, second = neighbors
    off = rotation_from_vector([3e-3, 0.0, 0.0]) @ second.camera_from_j2000
    spoiled = SolvedAttitude(second.image, second.et, off, second.a_priori_camera_from_j2000, STARS)
    agreed, torn = (carry_attitude(believed, 0.0, [first, n], MOTION) for n in (second, spoiled))
    assert torn.chi2 > 100.0 * torn.degrees_of_freedom
    assert np.trace(torn.covariance_rad2) > 100.0 * np.trace(agreed.covariance_rad2)
    error = vector_from_rotation(true @ torn.camera_from_j2000.T)
    assert error @ np.linalg.solve(torn.covariance_rad2, error) < 16.0


def test_bad_motion_and_no_neighbor_are_one_line():
    with pytest.raises(PointingError, match="no picture with stars to carry the pointing from"):
        carry_attitude(np.eye(3), 0.0, [], MOTION)
    for motion in ({"jitter_rad": -1.0}, {"jitter_rad": 0.0}, {"jitter_rad": np.nan}):
        with pytest.raises(PointingError, match="give sigmas of zero or more"):
            AttitudeMotion(**motion)
