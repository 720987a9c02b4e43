"""The elliptical Gaussian PSF against quadrature and closed forms."""

import numpy as np
import pytest
from scipy.special import erf

from opnav_workbench.errors import CameraError
from opnav_workbench.psf import GaussianPsf

SHARE_TOLERANCE = 1e-9


@pytest.mark.parametrize(
    ("major", "minor", "angle"),
    [(0.15, 0.15, 0.0), (0.5, 0.3, 0.4), (0.7, 0.7, 1.0), (1.3, 0.9, -0.8), (3.0, 0.5, 2.0), (2.5, 2.0, 0.1)],
)
def test_shares_agree_with_quadrature(pixel_quadrature, gaussian_density, major, minor, angle):
    line, pixel = np.indices((7, 7)).reshape(2, -1) - 3.0
    center = np.array([0.37, -0.18])
    expected = pixel_quadrature(gaussian_density(center, major, minor, angle), pixel, line, parts=8)
    box = GaussianPsf(major, minor, angle).box(center[None], [[-3, -3]], 7)[0]
    np.testing.assert_allclose(box.ravel(), expected, rtol=0.0, atol=SHARE_TOLERANCE)


def test_shares_agree_with_32_by_32_points_a_pixel(gaussian_density):
    at = (np.arange(9 * 32) + 0.5) / 32 - 4.5
    density = gaussian_density((0.2, 0.4), 1.1, 0.8, 0.6)(*np.meshgrid(at, at)) / 32**2
    expected = density.reshape(9, 32, 9, 32).sum(axis=(1, 3))
    box = GaussianPsf(1.1, 0.8, 0.6).box([[0.2, 0.4]], [[-4, -4]], 9)[0]
    np.testing.assert_allclose(box, expected, atol=3e-5)  # what the midpoint rule leaves at 32 x 32


def test_central_pixel_of_a_round_gaussian_is_the_error_function():
    for sigma in (0.3, 0.5, 1.0, 2.0):
        expected = erf(0.5 / (np.sqrt(2.0) * sigma)) ** 2
        assert GaussianPsf(sigma, sigma).box([[7.0, 3.0]], [[7, 3]], 1)[0, 0, 0] == pytest.approx(
            expected, abs=1e-15
        )


def test_angle_turns_from_pixel_toward_line():
    box = GaussianPsf(1.5, 0.5, np.pi / 2.0).box([[0.0, 0.0]], [[-3, -3]], 7)[0]
    assert box[6, 3] > 100.0 * box[3, 6]
    np.testing.assert_allclose(GaussianPsf(1.5, 0.5, np.pi / 2.0).sigma_px, [0.5, 1.5], atol=1e-12)


def test_a_half_turn_changes_nothing():
    args = [[0.3, 0.1]], [[-4, -4]], 9
    np.testing.assert_allclose(
        GaussianPsf(1.2, 0.7, 0.4).box(*args), GaussianPsf(1.2, 0.7, 0.4 + np.pi).box(*args), atol=1e-14
    )


@pytest.mark.parametrize("wrong", [(0.0, 1.0), (1.0, -1.0), (np.nan, 1.0), (1.0, 1.0, np.inf)])
def test_no_psf_without_width(wrong):
    with pytest.raises(CameraError, match="Gaussian PSF"):
        GaussianPsf(*wrong)


def test_points_nowhere_are_refused():
    with pytest.raises(CameraError, match="finite"):
        GaussianPsf(1.0, 1.0).box([[np.nan, 0.0]], [[0, 0]], 3)
    with pytest.raises(CameraError, match="at least 1"):
        GaussianPsf(1.0, 1.0).kernel(0)
