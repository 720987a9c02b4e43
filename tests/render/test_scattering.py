"""Scattering laws: their definition at zero phase, known values, and the light of whole spheres."""

import numpy as np
import pytest

from opnav_workbench.constants import AU_KM
from opnav_workbench.errors import MissionError
from opnav_workbench.render import Hapke, Lambert, LommelSeeliger, LunarLambert, Minnaert, law_from_mapping
from opnav_workbench.targets import lambert_phase_function, lommel_seeliger_phase_function

ROUGH = Hapke(w=0.2, b0=1.0, h=0.06, asymmetry=-0.3, second_share=0.1, roughness_deg=25.0)
ALL = [Lambert(), LommelSeeliger(), LunarLambert(), LunarLambert(0.3), Minnaert(0.7), Hapke(), ROUGH]


@pytest.mark.parametrize("law", ALL, ids=repr)
def test_albedo_is_the_brightness_of_a_flat_patch_at_zero_phase(law):
    assert law.reflectance(1.0, 1.0, 0.0) == pytest.approx(1.0, abs=1e-12)
    assert np.all(law.reflectance([-0.1, 0.0, 0.5, 0.5], [0.5, 0.5, -0.1, 0.0], 1.0) == 0.0)


@pytest.mark.parametrize("law", ALL, ids=repr)
def test_laws_are_reciprocal(law):
    # Exchanging Sun and observer changes I/F as the cosines of incidence (Helmholtz; Minnaert 1941).
    rng = np.random.default_rng(1)
    sun, camera = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 500, 3)))
    sun[:, 2], camera[:, 2] = np.abs(sun[:, 2]), np.abs(camera[:, 2])
    phase = np.arccos(np.sum(sun * camera, axis=1))
    there = law.reflectance(sun[:, 2], camera[:, 2], phase) / sun[:, 2]
    back = law.reflectance(camera[:, 2], sun[:, 2], phase) / camera[:, 2]
    np.testing.assert_allclose(there, back, rtol=1e-9)


def test_geometric_albedo_over_normal_albedo():
    assert Lambert().geometric_ratio == pytest.approx(2.0 / 3.0, abs=1e-12)
    assert LommelSeeliger().geometric_ratio == pytest.approx(1.0, abs=1e-12)
    assert LunarLambert(0.4).geometric_ratio == pytest.approx((2.0 + 0.4) / 3.0, abs=1e-12)
    assert Minnaert(0.7).geometric_ratio == pytest.approx(2.0 / 2.4, abs=1e-4)


@pytest.mark.parametrize("phase_deg", [0.0, 15.0, 60.0, 90.0, 120.0, 150.0])
@pytest.mark.parametrize(
    ("law", "closed", "geometric"),
    [
        (Lambert(), lambert_phase_function, 2.0 / 3.0),
        (LommelSeeliger(), lommel_seeliger_phase_function, 1.0),
    ],
)
def test_light_of_a_sphere_follows_the_closed_phase_integral(stage, law, closed, geometric, phase_deg):
    body = stage.model(40.0, phase_deg, law)
    target = body.target
    rendering = stage.render(body, sunlight_e=1e12)
    size = (target.radii_km[0] / target.range_km) ** 2
    light = (AU_KM / np.linalg.norm(target.sun_position_km)) ** 2
    expected = 1e12 * geometric * closed(np.radians(phase_deg)) * size * light
    # The closed forms are of a sphere infinitely far away; this one is 1e-4 rad in radius.
    assert rendering.bodies[0].flux_e == pytest.approx(expected, rel=7e-4)
    # Pixels: finest cells of 1/32 px, and a PSF cut at 5e-8 a side.
    assert rendering.electrons.sum() == pytest.approx(expected, rel=1e-3 if phase_deg < 150.0 else 3e-3)


@pytest.mark.parametrize("phase_deg", [15.0, 60.0, 90.0, 120.0])
def test_center_of_light_of_a_sphere(stage, phase_deg):
    # Facts sheet, section 7 (checked there against quadrature): offsets toward the Sun in radii.
    a = np.radians(phase_deg)
    bright = np.sin(a) + (np.pi - a) * np.cos(a)
    lambert = 3.0 * np.pi / 16.0 * np.sin(a) * (1.0 + np.cos(a)) / bright
    seeliger_light = 1.0 - np.sin(a / 2) * np.tan(a / 2) * np.log(1.0 / np.tan(a / 4))
    seeliger = 2.0 / (3.0 * np.pi) * np.tan(a / 2) * bright / seeliger_light
    for law, offset in ((Lambert(), lambert), (LommelSeeliger(), seeliger)):
        body = stage.render(stage.model(100.0, phase_deg, law)).bodies[0]
        assert np.linalg.norm(body.light_px - body.center_px) == pytest.approx(50.0 * offset, abs=0.05)


def test_mcewen_polynomial_runs_from_lunar_to_lambert():
    law, angle = LunarLambert(), np.radians(40.0)
    share = 1.0 - 0.019 * 40.0 + 2.42e-4 * 40.0**2 - 1.46e-6 * 40.0**3
    expected = 2.0 * share * 0.6 / (0.6 + 0.9) + (1.0 - share) * 0.6
    assert law.reflectance(0.6, 0.9, angle) == pytest.approx(expected, rel=1e-12)


def test_hapke_against_its_equation_written_out():
    law = Hapke(w=0.25, b0=0.8, h=0.07, asymmetry=-0.25, second_share=0.3)
    mu0, mu, g = 0.7, 0.4, np.radians(50.0)
    b, gamma = -0.25, np.sqrt(1.0 - 0.25)
    lobe = [(1 - b * b) / (1 + s * 2 * b * np.cos(g) + b * b) ** 1.5 for s in (1, -1)]
    chandrasekhar = [(1 + 2 * x) / (1 + 2 * x * gamma) for x in (mu0, mu)]
    surge = 0.8 / (1 + np.tan(g / 2) / 0.07)
    reflected = (1 + surge) * (0.7 * lobe[0] + 0.3 * lobe[1]) + chandrasekhar[0] * chandrasekhar[1] - 1
    expected = 0.25 / 4 * mu0 / (mu0 + mu) * reflected
    assert law.normal_albedo * law.reflectance(mu0, mu, g) == pytest.approx(expected, rel=1e-12)


def test_roughness_goes_over_into_the_smooth_law_and_darkens_toward_high_phase():
    smooth, nearly = Hapke(w=0.2), Hapke(w=0.2, roughness_deg=0.01)
    mu0, mu, g = np.array([0.9, 0.5]), np.array([0.6, 0.8]), np.radians([20.0, 60.0])
    np.testing.assert_allclose(nearly.reflectance(mu0, mu, g), smooth.reflectance(mu0, mu, g), rtol=1e-3)
    rough = Hapke(w=0.2, roughness_deg=25.0)
    i = np.radians(60.0)  # lit and seen from opposite sides at 60 deg: phase 120 deg
    ratio = rough.reflectance(np.cos(i), np.cos(i), 2 * i) / smooth.reflectance(np.cos(i), np.cos(i), 2 * i)
    assert 0.1 < ratio < 0.8


def test_laws_by_name():
    assert law_from_mapping("lommel_seeliger") == LommelSeeliger()
    assert law_from_mapping({"law": "hapke", "w": 0.1, "b0": None}) == Hapke(w=0.1)
    assert law_from_mapping({"law": "lunar_lambert", "lunar_weight": [1.0, -0.01]}) == LunarLambert(
        (1.0, -0.01)
    )


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"law": "phong"}, "'phong' is unknown; use lambert"),
        ({"law": "minnaert", "kk": 1.0}, "unknown parameter 'kk'; it takes k"),
        ({"law": "lambert", "k": 1.0}, "it takes none"),
        ({"law": "minnaert", "k": -1.0}, "k is -1.0; give a positive number"),
        ({"law": "minnaert", "k": "much"}, "not all numbers"),
        ({"law": "hapke", "w": 1.5}, "w is 1.5"),
        ({"law": "hapke", "asymmetry": float("nan")}, "asymmetry is nan"),
        ({"law": "lunar_lambert", "lunar_weight": 1.5}, "lunar_weight is 1.5"),
    ],
)
def test_bad_laws_say_what_is_allowed(values, message):
    with pytest.raises(MissionError, match=message):
        law_from_mapping(values)
