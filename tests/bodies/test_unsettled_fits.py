"""Fits that end before they have come to rest: their sigma holds what they would still move."""

from dataclasses import replace

import numpy as np
import pytest
from disk_truth import TrialSetup, make_trial

from opnav_workbench.bodies.disk import fit as disk_fit
from opnav_workbench.bodies.disk import starts
from opnav_workbench.bodies.disk.columns import CENTER
from opnav_workbench.bodies.disk.measurement import measure_disk


@pytest.mark.slow
def test_what_a_fit_would_still_move_is_in_its_sigma(monkeypatch):
    """It is stopped after a step with each light, from a place two pixels off; root mean square of five surfaces."""
    fits = []
    for seed in (2, 3, 4, 6, 8):
        trial = make_trial(TrialSetup(seed, 60.0, 40.0, family="field_mid", contrast=3.0, peak_dn=1500.0))
        disk = measure_disk(trial.picture, trial.name, "disk", None, None)
        beside = replace(disk.place, center_px=trial.truth_px + np.array([1.5, -1.0]), center_sigma_px=1.0)
        with monkeypatch.context() as stopping:
            stopping.setattr(disk_fit, "MOST_TURNS", 1)
            stopping.setattr(starts, "MOST_FINE", 1)
            stopping.setattr(starts, "_has_come_far", lambda fitter: False)  # nor go on by beginning anew
            stopped = starts.fit_disk(disk.picture, disk.name, beside, disk.pixels)
        fits.append((stopped, stopped.center_px - trial.truth_px))
        wants = stopped.solution.theta[CENTER]
        assert np.hypot(*wants) > 0.1
        assert np.all(np.linalg.eigvalsh(stopped.unrest_px2 - np.outer(wants, wants)) > -1e-12)
        # One that has come to rest wants nothing
        assert np.hypot(*disk.fit.solution.theta[CENTER]) < 0.01
    whole = [away @ np.linalg.solve(fit.covariance_px2, away) for fit, away in fits]
    linearized = [away @ np.linalg.solve(fit.covariance_px2 - fit.unrest_px2, away) for fit, away in fits]
    assert np.mean(linearized) > 3.0**2
    assert np.mean(whole) < 2.5**2
