"""Neighbors fitted together: centers and their errors of blended stars, and neighbors that are not there."""

import numpy as np
import pytest

from opnav_workbench.psf import GaussianPsf
from opnav_workbench.stars import NoiseModel, ShapePrior, StarFlag, fit_gaussian, fit_psf, flux_at_snr
from opnav_workbench.stars.picture_fit import MAX_GROUP_MEMBERS, groups_of, link_neighbors

NOISE_DN = 3.0
NOISE = NoiseModel(NOISE_DN, 15.0)
PAIRS, TILE = 300, 30
START_ERROR_PX = 1.0  # of the pattern; catalog positions relative to each other are far better


def pairs(star_mosaic, unit_gaussian, sigma, separation, ratio, snr, seed):
    """Image of pairs at random angles, true places and common starts (2 n, 2): bright ones first."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0.0, 2.0 * np.pi, PAIRS)
    offset = separation * np.column_stack([np.cos(angle), np.sin(angle)])
    flux = flux_at_snr(snr, GaussianPsf(sigma, sigma), NOISE_DN, box_px=13, noise_model=NOISE)

    def make(center, pixel, line):
        unit = unit_gaussian(sigma)
        return flux * (unit(center, pixel, line) + ratio * unit(center + offset, pixel, line))

    clean, bright = star_mosaic(PAIRS, TILE, make, rng)
    image = rng.poisson(15.0 * clean) / 15.0 + rng.normal(0.0, NOISE_DN, clean.shape) + 20.0
    truth = np.vstack([bright, bright + offset])
    common = np.tile(rng.uniform(-START_ERROR_PX, START_ERROR_PX, (PAIRS, 2)), (2, 1))
    return image, truth, truth + common + rng.normal(0.0, 0.05, truth.shape)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sigma", "separation", "ratio", "snr"), [(1.0, 2.0, 1.0, 50), (1.0, 1.5, 1.0, 100), (0.7, 2.5, 0.5, 40)]
)
def test_blended_stars_are_measured_as_well_as_they_say(
    star_mosaic, unit_gaussian, sigma, separation, ratio, snr
):
    image, truth, start = pairs(star_mosaic, unit_gaussian, sigma, separation, ratio, snr, 1)
    fit = fit_psf(image, NOISE_DN, None, start, GaussianPsf(sigma, sigma), noise_model=NOISE)
    assert np.mean(fit.usable) > 0.99
    error, own = (fit.pixel_line - truth)[fit.usable], fit.sigma_px[fit.usable]
    assert 0.9 < np.sqrt(np.mean((error / own) ** 2)) < 1.1
    assert np.abs(error.mean(axis=0)).max() < 3.0 * error.std() / np.sqrt(len(error))
    apart = fit_psf(
        image,
        NOISE_DN,
        None,
        truth,
        GaussianPsf(sigma, sigma),
        noise_model=NOISE,
        joint=False,
        mask_hits=False,
    )
    bright = np.arange(PAIRS)
    alone = np.median(np.hypot(*(apart.pixel_line - truth)[bright].T))
    assert np.median(np.hypot(*(fit.pixel_line - truth)[bright].T)) < 0.6 * alone


@pytest.mark.slow
def test_a_free_shape_is_shared_by_the_group(star_mosaic, unit_gaussian):
    image, truth, start = pairs(star_mosaic, unit_gaussian, 1.0, 2.5, 0.6, 60, 2)
    prior = ShapePrior.round_psf(1.1, 0.1, 0.05)
    fit = fit_gaussian(image, NOISE_DN, None, start, prior, noise_model=NOISE)
    np.testing.assert_array_equal(fit.shape[:PAIRS], fit.shape[PAIRS:])
    assert np.mean(fit.usable) > 0.98
    assert np.median(np.hypot(*(fit.pixel_line - truth).T)) < 0.06
    assert np.all(fit.flags & StarFlag.BLENDED)
    np.testing.assert_allclose(np.median(fit.background_dn), 20.0, atol=0.5)


@pytest.mark.slow
def test_a_faint_neighbor_is_not_put_onto_the_bright_star(star_mosaic, unit_gaussian):
    image, truth, start = pairs(star_mosaic, unit_gaussian, 1.0, 3.0, 0.2, 60, 3)
    fit = fit_psf(image, NOISE_DN, None, start, GaussianPsf(1.0, 1.0), noise_model=NOISE)
    error = np.hypot(*(fit.pixel_line - truth).T)
    assert np.mean(error[PAIRS:] < 0.5) > 0.98
    np.testing.assert_allclose(np.median(fit.flux_dn[PAIRS:] / fit.flux_dn[:PAIRS]), 0.2, atol=0.02)


@pytest.mark.slow
def test_a_listed_neighbor_that_is_not_there_costs_next_to_nothing(star_mosaic, unit_gaussian):
    image, truth, _ = pairs(star_mosaic, unit_gaussian, 1.0, 3.0, 0.0, 30, 4)
    start = truth + np.tile(np.random.default_rng(5).uniform(-0.3, 0.3, (PAIRS, 2)), (2, 1))
    psf = GaussianPsf(1.0, 1.0)
    fit = fit_psf(image, NOISE_DN, None, start, psf, noise_model=NOISE)
    alone = fit_psf(image, NOISE_DN, None, start[:PAIRS], psf, noise_model=NOISE)
    assert np.mean(fit.usable[:PAIRS]) > 0.99
    assert np.mean(fit.usable[PAIRS:]) < 0.02
    # Once the missing one is out, the other is fitted as if alone.
    same = np.abs(fit.pixel_line[:PAIRS] - alone.pixel_line).max(axis=1) < 1e-3
    assert same.mean() > 0.98


def test_two_entries_for_one_star_do_not_spoil_it(star_mosaic, unit_gaussian):
    image, truth, _ = pairs(star_mosaic, unit_gaussian, 1.0, 3.0, 0.0, 50, 6)
    fit = fit_psf(
        image,
        NOISE_DN,
        None,
        np.vstack([truth[:50], truth[:50] + 0.05]),
        GaussianPsf(1.0, 1.0),
        noise_model=NOISE,
    )
    assert fit.usable.all()
    np.testing.assert_allclose(fit.pixel_line[:50], fit.pixel_line[50:], atol=1e-3)


def test_a_neighbor_off_the_detector_does_not_spoil_the_star(star_mosaic, unit_gaussian):
    clean, truth = star_mosaic(1, 40, unit_gaussian(1.0), np.random.default_rng(7))
    image = 2000.0 * clean[:, 18:]
    star = truth[0] - [18.0, 0.0]
    fit = fit_psf(image, 1.0, None, [star, [-2.0, star[1]]], GaussianPsf(1.0, 1.0))
    np.testing.assert_allclose(fit.pixel_line[0], star, atol=0.01)
    assert fit.usable.tolist() == [True, False]


# ---------------------------------------------------------------- groups


def test_links_are_chains_within_boxes_and_large_chains_are_cut():
    rng = np.random.default_rng(8)
    lone, chain = rng.uniform(1000.0, 9000.0, (50, 2)), np.column_stack([np.arange(30) * 4.0, np.zeros(30)])
    chain[:, 0] += np.cumsum(rng.uniform(0.0, 1.0, 30))
    labels = link_neighbors(np.vstack([lone, chain]), np.ones(80, bool), 6.0, 0.5)
    sizes = np.bincount(labels)
    assert sizes.sum() == 80
    assert sizes.max() <= MAX_GROUP_MEMBERS
    assert len(np.unique(labels[:50])) == 50
    assert len(np.unique(labels[50:])) < 15


def test_groups_hold_each_chosen_star_once():
    labels = np.array([0, 1, 0, 2, 1, 0, 3])
    chosen = np.array([True, True, True, True, True, True, False])
    groups = groups_of(labels, chosen)
    assert [g.shape for g in groups] == [(1, 1), (1, 2), (1, 3)]
    assert [sorted(g.ravel().tolist()) for g in groups] == [[3], [1, 4], [0, 2, 5]]
    assert groups_of(labels, np.zeros(7, bool)) == []
