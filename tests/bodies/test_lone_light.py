"""Bodies as small as a star's image, far from where they are expected: which of the picture's lights is theirs."""

from dataclasses import replace

import numpy as np
import pytest
from disk_truth import GAIN_E_PER_DN, TrialSetup, make_trial

from opnav_workbench.bodies import find_disk

DISK = TrialSetup(8811, 2.2, 20.0, displacement_px=180.0, place_px=(410.0, 600.0))
CRESCENT = TrialSetup(8812, 7.0, 126.0, displacement_px=150.0, place_px=(700.0, 333.0))
STARS_PX = np.array([[200.3, 150.8], [655.1, 820.4], [820.0, 410.2], [333.3, 333.9]])


def with_stars(trial, shares, known):
    """The trial's picture with stars of some shares of the body's light, of which those `known` are in the catalog."""
    picture, light = trial.picture, trial.light_dn.sum()
    data, rng = picture.signal_dn.copy(), np.random.default_rng(5)
    line, pixel = np.indices(data.shape)
    for (x, y), share in zip(STARS_PX, shares, strict=False):
        psf = np.exp(-0.5 * ((pixel - x) ** 2 + (line - y) ** 2) / trial.core_px**2)
        star = share * light * psf / psf.sum()
        data += rng.poisson(star * GAIN_E_PER_DN) / GAIN_E_PER_DN
    return replace(picture, signal_dn=data, stars_px=known)


@pytest.mark.slow
@pytest.mark.parametrize("setup", [DISK, CRESCENT])
def test_the_one_light_that_no_star_explains_is_the_body(setup):
    trial = make_trial(setup)
    center = find_disk(with_stars(trial, (5.0, 1.0, 0.7, 0.4), STARS_PX), trial.name)
    assert center.status == "ok", center.messages
    away = center.pixel_line - trial.truth_px
    assert away @ np.linalg.solve(center.covariance_px2, away) < 9.0
    assert np.hypot(*away) < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("setup", [DISK, CRESCENT])
@pytest.mark.parametrize(
    ("shares", "known"),
    [
        ((5.0, 1.0, 0.7, 0.4), None),  # any of them may be the body
        ((1.0, 0.5), STARS_PX[:1]),  # one is in no catalog
    ],
)
def test_where_several_lights_may_be_the_body_none_is_taken_for_it(setup, shares, known):
    trial = make_trial(setup)
    center = find_disk(with_stars(trial, shares, known), trial.name)
    assert center.status == "not_detected"
    assert any("give a circle" in message for message in center.messages)


@pytest.mark.slow
@pytest.mark.parametrize("stars", [STARS_PX, None])
def test_near_its_expected_place_a_star_beside_it_changes_nothing(stars):
    trial = make_trial(replace(DISK, displacement_px=3.0))
    center = find_disk(with_stars(trial, (5.0, 1.0, 0.7, 0.4), stars), trial.name)
    assert center.status == "ok", center.messages
    assert np.hypot(*(center.pixel_line - trial.truth_px)) < 0.3


@pytest.mark.slow
def test_the_light_of_another_body_that_is_expected_there_is_not_taken_for_it():
    trial = make_trial(DISK)
    (model,) = trial.picture.models
    there = replace(model.target, name="OTHER", position_km=trial.body.position_km)
    picture = replace(trial.picture, models=(model, replace(model, target=there)))
    assert find_disk(picture, trial.name).status == "not_detected"


@pytest.mark.slow
def test_a_light_no_brighter_than_the_faintest_star_of_the_catalog_may_be_any_star():
    trial = make_trial(DISK)
    faintest = replace(trial.picture, stars_known_dn=float(trial.light_dn.sum()))
    assert find_disk(faintest, trial.name).status == "not_detected"
    assert (
        find_disk(replace(faintest, stars_known_dn=0.4 * faintest.stars_known_dn), trial.name).status == "ok"
    )
