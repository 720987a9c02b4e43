"""Saturated limbs by their flanks: how steeply light falls off beside a limb tells how bright it is, and so where."""

import numpy as np
import pytest
from disk_truth import TrialSetup, make_trial
from scipy.special import erfc

from opnav_workbench.bodies.crossings import crossing_depths
from opnav_workbench.bodies.disk.measurement import placed_body, with_true_sky
from opnav_workbench.bodies.flanks import hidden_limbs, limb_flanks

DEPTH = np.arange(-12.0, 12.0, 0.25)
LEVEL, WIDTH = 200.0, 1.1


def edges(times_the_level, at_px=0.0, sky=0.0):
    """Steps of light (n, m), so many times the level, blurred and cut off."""
    bright = LEVEL * np.reshape(times_the_level, (-1, 1))
    return np.minimum(sky + 0.5 * bright * erfc((DEPTH - at_px) / (np.sqrt(2.0) * WIDTH)), LEVEL)


def flanks(light):
    return limb_flanks(light, np.ones(light.shape, dtype=bool), DEPTH, LEVEL, WIDTH, 3.0, 1.0 / 22.0)


@pytest.mark.parametrize("sky", [0.0, 8.0])
@pytest.mark.parametrize("at_px", [-0.37, 0.0, 0.61])
def test_a_limb_is_where_it_is_however_bright(at_px, sky):
    times = np.array([1.5, 3.0, 10.0, 30.0])
    found = flanks(edges(times, at_px, sky))
    away = found.depth_px - at_px
    assert np.all(np.abs(away) < 0.35)
    assert np.all(np.abs(away) < 1.5 * found.sigma_px)
    half = crossing_depths(edges(times, at_px, sky), DEPTH, 1.3, 12.0) - at_px
    # Half of what is left lies outside, the farther the brighter.
    assert np.all(half[1:] > 2.0 * np.abs(away[1:]))
    assert half[-1] > 2.0


def test_sigmas_are_those_of_the_errors():
    rng = np.random.default_rng(5)
    times = np.exp(rng.uniform(0.2, 3.4, 2000))
    light = edges(times)
    pixels = np.arange(-12.0, 13.0)  # a picture is interpolated between pixels: samples share their noise
    noise = np.array(
        [np.interp(DEPTH, pixels, one) for one in rng.normal(0.0, 1.0, (len(times), len(pixels)))]
    )
    light = np.minimum(light + noise * np.sqrt(9.0 + light / 22.0), LEVEL)
    found = flanks(light)
    assert np.isfinite(found.depth_px).all()
    ratio = found.depth_px / found.sigma_px
    assert 0.5 < np.sqrt(np.mean(ratio**2)) < 1.1
    assert abs(np.mean(found.depth_px)) < 0.15


def test_light_of_which_nothing_is_left_to_read_tells_nothing():
    light = np.where(DEPTH < 0.0, LEVEL, 0.0)[None]
    valid = np.ones(light.shape, dtype=bool)
    valid[0, (DEPTH > -1.0) & (DEPTH < 8.0)] = False
    found = limb_flanks(np.where(valid, light, 0.0), valid, DEPTH, LEVEL, WIDTH, 3.0, 0.0)
    assert np.isnan(found.depth_px).all()
    assert np.isnan(flanks(np.zeros((1, len(DEPTH)))).depth_px).all()


def test_a_patch_behind_a_dark_limb_hides_no_limb():
    dark = 0.3 * LEVEL
    patch = np.where(DEPTH < -4.0, LEVEL, 0.5 * dark * erfc(DEPTH / (np.sqrt(2.0) * WIDTH)))
    light = np.stack([patch, edges(4.0)[0]])
    half = crossing_depths(light, DEPTH, 1.3, 12.0)
    assert hidden_limbs(light, DEPTH, LEVEL, half, WIDTH).tolist() == [False, True]


OVEREXPOSED = {
    "mottled, 150 px": TrialSetup(31, 150.0, 40.0, family="blobs_0.6", contrast=9.0, saturation_dn=150.0),
    "half lit, 220 px": TrialSetup(32, 220.0, 85.0, family="field_mid", contrast=9.0, saturation_dn=200.0),
    "crescent, 60 px": TrialSetup(33, 60.0, 110.0, family="blobs_0.35", contrast=3.0, saturation_dn=120.0),
}


@pytest.mark.parametrize("setup", [pytest.param(one, id=name) for name, one in OVEREXPOSED.items()])
def test_a_place_of_an_overexposed_patchy_disk_is_near_its_center(setup):
    trial = make_trial(setup)
    place = placed_body(with_true_sky(trial.picture), trial.name, "disk", None, None)
    assert np.hypot(*(place.center_px - trial.truth_px)) < 0.75
