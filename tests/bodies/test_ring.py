"""Rings of blocks, held to dense linear algebra."""

import numpy as np
import pytest

from opnav_workbench.bodies.disk.ring import RingFactor, products, ring_prior


def field(n, s, length):
    """Covariance (n s, n s) of points on a circle, exponential along it, and of two unlike kinds of them."""
    angle = np.repeat(np.arange(n * (s // 2)), 2) * (2.0 * np.pi / (n * (s // 2)))
    apart = np.abs(angle[:, None] - angle)
    apart = np.minimum(apart, 2.0 * np.pi - apart)
    kind = np.tile([0, 1], n * (s // 2))
    same = np.where(kind[:, None] == kind, 1.0, 0.3)
    return same * np.exp(-apart / length) + 1e-3 * np.eye(n * s)


def ring_of(prior, n):
    """The dense precision of a ring."""
    s = len(prior.diagonal)
    out = np.zeros((n, s, n, s))
    for i in range(n):
        out[i, :, i] += prior.diagonal
        out[i, :, i - 1] += prior.before
        out[i - 1, :, i] += prior.before.T
    return out.reshape(n * s, n * s)


@pytest.mark.parametrize("n", [3, 4, 5, 6, 10, 12, 24])
def test_a_ring_is_solved_as_dense_matrices_are(n):
    rng, s, m = np.random.default_rng(n), 4, 3
    root = rng.normal(size=(n, s, s))
    prior = ring_prior(*_blocks(field(n, s, 0.4), s), n)
    own = np.matmul(root, np.swapaxes(root, 1, 2))
    dense = ring_of(prior, n)
    whole = dense.copy().reshape(n, s, n, s)
    whole[np.arange(n), :, np.arange(n)] += own
    whole = whole.reshape(n * s, n * s)
    right = rng.normal(size=(n, s, m))
    factor = RingFactor(prior.diagonal + own, np.broadcast_to(prior.before, (n, s, s)))
    expected = np.linalg.solve(whole, right.reshape(n * s, m))
    halves = factor.halves(right)
    np.testing.assert_allclose(factor.solved(halves).reshape(n * s, m), expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(products(halves, halves), right.reshape(n * s, m).T @ expected, rtol=1e-9)
    np.testing.assert_allclose(factor.log_determinant, np.linalg.slogdet(whole)[1], rtol=1e-10)
    np.testing.assert_allclose(prior.log_determinant, np.linalg.slogdet(dense)[1], rtol=1e-8)
    inverse = np.linalg.inv(whole).reshape(n, s, n, s)
    diagonal, before = factor.inverse()
    here = np.arange(n)
    np.testing.assert_allclose(diagonal, inverse[here, :, here], rtol=0, atol=1e-9)
    np.testing.assert_allclose(before, inverse[here, :, here - 1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        prior.times(right).reshape(n * s, m), dense @ right.reshape(n * s, m), rtol=0, atol=1e-8
    )
    back = prior.covariance_times(prior.times(right))
    np.testing.assert_allclose(back, right, rtol=0, atol=1e-8)


@pytest.mark.parametrize("length", [0.1, 0.4, 0.7])
def test_a_ring_has_the_covariance_of_its_field(length):
    """Within a block, between neighbors and, of fields like those of albedo, everywhere."""
    n, s = 12, 8
    exact = field(n, s, length)
    prior = ring_prior(*_blocks(exact, s), n)
    found = np.linalg.inv(ring_of(prior, n))
    assert np.abs(found - exact).max() < 0.02
    assert np.abs((found - exact)[:s, : 2 * s]).max() < 0.02


def _blocks(covariance, s):
    return covariance[s : 2 * s, s : 2 * s], covariance[s : 2 * s, :s]
