"""Disks before a sky that is not at zero: a level left in the picture, a slope, the coma of a comet."""

from dataclasses import replace

import numpy as np
import pytest
from disk_disturbances import SKY_SHARE, away_px, level
from disk_truth import TrialSetup, make_trial

from opnav_workbench.bodies import find_disk
from opnav_workbench.bodies.disk.measurement import with_true_sky
from opnav_workbench.bodies.place import find_place

DISK = TrialSetup(5, 140.0, 58.0, family="blobs_0.35", contrast=3.0, displacement_px=20.0, peak_dn=400.0)


def slope(light, trial, _):
    """Of a straylight gradient: zero in one corner of the frame, twice the share in the other."""
    away = away_px(trial)
    return light + SKY_SHARE * trial.setup.peak_dn * (1.0 + (away[0] + 0.4 * away[1]) / 1000.0)


def coma(light, trial, _):
    """Falls with the distance, twice the share on one side and none of it on the other at the limb."""
    away, radius = away_px(trial), 0.5 * trial.setup.diameter_px
    distance = np.maximum(np.hypot(*away), radius)
    return light + SKY_SHARE * trial.setup.peak_dn * (1.0 + away[0] / distance) * radius / distance


def lit(trial, sky):
    return replace(trial.picture, signal_dn=sky(trial.picture.signal_dn, trial, None))


@pytest.mark.slow(keep=["level"])
@pytest.mark.parametrize("sky", [level, slope, coma])
def test_a_place_is_where_the_limb_ends_at_the_sky_and_not_at_zero(sky):
    """Crossings that took the sky for dark led away from where the silhouette was found."""
    trial = make_trial(DISK)
    place = find_place(with_true_sky(lit(trial, sky)), trial.name)
    assert np.hypot(*(place.center_px - trial.truth_px)) < 0.25
    assert place.size_ratio == pytest.approx(1.0, abs=0.015)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("diameter", "phase", "sky"),
    [
        (diameter, phase, sky)
        for diameter, phase in ((30.0, 20.0), (60.0, 100.0), (140.0, 58.0), (300.0, 80.0))
        for sky in (level, slope, coma)
        if sky is not coma or diameter > 50.0  # of a smaller one the light of a coma is the disk's as well
    ],
)
def test_a_center_before_a_lit_sky_is_confirmed_and_right(diameter, phase, sky):
    trial = make_trial(replace(DISK, diameter_px=diameter, phase_deg=phase))
    center = find_disk(lit(trial, sky), trial.name)
    error = center.pixel_line - trial.truth_px
    assert center.status == "ok", center.messages
    assert error @ np.linalg.solve(center.covariance_px2, error) < 4.0**2
