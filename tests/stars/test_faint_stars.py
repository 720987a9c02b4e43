"""The paper's finding: the matched filter pulls more faint stars out of the noise than the cross-correlation.

Both look for the same stars in the same images, each above the threshold that its own empty fields exceed in one
search of a hundred. The stars have wings; the matched filter's template is a real star, the other's a Gaussian.
"""

import numpy as np
import pytest

from opnav_workbench.constants import FWHM_PER_SIGMA
from opnav_workbench.psf import MoffatPsf, add_sources
from opnav_workbench.stars import correlate, extract_template, flux_at_snr, gaussian_template

NOISE_DN = 3.0
STARS, SPACING = 1600, 32
FWHM_PX, BETA = 2.0, 2.5
SEARCH_PX, FOUND_PX = 6.0, 1.5
FALSE_ALARM = 0.01
EMPTY_FIELDS = 6  # 9600 searches, some 100 false alarms


@pytest.fixture(scope="module")
def sky():
    rng = np.random.default_rng(11)
    line, pixel = np.divmod(np.arange(STARS), 40)
    truth = np.column_stack([pixel, line]) * SPACING + SPACING // 2 + rng.uniform(-0.5, 0.5, (STARS, 2))
    return rng, truth, truth + rng.uniform(-3.0, 3.0, truth.shape)


def searches():
    """The two methods as functions of an image and starts."""
    rng = np.random.default_rng(12)
    bright = np.full((60, 60), 40.0)
    add_sources(bright, MoffatPsf(FWHM_PX, BETA), [[30.2, 29.7]], [2e5])
    bright += rng.normal(0.0, NOISE_DN, bright.shape)
    star = extract_template(bright, None, [30.2, 29.7], 3.0 * FWHM_PX)
    gaussian = gaussian_template(FWHM_PX / FWHM_PER_SIGMA, 9)
    for template, method in ((star, "matched_filter"), (gaussian, "cross_correlation")):
        yield lambda image, start, template=template, method=method: correlate(
            image, NOISE_DN, None, start, template, search_radius_px=SEARCH_PX, method=method
        )


@pytest.mark.slow
def test_the_matched_filter_finds_more_faint_stars_at_equal_false_alarm_rate(sky):
    rng, truth, start = sky
    shape = (40 * SPACING, 40 * SPACING)
    filters = list(searches())
    empty = rng.normal(0.0, NOISE_DN, (EMPTY_FIELDS, *shape))
    thresholds = [
        np.quantile([find(field, start).snr for field in empty], 1.0 - FALSE_ALARM) for find in filters
    ]
    psf, part = MoffatPsf(FWHM_PX, BETA), []
    for snr in (3.0, 4.0, 5.0, 6.0, 8.0):
        flux = flux_at_snr(snr, psf, NOISE_DN, box_px=15, background="none")
        image = rng.normal(0.0, NOISE_DN, shape)
        add_sources(image, psf, truth, np.full(STARS, flux))
        seen = []
        for find, threshold in zip(filters, thresholds, strict=True):
            found = find(image, start)
            near = np.hypot(*(found.pixel_line - truth).T) < FOUND_PX
            seen.append(near & (found.snr > threshold))
        only = [np.sum(a & ~b) for a, b in (seen, seen[::-1])]
        assert only[0] >= only[1]
        if snr <= 5.0:  # stars that one finds and the other does not: a fair coin would not do this
            assert only[0] - only[1] > 3.0 * np.sqrt(sum(only))
        part.append([s.mean() for s in seen])
    matched, crossed = np.array(part).T
    assert matched[1] - crossed[1] > 0.02  # at SNR 4: of a hundred stars, two more at least
    assert matched[-1] > 0.995
