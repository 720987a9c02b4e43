"""What every PSF promises: all light in the boxes, at any sub-pixel phase, and a kernel that agrees with the boxes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from opnav_workbench.psf import (
    EmpiricalPsf,
    FieldPsf,
    GaussianPsf,
    GridShape,
    MoffatPsf,
    PolynomialShape,
    Psf,
    TrailedPsf,
    covering_boxes,
)

FLUX_TOLERANCE = 1e-6
CENTER_TOLERANCE_PX, SIGMA_TOLERANCE_PX = 3e-6, 2e-3
SIZE = (1024, 512)

TRAIL = TrailedPsf(MoffatPsf(1.7, 4.0), [[-3.1, 0.2], [0.0, 0.0], [2.7, -0.4]], [1.0, 2.0, 1.0])
GRID = GridShape(
    SIZE,
    [0.0, 400.0, 1023.0],
    [0.0, 511.0],
    [[0.8, 0.7, 0.9], [0.9, 0.8, 1.1]],
    e2=[[0.1, 0, 0], [0, 0.2, 0]],
)
PSFS = {
    "round": GaussianPsf(0.7, 0.7),
    "narrow": GaussianPsf(0.2, 0.2),
    "elliptical": GaussianPsf(1.4, 0.6, 0.7),
    "along line": GaussianPsf(1.4, 0.6, np.pi / 2.0),
    "moffat": MoffatPsf(2.0, 3.0),
    "sharp moffat": MoffatPsf(0.8, 2.5),
    "empirical": EmpiricalPsf(MoffatPsf(1.9, 4.0).kernel(5), 5),
    "empirical, even": EmpiricalPsf(GaussianPsf(0.9, 0.7, 0.3).kernel(4), 4),
    "polynomial": FieldPsf(PolynomialShape(SIZE, [0.8, 0.1, 0.0, 0.2, 0.0, 0.1], e1=[0.0, 0.1, 0.1])),
    "grid": FieldPsf(GRID),
    "trailed": TRAIL,
    "trailed field": TrailedPsf(FieldPsf(GRID), [[0.0, -4.0], [0.0, 0.0], [0.3, 4.0]], np.ones(3)),
}
every_psf = pytest.mark.parametrize("psf", PSFS.values(), ids=PSFS.keys())


@every_psf
def test_is_a_psf(psf):
    assert isinstance(psf, Psf)
    assert isinstance(psf.at([10.0, 20.0]), Psf)
    assert psf.sigma_px.shape == (2,)


@every_psf
@settings(max_examples=30, deadline=None)
@given(
    x=st.floats(-0.5, 0.5), y=st.floats(-0.5, 0.5), at=st.tuples(st.integers(0, 1023), st.integers(0, 511))
)
def test_boxes_hold_all_light_at_any_phase(psf, x, y, at):
    center = np.array([[at[0] + x, at[1] + y]])
    first, size = covering_boxes(psf, center)
    box = psf.box(center, first, size)
    assert box.shape == (1, size, size)
    assert abs(box.sum() - 1.0) < FLUX_TOLERANCE


@every_psf
def test_a_larger_box_holds_the_same_light_at_the_same_places(psf):
    center = np.array([[300.3, 200.8]])
    first, size = covering_boxes(psf, center)
    inner, outer = psf.box(center, first, size)[0], psf.box(center, first - 3, size + 6)[0]
    np.testing.assert_allclose(outer[3:-3, 3:-3], inner, rtol=0.0, atol=1e-12)
    assert abs(outer.sum() - inner.sum()) < FLUX_TOLERANCE


@every_psf
def test_many_points_are_like_single_ones(psf):
    centers = np.random.default_rng(5).uniform(20.0, 480.0, (7, 2))
    first, size = covering_boxes(psf, centers)
    together = psf.box(centers, first, size)
    for i in range(len(centers)):
        alone = psf.box(centers[i : i + 1], first[i : i + 1], size)[0]
        np.testing.assert_allclose(together[i], alone, rtol=0.0, atol=1e-9)


@every_psf
@pytest.mark.parametrize("subsample", [1, 2, 5])
def test_kernel_summed_over_pixels_is_the_box(psf, subsample):
    middle = np.array([512.0, 256.0]) - 0.5  # where the kernel of a field is taken
    local = psf.at(middle)
    kernel = psf.kernel(subsample)
    reach = len(kernel) // 2
    assert kernel.shape == (2 * reach + 1, 2 * reach + 1)
    assert kernel.sum() == pytest.approx(1.0, abs=1e-12)
    for cell in ((0, 0), (subsample - 1, subsample // 2)):
        center = (np.array(cell) + 0.5) / subsample - 0.5  # middle of that cell of pixel (0, 0)
        side = int(np.ceil((reach + 1) / subsample))
        fine = np.zeros(((2 * side + 1) * subsample,) * 2)
        pixel, line = side * subsample + np.array(cell)
        fine[line - reach : line + reach + 1, pixel - reach : pixel + reach + 1] = kernel
        summed = fine.reshape(2 * side + 1, subsample, 2 * side + 1, subsample).sum(axis=(1, 3))
        box = local.box(center[None], np.full((1, 2), -side), 2 * side + 1)[0]
        np.testing.assert_allclose(summed, box, rtol=0.0, atol=3e-8)


@every_psf
def test_a_displaced_kernel_has_its_light_at_the_displaced_place(psf):
    shift = np.array([0.08, -0.21])
    kernels = psf.kernel(4), psf.kernel(4, shift)
    centroids = []
    for kernel in kernels:
        at = (np.arange(len(kernel)) - len(kernel) // 2) / 4.0
        centroids.append([kernel.sum(axis=0) @ at, kernel.sum(axis=1) @ at])
    np.testing.assert_allclose(np.diff(centroids, axis=0)[0], shift, atol=2e-6)


@every_psf
def test_light_has_the_center_and_the_second_moments_of_the_psf_and_a_pixel(psf):
    """On average over all phases: pixels sample a narrow PSF too coarsely for a single one."""
    local = psf.at([511.5, 255.5])
    phase = (np.arange(16) + 0.5) / 16 - 0.5
    centers = np.stack(np.meshgrid(phase, phase), axis=-1).reshape(-1, 2)
    first, size = covering_boxes(local, centers)
    boxes = local.box(centers, first, size)
    for axis, profile in enumerate((boxes.sum(axis=1), boxes.sum(axis=2))):
        offset = first[:, axis, None] + np.arange(size) - centers[:, axis, None]
        mean = np.mean(np.sum(profile * offset, axis=1))
        trail = local.weights @ local.offsets_px[:, axis] if isinstance(local, TrailedPsf) else 0.0
        assert mean == pytest.approx(trail, abs=CENTER_TOLERANCE_PX)
        sigma = np.sqrt(np.mean(np.sum(profile * offset**2, axis=1)) - mean**2 - 1.0 / 12.0)
        assert sigma == pytest.approx(local.sigma_px[axis], abs=SIGMA_TOLERANCE_PX)


@pytest.mark.slow(keep=["narrow", "along line", "polynomial"])
@every_psf
@settings(max_examples=15, deadline=None)
@given(x=st.floats(-0.5, 0.5), y=st.floats(-0.5, 0.5))
def test_gradient_is_the_change_of_the_box_with_the_center(psf, x, y):
    # A field's shape is that of the place where the point is, held while it moves by a step.
    local = psf.at([300.0, 200.0])
    center, first, size, step = np.array([[300.0 + x, 200.0 + y]]), np.array([[294, 194]]), 13, 1e-4
    gradient = local.gradient(center, first, size)
    np.testing.assert_allclose(gradient.value, local.box(center, first, size), atol=1e-9)
    for derivative, shift in ((gradient.d_pixel, [step, 0.0]), (gradient.d_line, [0.0, step])):
        ahead, behind = (local.box(center + sign * np.array(shift), first, size) for sign in (1.0, -1.0))
        np.testing.assert_allclose(derivative, (ahead - behind) / (2.0 * step), atol=2e-6)


def test_a_straight_trail_has_the_moments_of_a_boxcar():
    trail = TrailedPsf.straight(GaussianPsf(0.8, 0.8), 9.0, 0.0)
    np.testing.assert_allclose(trail.sigma_px, [np.sqrt(0.64 + 81.0 / 12.0), 0.8], rtol=2e-3)
    round_psf, where = GaussianPsf(0.8, 0.8), ([[5.2, 5.1]], [[0, 0]], 11)
    still = TrailedPsf.straight(round_psf, 0.0, 1.0)
    np.testing.assert_allclose(still.box(*where), round_psf.box(*where), atol=1e-12)


def test_a_field_shape_enters_the_gradient_at_its_own_place():
    psf, center, first = PSFS["grid"], np.array([[300.2, 200.4]]), np.array([[294, 194]])
    here = psf.at(center[0]).gradient(center, first, 13)
    np.testing.assert_allclose(psf.gradient(center, first, 13).d_pixel, here.d_pixel, atol=1e-12)
