"""PSFs that vary over the detector, and PSFs smeared by motion."""

import numpy as np
import pytest

from opnav_workbench.errors import CameraError
from opnav_workbench.psf import (
    EmpiricalPsf,
    FieldPsf,
    GaussianPsf,
    GridShape,
    MoffatPsf,
    PolynomialShape,
    TrailedPsf,
    add_sources,
    covering_boxes,
)

SIZE = (200, 100)


def test_each_point_has_the_shape_of_its_place():
    psf = FieldPsf(PolynomialShape(SIZE, [0.8, 0.1, 0.0], e1=[0.1], e2=[0.0, 0.0, 0.2]))
    centers = np.array([[-0.5, 49.5], [99.5, 49.5], [150.3, 20.7], [199.5, 99.5]])
    first, size = covering_boxes(psf, centers)
    boxes = psf.box(centers, first, size)
    for center, corner, box in zip(centers, first, boxes, strict=True):
        alone = psf.at(center).box(center[None], corner[None], size)[0]
        np.testing.assert_allclose(box, alone, atol=1e-9)
    np.testing.assert_allclose(psf.at([99.5, 49.5]).sigma_px, 0.8 * np.sqrt([1.1, 0.9]), rtol=1e-12)
    x = 2.0 * 150.8 / 200.0 - 1.0
    assert np.sqrt(np.mean(psf.at([150.3, 20.7]).sigma_px ** 2)) == pytest.approx(0.8 + 0.1 * x, rel=1e-12)


def test_polynomial_terms_stand_in_the_order_of_their_degree():
    shape = PolynomialShape((2, 2), [1.0, 0.1, 0.01, 1e-3, 1e-4, 1e-5])
    x, y = 0.5, -0.25  # of half the detector
    place = np.array([[(x + 1.0) - 0.5, (y + 1.0) - 0.5]])
    expected = 1.0 + 0.1 * x + 0.01 * y + 1e-3 * x**2 + 1e-4 * x * y + 1e-5 * y**2
    assert shape.shape(place)[0, 0] == pytest.approx(expected, rel=1e-14)


def test_grid_is_bilinear_and_constant_outside():
    shape = GridShape(SIZE, [0.0, 100.0], [0.0, 50.0], [[1.0, 2.0], [3.0, 4.0]])
    places = np.array([[0.0, 0.0], [50.0, 25.0], [25.0, 50.0], [-90.0, -3.0], [500.0, 500.0]])
    np.testing.assert_allclose(shape.shape(places)[:, 0], [1.0, 2.5, 3.25, 1.0, 4.0])


@pytest.mark.parametrize(
    "build",
    [
        lambda: FieldPsf(PolynomialShape(SIZE, [0.1, 0.5, 0.0])),
        lambda: FieldPsf(PolynomialShape(SIZE, [1.0], e1=[0.8], e2=[0.8])),
        lambda: PolynomialShape(SIZE, [1.0, 0.1]),
        lambda: PolynomialShape(SIZE, [np.nan]),
        lambda: PolynomialShape((0, 5), [1.0]),
        lambda: GridShape(SIZE, [0.0], [0.0, 1.0], [[1.0], [1.0]]),
        lambda: GridShape(SIZE, [0.0, 1.0], [1.0, 0.0], np.ones((2, 2))),
        lambda: GridShape(SIZE, [0.0, 1.0], [0.0, 1.0], np.ones((2, 3))),
    ],
)
def test_fields_without_sense_are_refused(build):
    with pytest.raises(CameraError, match="PSF"):
        build()


def test_a_trail_is_the_sum_of_displaced_copies():
    sharp = GaussianPsf(0.8, 0.6, 0.3)
    offsets, weights = np.array([[-2.4, 0.3], [0.0, 0.0], [3.3, -1.7]]), np.array([1.0, 3.0, 2.0])
    trail = TrailedPsf(sharp, offsets, weights)
    center = np.array([[40.2, 30.9], [10.7, 12.1]])
    first, size = covering_boxes(trail, center)
    expected = sum(
        w / 6.0 * sharp.box(center + o, first, size) for o, w in zip(offsets, weights, strict=True)
    )
    np.testing.assert_allclose(trail.box(center, first, size), expected, atol=2e-8)


def test_a_steady_drift_of_a_gaussian_has_the_closed_form():
    """A Gaussian smeared evenly over L along pixel: second moment sigma^2 + L^2 / 12."""
    steps = (np.arange(64) + 0.5) / 64 - 0.5
    trail = TrailedPsf(GaussianPsf(0.7, 0.7), np.column_stack([6.0 * steps, np.zeros(64)]), np.ones(64))
    np.testing.assert_allclose(trail.sigma_px, [np.sqrt(0.49 + 36.0 / 12.0), 0.7], rtol=2e-4)  # 64 copies


def test_a_trail_over_a_table_is_a_trail_over_its_psf():
    offsets = np.array([[-1.3, 0.4], [1.1, 0.0]])
    exact = TrailedPsf(GaussianPsf(0.9, 0.9), offsets, np.ones(2))
    table = TrailedPsf(EmpiricalPsf(GaussianPsf(0.9, 0.9).kernel(12), 12), offsets, np.ones(2))
    args = [[5.2, 6.1]], [[-3, -2]], 17
    np.testing.assert_allclose(table.box(*args), exact.box(*args), atol=1e-5)


@pytest.mark.parametrize(
    ("offsets", "weights"),
    [
        ([], []),
        ([[0.0, 0.0]], [0.0]),
        ([[0.0, 0.0]], [-1.0]),
        ([[np.nan, 0.0]], [1.0]),
        ([[0.0, 0.0]], [1.0, 1.0]),
    ],
)
def test_trails_without_sense_are_refused(offsets, weights):
    with pytest.raises(CameraError, match="trailed PSF"):
        TrailedPsf(GaussianPsf(1.0, 1.0), np.array(offsets), np.array(weights))


def test_sources_add_up_and_lose_only_what_falls_off_the_edge():
    psf = MoffatPsf(1.8, 3.5)
    picture = np.full((60, 80), 5.0)
    inside = [[40.3, 30.2], [20.0, 20.5], [20.0, 20.5]]
    add_sources(picture, psf, inside, [100.0, 10.0, 20.0])
    assert picture.sum() - 5.0 * picture.size == pytest.approx(130.0, rel=1e-9)

    edge = np.zeros((60, 80))
    add_sources(edge, psf, [[-0.5, 30.0], [np.nan, 3.0], [1e9, 3.0], [-40.0, 5.0]], 100.0)
    assert edge.sum() == pytest.approx(50.0, rel=1e-6)  # half of a star on the left edge

    whole = np.zeros((60, 80))
    add_sources(whole, psf, np.array(inside), np.array([100.0, 10.0, 20.0]))
    np.testing.assert_allclose(whole, picture - 5.0, atol=1e-12)


@pytest.mark.parametrize("n", [1, 400], ids=["few", "many"])
def test_sources_are_added_to_a_part_of_a_larger_picture(n):
    whole = np.zeros((200, 300))
    part = whole[20:140, 30:250]  # not contiguous
    centers = np.random.default_rng(1).uniform(20.0, 90.0, (n, 2))
    add_sources(part, GaussianPsf(1.0, 1.0), centers, 10.0)
    assert whole.sum() == pytest.approx(10.0 * n, rel=1e-6)
    place = np.round(centers[0]).astype(int)
    assert part[place[1], place[0]] > 1.0
