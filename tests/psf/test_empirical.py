"""The empirical PSF: interpolation of a known template, and a template found again from simulated stars."""

import numpy as np
import pytest

from opnav_workbench.errors import CameraError
from opnav_workbench.psf import EmpiricalPsf, GaussianPsf, MoffatPsf, add_sources, covering_boxes
from opnav_workbench.psf.empirical import cells_from_stars

TRUE = GaussianPsf(0.95, 0.75, 0.5)


def psf_from_stars(image, bad, centers, fluxes, oversampling, **size):
    return EmpiricalPsf(cells_from_stars(image, bad, centers, fluxes, oversampling, **size), oversampling)


def field_of_stars(psf, n, rng, read_noise=0.0):
    """Return an image of n stars on a grid of 26 px, their places and their fluxes."""
    side = int(np.ceil(np.sqrt(n)))
    line, pixel = np.divmod(np.arange(n), side)
    centers = 26.0 * (np.column_stack([pixel, line]) + 0.5) + rng.uniform(-0.5, 0.5, (n, 2))
    fluxes = rng.uniform(2e4, 1e5, n)
    image = np.zeros((26 * side, 26 * side))
    add_sources(image, psf, centers, fluxes)
    if read_noise:
        image = rng.poisson(image) + rng.normal(0.0, read_noise, image.shape)
    return image, centers, fluxes


def worst_share(found, true):
    """Largest error of a pixel's share over all phases, as a fraction of the light."""
    phase = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(-0.5, 0.5, 9)), axis=-1).reshape(
        -1, 2
    )
    first, size = covering_boxes(true, phase)
    return float(np.abs(found.box(phase, first, size) - true.box(phase, first, size)).max())


@pytest.mark.parametrize(("oversampling", "tolerance"), [(4, 4e-5), (8, 2e-6), (12, 5e-7)])
def test_interpolates_a_known_template(oversampling, tolerance):
    psf = EmpiricalPsf(TRUE.kernel(oversampling), oversampling)
    assert worst_share(psf, TRUE) < tolerance


def test_is_exact_where_pixels_fall_on_cells():
    psf = EmpiricalPsf(TRUE.kernel(4), 4)
    centers = np.array([[0.125, -0.375], [0.375, 0.125]])
    first, size = covering_boxes(TRUE, centers)
    np.testing.assert_allclose(psf.box(centers, first, size), TRUE.box(centers, first, size), atol=1e-7)


@pytest.mark.slow(keep=["gaussian"])
@pytest.mark.parametrize("true", [TRUE, MoffatPsf(1.9, 4.0)], ids=["gaussian", "moffat"])
def test_extracted_from_noiseless_stars(true):
    image, centers, fluxes = field_of_stars(true, 144, np.random.default_rng(1))
    psf = psf_from_stars(image, None, centers, fluxes, 4)
    assert worst_share(psf, true) < 1e-4


@pytest.mark.slow
def test_extracted_from_noisy_stars_with_bad_pixels_and_a_cosmic_ray():
    rng = np.random.default_rng(7)
    image, centers, fluxes = field_of_stars(TRUE, 225, rng, read_noise=10.0)
    bad = rng.random(image.shape) < 0.02
    image[bad] = np.nan
    hit = np.rint(centers[10:30]).astype(int) + np.array([2, 1])
    image[hit[:, 1], hit[:, 0]] += 2e4
    psf = psf_from_stars(image, bad, centers, fluxes, 4)
    assert worst_share(psf, TRUE) < 2.5e-3
    np.testing.assert_allclose(psf.sigma_px, TRUE.sigma_px, rtol=0.02)


def test_too_few_stars_are_refused():
    image, centers, fluxes = field_of_stars(TRUE, 4, np.random.default_rng(1))
    with pytest.raises(CameraError, match=r"pixels around 4 stars cannot determine 2401 cells"):
        psf_from_stars(image, None, centers, fluxes, 4)
    with pytest.raises(CameraError, match="mask"):
        psf_from_stars(image, image[1:] > 0, centers, fluxes, 4)
    with pytest.raises(CameraError, match="fluxes"):
        psf_from_stars(image, None, centers, fluxes[1:], 4)


def test_stars_at_the_edge_and_unknown_ones_do_no_harm():
    image, centers, fluxes = field_of_stars(TRUE, 144, np.random.default_rng(1))
    outside = np.array([[-2.0, 30.0], [np.nan, 1.0], [1e4, 1e4]])
    psf = psf_from_stars(
        image, None, np.vstack([centers, outside]), np.concatenate([fluxes, np.full(3, 1e-3)]), 4
    )
    assert worst_share(psf, TRUE) < 1e-4


def test_saved_and_loaded(tmp_path):
    psf = EmpiricalPsf(TRUE.kernel(5), 5)
    psf.save(tmp_path / "psf.npz")
    again = EmpiricalPsf.load(tmp_path / "psf.npz")
    np.testing.assert_array_equal(again.samples, psf.samples)
    assert again.oversampling == 5
    with pytest.raises(CameraError, match="cannot be read"):
        EmpiricalPsf.load(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("no")
    with pytest.raises(CameraError, match="cannot be read"):
        EmpiricalPsf.load(tmp_path / "text.npz")


@pytest.mark.parametrize(
    "samples", [np.ones((4, 4)), np.ones((3, 5)), np.zeros((3, 3)), np.full((3, 3), np.nan)]
)
def test_templates_without_sense_are_refused(samples):
    with pytest.raises(CameraError, match="PSF samples"):
        EmpiricalPsf(samples, 3)
    with pytest.raises(CameraError, match="oversampling"):
        EmpiricalPsf(np.ones((3, 3)), 0)
