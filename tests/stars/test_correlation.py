"""Matched filter and cross-correlation: centers, errors, and what they say when there is nothing to find."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from opnav_workbench.errors import CenterfindingError
from opnav_workbench.stars import StarFlag, correlate, extract_template, fit_gaussian, gaussian_template
from opnav_workbench.stars.peaks import refine_peaks
from opnav_workbench.stars.results import ShapePrior

NOISE_DN = 3.0
METHODS = ("matched_filter", "cross_correlation")


def field(render_stars, star_grid, sigma, snr, seed, n=400):
    rng = np.random.default_rng(seed)
    centers, shape = star_grid(n, 32, rng)
    flux = snr * NOISE_DN * np.sqrt(4.0 * np.pi * (sigma**2 + 1.0 / 12.0))
    image = render_stars(shape, centers, flux, sigma) + rng.normal(0.0, NOISE_DN, shape) + 25.0
    return image, centers, flux, centers + rng.uniform(-4.0, 4.0, centers.shape)


@pytest.mark.slow(keep=["0.35-30.0-matched_filter", "0.7-15.0-cross_correlation"])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("sigma", "snr"), [(0.35, 30.0), (0.7, 15.0), (1.0, 40.0), (2.0, 40.0)])
def test_centers_agree_with_truth_within_their_sigmas(render_stars, star_grid, method, sigma, snr):
    image, truth, flux, start = field(render_stars, star_grid, sigma, snr, [int(100 * sigma), 7])
    template = gaussian_template(sigma, 2 * int(np.ceil(4 * sigma)) + 1)
    found = correlate(image, NOISE_DN, None, start, template, search_radius_px=6.0, method=method)
    assert found.method == method
    assert found.usable.mean() > 0.99
    error = (found.pixel_line - truth)[found.usable]
    assert np.abs(error).max() < 1.0
    scatter = (error / found.sigma_px[found.usable]).std(axis=0)
    assert np.all((scatter > 0.8) & (scatter < 1.25)), scatter  # the covariance is approximate
    assert np.all(np.abs(error.mean(axis=0)) < 0.02)
    assert 0.65 < np.median(found.flux_dn) / flux < 1.05  # the filter does not follow the pixel phase
    np.testing.assert_allclose(
        np.median(found.background_dn), 25.0, atol=2.0
    )  # the star's wings are in the box


def test_template_of_a_real_star_refers_to_that_stars_center(render_stars, star_grid):
    image, truth, _, start = field(render_stars, star_grid, 0.9, 60.0, 9, n=100)
    template = extract_template(image, None, truth[11], 4.0)
    found = correlate(image, NOISE_DN, None, start, template, search_radius_px=6.0)
    error = found.pixel_line - truth
    assert np.abs(error.mean(axis=0)).max() < 0.1  # noise and pixel phase of the one star
    assert error.std(axis=0).max() < 0.08
    np.testing.assert_allclose(template.values.sum(), 1.0)
    assert 0.7 < template.ellipse[1] <= template.ellipse[0] < 1.2


def test_matched_filter_leaves_bad_pixels_out_and_cross_correlation_sees_only_its_sub_image(render_stars):
    image = render_stars((60, 60), [[30.3, 29.8]], 400.0, 1.0) + np.random.default_rng(1).normal(
        0, 1.0, (60, 60)
    )
    bad = np.zeros(image.shape, bool)
    image[35, 36], bad[35, 36] = 1e5, True
    template = gaussian_template(1.0, 9)
    found = correlate(image, 1.0, bad, [[24.0, 25.0]], template, search_radius_px=12.0)
    np.testing.assert_allclose(found.pixel_line, [[30.3, 29.8]], atol=0.15)
    far = correlate(
        image, 1.0, bad, [[15.0, 15.0]], template, search_radius_px=30.0, method="cross_correlation"
    )
    assert not np.allclose(far.pixel_line, [[30.3, 29.8]], atol=2.0)


def test_a_peak_on_the_border_is_flagged(render_stars):
    image = render_stars((60, 60), [[30.0, 30.0]], 1000.0, 1.5)
    found = correlate(image, 1.0, None, [[24.0, 30.0]], gaussian_template(1.5, 11), search_radius_px=5.0)
    assert found.flags[0] & StarFlag.AT_BOUND
    assert not found.usable[0]


def test_noise_alone_is_not_a_star():
    image = np.random.default_rng(3).normal(0.0, 1.0, (300, 300))
    start = np.random.default_rng(4).uniform(20.0, 280.0, (80, 2))
    found = correlate(image, 1.0, None, start, gaussian_template(0.8, 7), search_radius_px=3.0)
    assert np.mean(found.usable) < 0.1


def test_a_star_off_the_detector_has_no_center_and_says_so():
    found = correlate(np.zeros((30, 30)), 1.0, None, [[-40.0, 5.0], [1e8, 3.0]], gaussian_template(1.0, 9),
                      search_radius_px=5.0)  # fmt: skip
    assert np.all(found.flags & StarFlag.NOT_FINITE)
    assert np.isnan(found.pixel_line).all()


def test_stars_at_the_edge_are_found(render_stars):
    image = render_stars((40, 40), [[0.3, 20.0], [20.0, 38.8]], 1000.0, 1.0)
    found = correlate(
        image, 1.0, None, [[3.0, 18.0], [21.0, 36.0]], gaussian_template(1.0, 9), search_radius_px=6.0
    )
    np.testing.assert_allclose(found.pixel_line[1], [20.0, 38.8], atol=0.4)
    assert np.all(found.flags & StarFlag.EDGE)


def test_three_methods_agree_as_in_the_paper(render_stars):
    # Table 1 of AAS 13-443: first guesses within 0.2 (matched filter) and 0.35 px of least squares.
    rng = np.random.default_rng(443)
    image = render_stars((48, 48), [[22.46, 24.37]], 900.0, 0.9, 0.7, 0.5) + rng.normal(0.0, 4.0, (48, 48))
    template = gaussian_template(0.8, 9)
    first = [
        correlate(image, 4.0, None, [[20.0, 26.0]], template, search_radius_px=6.0, method=method).pixel_line
        for method in METHODS
    ]
    final = fit_gaussian(image, 4.0, None, first[0], ShapePrior.round_psf(0.8)).pixel_line
    assert np.abs(first[0] - final).max() < 0.2
    assert np.abs(first[1] - final).max() < 0.35


@given(
    x=st.floats(-0.6, 0.6),
    y=st.floats(-0.6, 0.6),
    a=st.floats(0.2, 3.0),
    b=st.floats(0.2, 3.0),
    r=st.floats(-0.9, 0.9),
)
def test_paraboloid_is_exact_on_a_paraboloid(x, y, a, b, r):
    line, pixel = np.indices((5, 5)) - 2.0
    cross = r * np.sqrt(a * b)
    surface = -0.5 * (a * (pixel - x) ** 2 + b * (line - y) ** 2) - cross * (pixel - x) * (line - y)
    offset, hessian = refine_peaks(surface[None], np.array([2]), np.array([2]))
    np.testing.assert_allclose(offset, [[x, y]], atol=1e-9)
    np.testing.assert_allclose(hessian, [[[-a, -cross], [-cross, -b]]], atol=1e-9)


def test_a_ridge_has_no_peak():
    ridge = np.tile([0.0, 1.0, 0.0], (3, 1))[None]
    assert refine_peaks(ridge, np.array([1]), np.array([1]))[0].tolist() == [[0.0, 0.0]]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda t: correlate(np.zeros((9, 9)), 1.0, None, [[4, 4]], t, search_radius_px=0.2),
            "search_radius_px",
        ),
        (
            lambda t: correlate(np.zeros((9, 9)), 1.0, None, [[4, 4]], t, search_radius_px=3, method="x"),
            "method",
        ),
        (lambda t: gaussian_template(0.0, 5), "positive"),
        (lambda t: extract_template(np.zeros((20, 20)), None, [10, 10], 3.0), "no star"),
        (lambda t: extract_template(np.ones((20, 20)), None, [0, 10], 4.0), "off the detector"),
        (lambda t: extract_template(np.ones((20, 20)), None, [10, 10], 0.1), "radius"),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(CenterfindingError, match=message):
        call(gaussian_template(1.0, 7))
