"""The Moffat PSF against quadrature of its density."""

import numpy as np
import pytest

from opnav_workbench.errors import CameraError
from opnav_workbench.psf import MoffatPsf, covering_boxes

SHARE_TOLERANCE = 1e-6


def moffat_density(center, fwhm, beta):
    alpha = fwhm / (2.0 * np.sqrt(2.0 ** (1.0 / beta) - 1.0))

    def density(x, y):
        r2 = ((x - center[0]) ** 2 + (y - center[1]) ** 2) / alpha**2
        return (beta - 1.0) / (np.pi * alpha**2) * (1.0 + r2) ** -beta

    return density


@pytest.mark.parametrize(("fwhm", "beta"), [(0.8, 3.0), (1.7, 4.765), (2.0, 2.5), (3.5, 3.5)])
def test_shares_agree_with_quadrature(pixel_quadrature, fwhm, beta):
    line, pixel = np.indices((7, 7)).reshape(2, -1) - 3.0
    center = np.array([0.37, -0.18])
    expected = pixel_quadrature(moffat_density(center, fwhm, beta), pixel, line, parts=4)
    psf = MoffatPsf(fwhm, beta)
    box = psf.box(center[None], [[-3, -3]], 7)[0].ravel()
    kept = 1.0 / (
        box @ expected / (expected @ expected)
    )  # the wings that are cut off are spread over the rest
    assert 0.998 < kept < 1.0
    np.testing.assert_allclose(box * kept, expected, rtol=0.0, atol=SHARE_TOLERANCE)


def test_share_that_is_cut_off_is_the_one_asked_for():
    wide, narrow = MoffatPsf(2.0, 3.0, cut_share=1e-4), MoffatPsf(2.0, 3.0, cut_share=1e-2)
    center = np.zeros((1, 2))
    first, size = covering_boxes(wide, center)
    box = wide.box(center, first, size)[0]
    reach = int(narrow.half_size_px)
    middle = size // 2
    inside = box[middle - reach : middle + reach + 1, middle - reach : middle + reach + 1].sum()
    assert 0.985 < inside < 0.999
    assert wide.half_size_px > 2.0 * narrow.half_size_px


def test_half_of_the_peak_lies_at_half_the_width():
    kernel = MoffatPsf(4.0, 3.0).kernel(25)
    middle = len(kernel) // 2
    assert kernel[middle, middle + 50] / kernel[middle, middle] == pytest.approx(0.5, abs=2e-3)


def test_becomes_a_gaussian_for_large_beta():
    psf = MoffatPsf(2.0, 1000.0, cut_share=1e-7)
    np.testing.assert_allclose(psf.sigma_px, 2.0 / np.sqrt(8.0 * np.log(2.0)), rtol=2e-3)


@pytest.mark.parametrize("wrong", [(0.0, 3.0), (2.0, 1.0), (2.0, np.nan), (2.0, 3.0, 1.5), (2.0, 3.0, 0.0)])
def test_parameters_without_sense_are_refused(wrong):
    with pytest.raises(CameraError, match="Moffat PSF"):
        MoffatPsf(*wrong)
