"""Speed of 2000 stars on a 1024 x 1024 picture as a ratio against one star at a time, measured in the same run."""

import numpy as np
import pytest

from opnav_workbench.psf import EmpiricalPsf, GaussianPsf, MoffatPsf, TrailedPsf, add_sources, covering_boxes

STARS, SIZE = 2000, 1024
PEER_STARS = 50  # the loop is timed on these and scaled
LEAST_GAIN = 2.0
PSFS = {
    "gaussian": GaussianPsf(0.7, 0.7),
    "elliptical": GaussianPsf(1.0, 0.7, 0.4),
    "moffat": MoffatPsf(2.0, 3.0),
    "empirical": EmpiricalPsf(GaussianPsf(0.9, 0.7).kernel(8), 8),
    "trailed": TrailedPsf(GaussianPsf(0.7, 0.7), np.linspace([-5.0, -3.0], [5.0, 3.0], 20), np.ones(20)),
}


@pytest.fixture(scope="module")
def field():
    rng = np.random.default_rng(2000)
    return rng.uniform(0.0, SIZE - 1.0, (STARS, 2)), rng.uniform(10.0, 1e5, STARS)


def one_by_one(psf, centers, fluxes):
    picture = np.zeros((SIZE, SIZE))
    for center, flux in zip(np.clip(centers, 60.0, SIZE - 60.0), fluxes, strict=True):
        first, size = covering_boxes(psf, center[None])
        pixel, line = first[0]
        picture[line : line + size, pixel : pixel + size] += psf.box(center[None], first, size)[0] * flux


@pytest.mark.parametrize("name", PSFS)
def test_two_thousand_stars(benchmark, fastest, field, name):
    psf, (centers, fluxes) = PSFS[name], field

    def draw():
        picture = np.zeros((SIZE, SIZE))
        add_sources(picture, psf, centers, fluxes)
        return picture

    picture = benchmark.pedantic(draw, rounds=1, warmup_rounds=0)
    assert picture.sum() == pytest.approx(fluxes.sum(), rel=0.02)  # a little falls off the edges

    (together, _), (part, _) = fastest(
        draw,
        lambda: one_by_one(psf, centers[:PEER_STARS], fluxes[:PEER_STARS]),
        enough=lambda together, part: part * STARS / PEER_STARS > LEAST_GAIN * together,
    )
    alone = part * STARS / PEER_STARS
    benchmark.extra_info |= {"seconds": together, "times_faster_than_one_by_one": alone / together}
    assert alone / together > LEAST_GAIN
