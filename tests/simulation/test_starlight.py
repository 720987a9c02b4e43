"""Stars and their trails: places by first moments, flux, and what falls off the detector."""

import numpy as np
import pytest

from opnav_workbench.errors import CameraError
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.simulation.picture import add_stars, trails

PSF = GaussianPsf(0.9, 0.6, 0.4)


def moments(picture, place, half=12):
    """Flux and first moments of a box: an estimate of a center that knows nothing of any PSF."""
    p, q = np.rint(place).astype(int)
    box = picture[q - half : q + half + 1, p - half : p + half + 1]
    line, pixel = np.mgrid[q - half : q + half + 1, p - half : p + half + 1]
    return box.sum(), np.array([(box * pixel).sum(), (box * line).sum()]) / box.sum()


def spread_out(n, rng):
    """Places too far apart to share light, at random sub-pixel phases."""
    grid = 30.0 * np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2) + 20.0
    return grid + rng.uniform(-0.5, 0.5, grid.shape)


def test_stars_stand_where_the_truth_says_and_keep_their_flux():
    rng = np.random.default_rng(1)
    places, flux = spread_out(10, rng), 10.0 ** rng.uniform(1.0, 6.0, 100)
    picture = np.zeros((330, 340))
    add_stars(picture, places, flux, PSF)
    for place, electrons in zip(places, flux, strict=True):
        total, center = moments(picture, place)
        assert total == pytest.approx(electrons, rel=1e-6)
        # First moments of whole pixels alias: exp(-2 pi^2 0.6^2) / pi = 3e-4 px. The truth is good to less than that.
        assert center == pytest.approx(place, abs=4e-4)


def test_it_adds_to_what_is_there_and_repeats_bit_for_bit():
    rng = np.random.default_rng(2)
    places, flux = rng.uniform(-5, 70, (200, 2)), rng.uniform(1, 100, 200)
    first, second = (np.full((64, 64), 3.0) for _ in range(2))
    add_stars(first, places, flux, PSF)
    add_stars(second, places, flux, PSF)
    assert np.array_equal(first, second)
    alone = np.zeros((64, 64))
    add_stars(alone, places, flux, PSF)
    assert first == pytest.approx(alone + 3.0, abs=1e-9)


def test_the_part_of_a_star_that_falls_on_the_detector_is_kept():
    """Half of a star on the edge, and the wing of one beyond it, from the error function."""
    from scipy.special import ndtr

    round_ = GaussianPsf(0.8, 0.8)
    for x in (-0.5, -1.5, -2.5, 0.25):
        picture = np.zeros((40, 40))
        add_stars(picture, [[x, 20.0]], [1000.0], round_)
        assert picture.sum() == pytest.approx(1000.0 * ndtr((x + 0.5) / 0.8), abs=2e-3)
    picture = np.zeros((40, 40))
    add_stars(picture, [[np.nan, np.nan], [-40.0, 3.0], [1e9, 1e9]], [1.0, 1.0, 1.0], round_)
    assert not picture.any()


def test_trail_has_the_length_and_the_center_of_its_path():
    step, k = np.array([0.2, 0.1]), 51
    places = np.array([60.3, 40.7]) + (np.arange(k) - k // 2)[:, None] * step
    picture = np.zeros((80, 120))
    add_stars(picture, places[None], [5000.0], PSF)
    total, center = moments(picture, places[k // 2], half=20)
    assert total == pytest.approx(5000.0, rel=1e-6)
    assert center == pytest.approx([60.3, 40.7], abs=1e-4)
    path = trails(places[None])
    assert path.length_px[0] == pytest.approx(k * np.hypot(0.2, 0.1))
    line, pixel = np.mgrid[:80, :120]
    along = (pixel - center[0]) * 2 / np.sqrt(5) + (line - center[1]) / np.sqrt(5)
    # A uniform line has L^2/12; the PSF and the pixel have what the same star at rest has.
    rest = np.zeros((80, 120))
    add_stars(rest, places[[k // 2]], [5000.0], PSF)
    spread = ((picture - rest) * along**2).sum() / 5000.0
    assert np.sqrt(12.0 * spread) == pytest.approx(path.length_px[0], rel=1e-3)


def test_uneven_times_move_the_mean_place():
    places = np.array([[[10.0, 10.0], [14.0, 10.0], [18.0, 10.0]], [[30.0, 8.0], [30.0, 9.0], [30.0, 10.0]]])
    weights = np.array([0.5, 0.25, 0.25])
    path = trails(places, weights)
    assert path.mean_px == pytest.approx(np.array([[13.0, 10.0], [30.0, 8.75]]))
    assert path.middle_px == pytest.approx(np.array([[14.0, 10.0], [30.0, 9.0]]))
    picture = np.zeros((30, 60))
    add_stars(picture, places[:1], [400.0], PSF, weights)
    assert moments(picture, [14.0, 12.0], half=11)[1] == pytest.approx([13.0, 10.0], abs=1e-4)


def test_a_still_star_has_no_length():
    assert trails([[1.0, 2.0]]).length_px.tolist() == [0.0]


@pytest.mark.parametrize(
    ("places", "flux", "weights", "words"),
    [
        ([[1.0, 2.0]], [1.0, 2.0], None, "1 places but fluxes"),
        ([[1.0, 2.0]], [np.nan], None, "1 stars with a flux"),
        ([[1.0, 2.0]], [-1.0], None, "negative"),
        ([1.0, 2.0], [1.0], None, r"places of shape \(2,\)"),
        ([[[1.0, 2.0], [1.0, 2.0]]], [1.0], [1.0], "2 places per star"),
    ],
)
def test_what_does_not_fit_is_refused(places, flux, weights, words):
    picture = np.zeros((10, 10))
    with pytest.raises(CameraError, match=words):
        add_stars(picture, places, flux, PSF, weights)
    assert not picture.any()
