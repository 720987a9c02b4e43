"""Centers of disks on surfaces, laws, figures and PSFs that the model does not have, beside a truth drawn without it."""

import numpy as np
import pytest
from disk_exam import draw
from disk_truth import TrialSetup, make_trial


def shift_between(light, other):
    """Displacement (pixel, line) of one picture against another that is alike, from all pixels."""
    scaled = other * (np.sum(light * other) / np.sum(other**2))
    slopes = np.gradient(scaled)[::-1]
    columns = np.stack([*(s.ravel() for s in slopes), scaled.ravel()], axis=1)
    return np.linalg.lstsq(columns, (light - scaled).ravel(), rcond=None)[0][:2]


@pytest.mark.slow(keep=["6.0-80.0-36"])
@pytest.mark.parametrize(("diameter", "phase", "n"), [(6.0, 80.0, 36), (50.0, 0.0, 18), (50.0, 100.0, 18)])
def test_truth_is_that_of_exact_rays(body_stage, diameter, phase, n):
    """Cells, their subcells and polynomials for rays, against n by n exact rays a pixel."""
    trial = make_trial(TrialSetup(3, diameter, phase, axes=(1.1, 1.0, 0.9)))
    picture = trial.picture
    stage = type(body_stage)(
        picture.camera, picture.camera_from_j2000, picture.observer_velocity_km_s, picture.psf
    )
    half = int(0.5 * diameter) + 7
    first = np.rint(trial.truth_px).astype(int) - half
    exact = stage.brute_force(picture.models[0], (*first, 2 * half, 2 * half), n)
    assert np.abs(shift_between(trial.light_dn, exact)).max() < 1e-3
    assert np.abs(picture.center_px(trial.name) - trial.truth_px).max() < 1e-6


def test_same_setup_is_the_same_picture():
    setup = draw(4, 11, "small")
    first, second = make_trial(setup), make_trial(setup)
    np.testing.assert_array_equal(first.picture.signal_dn, second.picture.signal_dn)
    assert draw(4, 11, "small") == setup
