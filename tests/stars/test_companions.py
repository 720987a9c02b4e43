"""Unlisted companions: what they make of a star's center, and stars that have none."""

import numpy as np
import pytest

from opnav_workbench.stars import NoiseModel, ShapePrior, StarFlag, fit_stars, with_companions

SIGMA, NOISE_DN = 0.8, 3.0
NOISE = NoiseModel(NOISE_DN, 15.0)
PRIOR = ShapePrior.round_psf(SIGMA, 0.2)
TILES, TILE = 100, 30


def lone_pictures(star_mosaic, unit_gaussian, apart_px, ratio, flux, seed):
    """Pictures of one star each, with an unlisted companion: images, and where the star is."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0.0, 2.0 * np.pi, TILES)
    offset = apart_px * np.column_stack([np.cos(angle), np.sin(angle)])

    def make(center, pixel, line):
        unit = unit_gaussian(SIGMA)
        return flux * (unit(center, pixel, line) + ratio * unit(center + offset, pixel, line))

    clean, truth = star_mosaic(TILES, TILE, make, rng)
    image = rng.poisson(15.0 * clean) / 15.0 + rng.normal(0.0, NOISE_DN, clean.shape) + 20.0
    start = truth + 0.5 * offset + rng.uniform(-0.3, 0.3, truth.shape)
    corner = np.floor(truth / TILE).astype(int) * TILE
    tiles = [image[y : y + TILE, x : x + TILE] for x, y in corner]
    return tiles, truth - corner, start - corner


def measured(image, start, known=PRIOR):
    """Centers before and after, with what is known of the PSF by other stars."""
    centers, psf = fit_stars(image, NOISE_DN, None, start[None], PRIOR, noise_model=NOISE)
    found = with_companions(
        image, NOISE_DN, None, centers, np.arange(1), np.array([10.0]), known, psf, noise_model=NOISE
    )
    return centers, found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("apart_px", "ratio", "known"), [(2.2, 1.0, PRIOR), (1.8, 0.6, ShapePrior.round_psf(SIGMA, 0.03, 0.03))]
)
def test_a_blend_says_what_it_does_not_know(star_mosaic, unit_gaussian, apart_px, ratio, known):
    tiles, truth, start = lone_pictures(star_mosaic, unit_gaussian, apart_px, ratio, 3000.0, 1)
    before, after = [], []
    for image, place, near in zip(tiles[:40], truth, start, strict=False):
        for found, told in zip(measured(image, near, known), (before, after), strict=True):
            error = found.pixel_line[0] - place
            told.append(float(error @ np.linalg.solve(found.covariance_px2[0], error)) / 2.0)
    assert np.mean(np.array(before) > 12.5) > 0.9  # between the two images, and sure
    assert np.mean(np.array(after) > 12.5) < 0.05
    assert np.sqrt(np.mean(after)) < 2.0


@pytest.mark.slow
def test_a_star_alone_stays_as_it_was_fitted(star_mosaic, unit_gaussian):
    tiles, _, start = lone_pictures(star_mosaic, unit_gaussian, 2.0, 0.0, 3000.0, 2)
    changed = 0
    for image, near in zip(tiles, start, strict=True):
        before, after = measured(image, near)
        pair = bool(after.flags[0] & int(StarFlag.PAIR))
        changed += pair
        assert pair or (after.pixel_line == before.pixel_line).all()
    assert changed <= 1


def test_brightness_tells_which_of_two_images_the_star_is(star_mosaic, unit_gaussian):
    tiles, truth, start = lone_pictures(star_mosaic, unit_gaussian, 2.2, 0.2, 6000.0, 3)
    mag = -2.5 * np.log10([6000.0])
    errors = []
    for image, place, near in zip(tiles[:20], truth, start, strict=False):
        centers, psf = fit_stars(image, NOISE_DN, None, near[None], PRIOR, noise_model=NOISE)
        found = with_companions(
            image,
            NOISE_DN,
            None,
            centers,
            np.arange(1),
            mag,
            PRIOR,
            psf,
            noise_model=NOISE,
            zero_point_mag=0.0,
        )
        assert found.flags[0] & int(StarFlag.PAIR)
        errors.append(np.hypot(*(found.pixel_line[0] - place)))
    assert np.median(errors) < 0.1
