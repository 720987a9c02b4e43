"""Disks not much wider than the PSF: their centers' sigmas hold the size that the picture does not tell."""

from dataclasses import replace

import numpy as np
import pytest
from disk_exam import draw
from disk_truth import TrialSetup, make_trial

from opnav_workbench.bodies import find_disk, measure_disk
from opnav_workbench.bodies.disk import measurement
from opnav_workbench.render import FigureUncertainty

SMALLEST_PX, LARGEST_PX, TRIALS, SEED = 5.0, 12.0, 8, 7301


def _patchy():
    """Setups of small patchy disks, drawn as the disk exam draws them."""
    chosen = [draw(SEED, index) for index in range(600)]
    return [s for s in chosen if SMALLEST_PX < s.diameter_px < LARGEST_PX and s.contrast > 1.0]


def _fit(trial):
    return measure_disk(trial.picture, trial.name, "disk", None, None).fit


@pytest.mark.slow
def test_sizes_that_are_as_likely_belong_to_the_sigma(monkeypatch, sample):
    scores, ratios = [], []
    trials = [make_trial(setup) for setup in _patchy()[: sample.trials(TRIALS)]]
    met, alone, sized, over_sizes = [], [], [], measurement._over_sizes

    def kept(picture, name, place, pixels, fit):
        met.append(fit)
        return over_sizes(picture, name, place, pixels, fit)

    monkeypatch.setattr(measurement, "_over_sizes", kept)
    for trial in trials:
        sized.append(_fit(trial))
        alone.append(met[-1])  # a limb that shows to be rough is fitted twice
    fits = [sized, alone]
    for each in fits:
        off = [fit.center_px - trial.truth_px for fit, trial in zip(each, trials, strict=True)]
        chi2 = np.array([o @ np.linalg.solve(f.covariance_px2, o) for o, f in zip(off, each, strict=True)])
        width = np.array([np.linalg.slogdet(f.covariance_px2)[1] for f in each])
        scores.append(float(np.mean(chi2 + width)))
        ratios.append(float(np.sqrt(0.5 * chi2.mean())))
    # Minus twice the logarithm of the likelihood of the errors, and the ratio itself
    assert scores[0] < scores[1] - 0.2
    assert ratios[0] < 0.95 * ratios[1]
    for wide, one in zip(*fits, strict=True):  # the center is the same
        np.testing.assert_array_equal(wide.center_px, one.center_px)
        assert np.all(np.linalg.eigvalsh(wide.unrest_px2 - one.unrest_px2) > -1e-12)


@pytest.mark.slow(keep=["8.0-figure1-1", "40.0-figure2-1"])
@pytest.mark.parametrize(
    ("diameter_px", "figure", "fits"),
    [
        (8.0, FigureUncertainty(), 1 + len(measurement.SIZES)),
        (8.0, FigureUncertainty(size_sigma=1e-3, axes_sigma=1e-3), 1),  # its size is known
        (40.0, FigureUncertainty(), 1),  # its limb tells it
    ],
)
def test_other_sizes_are_fitted_where_they_may_be(monkeypatch, diameter_px, figure, fits):
    trial = make_trial(TrialSetup(seed=5, diameter_px=diameter_px, phase_deg=40.0))
    models = tuple(replace(model, figure=figure) for model in trial.picture.models)
    calls = []
    fit_disk = measurement.fit_disk
    monkeypatch.setattr(measurement, "fit_disk", lambda *a, **k: calls.append(k) or fit_disk(*a, **k))
    _fit(replace(trial, picture=replace(trial.picture, models=models)))
    assert len(calls) == fits
    held = [call["held_log_size"] for call in calls if "held_log_size" in call]
    np.testing.assert_allclose(held, figure.size_sigma * np.array(measurement.SIZES[: len(held)]))


def test_a_quick_look_is_one_fit(monkeypatch):
    trial = make_trial(TrialSetup(seed=5, diameter_px=8.0, phase_deg=40.0))
    calls = []
    fit_disk = measurement.fit_disk
    monkeypatch.setattr(measurement, "fit_disk", lambda *a, **k: calls.append(k) or fit_disk(*a, **k))
    center = find_disk(trial.picture, trial.name, quick=True)
    off = center.pixel_line - trial.truth_px
    assert len(calls) == 1
    assert center.status == "ok"
    assert off @ np.linalg.solve(center.covariance_px2, off) < 9.0
