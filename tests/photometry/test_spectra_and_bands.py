"""Vega and the Sun against published fluxes and magnitudes, band passes against closed forms."""

import numpy as np
import pytest
from scipy.constants import c as light_m_s
from scipy.constants import h as planck_j_s

from opnav_workbench.errors import CameraError
from opnav_workbench.photometry import (
    JOHNSON_B,
    JOHNSON_V,
    SUN,
    SUN_B_V,
    SUN_V_MAG,
    VEGA,
    Bandpass,
    Spectrum,
    blackbody,
    electron_rate,
    johnson_magnitude,
    zero_point_mag,
)


def photons(erg_s_cm2_angstrom, wavelength_nm):
    """Photons / (s m^2 nm) of a flux in erg / (s cm^2 Angstrom)."""
    watt_m2_nm = erg_s_cm2_angstrom * 1e-7 * 1e4 * 10.0
    return watt_m2_nm * wavelength_nm * 1e-9 / (planck_j_s * light_m_s)


def box(low, high, response=1.0):
    return Bandpass([low, low + 1e-6, high - 1e-6, high], [0.0, response, response, 0.0])


def test_vega_at_5556_angstrom_is_the_standard_candle():
    assert photons(3.44e-9, 555.6) / 1e5 == pytest.approx(962.0, abs=0.5)
    assert float(VEGA.at(555.6)) == pytest.approx(photons(3.44e-9, 555.6), rel=0.005)


def test_vega_averaged_over_v_agrees_with_hayes():
    """Hayes (1985): 3.55e-9 erg/s/cm2/A on average over Johnson V (Colina & Bohlin 1994), at 3.44e-9 at 555.6 nm."""
    grid = np.arange(470.0, 700.5, 0.5)
    energy_weight = JOHNSON_V.at(grid) * grid
    erg = VEGA.at(grid) / photons(1.0, grid)
    assert np.sum(erg * energy_weight) / np.sum(energy_weight) == pytest.approx(3.55e-9, rel=0.015)


def test_sun_at_607_6_nm_as_the_lorri_pipeline_has_it():
    assert float(SUN.at(607.6)) == pytest.approx(photons(176.0, 607.6), rel=0.02)


def test_sun_has_its_published_magnitude_and_color():
    v = johnson_magnitude(SUN)
    assert v == pytest.approx(SUN_V_MAG, abs=0.01)
    assert johnson_magnitude(SUN, JOHNSON_B) - v == pytest.approx(SUN_B_V, abs=0.01)


def test_sunlight_between_300_and_1100_nm():
    """ASTM G173-03, extraterrestrial spectrum: 1001.9 of its 1347.9 W/m2 below 4000 nm."""
    watt = SUN.photons_s_m2_nm * planck_j_s * light_m_s / (SUN.wavelength_nm * 1e-9)
    assert np.trapezoid(watt, SUN.wavelength_nm) == pytest.approx(1001.9, rel=0.01)


def test_rate_of_a_box_in_a_flat_spectrum():
    flat = Spectrum([300.0, 1000.0], [2e7, 2e7])
    assert box(500.0, 650.0, 0.3).photon_rate(flat) == pytest.approx(0.3 * 150.0 * 2e7, rel=1e-6)


def test_rate_of_a_curve_agrees_with_a_fine_grid():
    band = Bandpass([400.0, 430.0, 600.0, 850.0, 900.0], [0.0, 0.5, 0.7, 0.4, 0.0])
    star = blackbody(4500.0, np.linspace(300.0, 1100.0, 400))
    grid = np.linspace(400.0, 900.0, 500_001)
    expected = np.trapezoid(band.at(grid) * star.at(grid), grid)
    assert band.photon_rate(star) == pytest.approx(expected, rel=1e-5)


def test_black_body_is_plancks_law():
    x = np.array([400.0, 550.0, 800.0]) * 1e-9
    k_b = 1.380649e-23
    energy = 2 * planck_j_s * light_m_s**2 / x**5 / np.expm1(planck_j_s * light_m_s / (x * k_b * 5000.0))
    number = energy / (planck_j_s * light_m_s / x)
    np.testing.assert_allclose(blackbody(5000.0, x * 1e9).photons_s_m2_nm, number / number[1], rtol=1e-8)


def test_pivot_of_a_box_has_its_closed_form():
    low, high = 500.0, 800.0
    expected = np.sqrt(0.5 * (high**2 - low**2) / np.log(high / low))
    assert box(low, high).pivot_nm == pytest.approx(expected, rel=1e-5)


def test_product_of_parts():
    both = Bandpass.product(box(400.0, 700.0, 0.5), box(500.0, 900.0, 0.4), Bandpass([300, 1000], [1.0, 0.0]))
    assert both.wavelength_nm[[0, -1]].tolist() == [500.0, 700.0]
    assert float(both.at(600.0)) == pytest.approx(0.2 * 4.0 / 7.0, rel=1e-9)
    with pytest.raises(CameraError, match="do not overlap"):
        Bandpass.product(box(400.0, 500.0), box(600.0, 700.0))


def test_vega_has_its_magnitude_in_every_band():
    for band in (JOHNSON_B, JOHNSON_V, box(400.0, 900.0)):
        assert johnson_magnitude(VEGA, band) == 0.026


def test_zero_point_gives_one_data_number_per_second():
    band, aperture, gain, obscured = box(450.0, 800.0, 0.4), 0.15, 3.0, 0.2
    zero_point = zero_point_mag(band, aperture, gain, obscured)
    area_m2 = np.pi * 0.075**2 * 0.8
    electrons = area_m2 * 0.4 * np.trapezoid(VEGA.at(np.arange(450.0, 800.5, 0.5)), dx=0.5)
    assert electrons * 10 ** (0.4 * (0.026 - zero_point)) / gain == pytest.approx(1.0, rel=1e-3)
    assert electron_rate(band, aperture, obscured) == pytest.approx(electrons, rel=1e-3)


def test_twice_the_aperture_is_one_and_a_half_magnitudes():
    band = box(450.0, 800.0, 0.4)
    assert zero_point_mag(band, 0.2, 5.0) - zero_point_mag(band, 0.1, 5.0) == pytest.approx(1.50515, abs=1e-5)


@pytest.mark.parametrize(
    "build",
    [
        lambda: Bandpass([500.0], [1.0]),
        lambda: Bandpass([500.0, 400.0], [1.0, 1.0]),
        lambda: Bandpass([400.0, 500.0], [1.0, -0.1]),
        lambda: Bandpass([400.0, 500.0], [0.0, 0.0]),
        lambda: Bandpass([400.0, 500.0], [1.0, np.nan]),
        lambda: Bandpass([400.0, 500.0], "ab"),
        lambda: Spectrum([400.0, 500.0], [1.0]),
        lambda: blackbody(0.0, np.array([400.0, 500.0])),
        lambda: zero_point_mag(box(400.0, 500.0), 0.1, 0.0),
        lambda: zero_point_mag(box(400.0, 500.0), 0.0, 1.0),
        lambda: zero_point_mag(box(400.0, 500.0), 0.1, 1.0, 1.0),
        lambda: box(900.0, 1500.0).photon_rate(VEGA),
    ],
)
def test_curves_and_numbers_without_sense_are_refused(build):
    with pytest.raises(CameraError) as caught:
        build()
    assert "\n" not in str(caught.value)
