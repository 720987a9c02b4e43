"""Light of resolved bodies told from that of stars, and the sky measured beside bodies of any size."""

import numpy as np
import pytest
from scipy import ndimage

from opnav_workbench.image import estimate_background, extended, extended_light, sky_and_bodies

SIGMA_PX = 0.85
OPTIONS = {"radius_px": 6.0, "psf_sigma_px": SIGMA_PX}
NOISE_DN, SKY_DN = 1.1, 20.0
N = 512


def _distance(center):
    line, pixel = np.indices((N, N))
    return np.hypot(pixel - center[0], line - center[1])


def _picture(seed=3):
    return np.random.default_rng(seed).normal(SKY_DN, NOISE_DN, (N, N))


def _star(center, peak_dn, sigma_px=SIGMA_PX):
    return peak_dn * np.exp(-0.5 * (_distance(center) / sigma_px) ** 2)


def _mask(image, saturated=None, bad=None):
    none = np.zeros((N, N), dtype=bool)
    return extended_light(
        image - SKY_DN,
        np.full((N, N), NOISE_DN),
        none if bad is None else bad,
        none if saturated is None else saturated,
        **OPTIONS,
    )


@pytest.mark.parametrize("radius", [8.0, 20.0, 90.0])
def test_a_disk_is_covered_with_a_rim_and_no_more(radius):
    center = (240.3, 251.7)
    mask = _mask(_picture() + 300.0 * (_distance(center) < radius))
    assert mask[_distance(center) < radius + 3.0].all()
    assert not mask[_distance(center) > radius + 9.0].any()


def test_stars_and_noise_are_not_bodies():
    image = _picture()
    rng = np.random.default_rng(8)
    for place, peak in zip(rng.uniform(20, N - 20, (40, 2)), 10.0 ** rng.uniform(1.0, 4.5, 40), strict=True):
        image += _star(place, peak)
    assert not _mask(image).any()


def test_a_saturated_star_with_its_wings_and_columns_is_no_body():
    """A core that is cut at the converter's end, a halo of 1 % that falls off, a column of blooming."""
    center = (200.0, 300.0)
    image = _picture() + _star(center, 3e5) + 3e3 / (1.0 + (_distance(center) / 3.0) ** 3)
    image[250:350, 199:202] = 3500.0
    image = np.minimum(image, 3500.0)
    assert not _mask(image, saturated=image >= 3500.0).any()


def test_a_body_cut_by_the_edge_and_one_with_bad_pixels():
    image = _picture() + 200.0 * (_distance((0.0, 250.0)) < 40.0)
    image += 200.0 * (_distance((400.0, 100.0)) < 30.0)
    bad = np.zeros((N, N), dtype=bool)
    bad[100, 380:420] = True
    image[bad] = SKY_DN
    mask = _mask(image, bad=bad)
    assert mask[250, :35].all()
    assert mask[100, 375:425].all()


def test_a_crescent_is_covered_on_its_lit_side():
    lit = (_distance((250.0, 250.0)) < 80.0) & (_distance((220.0, 250.0)) > 85.0)
    mask = _mask(_picture() + 150.0 * lit)
    assert mask[lit].mean() > 0.99
    assert not mask[_distance((200.0, 250.0)) < 40.0].any()


@pytest.mark.parametrize("diameter", [50, 250, 350, 450])
def test_the_sky_beside_a_body_of_any_size(diameter):
    """Up to 60 % of the picture: the level stays the sky's within a tenth of its noise, wherever it is seen."""
    rng = np.random.default_rng(diameter)
    center = (250.0, 260.0)
    disk = _distance(center) < 0.5 * diameter
    image = _picture() + disk * rng.uniform(150.0, 400.0, (N // 8, N // 8)).repeat(8, 0).repeat(8, 1)
    none = np.zeros((N, N), dtype=bool)
    background, extended = sky_and_bodies(image, none, none, **OPTIONS)
    assert extended[disk].all()
    sky = ~extended
    assert np.abs(background.level_dn[sky] - SKY_DN).max() < 0.6 * NOISE_DN
    assert np.abs(background.level_dn[sky] - SKY_DN).mean() < 0.1 * NOISE_DN
    np.testing.assert_allclose(np.median(background.noise_dn[sky]), NOISE_DN, rtol=0.05)


def test_without_bodies_the_background_is_that_of_the_mesh_alone():
    image = _picture() + _star((100.0, 200.0), 5000.0) + np.linspace(0.0, 40.0, N)  # stray light
    none = np.zeros((N, N), dtype=bool)
    background, extended = sky_and_bodies(image, none, none, **OPTIONS)
    assert not extended.any()
    plain = estimate_background(image, none)
    np.testing.assert_array_equal(background.level_dn, plain.level_dn)
    np.testing.assert_array_equal(background.noise_dn, plain.noise_dn)


def test_boxes_found_by_bands_are_those_of_the_whole(monkeypatch):
    """An area that goes on in the next band has one box, also where it is not in the band before."""
    monkeypatch.setattr(extended, "BAND_PIXELS", 300)
    areas, n = ndimage.label(np.random.default_rng(8).uniform(size=(61, 90)) > 0.55)
    assert n > 20
    assert extended._boxes(areas) == ndimage.find_objects(areas)
    assert extended._boxes(np.zeros((61, 90), int)) == []
