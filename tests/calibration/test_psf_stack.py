"""Empirical PSFs from simulated star pictures with a known PSF."""

from dataclasses import replace

import numpy as np
import pytest

from opnav_workbench.calibration import PsfPicture, stack_psf
from opnav_workbench.errors import CameraError
from opnav_workbench.psf import GaussianPsf, MoffatPsf, add_sources
from opnav_workbench.stars import NoiseModel, ShapePrior, fit_psf

READ_NOISE_DN, GAIN = 2.0, 20.0
TRUE = MoffatPsf(fwhm_px=1.6, beta=2.5)


def picture(rng, psf, n=40, size=256, flux=(2e3, 2e4), name="frame"):
    """A picture of isolated stars on a jittered grid, with shot and read noise; and where they truly are."""
    side = int(np.ceil(np.sqrt(n)))
    step = (size - 20.0) / side
    grid = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)[:n]
    places = 10.0 + step * (grid + 0.5) + rng.uniform(-0.5, 0.5, (n, 2))
    fluxes = np.exp(rng.uniform(*np.log(flux), n))
    image = np.zeros((size, size))
    add_sources(image, psf, places, fluxes)
    variance = READ_NOISE_DN**2 + np.maximum(image, 0.0) / GAIN
    image = image + rng.normal(size=image.shape) * np.sqrt(variance)
    start = np.round(places)
    made = PsfPicture(
        name, image, np.full(image.shape, READ_NOISE_DN), np.zeros(image.shape, bool), start,
        NoiseModel(READ_NOISE_DN, GAIN),
    )  # fmt: skip
    return made, places


PRIOR = ShapePrior.round_psf(0.7)


@pytest.fixture(scope="module")
def stacked():
    pictures = [picture(np.random.default_rng([1, i]), TRUE, name=f"frame {i}")[0] for i in range(4)]
    return stack_psf(pictures, PRIOR)


@pytest.mark.slow
def test_the_stack_is_the_true_psf(stacked):
    """Pixel shares at any phase against the truth; a Gaussian is off by 0.03 and more."""
    rng = np.random.default_rng(2)
    center = rng.uniform(-0.5, 0.5, (50, 2))
    first = np.full((50, 2), -4)
    truth = TRUE.box(center, first, 9)
    found = stacked.psf.box(center, first, 9)
    assert np.abs(found - truth).max() < 0.012
    gaussian = GaussianPsf(0.6, 0.6).box(center, first, 9)
    assert np.abs(gaussian - truth).max() > 0.03
    assert stacked.n_stars == 160
    assert stacked.messages == ()


@pytest.mark.slow
def test_stars_are_explained_by_noise(stacked):
    assert np.median(stacked.empirical_chi2) == pytest.approx(1.0, abs=0.15)
    assert np.median(stacked.gaussian_chi2) > 2.0 * np.median(stacked.empirical_chi2)
    assert stacked.held_out_chi2 < 0.7 * np.median(stacked.gaussian_chi2)


@pytest.mark.slow
def test_centers_of_other_stars(stacked):
    """A picture that was not in the stack: centers without bias, and their errors what they say."""
    other, places = picture(np.random.default_rng(3), TRUE, n=100, flux=(5e3, 5e3))
    fit = fit_psf(
        other.signal_dn, other.noise_dn, None, other.pixel_line, stacked.psf, noise_model=other.noise_model
    )
    error = fit.pixel_line - places
    assert np.abs(error.mean(axis=0)).max() < 0.01
    assert np.sqrt(np.mean(error**2)) < 1.25 * np.sqrt(np.mean(fit.sigma_px**2))


@pytest.mark.slow
def test_frames_of_another_shape_are_left_out():
    pictures = [picture(np.random.default_rng([4, i]), TRUE, name=f"frame {i}")[0] for i in range(3)]
    smeared, _ = picture(np.random.default_rng(5), GaussianPsf(1.6, 0.7, 0.4), name="smeared")
    empty = replace(pictures[0], name="empty", pixel_line=np.zeros((0, 2)))
    result = stack_psf([*pictures, smeared, empty], PRIOR)
    assert result.used_pictures.tolist() == [True, True, True, False, False]
    assert any("smeared: its stars are of another shape" in message for message in result.messages)
    assert any("empty: no bright star" in message for message in result.messages)


@pytest.mark.slow
def test_blends_and_hits_do_not_count():
    made, places = picture(np.random.default_rng(6), TRUE, n=100)
    image = made.signal_dn.copy()
    column, row = np.round(places[:5]).astype(int).T
    image[row + 2, column] += 3e4  # beside five stars
    clean = stack_psf([made], PRIOR)
    hit = stack_psf([replace(made, signal_dn=image)], PRIOR)
    center, first = np.zeros((1, 2)), np.full((1, 2), -4)
    assert hit.n_stars >= 90
    assert np.abs(hit.psf.box(center, first, 9) - clean.psf.box(center, first, 9)).max() < 0.01


@pytest.mark.slow
def test_few_stars_give_fewer_cells_and_say_so():
    made, _ = picture(np.random.default_rng(7), TRUE, n=30)
    result = stack_psf([made], PRIOR, oversampling=4)
    assert result.psf.oversampling == 2
    assert "fill 2 cells a pixel, 4 were wanted" in result.messages[-1]
    with pytest.raises(CameraError, match="9 bright stars cannot fill"):
        stack_psf([picture(np.random.default_rng(8), TRUE, n=9)[0]], PRIOR)


@pytest.mark.slow
def test_same_frames_same_psf():
    pictures = [picture(np.random.default_rng(9), TRUE, n=20, size=128)[0]]
    first, second = (stack_psf(pictures, PRIOR) for _ in range(2))
    assert first.psf.samples.tobytes() == second.psf.samples.tobytes()
