"""Undersampled pictures: the PSF beyond a Gaussian, learned from all stars, against images summed from fine samples.

The truth has shapes that the model does not: an obstructed aperture's rings, coma, a core with wings, pixels less
sensitive at their edges. Its bound is that of a PSF known exactly.
"""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates, spline_filter
from scipy.signal import fftconvolve
from scipy.special import j1

from opnav_workbench.calibration import TeachingPicture, learn_effective_psf
from opnav_workbench.errors import CameraError
from opnav_workbench.psf import EffectivePsf, PsfEvidence
from opnav_workbench.psf.correction import PRIOR_AMPLITUDES, PsfCorrection, mode_layers
from opnav_workbench.stars import ExpectedPlaces, NoiseModel, ShapePrior, fit_stars
from opnav_workbench.stars.effective_psf import prior_correction

FINE, HALF = 40, 8  # samples a pixel; pixels on each side
READ_NOISE_DN, GAIN = 1.1, 22.0
NOISE = NoiseModel(READ_NOISE_DN, GAIN)
BOX, SIDE = 9, 256


def gaussian(x, y, sigma):
    return np.exp(-0.5 * (x**2 + y**2) / sigma**2) / sigma**2


def wings(x, y, s):
    return 0.85 * gaussian(x, y, s) + 0.15 * gaussian(x, y, 2.5 * s)


def coma(x, y, s):
    return (
        gaussian(x, y, 0.9 * s)
        + 0.35 * gaussian(x - 0.9 * s, y - 0.5 * s, 1.2 * s)
        + 0.12 * gaussian(x - 2.0 * s, y - 1.2 * s, 1.5 * s)
    )


def disk(x, y, s):
    """Out of focus."""
    return 1.0 / (1.0 + np.exp((np.hypot(x, y) - 1.8 * s) / (0.1 * s)))


def obstructed(x, y, s, part=0.35):
    r = np.hypot(x, y) / (2.355 * s) * 1.03 * np.pi + 1e-9
    return ((2.0 * j1(r) / r - part * 2.0 * j1(part * r) / r) / (1.0 - part**2)) ** 2


def pixel_shares(density, sigma, edge_loss=0.0):
    """Share of the light in a pixel at every offset in steps of 1/FINE px, by summation of fine samples; for a spline."""
    at = np.arange(-HALF * FINE, HALF * FINE + 1) / FINE
    light = density(*np.meshgrid(at, at), sigma)
    u = np.arange(-FINE // 2, FINE // 2 + 1) / FINE
    response = 1.0 - edge_loss * 4.0 * u**2
    response[[0, -1]] *= 0.5  # trapezoids
    response *= FINE / response.sum()
    return spline_filter(fftconvolve(light / light.sum(), np.outer(response, response), mode="same"))


def corners(center):
    return np.rint(center).astype(int) - BOX // 2


def boxes_of(shares, center, first):
    pixel, line = ((first[:, a, None] + np.arange(BOX) - center[:, a, None] + HALF) * FINE for a in (0, 1))
    at = np.broadcast_arrays(line[:, :, None], pixel[:, None, :])
    return map_coordinates(shares, at, order=3, mode="constant", prefilter=False)


def bound(shares, center, flux):
    """Cramer-Rao bound (n, 2) with a known PSF; flux, center and level free; and the signal-to-noise ratio."""
    first, step = corners(center), 0.02
    value = boxes_of(shares, center, first)
    moved = [
        (boxes_of(shares, center + e, first) - boxes_of(shares, center - e, first)) / (2.0 * step)
        for e in step * np.eye(2)
    ]
    jacobian = np.stack([value, *(flux[:, None, None] * d for d in moved), np.ones_like(value)], 1)
    jacobian = jacobian.reshape(len(center), 4, -1)
    variance = READ_NOISE_DN**2 + np.maximum(flux[:, None, None] * value, 0.0).reshape(len(center), -1) / GAIN
    covariance = np.linalg.inv((jacobian / variance[:, None]) @ jacobian.transpose(0, 2, 1))
    return np.sqrt(np.stack([covariance[:, 1, 1], covariance[:, 2, 2]], 1)), flux / np.sqrt(
        covariance[:, 0, 0]
    )


def frame(shares, n, snr, rng):
    """Image of n isolated stars, their centers, their bound, and their signal-to-noise ratios."""
    side = int(np.ceil(np.sqrt(n)))
    cell = rng.permutation(side**2)[:n]
    spacing = SIDE / side
    free = np.array([spacing / 2.0 - BOX])
    center = (np.stack([cell % side, cell // side], 1) + 0.5) * spacing + rng.uniform(-free, free, (n, 2))
    wanted = np.exp(rng.uniform(*np.log(snr), n))
    flux = 4.0 * wanted
    for _ in range(6):
        flux *= wanted / bound(shares, center, flux)[1]
    image = np.zeros((SIDE, SIDE))
    first = corners(center)
    light = boxes_of(shares, center, first)
    for corner, star in zip(first, flux[:, None, None] * light, strict=True):
        image[corner[1] : corner[1] + BOX, corner[0] : corner[0] + BOX] += star
    image = rng.poisson(np.maximum(image, 0.0) * GAIN) / GAIN + rng.normal(0.0, READ_NOISE_DN, image.shape)
    return image, center, *bound(shares, center, flux)


def errors(shares, sigma, n, frames, snr, place_sigma=None, prior_off=1.1, kept=None):
    """Errors, own sigmas, bounds and SNR (4, m, 2) of all usable stars; a common shift of all frames is taken out.

    What a PSF's center is, is a convention. It is the same in all frames, and the stars tell it by their weights: a median
    of 40 stars, most of them faint, is worse known than a bright star's place.
    """
    rows = []
    for seed in range(frames):
        rng = np.random.default_rng([seed, n])
        image, center, least, ratio = frame(shares, n, snr, rng)
        places = None
        if place_sigma is not None:
            known = center + np.array([0.4, -0.3]) + rng.normal(0.0, place_sigma, center.shape)
            places = ExpectedPlaces(known, np.full(n, place_sigma))
        prior = ShapePrior.round_psf(prior_off * sigma)
        start = center + rng.uniform(-0.5, 0.5, center.shape)
        fit, _ = fit_stars(
            image, READ_NOISE_DN, None, start, prior, noise_model=NOISE, places=places, kept=kept
        )
        error = fit.pixel_line - center
        rows.append(np.stack([error, fit.sigma_px, least, np.column_stack([ratio, ratio])])[:, fit.usable])
    found = np.concatenate(rows, axis=1)
    found[0] -= np.average(found[0], axis=0, weights=found[2] ** -2.0)
    return found


def teaching_picture(shares, seed, place_sigma=0.02, n=40, snr=(8, 400)):
    """A picture of n stars of known places, for a calibration."""
    rng = np.random.default_rng([seed, n, 7])
    image, center, *_ = frame(shares, n, snr, rng)
    places = ExpectedPlaces(
        center + rng.normal(0.0, place_sigma, center.shape), np.full(len(center), place_sigma)
    )
    noise, none = np.full(image.shape, READ_NOISE_DN), np.zeros(image.shape, bool)
    start = center + rng.uniform(-0.5, 0.5, center.shape)
    return TeachingPicture(f"picture {seed}", image, noise, none, none, start, places, NOISE)


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.slow(keep=["obstructed"])
@pytest.mark.parametrize(
    ("density", "sigma", "frames"),
    [(obstructed, 0.35, 2), (coma, 0.5, 3), (wings, 0.35, 3)],
    ids=["obstructed", "coma", "wings"],
)
def test_undersampled_stars_of_any_shape_are_near_the_bound(density, sigma, frames):
    error, own, least, _ = errors(pixel_shares(density, sigma), sigma, 40, frames, (12, 60))
    assert rms(error / least) < 1.25  # a Gaussian: 2 to 5
    assert 0.8 < rms(error / own) < 1.2


@pytest.mark.slow
def test_pixels_less_sensitive_at_their_edges_are_learned():
    error, own, least, _ = errors(pixel_shares(gaussian, 0.35, edge_loss=0.25), 0.35, 40, 3, (20, 100))
    assert rms(error / least) < 1.4
    assert 0.75 < rms(error / own) < 1.2


@pytest.mark.slow
def test_where_the_catalog_has_the_stars_tells_what_no_picture_can():
    shares = pixel_shares(disk, 0.3)
    without, with_places = (
        errors(shares, 0.3, 40, 3, (30, 100), place_sigma=sigma) for sigma in (None, 0.01)
    )
    assert rms(with_places[0]) < 0.8 * rms(without[0])
    assert rms(with_places[0] / with_places[1]) < 1.4


@pytest.mark.parametrize(
    ("density", "sigma", "n"),
    [(coma, 0.25, 2), pytest.param(wings, 0.25, 4, marks=pytest.mark.slow)],
)
def test_sigmas_of_few_stars_hold_what_they_cannot_know_of_the_psf(density, sigma, n):
    error, own, least, _ = errors(pixel_shares(density, sigma), sigma, n, 24 // n, (60, 400))
    assert rms(error / least) > 3.0  # of a PSF known exactly: it matters here
    assert 0.4 < rms(error / own) < 1.7


@pytest.mark.slow
def test_a_gaussian_stays_at_the_bound():
    error, own, least, _ = errors(pixel_shares(gaussian, 0.4), 0.4, 40, 3, (12, 60))
    assert rms(error / least) < 1.15
    assert 0.8 < rms(error / own) < 1.15


@pytest.mark.slow
def test_double_stars_do_not_teach_the_psf():
    """One star in five has a bright neighbor in no catalog: what these leave over is nobody else's PSF."""
    shares, rng = pixel_shares(gaussian, 0.55), np.random.default_rng(11)
    image, center, least, _ = frame(shares, 60, (100, 400), rng)
    double = np.arange(60) < 12
    turn = rng.uniform(0.0, 2.0 * np.pi, 12)
    beside = center[double] + rng.uniform(2.3, 4.0, 12)[:, None] * np.stack([np.cos(turn), np.sin(turn)], 1)
    for corner, box in zip(corners(beside), boxes_of(shares, beside, corners(beside)), strict=True):
        image[corner[1] : corner[1] + BOX, corner[0] : corner[0] + BOX] += 3e4 * box
    fit, _ = fit_stars(image, READ_NOISE_DN, None, center, ShapePrior.round_psf(0.55), noise_model=NOISE)
    error = (fit.pixel_line - center)[~double]
    assert rms(error / least[~double]) < 1.3  # 13 where they do
    assert 0.8 < rms(error / fit.sigma_px[~double]) < 1.2


def test_derivatives_of_a_correction_are_those_of_its_shares():
    rng = np.random.default_rng(1)
    count = len(mode_layers())
    correction = PsfCorrection(0.3, rng.normal(size=count), np.zeros((count, 0)))
    center, first, step = rng.uniform(-0.5, 0.5, (5, 2)), np.full((5, 2), -4.0), 1e-5
    derivatives = correction.evaluate(center, first, 9)[1:]
    for moved, derivative in zip(step * np.eye(2), derivatives, strict=True):
        up, down = (correction.evaluate(center + s * moved, first, 9)[0] for s in (1.0, -1.0))
        np.testing.assert_allclose((up - down) / (2.0 * step), derivative, atol=1e-8)


def test_well_sampled_gaussians_are_fitted_as_ever():
    shares = pixel_shares(gaussian, 1.0)
    rng = np.random.default_rng(3)
    image, center, *_ = frame(shares, 16, (30, 100), rng)
    _, psf = fit_stars(image, READ_NOISE_DN, None, center, ShapePrior.round_psf(1.0), noise_model=NOISE)
    assert psf.correction is None


def test_what_was_taught_is_the_same_psf_when_it_is_taken_up_again():
    """Light and center that no star tells of the modes are a convention: other pictures must not scale or shift by it."""
    image, center, *_ = frame(pixel_shares(obstructed, 0.25), 40, (12, 400), np.random.default_rng(2))
    _, psf = fit_stars(image, READ_NOISE_DN, None, center, ShapePrior.round_psf(0.27), noise_model=NOISE)
    again = prior_correction(psf, BOX, psf.correction.evidence)
    places = np.random.default_rng(3).uniform(-0.5, 0.5, (20, 2)), np.full((20, 2), -4.0), BOX
    wrong = again.evaluate(*places)[0] - psf.correction.evaluate(*places)[0]
    assert rms(wrong.sum(axis=(1, 2))) < 0.02  # of a star's light; 2 without the convention
    assert np.abs(wrong).max() < 0.01


@pytest.mark.parametrize(("spread", "low", "high"), [(0.0, 0.0, 0.004), (0.03, 0.015, 0.03)])
def test_how_far_the_shapes_of_stars_differ_is_learned(spread, low, high):
    rng = np.random.default_rng(6)
    pictures = [
        frame(pixel_shares(gaussian, 0.4 * factor), 25, (100, 400), np.random.default_rng(8))
        for factor in (1.0 - spread, 1.0 + spread)
    ]
    (image, center, *_), (other, *_) = pictures
    right = np.arange(SIDE) >= SIDE // 2
    both = np.where(right, other, image)
    start = center + rng.uniform(-0.3, 0.3, center.shape)
    _, psf = fit_stars(both, READ_NOISE_DN, None, start, ShapePrior.round_psf(0.42), noise_model=NOISE)
    assert low <= psf.sigma_log_scale <= high


@pytest.fixture(scope="module")
def taught():
    """What six pictures of 40 stars teach of a camera with coma, and its shares."""
    shares = pixel_shares(coma, 0.3)
    pictures = [teaching_picture(shares, seed) for seed in range(6)]
    return shares, pictures, learn_effective_psf(pictures, ShapePrior.round_psf(0.33))


@pytest.mark.slow
def test_few_stars_are_near_the_bound_with_what_other_pictures_taught(taught):
    shares, _, kept = taught
    error, own, least, _ = errors(shares, 0.3, 4, 12, (12, 150), kept=kept)
    alone = errors(shares, 0.3, 4, 12, (12, 150))
    assert rms(error / least) < 1.25  # without: 3
    assert 0.75 < rms(error / own) < 1.15
    assert rms(error / least) < 0.6 * rms(alone[0] / alone[2])


@pytest.mark.slow
def test_the_psf_of_another_camera_is_not_taken(taught):
    """Where the stars contradict what was taught, they are fitted as without it."""
    shares = pixel_shares(gaussian, 0.55)
    error, *_ = errors(shares, 0.55, 20, 2, (30, 100), kept=taught[2])
    alone, *_ = errors(shares, 0.55, 20, 2, (30, 100))
    np.testing.assert_array_equal(error, alone)


@pytest.mark.slow
def test_what_was_taught_is_kept_in_a_file_and_no_picture_counts_twice(taught, tmp_path):
    _, pictures, kept = taught
    kept.save(tmp_path / "psf.npz")
    again = EffectivePsf.load(tmp_path / "psf.npz")
    np.testing.assert_array_equal(again.evidence.matrix, kept.evidence.matrix)
    assert (again.pictures, again.n_stars, again.scatter) == (kept.pictures, kept.n_stars, kept.scatter)
    same = learn_effective_psf(pictures[:2], ShapePrior.round_psf(0.33), again)
    np.testing.assert_array_equal(same.evidence.right, kept.evidence.right)
    more = learn_effective_psf(
        [*pictures[:2], teaching_picture(taught[0], 99)], ShapePrior.round_psf(0.33), again
    )
    assert more.pictures == (*kept.pictures, "picture 99")
    assert np.trace(more.evidence.matrix) > np.trace(kept.evidence.matrix)


def evidence_of(truth, count, scatter, rng):
    """Evidence of pictures whose modes scatter about one truth, each known to a twentieth of its prior."""
    prior = np.asarray(PRIOR_AMPLITUDES)[mode_layers()]
    matrix = np.diag((0.05 * prior) ** -2.0)
    told = {}
    for number in range(count):
        own = truth + scatter * prior * rng.normal(size=len(prior))
        seen = own + 0.05 * prior * rng.normal(size=len(prior))
        told[str(number)] = PsfEvidence(matrix, matrix @ seen), 10
    return told


@pytest.mark.parametrize("scatter", [0.0, 0.05, 0.2])
def test_how_far_pictures_differ_is_learned(scatter):
    rng = np.random.default_rng(4)
    truth = np.asarray(PRIOR_AMPLITUDES)[mode_layers()] * rng.normal(size=len(mode_layers()))
    found = EffectivePsf.of_pictures(-1.0, np.zeros(2), evidence_of(truth, 12, scatter, rng))
    assert found.scatter == pytest.approx(scatter, abs=0.02)
    known = found.for_a_picture()
    np.testing.assert_allclose(
        np.linalg.solve(known.matrix, known.right),
        np.linalg.solve(found.evidence.matrix, found.evidence.right),
    )
    assert np.trace(known.matrix) <= np.trace(found.evidence.matrix)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"no archive", "is no npz file"),
        (None, "cannot be read"),
        ({"samples": np.ones(3)}, "holds no effective PSF"),
        ({"layout": np.ones((4, 9))}, "of other modes"),
        ({"right": np.full(len(mode_layers()), np.nan)}, "is damaged"),
        ({"format_version": np.array(99)}, "99"),
    ],
)
def test_files_that_are_no_effective_psf(tmp_path, content, said):
    path = tmp_path / "psf.npz"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None and "samples" in content:
        np.savez(path, **content)
    elif content is not None:
        count = len(mode_layers())
        EffectivePsf(-1.0, np.zeros(2), PsfEvidence(np.eye(count), np.zeros(count)), 0.0, ("a",), 3).save(
            path
        )
        with np.load(path) as file:
            whole = dict(file)
        np.savez(path, **(whole | content))
    with pytest.raises(CameraError, match=said):
        EffectivePsf.load(path)
