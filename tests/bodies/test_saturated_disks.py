"""Disks with saturated parts: their limb is still there, outside of what was cut off."""

from dataclasses import replace

import numpy as np
import pytest
from disk_truth import TrialSetup, make_trial

from opnav_workbench.bodies import BodyFlag, judged_disk, measure_disk
from opnav_workbench.bodies.disk.measurement import with_true_sky
from opnav_workbench.bodies.disk.starts import fit_disk

OVEREXPOSED = {  # of the peak the detector holds a tenth or so
    "half lit, 740 px": TrialSetup(11, 740.0, 98.0, saturation_dn=110.0),
    "crescent, 260 px": TrialSetup(12, 260.0, 115.0, law="lunar_0.3", saturation_dn=140.0, psf="known_wings"),
    "small, 32 px": TrialSetup(13, 32.0, 18.0, saturation_dn=100.0),
    "mottled, 150 px": TrialSetup(14, 150.0, 50.0, family="field_mid", contrast=3.0, saturation_dn=150.0),
}


LONG = ("half lit, 740 px", "crescent, 260 px", "mottled, 150 px")


@pytest.fixture(
    scope="module",
    params=[pytest.param(case, marks=pytest.mark.slow if case in LONG else ()) for case in OVEREXPOSED],
)
def overexposed(request):
    trial = make_trial(OVEREXPOSED[request.param])
    disk = measure_disk(trial.picture, trial.name, "disk", None, None)
    return trial, disk, judged_disk(disk)


def test_an_overexposed_disk_is_confirmed_where_it_is(overexposed):
    """Before: all were doubted, "0 % of its limb is lit and in sight", three by crossings that lay 1.5 px too far out."""
    trial, _, center = overexposed
    away = center.pixel_line - trial.truth_px
    assert center.status == "ok", center.messages
    assert center.flags & BodyFlag.OVEREXPOSED
    assert away @ np.linalg.solve(center.covariance_px2, away) < 3.5**2
    assert np.hypot(*away) < 0.4


def test_crossings_of_a_limb_that_is_cut_off_are_compared_with_light_that_is(overexposed):
    trial, disk, center = overexposed
    covariance = disk.crossing.covariance[:2, :2] + 0.15**2 * np.eye(2)
    away = disk.fit.center_px + disk.crossing.step_px - trial.truth_px
    assert away @ np.linalg.solve(covariance, away) < 3.5**2
    assert center.second is not None


@pytest.mark.slow
def test_a_column_that_bled_is_no_light_of_the_disk():
    trial = make_trial(OVEREXPOSED["mottled, 150 px"])
    picture, level = trial.picture, trial.setup.saturation_dn
    column = int(trial.truth_px[0])
    signal, saturated = np.array(picture.signal_dn), np.array(picture.saturated)
    signal[:, column : column + 2], saturated[:, column : column + 2] = level, True
    bled = replace(picture, signal_dn=signal, saturated=saturated)
    center = judged_disk(measure_disk(bled, trial.name, "disk", None, None))
    assert np.hypot(*(center.pixel_line - trial.truth_px)) < 0.4


@pytest.mark.slow
def test_a_center_far_beside_the_frame_goes_its_way_at_once():
    """1500 px wide, a quarter in the frame: size, axes and center change together by much, the limb in sight by little."""
    setup = TrialSetup(
        3, 1400.0, 60.0, family="field_mid", contrast=3.0, place_px=(1150.0, 1150.0), displacement_px=30.0
    )
    trial = make_trial(setup)
    disk = measure_disk(trial.picture, trial.name, "disk", None, None)
    shifted = replace(disk.place, center_px=disk.place.center_px + np.array([9.0, 9.0]), size_ratio=0.99)
    fit = fit_disk(trial.picture, trial.name, shifted, disk.pixels)
    assert fit.lengths_px[0] > 4.0
    away = fit.center_px - trial.truth_px
    assert away @ np.linalg.solve(fit.covariance_px2, away) < 3.5**2


def test_light_that_a_converter_cut_off_is_told_by_how_its_pixels_crowd():
    """Nobody named them saturated, and each has a noise of its own: values of a display, or calibrated after the cut."""
    trial = make_trial(TrialSetup(21, 120.0, 40.0, peak_dn=300.0))
    rng = np.random.default_rng(4)
    whole = trial.picture
    cut = replace(
        whole, signal_dn=np.minimum(whole.signal_dn, 255.0) + rng.uniform(-0.5, 0.5, whole.signal_dn.shape)
    )
    over = whole.signal_dn > 256.0
    assert over.sum() > 300
    assert with_true_sky(cut).saturated[over].all()
    assert not with_true_sky(cut).saturated[whole.signal_dn < 250.0].any()
    assert not with_true_sky(whole).saturated.any()  # light that goes on to its own end


def test_where_no_noise_model_says_how_light_scatters_its_noise_is_not_made_up():
    """Reflectances are small numbers: with one electron each they would be all noise, and all of one level."""
    trial = make_trial(TrialSetup(21, 120.0, 40.0, peak_dn=300.0))
    scale = 1e-4
    picture = trial.picture
    reflectance = replace(
        picture, signal_dn=scale * picture.signal_dn, noise_dn=scale * picture.noise_dn, noise_model=None
    )
    assert reflectance.shot_gain_e_per_dn == np.inf
    assert picture.shot_gain_e_per_dn == picture.noise_model.gain_e_per_dn
    assert not with_true_sky(reflectance).saturated.any()
