"""The prior of a limb's field: its slopes are those of the likelihood, and where it ends nothing near is likelier."""

from dataclasses import replace

import numpy as np
import pytest
from disk_truth import TrialSetup, make_trial

from opnav_workbench.bodies.disk.limb_field import FieldPrior
from opnav_workbench.bodies.disk.measurement import measure_disk
from opnav_workbench.bodies.disk.tuning import VARIETY, tuned

PATCHED = {"tiny": (5.0, "blobs_0.6"), "small": (25.0, "blobs_0.35"), "large": (90.0, "field_mid")}


@pytest.fixture(scope="module", params=PATCHED.values(), ids=PATCHED)
def system(request):
    """A patched disk's cells about its solution."""
    diameter, family = request.param
    trial = make_trial(TrialSetup(5, diameter, 40.0, family=family, contrast=3.0, peak_dn=1500.0))
    return measure_disk(trial.picture, trial.name, "disk", None, None).fit.system


def likelihood(system, logarithms):
    prior = FieldPrior.from_logarithms(logarithms)
    return system.log_likelihood(prior, system.weighed(prior.grain))


@pytest.mark.slow(keep=["tiny-prior0", "tiny-prior1"])
@pytest.mark.parametrize(
    "prior", [FieldPrior(0.3, 0.4, 0.05, 0.02), FieldPrior(0.05, 0.2, 0.01, 0.3, hemispheres=0.1)]
)
def test_slopes_are_those_of_the_likelihood(system, prior):
    at, step = prior.logarithms(), 1e-4
    ascent = system.ascent(prior, system.weighed(prior.grain))
    assert ascent.log_likelihood == pytest.approx(likelihood(system, at), rel=1e-9)
    each = step * np.eye(5)
    differences = [(likelihood(system, at + d) - likelihood(system, at - d)) / (2.0 * step) for d in each]
    np.testing.assert_allclose(ascent.gradient, differences, rtol=1e-3, atol=1e-2)
    least = 1e-8 if len(system.own) > 1 else 1e-5  # of a mixture over scales, with modes that hardly show
    assert np.linalg.eigvalsh(ascent.information).min() > -least * np.trace(ascent.information)


def test_nothing_near_a_tuned_prior_is_likelier(system):
    """But for what is not worth a step; what far starts end at is as likely: hemispheres may have two tops."""
    starts = [FieldPrior(0.15, 0.5, 0.02, 0.05), FieldPrior(0.6, 0.2, 0.1, 0.2)]
    found = [tuned(system, start, 0.05, 0.008) for start in starts]
    assert found[0].cost == pytest.approx(found[1].cost, abs=1.5)
    at = found[0].prior.logarithms()
    usual = np.append(np.log([0.1, 0.4, 0.01, 0.05]), 0.0)

    def cost(x):
        return 0.5 * float(np.sum(((x - usual) / VARIETY) ** 2)) - likelihood(system, x)

    assert cost(at) == pytest.approx(found[0].cost, rel=1e-9)
    for k in range(4):
        for sign in (-0.3, 0.3):
            beside = at + sign * np.eye(5)[k]
            if 0.08 <= np.exp(beside[1]) <= 0.7 and 0.001 <= np.exp(beside[2]) <= 0.25:
                assert cost(beside) > cost(at) - 0.2


def test_a_brighter_picture_of_the_same_surface_has_the_same_prior(system):
    """Contrast, length and grain are relative."""
    scale = 7.0
    brighter = replace(
        system,
        data=scale * system.data,
        variance=scale**2 * system.variance,
        seen_variance=scale**2 * system.seen_variance,
        light=scale * system.light,
        shared=scale * system.shared,
        own=np.concatenate([system.own[:-1], scale * system.own[-1:]]),  # albedos are in DN
        brightness_dn=scale * system.brightness_dn,
    )
    start = FieldPrior(0.15, 0.5, 0.02, 0.05)
    one, other = (tuned(s, start, 0.05, 0.008).prior.logarithms() for s in (system, brighter))
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-3)
