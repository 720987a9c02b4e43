"""Disks in pictures that have what no model has; `disk_exam.py --disturbed` holds more of each."""

from dataclasses import replace

import numpy as np
import pytest
from disk_disturbances import DISTURBANCES, OF_DATA, disturbed
from disk_exam import draw, error_over_sigma, fair, is_false, is_ok, run
from disk_truth import TrialSetup, make_trial

from opnav_workbench.bodies import BodyFlag, judged_disk, measure_disk
from opnav_workbench.bodies.judgement import POOR_CHI2

SEED = 9710


@pytest.mark.slow(keep=["gradient", "stripes"])
@pytest.mark.parametrize("name", [name for name in DISTURBANCES if name != "nothing"])
def test_a_disturbance_disturbs(name):
    """Each changes what it is given by more than noise would, and leaves what is believed of the body as it is."""
    trial = make_trial(TrialSetup(3, 60.0, 50.0, peak_dn=1000.0))
    disturb = DISTURBANCES[name]
    plane = trial.picture.signal_dn if disturb in OF_DATA else trial.light_dn
    change = disturb(plane.copy(), trial, np.random.default_rng(1)) - plane
    assert np.abs(change).max() > 3.0 * trial.picture.typical_noise_dn
    picture = disturbed(trial, name)
    assert np.isfinite(picture.signal_dn).all()
    np.testing.assert_array_equal(picture.center_px(trial.name), trial.picture.center_px(trial.name))


@pytest.mark.slow
@pytest.mark.parametrize("disturbance", ["level", "gradient", "stripes", "lost_lines"])
def test_centers_hold_in_disturbed_pictures(disturbance):
    numbers = [i for i in range(12) if 8.0 < draw(SEED, i).diameter_px < 200.0][:5]
    records = run(numbers, SEED, "auto", disturbance=disturbance)
    asked = [record for record in records if fair(record)]
    assert len(asked) > 2
    assert np.mean([is_ok(record) for record in asked]) >= 0.8
    assert not any(is_false(record) for record in records)
    assert error_over_sigma([record for record in records if is_ok(record)]) < 2.0


@pytest.mark.slow(keep=["planetshine-95.0"])
@pytest.mark.parametrize(("disturbance", "phase"), [("planetshine", 95.0), ("coma", 100.0)])
def test_light_of_no_model_is_doubted_where_the_limb_does_not_confirm_the_center(disturbance, phase):
    """Night that shines, and air that does: chi-squared of 5 to 17, and a center that is right."""
    trial = make_trial(TrialSetup(3, 60.0, phase, peak_dn=2000.0))
    disk = measure_disk(disturbed(trial, disturbance), trial.name, "disk", None, None)
    assert disk.fit.chi2_reduced > 2.0 * POOR_CHI2
    center = judged_disk(disk)
    assert center.status == "ok", center.messages
    off = center.pixel_line - trial.truth_px
    assert off @ np.linalg.solve(center.covariance_px2, off) < 9.0
    assert np.hypot(*off) < 0.2
    beside = replace(disk.crossing, step_px=disk.crossing.step_px + 20.0)
    for crossing in (None, beside, replace(disk.crossing, patterned=True)):
        doubted = judged_disk(replace(disk, crossing=crossing))
        assert doubted.flags & BodyFlag.POOR_FIT
        assert doubted.status == "uncertain"
