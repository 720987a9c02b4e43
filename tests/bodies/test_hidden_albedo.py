"""Steps of a limb by albedo between a field's nodes, against edges that are drawn, blurred and fitted."""

import numpy as np
import pytest
from scipy.special import erfc

from opnav_workbench.bodies.disk.hidden_albedo import hidden_albedo

RADIUS_PX, WIDTH_PX, PIECES = 60.0, 0.9, 48
NODES = np.linspace(0.0, 0.6, 5)
ALONG = 8  # rays of a piece
DRAWS = 1500


def drawn_steps(length_rad, rng):
    """Steps (draws, 2) of two neighbouring pieces: fields drawn point by point, edges summed pixel by pixel."""
    depth = np.arange(0.075, 4.5, 0.15)  # inward, px
    arc = np.concatenate([np.arccos(1.0 - depth / RADIUS_PX), NODES])
    ray = (np.arange(2 * ALONG) + 0.5) / ALONG * (2.0 * np.pi / PIECES)
    a, r = np.meshgrid(arc, ray, indexing="ij")
    place = np.stack([np.cos(a) * np.cos(r), np.cos(a) * np.sin(r), np.sin(a)], axis=-1).reshape(-1, 3)
    apart = np.arccos(np.clip(place @ place.T, -1.0, 1.0))
    value, vector = np.linalg.eigh(np.exp(-apart / length_rad))
    root = vector * np.sqrt(np.maximum(value, 0.0))
    field = (root @ rng.standard_normal((len(place), DRAWS))).reshape(len(arc), 2, ALONG, DRAWS).mean(axis=2)
    n = len(depth)
    between = np.stack([np.interp(arc[:n], NODES, hat) for hat in np.eye(len(NODES))], axis=1)
    seen = field[:n] - np.einsum("dk,kpn->dpn", between, field[n:])
    x = np.arange(-8.0, 8.0, 0.1)
    spread = np.exp(-0.5 * ((x[:, None] + depth) / WIDTH_PX) ** 2) / (WIDTH_PX * np.sqrt(2.0 * np.pi)) * 0.15
    edge = 0.5 * erfc(x / (WIDTH_PX * np.sqrt(2.0)))
    slope = -np.gradient(edge, x)  # by how much an edge that lies farther out is brighter
    change = np.einsum("xd,dpn->xpn", spread, seen)
    return np.einsum("x,xpn->np", slope, change) / (slope @ slope)


@pytest.mark.slow(keep=("0.3",))
@pytest.mark.parametrize("length_rad", [0.1, 0.3, 0.6])
def test_steps_are_those_of_edges_that_were_drawn(length_rad):
    steps = drawn_steps(length_rad, np.random.default_rng(7))
    expected = hidden_albedo(RADIUS_PX, WIDTH_PX, NODES, PIECES).covariance_px2(length_rad)
    found = steps.T @ steps / len(steps)
    assert found[0, 0] == pytest.approx(expected[0, 0], rel=0.12)
    assert found[0, 1] / found[0, 0] == pytest.approx(expected[0, 1] / expected[0, 0], abs=0.06)


@pytest.mark.parametrize("radius_px", [3.0, 30.0, 400.0])
def test_covariances_are_of_a_ring_and_positive(radius_px):
    hidden = hidden_albedo(
        radius_px, WIDTH_PX, np.linspace(0.0, min(0.6, np.arccos(max(1.0 - 12.0 / radius_px, 0.0)))), 24
    )
    covariance = hidden.covariance_px2(0.3)
    assert np.allclose(covariance, covariance.T)
    assert np.allclose(np.diag(covariance), covariance[0, 0])
    assert covariance[0, 1] == pytest.approx(covariance[0, 23])
    assert np.linalg.eigvalsh(covariance).min() > -1e-6 * covariance[0, 0]
    assert 0.0 < covariance[0, 0] < (2.0 * WIDTH_PX) ** 2
