"""Speed of simulated light and of the detector as ratios against plain numpy, measured in the same run."""

import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from opnav_workbench.mission import load_mission
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.simulation.detector import DetectorEffects, expose
from opnav_workbench.simulation.starlight import add_stars

STARS = 2000
PEER_STARS = 200  # the loop is timed on these and scaled
SIGMA_PX = 0.85
ALL_EFFECTS = {
    "dark_current": {"rate_e_s": 1.0, "nonuniformity": 0.1},
    "bias": {"pattern_dn": 0.5},
    "flat_field": {"vignetting": 0.05, "prnu": 0.01, "error": 0.002},
    "bad_pixels": True,
    "cosmic_rays": True,
    "sky": {"level_dn": 1.0},
    "stray_light": {"center_e_s": 3.0, "along_pixel_e_s": 2.0},
    "lost_data": {"lines": 2, "blocks": 2},
}


def seconds(function):
    begin = time.perf_counter()
    result = function()
    return time.perf_counter() - begin, result


def star_by_star(picture, places, flux):
    """One separable Gaussian per star, added to its box."""
    for (x, y), electrons in zip(places, flux, strict=True):
        first = np.rint([x, y]).astype(int) - 5
        part = [
            np.diff(ndtr((np.arange(12) - 0.5 + f - c) / SIGMA_PX))
            for f, c in zip(first, (x, y), strict=True)
        ]
        picture[first[1] : first[1] + 11, first[0] : first[0] + 11] += electrons * np.outer(part[1], part[0])
    return picture


@pytest.fixture(scope="module")
def field():
    rng = np.random.default_rng(2000)
    return rng.uniform(10.0, 1013.0, (STARS, 2)), 10.0 ** rng.uniform(2.0, 5.5, STARS)


def test_stars_against_a_loop_over_stars(benchmark, field):
    places, flux = field

    def batched():
        picture = np.zeros((1024, 1024))
        add_stars(picture, places, flux, GaussianPsf(SIGMA_PX, SIGMA_PX))
        return picture

    batched()
    loop_s, peer = seconds(
        lambda: star_by_star(np.zeros((1024, 1024)), places[:PEER_STARS], flux[:PEER_STARS])
    )
    batch_s, _ = seconds(batched)
    picture = benchmark(batched)
    benchmark.extra_info["times_faster_than_loop"] = loop_s / PEER_STARS * STARS / batch_s
    few = np.zeros((1024, 1024))
    add_stars(few, places[:PEER_STARS], flux[:PEER_STARS], GaussianPsf(SIGMA_PX, SIGMA_PX))
    np.testing.assert_allclose(few, peer, atol=1e-6 * flux.max())
    assert picture.sum() == pytest.approx(flux.sum(), rel=1e-6)


def test_all_effects_against_plain_noise(benchmark, field):
    """The whole detector, and the time numpy needs for photon and read noise alone."""
    camera = load_mission("new_horizons").camera_for(
        {"MISSION": "New Horizons", "INSTRU": "lor", "SFORMAT": "1X1"}
    )
    camera = replace(camera, full_well_e=80_000.0, frame_transfer_s=0.013)
    light = np.zeros((1024, 1024))
    add_stars(light, *field, GaussianPsf(SIGMA_PX, SIGMA_PX))
    settings = DetectorEffects.model_validate(ALL_EFFECTS)

    def detector():
        return expose(light, camera, settings, exposure_s=0.1, seed=1)

    def plain():
        rng = np.random.default_rng(1)
        return np.rint((rng.poisson(light + 22.0) + rng.normal(0.0, 24.2, light.shape)) / 22.0)

    detector()
    plain_s, _ = seconds(plain)
    detector_s, _ = seconds(detector)
    exposed = benchmark(detector)
    benchmark.extra_info["times_plain_noise"] = detector_s / plain_s
    assert exposed.defective.any()
    assert exposed.lost.any()
