"""What two readings of one disk say together: agreeing ones are weighed, a likelihood that explains the picture is kept."""

from dataclasses import replace

import numpy as np
import pytest
from disk_truth import TrialSetup, make_trial

from opnav_workbench.bodies import BodyFlag, judged_disk, measure_disk
from opnav_workbench.bodies.disk import centerfinder


@pytest.fixture(scope="module")
def disk():
    trial = make_trial(TrialSetup(5, 40.0, 50.0, family="field_mid", contrast=3.0))
    return measure_disk(trial.picture, trial.name, "disk", None, None)


def moved(disk, by_px, *, covariance_px2=None, **fit):
    """The same disk with its crossings `by_px` from the fit, and the fit changed."""
    fit = replace(disk.fit, **fit)
    covariance = np.array(disk.crossing.covariance)
    if covariance_px2 is not None:
        covariance[:2, :2] = covariance_px2
    return replace(
        disk, fit=fit, crossing=replace(disk.crossing, step_px=np.array(by_px), covariance=covariance)
    )


@pytest.mark.slow
def test_readings_that_agree_are_weighed_by_what_they_know(disk):
    away = np.array([0.2, -0.1])
    both = judged_disk(moved(disk, away))
    share = (both.pixel_line - disk.fit.center_px) @ away / (away @ away)
    assert both.status == "ok"
    assert 0.0 < share < 1.0
    sure = judged_disk(moved(disk, away, covariance_px2=1e-8 * np.eye(2)))
    unsure = judged_disk(moved(disk, away, covariance_px2=1e4 * np.eye(2)))
    shares = [(c.pixel_line - disk.fit.center_px) @ away / (away @ away) for c in (unsure, both, sure)]
    assert shares == sorted(shares)
    assert shares[0] < 1e-4


@pytest.mark.parametrize(("sigmas", "share"), [(0.2, 0.0196), (2.0**0.5, 0.5), (3.4, 0.8525)])
def test_half_of_a_difference_beyond_what_is_expected_is_in_the_covariance(disk, sigmas, share):
    """Chi-squared of two coordinates is two: what both readings say of themselves is in their covariances."""
    own = judged_disk(moved(disk, [1e-9, 0.0]))
    step_px = sigmas * 1e-9 / own.second.difference_sigmas
    far = judged_disk(moved(disk, [step_px, 0.0]))
    assert far.second.difference_sigmas == pytest.approx(sigmas, rel=1e-3)
    more = far.covariance_px2[0, 0] - own.covariance_px2[0, 0]
    assert more == pytest.approx(share * (0.5 * step_px) ** 2, rel=0.01)


def test_a_place_whose_limb_is_hardly_seen_confirms_nothing(disk):
    """677 px, all but its last corner beside the frame: 25 px off, and the crossings that it began from agreed."""
    center = judged_disk(replace(disk, crossing=None))
    assert center.second is not None
    assert center.second.difference_sigmas < 3.5
    assert center.status == "uncertain"
    assert "too little of its limb" in " ".join(center.messages)


def test_a_likelihood_that_explains_the_picture_is_not_left_for_the_crossings(disk):
    """439 px of craters: the crossings were 15 px off, the likelihood 0.2 px, and the crossings were told."""
    center = judged_disk(moved(disk, [9.0, 0.0]))
    assert center.status == "uncertain"
    assert center.flags & BodyFlag.UNCONFIRMED
    np.testing.assert_allclose(center.pixel_line, disk.fit.center_px)
    assert center.covariance_px2[0, 0] > 4.0**2


@pytest.mark.parametrize("why", [{"chi2_reduced": 9.0}, {"converged": False}])
def test_one_that_does_not_is(disk, why):
    center = judged_disk(moved(disk, [9.0, 0.0], **why))
    assert center.status == "uncertain"
    np.testing.assert_allclose(center.pixel_line, disk.fit.center_px + np.array([9.0, 0.0]))


def test_a_fit_that_wanders_within_its_sigma_is_settled_where_the_crossings_confirm_it(disk):
    assert judged_disk(moved(disk, [0.02, 0.0], converged=False)).status == "ok"
    assert judged_disk(moved(disk, [9.0, 0.0], converged=False)).flags & BodyFlag.NOT_CONVERGED


@pytest.mark.slow
def test_a_rough_sky_beside_a_body_does_not_judge_its_image():
    """A converter has left waves in the sky: chi-squared of all cells is poor, that of the image is not."""
    trial = make_trial(TrialSetup(8, 120.0, 40.0))
    picture = trial.picture
    line, pixel = np.mgrid[: picture.camera.n_line, : picture.camera.n_pixel]
    waves = 6.0 * np.sin(pixel / 2.7) * np.sin(line / 3.1)
    away = np.hypot(pixel - trial.truth_px[0], line - trial.truth_px[1])
    waves[away < 60.0 + 3.0] = 0.0
    rough = replace(picture, signal_dn=picture.signal_dn + waves)
    fit = measure_disk(rough, trial.name, "disk", None, None).fit
    cells = np.count_nonzero(np.isfinite(fit.system.variance))
    assert fit.solution.chi2 / cells > centerfinder.POOR_CHI2 > fit.chi2_reduced
