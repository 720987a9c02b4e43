"""What a star's color does to its magnitude."""

import numpy as np
import pytest

from opnav_workbench.photometry import (
    JOHNSON_B,
    JOHNSON_V,
    SUN,
    VEGA,
    Bandpass,
    ColorResponse,
    blackbody,
    color_response,
    instrument_magnitude,
    johnson_magnitude,
    synthetic_magnitude,
)

PANCHROMATIC = Bandpass([350.0, 450.0, 700.0, 850.0, 950.0], [0.0, 0.5, 0.6, 0.4, 0.0])


def test_the_v_band_itself_has_no_color():
    response = color_response(JOHNSON_V)
    assert np.abs(response.offset([-0.3, 0.0, 0.8, 1.6])).max() < 1e-12


def test_the_b_band_has_the_whole_color():
    np.testing.assert_allclose(
        color_response(JOHNSON_B).offset([-0.2, 0.5, 1.2]), [-0.2, 0.5, 1.2], atol=1e-3
    )


@pytest.mark.parametrize("temperature", [3200.0, 4200.0, 5400.0, 8000.0, 16000.0])
def test_stars_between_the_fitted_ones_lie_within_its_sigma(temperature):
    grid = VEGA.wavelength_nm
    ratio = blackbody(temperature, grid).photons_s_m2_nm / blackbody(9550.0, grid).photons_s_m2_nm
    star = VEGA.times(ratio)
    v = johnson_magnitude(star)
    response = color_response(PANCHROMATIC)
    expected = synthetic_magnitude(PANCHROMATIC, star) - v
    got = float(response.offset(johnson_magnitude(star, JOHNSON_B) - v))
    assert abs(got - expected) < response.sigma_mag


def test_the_sun_lies_within_its_sigma():
    response = color_response(PANCHROMATIC)
    expected = synthetic_magnitude(PANCHROMATIC, SUN) - johnson_magnitude(SUN)
    assert abs(float(response.offset(0.65)) - expected) < response.sigma_mag
    assert response.sigma_mag < 0.06


def test_reference_color_moves_the_zero_of_the_offset_only():
    plain, moved = color_response(PANCHROMATIC), color_response(PANCHROMATIC, reference_b_v=0.6)
    assert float(moved.offset(0.6)) == 0.0
    np.testing.assert_allclose(
        moved.offset([0.0, 1.2]), plain.offset([0.0, 1.2]) - plain.offset(0.6), atol=1e-12
    )


def test_slope_is_the_derivative_of_the_offset():
    response = ColorResponse(-0.1, 0.03, 0.6, -0.25)
    colors = np.array([-0.2, 0.4, 1.3])
    difference = (response.offset(colors + 1e-6) - response.offset(colors - 1e-6)) / 2e-6
    np.testing.assert_allclose(response.slope_at(colors), difference, atol=1e-8)


def test_errors_are_propagated():
    response = ColorResponse(-0.2, 0.03, curvature_mag_per_bv2=-0.1)
    mag, sigma = instrument_magnitude([8.0], [0.01], [1.0], [0.05], response)
    assert mag[0] == pytest.approx(8.0 - 0.2 - 0.1)
    assert sigma[0] == pytest.approx(np.sqrt(0.01**2 + (0.4 * 0.05) ** 2 + 0.03**2))


def test_what_a_catalog_does_not_know_widens_the_error():
    response = ColorResponse(-0.2, 0.03)
    mag, sigma = instrument_magnitude([8.0, 8.0, 8.0, np.nan], [0.01, 0.01, np.nan, 0.1],
                                      [1.0, np.nan, 1.0, 1.0], [0.05, np.nan, np.nan, 0.1], response)  # fmt: skip
    assert np.isnan(mag).tolist() == np.isnan(sigma).tolist() == [False, False, False, True]
    assert sigma[0] < sigma[1]
    assert sigma[2] > 0.1
    assert mag[1] == pytest.approx(8.0 - 0.2 * 0.75)


def test_unknown_colors_stand_for_those_of_the_sky():
    """A mean color taken for known ones: mean of the differences zero, scatter as the sigma says."""
    colors = np.random.default_rng(3).normal(0.75, 0.45, 4000)
    response = ColorResponse(-0.3, 1e-6)
    true, _ = instrument_magnitude(np.zeros(4000), 0.0, colors, 0.0, response)
    guess, sigma = instrument_magnitude(0.0, 0.0, np.nan, np.nan, response)
    assert abs(np.mean(true - guess)) < 4.0 * float(sigma) / np.sqrt(4000)
    assert np.std(true - guess) == pytest.approx(float(sigma), rel=0.05)
