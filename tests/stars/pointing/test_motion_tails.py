"""Stars of unknown motion: a few run away, and the pointing is neither drawn along nor surer than it may be."""

import numpy as np
import pytest

from opnav_workbench.camera import Camera
from opnav_workbench.catalog import unknown_motion_mixture
from opnav_workbench.geometry import camera_from_j2000, rotation_from_vector, vector_from_rotation
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.stars.pointing import MotionTails, solve_pointing

YEARS, CENTER_PX = 20.0, 0.03


def _field(rng, camera, n):
    """One field of n stars that move as the sky's do: error of the attitude over its covariance, and error in rad."""
    shares, sigmas = unknown_motion_mixture(2.864, 0.122, np.full(n, 11.0))
    sigmas_px = sigmas * YEARS / camera.pixel_scale_rad
    shares = np.broadcast_to(shares, sigmas_px.shape)
    part = (rng.random((n, 1)) > np.cumsum(shares, axis=1)).sum(axis=1)
    whole = np.sum(shares * sigmas_px**2, axis=1)
    a_priori = camera_from_j2000(1.0, 0.3, 2.0, camera.focal_from_camera)
    truth = rotation_from_vector(rng.normal(0.0, 1e-4, 3)) @ a_priori
    places = rng.uniform(10.0, 245.0, (n, 2))
    seen = places + rng.normal(0.0, np.hypot(CENTER_PX, sigmas_px[np.arange(n), part])[:, None], (n, 2))
    unknown = whole[:, None, None] * np.eye(2)
    center = np.tile(CENTER_PX**2 * np.eye(2), (n, 1, 1))

    def solved(**options):
        solution = solve_pointing(
            seen, center, camera.unproject(places) @ truth, camera, a_priori,
            catalog_covariance_px2=unknown, twist_sigma_rad=1e-4, **options,
        )  # fmt: skip
        error = vector_from_rotation(solution.camera_from_j2000 @ truth.T)
        return error, error @ np.linalg.solve(solution.covariance_rad2, error) / 3.0

    return solved(), solved(motion_tails=MotionTails(unknown, shares, sigmas_px**2 / whole[:, None]))


@pytest.mark.parametrize(("n", "gain"), [(1, 1.0), (8, 1.0)])
def test_stars_that_run_away_neither_draw_the_pointing_along_nor_make_it_promise_too_much(n, gain):
    camera = Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_4x4.yaml")
    rng = np.random.default_rng(18)
    fields = [_field(rng, camera, n) for _ in range(20)]
    gaussian, mixture = (np.array([field[k][0][:2] for field in fields]) for k in range(2))
    assert np.sqrt(np.mean(mixture**2)) <= gain * np.sqrt(np.mean(gaussian**2)) * (1.0 + 1e-9)
    assert 0.4 < np.mean([field[1][1] for field in fields]) < 2.0
