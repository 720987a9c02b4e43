"""Linear unknowns with a prior of unknown scale, held beside sums over a grid."""

import numpy as np
import pytest

from opnav_workbench.bodies.scales import mixed_solution, scale_precisions
from opnav_workbench.render import FigureUncertainty

SCALES = (1.0, 0.2, 0.04)


def summed(normal, right, sigmas):
    """Mean, covariance and evidence of two unknowns, the second with a prior of several scales, by a sum over a grid."""
    x, y = np.meshgrid(np.linspace(-8.0, 8.0, 1601), np.linspace(-4.0, 4.0, 1601), indexing="ij")
    cost = (
        normal[0, 0] * x**2
        + 2.0 * normal[0, 1] * x * y
        + normal[1, 1] * y**2
        - 2.0 * (right[0] * x + right[1] * y)
    )
    prior = np.mean([np.exp(-0.5 * (y / s) ** 2) / s / np.sqrt(2.0 * np.pi) for s in sigmas], axis=0)
    density = np.exp(-0.5 * cost) * prior
    whole = density.sum()
    mean = np.array([(density * x).sum(), (density * y).sum()]) / whole
    away = np.stack([x - mean[0], y - mean[1]])
    covariance = np.einsum("aij,bij,ij->ab", away, away, density) / whole
    step = (x[1, 0] - x[0, 0]) * (y[0, 1] - y[0, 0])
    return mean, covariance, np.log(whole * step / (2.0 * np.pi))


@pytest.mark.parametrize("told", [0.02, 0.3, 0.9])
def test_moments_are_those_of_all_scales(told):
    """What is near nothing keeps near; what the data tell plainly is let go; between, both are in the covariance."""
    normal = np.array([[4.0, 9.0], [9.0, 60.0]])
    right = normal @ np.array([0.5, told])
    solution = mixed_solution(normal, right, scale_precisions(2, ([1], SCALES)))
    mean, covariance, evidence = summed(normal, right, SCALES)
    np.testing.assert_allclose(solution.theta, mean, rtol=0, atol=1e-4)
    np.testing.assert_allclose(solution.covariance, covariance, rtol=2e-3, atol=1e-5)
    # The unknown without a prior adds a constant to the evidence: sqrt(2 pi) of its flat density.
    assert solution.log_evidence == pytest.approx(evidence + 0.5 * np.log(2.0 * np.pi), abs=2e-3)
    assert solution.share.sum() == pytest.approx(1.0)
    assert solution.share.argmax() == (2 if told == 0.02 else 0 if told == 0.9 else solution.share.argmax())


def test_one_scale_is_plain_least_squares():
    rng = np.random.default_rng(5)
    design = rng.normal(size=(20, 4))
    normal, right = design.T @ design, design.T @ rng.normal(size=20)
    precision = scale_precisions(4, ([1, 3], [0.3]))
    solution = mixed_solution(normal, right, precision)
    np.testing.assert_allclose(
        solution.theta, np.linalg.solve(normal + np.diag(precision[0]), right), rtol=1e-8
    )
    np.testing.assert_allclose(solution.covariance, np.linalg.inv(normal + np.diag(precision[0])), rtol=1e-8)


def test_what_nothing_tells_stays_finite():
    normal = np.diag([0.0, 5.0, 1.0])
    solution = mixed_solution(normal, np.array([0.0, 1.0, 1.0]), scale_precisions(3, ([2], SCALES)))
    assert np.isfinite(solution.theta).all()
    assert solution.covariance[0, 0] > 1e6


def test_scales_stand_for_what_nobody_stated():
    assert FigureUncertainty().size_scales == pytest.approx((0.1, 0.02, 0.004, 0.0008))
    assert FigureUncertainty().axes_scales == pytest.approx((0.05, 0.01, 0.002, 0.0004))
    assert FigureUncertainty().albedo_scales == pytest.approx((0.5, 0.2, 0.04, 0.008, 0.0016))
    assert FigureUncertainty(albedo_sigma=0.1).albedo_scales == (0.1,)
    stated = FigureUncertainty(size_sigma=0.03)
    assert stated.size_scales == (0.03,)
    assert len(stated.axes_scales) == 4
    groups = scale_precisions(5, ([0], (1.0, 0.5)), ([1, 2], (1.0, 0.1)), ([3, 4], np.array([[1.0, 2.0]])))
    assert groups.shape == (4, 5)
    np.testing.assert_allclose(groups[-1], [4.0, 100.0, 100.0, 1.0, 0.25])
