"""The scatter of pieces of limb: one for pictures of the model, more where pieces pull a center apart."""

from dataclasses import replace

import numpy as np
import pytest
from disk_truth import TrialSetup, make_trial

from opnav_workbench.bodies.disk.columns import CENTER
from opnav_workbench.bodies.disk.limb_field import BLOCK
from opnav_workbench.bodies.disk.limb_scatter import MODEL_DEGREES, limb_scatter
from opnav_workbench.bodies.disk.marginal import LimbScores
from opnav_workbench.bodies.disk.measurement import measure_disk


@pytest.fixture(scope="module", params=[40.0, 6.0])
def fit(request):
    trial = make_trial(TrialSetup(5, request.param, 60.0, family="blobs_0.35", contrast=3.0, peak_dn=1500.0))
    return measure_disk(trial.picture, trial.name, "disk", None, None).fit


class DenseCells:
    """A disk's cells without any structure: C of patches, heights and noise, and X of what is shared and of amplitudes.

    Only the largest figure is kept of those that theta may have, so that its prior is Gaussian.
    """

    def __init__(self, fit):
        self.system = system = replace(fit.system, scales=fit.system.scales[:1])
        self.used = np.isfinite(system.variance)
        j, q = system.data.shape[0], len(system.own)
        own = np.zeros((*system.data.shape, j, q))
        own[np.arange(j), :, np.arange(j)] = system.own.transpose(1, 2, 0)
        own = own[self.used].reshape(-1, j * q)
        ring = system.field.ring(fit.prior, system.brightness_dn)
        n = j // BLOCK
        noise = system.variance[self.used] + (fit.prior.grain * system.light[self.used]) ** 2
        patches = ring.covariance_times(np.eye(j * q).reshape(n, -1, j * q)).reshape(j * q, j * q)
        self.covariance = own @ patches @ own.T + np.diag(noise)
        amplified, p = system.amplified[:, self.used].T, len(system.shared)
        self.columns = np.concatenate([system.shared[:, self.used].T, amplified], axis=1)
        self.precision = np.zeros((self.columns.shape[1], self.columns.shape[1]))
        self.precision[:p, :p] = np.diag(system.prior_precision + system.scales[0])
        covariance = system.field.amplitudes(fit.prior).covariance * system.brightness_dn**2
        self.precision[p:, p:] = np.linalg.inv(covariance)
        self.mean = np.append(system.prior_mean, np.zeros(amplified.shape[1]))

    def drawn(self, rng):
        """Cells as the model has them, with all that is shared at what was expected of it."""
        data = self.system.data.copy()
        root = np.linalg.cholesky(self.covariance)
        data[self.used] = self.columns @ self.mean + root @ rng.normal(size=len(root))
        return replace(self.system, data=data)


@pytest.fixture(scope="module")
def cells(fit):
    return DenseCells(fit)


@pytest.mark.slow(keep=["6.0"])
def test_scores_are_those_of_dense_algebra(fit, cells):
    data, columns = cells.system.data[cells.used], cells.columns
    inverse = np.linalg.inv(cells.covariance)
    known = np.linalg.inv(columns.T @ inverse @ columns + cells.precision)
    theta = known @ (columns.T @ inverse @ data + cells.precision @ cells.mean)
    gain = known[CENTER] @ columns.T
    by_piece = np.zeros((len(cells.used), len(data)))
    by_piece[np.nonzero(cells.used)[0], np.arange(len(data))] = 1.0
    taken = inverse - inverse @ columns @ known @ columns.T @ inverse
    each = (gain[:, None, :] * by_piece).reshape(-1, len(data))
    pull = inverse @ (data - columns @ theta)
    scores = cells.system.scores(fit.prior, CENTER)
    dense = (gain * pull) @ by_piece.T, (each @ taken @ each.T).reshape(scores.expected.shape)
    for one, other in zip(scores, (*dense, gain @ inverse @ gain.T), strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=0.01 * np.abs(other).max())


@pytest.mark.slow(keep=["6.0"])
def test_a_surface_of_the_model_scatters_as_the_model_says(fit, cells):
    """The ratio is one, so what is told is the variance of a Student's distribution with the degrees that there are."""
    rng = np.random.default_rng(3)
    scatter = [limb_scatter(cells.drawn(rng).scores(fit.prior, CENTER)) for _ in range(200)]
    few = MODEL_DEGREES / (MODEL_DEGREES - 2.0)
    assert 1.0 < np.mean(scatter) < few
    assert np.std(scatter) < 0.6


def test_pieces_that_pull_apart_widen_a_center(fit, cells):
    """Half of the limb lies outward and half inward of a smooth one by far more than roughness has it, turn by turn."""
    plain = cells.drawn(np.random.default_rng(4))
    j = len(plain.data)
    waves = np.sin(3.0 * 2.0 * np.pi * np.arange(j) / j)
    scatter = []
    for height in (0.0, 0.5, 1.0):
        data = plain.data + np.where(cells.used, height * waves[:, None] * plain.own[-1], 0.0)
        scatter.append(limb_scatter(replace(plain, data=data).scores(fit.prior, CENTER)))
    assert scatter[0] < 2.0
    assert scatter[0] + 0.5 < scatter[1] < scatter[2]


def test_a_limb_that_tells_nothing_leaves_the_model_as_it_is():
    none = LimbScores(np.zeros((2, 8)), np.zeros((2, 8, 2, 8)), np.zeros((2, 2)))
    assert limb_scatter(none) == 1.0
