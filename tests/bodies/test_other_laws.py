"""Even surfaces whose law is of another kind than what was stated of the body, beside a truth drawn without the model."""

from dataclasses import replace

import numpy as np
import pytest
from disk_truth import TrialSetup, make_trial

from opnav_workbench.bodies import measure_disk
from opnav_workbench.bodies.disk import problem as disk_problem
from opnav_workbench.bodies.disk.columns import Unknown
from opnav_workbench.bodies.disk.limb_light import own_law
from opnav_workbench.render import Hapke, Lambert, LommelSeeliger, LunarLambert, Minnaert


def test_what_a_law_has_of_mixtures_and_powers():
    assert own_law(Lambert(), 0.3).tolist() == [0.0, 0.0]
    assert own_law(LommelSeeliger(), 0.3).tolist() == [1.0, 0.0]
    assert own_law(LunarLambert(0.4), 0.3).tolist() == [0.4, 0.0]
    assert own_law(Minnaert(0.7), 0.3) == pytest.approx([0.0, -0.3])
    assert own_law(Hapke(w=0.2), 0.3).tolist() == [0.5, 0.0]


@pytest.fixture
def tabulations(monkeypatch):
    """How often fine light is tabulated, and how often coarse."""
    counts, whole = {True: 0, False: 0}, disk_problem.limb_light

    def counted(*args, **kwargs):
        counts[kwargs["fine"]] += 1
        return whole(*args, **kwargs)

    monkeypatch.setattr(disk_problem, "limb_light", counted)
    return counts


def measured(setup, law):
    """A disk whose law is said to be `law`; how far off its center is (px, sigmas)."""
    trial = make_trial(setup)
    models = tuple(replace(model, law=law) for model in trial.picture.models)
    disk = measure_disk(replace(trial.picture, models=models), trial.name, "disk", None, None)
    away = disk.fit.center_px - trial.truth_px
    sigmas = float(np.sqrt(away @ np.linalg.solve(disk.fit.covariance_px2, away)))
    return disk.fit, float(np.hypot(*away)), sigmas


@pytest.mark.slow
@pytest.mark.parametrize(
    ("diameter", "phase", "law", "said", "within_px", "true"),
    [
        (200.0, 70.0, "lommel_seeliger", Minnaert(0.7), 0.1, [1.0, 0.0]),
        (290.0, 16.0, "minnaert_0.6", LunarLambert(0.5), 0.07, [0.0, -0.4]),
        (150.0, 20.0, "minnaert_0.6", LunarLambert(0.5), 0.03, [0.0, -0.4]),
    ],
)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_law_is_that_of_the_picture(seed, diameter, phase, law, said, within_px, true):
    """Before, 0.4 px and 4 sigma off with a faint albedo that made up for the law, or 0.06 px and 5 sigma."""
    setup = TrialSetup(seed, diameter, phase, law=law, displacement_px=3.0)
    fit, away_px, sigmas = measured(setup, said)
    found = fit.solution.theta[[Unknown.LAW, Unknown.LAW_2]] + own_law(said, np.radians(phase))
    np.testing.assert_allclose(found, true, rtol=0, atol=0.05)
    assert away_px < within_px
    assert sigmas < 4.0


@pytest.mark.slow(keep=["7"])
@pytest.mark.parametrize("seed", [7, 8, 9])
def test_a_psf_that_is_told_too_wide_is_tabulated_as_narrow_as_it_is(seed, tabulations):
    """Sharpened by half as much as it should have been, no table was likelier than the last: the same one, eight times."""
    setup = TrialSetup(seed, 120.0, 25.0, law="lommel_seeliger", peak_dn=2500.0, psf="width")
    fit, away_px, _ = measured(setup, Lambert())
    assert away_px < 0.05
    assert fit.solution.theta[Unknown.LAW] == pytest.approx(1.0, abs=0.05)
    assert tabulations[True] <= 5
