"""Limb crossings among patches: what a fitted albedo explains of them confirms its fit, and no fit that stands elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from disk_truth import TrialSetup, make_trial

from opnav_workbench.bodies import find_disk, judged_disk, measure_disk
from opnav_workbench.bodies.disk import problem
from opnav_workbench.bodies.disk.measurement import alike, read_crossings
from opnav_workbench.bodies.disk.starts import fit_disk

# Centers that crossings doubted, 5 to 10 px beside at 4 to 12 of their sigmas: patches on the limb had drawn those. Of the
# first they do no longer, begun as far from the model's figure as they are.
DOUBTED = {
    "258 px": TrialSetup(
        823866737, 257.976, 72.971, family="blobs_0.1", contrast=3.0, figure_error=0.0816,
        figure_pattern=(-1.0, -1.0, -1.0), displacement_px=3.648, psf="width", peak_dn=182.3,
    ),
    "388 px": TrialSetup(
        1782899656, 388.201, 72.157, family="field_mid", contrast=9.0, law="lommel_seeliger", figure_error=0.0884,
        figure_pattern=(1.0, 1.0, 1.0), displacement_px=67.931, psf="wings", peak_dn=509.8,
    ),
}  # fmt: skip


def measured(case):
    trial = make_trial(DOUBTED[case])
    return measure_disk(trial.picture, trial.name, "disk", None, None)


@pytest.fixture(scope="module")
def patchy():
    """The disk of the first, measured."""
    return measured("258 px")


@pytest.mark.slow
@pytest.mark.parametrize("case", DOUBTED)
def test_patches_do_not_doubt_a_center_that_explains_them(case):
    trial = make_trial(DOUBTED[case])
    center = find_disk(trial.picture, trial.name)
    away = center.pixel_line - trial.truth_px
    assert center.status == "ok", center.messages
    assert np.hypot(*away) < 0.5
    assert away @ np.linalg.solve(center.covariance_px2, away) < 3.5**2
    assert ("patches" in center.second.method) == (case == "388 px")
    assert center.second.difference_sigmas < 3.5


@pytest.mark.slow
@pytest.mark.parametrize("away_px", [(2.5, 1.0), (0.3, -5.0), (-7.0, -2.0)])
def test_an_albedo_does_not_confirm_a_fit_that_stands_elsewhere(patchy, away_px, monkeypatch):
    """Held there, with all the albedo that it likes."""
    monkeypatch.setattr(problem, "PLACE_PX", 0.05)
    disk, fit = patchy, patchy.fit
    place = replace(
        fit.place,
        center_px=fit.center_px + away_px,
        size_ratio=float(np.exp(fit.shape.log_size)),
        center_sigma_px=0.0,
        strain=fit.shape.strain[:2],
    )
    held = fit_disk(disk.picture, disk.name, place, disk.pixels)
    assert np.hypot(*(held.center_px - fit.center_px)) > 0.8 * np.hypot(*away_px)
    read = read_crossings(disk.picture, held)
    assert not read.patterned
    sigma = np.sqrt(np.trace(held.covariance_px2 + read.relief_px2))
    assert not alike(held, read) or sigma > 0.3 * np.hypot(*away_px)


@pytest.mark.slow
def test_crossings_by_a_likelihoods_own_albedo_are_not_weighed_with_it():
    """They are no other reading of the place, only of whether the picture has a limb where the fit has one."""
    doubted = measured("388 px")
    crossing = doubted.crossing
    assert crossing.patterned
    assert np.hypot(*crossing.step_px) > 0.0
    np.testing.assert_array_equal(judged_disk(doubted).pixel_line, doubted.fit.center_px)
    other = replace(doubted, crossing=replace(crossing, patterned=False))
    assert np.any(judged_disk(other).pixel_line != doubted.fit.center_px)


@pytest.mark.slow
def test_an_albedo_over_all_of_a_small_disk_confirms_nothing(monkeypatch):
    """It would explain any center's light, so that crossings which differ are left as they are, however near it has them."""
    trial = make_trial(TrialSetup(11, 12.0, 70.0, family="blobs_0.6", contrast=9.0))
    disk = measure_disk(trial.picture, trial.name, "disk", None, None)
    assert len(disk.fit.solution.albedo) == 1
    monkeypatch.setattr("opnav_workbench.bodies.disk.measurement.EXPLAINED_SIGMAS", 1e-6)
    monkeypatch.setattr("opnav_workbench.bodies.disk.measurement.ALIKE_PX", 1e3)
    monkeypatch.setattr("opnav_workbench.bodies.disk.measurement.alike", lambda *_: False)
    assert not read_crossings(disk.picture, disk.fit).patterned
