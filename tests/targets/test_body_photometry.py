"""Magnitudes of bodies: phase laws against closed forms and integrals over the sphere, albedo, missions' targets."""

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import dblquad

from opnav_workbench.constants import AU_KM
from opnav_workbench.mission import load_mission
from opnav_workbench.targets import (
    Photometry,
    TargetState,
    absolute_magnitude,
    diameter_km,
    disk_magnitude,
    hg_magnitude,
    hg_phase_function,
    lambert_phase_function,
    linear_phase_magnitude,
    lommel_seeliger_phase_function,
)

DEG = np.pi / 180.0


def sphere_integral(reflectance, phase):
    """Integrate I/F over the lit and seen part of a unit sphere's disk, over the disk's area."""

    def light(longitude, latitude):  # observer at longitude 0, Sun at longitude `phase`
        cos_e = np.cos(latitude) * np.cos(longitude)
        cos_i = np.cos(latitude) * np.cos(longitude - phase)
        return reflectance(cos_i, cos_e) * cos_e * np.cos(latitude)

    total, _ = dblquad(light, -np.pi / 2, np.pi / 2, phase - np.pi / 2, np.pi / 2, epsabs=1e-9)
    return total / np.pi


@pytest.mark.parametrize("phase_deg", [0.0, 10.0, 45.0, 90.0, 150.0])
@pytest.mark.parametrize(
    ("law", "function", "at_zero"),
    [
        (lambda mu0, mu: mu0, lambert_phase_function, 2.0 / 3.0),
        (lambda mu0, mu: mu0 / (mu0 + mu), lommel_seeliger_phase_function, 0.5),
    ],
    ids=["lambert", "lommel_seeliger"],
)
def test_phase_functions_are_the_integrals_of_their_laws(law, function, at_zero, phase_deg):
    expected = sphere_integral(law, phase_deg * DEG) / at_zero
    assert float(function(phase_deg * DEG)) == pytest.approx(expected, abs=1e-5)


def test_hg_has_its_published_phase_integral():
    """q = 0.290 + 0.684 G, a line fitted by Bowell et al. (1989)."""
    phase = np.linspace(0.0, 180.0, 20001)[:-1] * DEG
    for g in (0.05, 0.15, 0.3):
        q = 2.0 * np.trapezoid(hg_phase_function(phase, g) * np.sin(phase), phase)
        assert q == pytest.approx(0.290 + 0.684 * g, rel=0.03)
    assert float(hg_phase_function(0.0, 0.15)) == 1.0


@pytest.mark.parametrize("phase_deg", [1.0, 5.0, 20.0, 60.0, 110.0])
def test_hg_agrees_with_its_short_form(phase_deg):
    """Minor Planet Circular 10193: phi_i = exp(-A_i tan(alpha / 2)^B_i), A = 3.33, 1.87, B = 0.63, 1.22."""
    half = np.tan(0.5 * phase_deg * DEG)
    small, large = np.exp(-3.33 * half**0.63), np.exp(-1.87 * half**1.22)
    got = float(hg_phase_function(phase_deg * DEG, 0.15))
    assert -2.5 * np.log10(got / (0.85 * small + 0.15 * large)) == pytest.approx(0.0, abs=0.04)


def test_hg_magnitude_of_an_asteroid():
    """MPC's tabulated reduced magnitude of G = 0.15 at 20 deg of phase: H + 1.00."""
    assert hg_magnitude(15.0, 0.15, AU_KM, AU_KM, 20.0 * DEG) == pytest.approx(16.0, abs=0.01)
    assert hg_magnitude(15.0, 0.15, 2.0 * AU_KM, AU_KM, 0.0) == pytest.approx(15.0 + 5.0 * np.log10(2.0))


@pytest.mark.parametrize(
    # facts: Pluto p 0.52, R 1188.3 km; Charon 0.41, 606 km; Bennu 0.044, 0.49 km
    ("albedo", "diameter", "mag"),
    [(0.52, 2376.6, -0.55), (0.41, 1212.0, 1.17), (0.044, 0.49, 20.56)],
)
def test_albedo_size_and_absolute_magnitude_belong_together(albedo, diameter, mag):
    assert absolute_magnitude(albedo, diameter) == pytest.approx(mag, abs=0.01)
    assert diameter_km(absolute_magnitude(albedo, diameter), albedo) == pytest.approx(diameter, rel=1e-12)


def test_disk_magnitude_is_reflected_sunlight():
    """At zero phase a white Lambert disk of 1 au radius at 1 au would be as bright as the Sun: p = 1."""
    assert disk_magnitude(1.0, AU_KM, AU_KM, AU_KM, 0.0) == pytest.approx(-26.75)
    faint = disk_magnitude(0.3, 1000.0, 5.0 * AU_KM, 1e6, 0.0)
    expected = -26.75 - 2.5 * np.log10(0.3 * (1000.0 / 1e6) ** 2 / 25.0)
    assert faint == pytest.approx(expected, abs=1e-12)


def test_disk_magnitude_at_zero_phase_agrees_with_the_convention_of_diameters():
    """1329 km stands for a Sun of V = -26.76; ours is -26.75."""
    mag = disk_magnitude(0.1, 5.0, AU_KM, AU_KM, 0.0)
    assert mag == pytest.approx(absolute_magnitude(0.1, 10.0), abs=0.015)


def test_half_lit_lambert_sphere_loses_a_factor_pi():
    full, half = (disk_magnitude(0.5, 10.0, AU_KM, 1e5, a) for a in (0.0, np.pi / 2.0))
    assert half - full == pytest.approx(2.5 * np.log10(np.pi), abs=1e-9)


def test_a_body_behind_which_the_sun_stands_is_dark():
    assert disk_magnitude(0.5, 10.0, AU_KM, 1e5, np.pi) > 30.0


def seen(phase_deg, sun_au=1.2, range_km=2e6, **fields):
    sun = -np.array([np.cos(phase_deg * DEG), np.sin(phase_deg * DEG), 0.0]) * sun_au * AU_KM
    return TargetState("BODY", [range_km, 0.0, 0.0], sun_position_km=sun, **fields)


def test_linear_law_and_hg_from_a_mapping():
    target = seen(40.0)
    args = 1.2 * AU_KM, 2e6, 40.0 * DEG
    linear = Photometry(absolute_mag=20.9, slope_mag_deg=0.04)
    assert linear.of(target) == pytest.approx(linear_phase_magnitude(20.9, 0.04, *args))
    assert Photometry(absolute_mag=20.6, g=-0.08).of(target) == pytest.approx(
        hg_magnitude(20.6, -0.08, *args)
    )
    assert Photometry(absolute_mag=20.6).of(target) == pytest.approx(linear_phase_magnitude(20.6, 0.0, *args))


@pytest.mark.parametrize("law", [{"slope_mag_deg": 0.03}, {"g": 0.15}, {"law": "lommel_seeliger"}, {}])
def test_a_magnitude_measured_from_earth_comes_back_at_that_geometry(law):
    earth = {"mag": 14.1, "sun_au": 32.8, "range_au": 31.9, "phase_deg": 1.2}
    photometry = Photometry(earth_apparent=earth, **law)
    there = photometry.magnitude(32.8 * AU_KM, 31.9 * AU_KM, 1.2 * DEG)
    assert there == pytest.approx(14.1, abs=1e-12)
    closer = photometry.magnitude(32.8 * AU_KM, 0.319 * AU_KM, 1.2 * DEG)
    assert there - closer == pytest.approx(10.0, abs=1e-9)  # 100 times nearer


def test_albedo_uses_the_bodys_own_radii():
    body = seen(0.0, radii_km=[8.0, 4.0, 2.0])
    from_radii = Photometry(geometric_albedo=0.2).of(body)
    assert from_radii == pytest.approx(disk_magnitude(0.2, 4.0, 1.2 * AU_KM, 2e6, 0.0))
    assert Photometry(geometric_albedo=0.2, diameter_km=8.0).of(body) == pytest.approx(from_radii)
    assert Photometry(geometric_albedo=0.2).of(seen(0.0)) is None


@pytest.mark.parametrize("law", ["lambert", "lommel_seeliger"])
def test_albedo_with_a_phase_function(law):
    function = {"lambert": lambert_phase_function, "lommel_seeliger": lommel_seeliger_phase_function}[law]
    body = seen(70.0, radii_km=[3.0, 3.0, 3.0])
    expected = disk_magnitude(0.1, 3.0, 1.2 * AU_KM, 2e6, 70.0 * DEG, function)
    assert Photometry(geometric_albedo=0.1, law=law).of(body) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({}, "give one of absolute_mag, earth_apparent and geometric_albedo"),
        ({"absolute_mag": 1.0, "geometric_albedo": 0.5}, "give one of"),
        ({"absolute_mag": 1.0, "g": 0.1, "slope_mag_deg": 0.0}, "give one of slope_mag_deg and g"),
        ({"absolute_mag": 1.0, "diameter_km": 2.0}, "diameter_km goes with geometric_albedo"),
        ({"geometric_albedo": 0.0}, "greater than 0"),
        ({"absolute_mag": 1.0, "slope": 0.1}, "slope"),
    ],
)
def test_photometry_without_sense_is_refused(fields, message):
    with pytest.raises(ValidationError, match=message):
        Photometry(**fields)


def test_bennu_on_approach_is_as_bright_as_the_paper_says():
    """Figure 3, 2018-09-24: Bennu a few 1e5 km away, still sub-pixel, outshines the faintest usable stars."""
    bennu = load_mission("osiris_rex").with_magnitude(
        TargetState("BENNU", [4e5, 0.0, 0.0], sun_position_km=np.array([-1.1, -0.5, 0.0]) * AU_KM)
    )
    assert 8.0 < bennu.magnitude < 11.0


def test_pluto_and_charon_stay_as_they_were():
    mission = load_mission("new_horizons")
    for name, mag, slope in (("PLUTO", -0.55, 0.0294), ("CHARON", 1.17, 0.0866)):
        target = seen(15.0, sun_au=32.9, range_km=6.3e6)
        known = mission.with_magnitude(
            TargetState(name, target.position_km, sun_position_km=target.sun_position_km)
        )
        assert known.magnitude == pytest.approx(
            linear_phase_magnitude(mag, slope, 32.9 * AU_KM, 6.3e6, 15.0 * DEG)
        )
