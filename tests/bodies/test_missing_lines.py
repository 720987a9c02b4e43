"""Pictures that came down with lines missing: what is left of a disk tells its center."""

from dataclasses import replace

import numpy as np
import pytest
from disk_truth import TrialSetup, make_trial

from opnav_workbench.bodies import find_disk, find_least_squares

EVERY_OTHER_LINE, EVERY_THIRD_COLUMN = np.s_[::2, :], np.s_[:, ::3]


@pytest.fixture(scope="module", params=[25.0, 60.0])
def trial(request):
    return make_trial(
        TrialSetup(
            77, request.param, 50.0, family="field_mid", contrast=3.0, displacement_px=8.0, peak_dn=1500.0
        )
    )


@pytest.mark.slow
@pytest.mark.parametrize("lost", [EVERY_OTHER_LINE, EVERY_THIRD_COLUMN], ids=["every other line", "columns"])
@pytest.mark.parametrize("find", [find_disk, find_least_squares], ids=lambda find: find.__name__)
def test_a_disk_is_found_where_lines_are_missing(trial, lost, find):
    """It was "not detected", or lost by several px, as no ray across the limb met whole pixels alone."""
    signal = trial.picture.signal_dn.copy()
    signal[lost] = np.nan
    center = find(replace(trial.picture, signal_dn=signal), trial.name)
    assert center.status == "ok", center.messages
    off = center.pixel_line - trial.truth_px
    assert off @ np.linalg.solve(center.covariance_px2, off) < 9.0
    whole = find(trial.picture, trial.name)
    assert np.trace(center.covariance_px2) < 4.0 * np.trace(whole.covariance_px2)
