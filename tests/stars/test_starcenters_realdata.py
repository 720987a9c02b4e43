"""Six LORRI 4x4 frames of 2020: star centers against a Gaia-fitted WCS, targets against their publication.

The WCS in each header was fitted to Gaia DR3; Tycho-2 positions (epoch J2000.0, no motions) through it are
off by the stars' motions of 20 years, some 0.07 px an axis. Published centers: Lauer et al. (2025),
"A Demonstration of Interstellar Navigation Using New Horizons", supplement.
"""

import warnings
from dataclasses import dataclass

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS, FITSFixedWarning

from opnav_workbench.stars import (
    NoiseModel,
    ShapePrior,
    StarCenters,
    correlate,
    detect,
    extract_template,
    fit_stars,
    gaussian_template,
    identify,
)

pytestmark = pytest.mark.realdata

CENTER = np.array([127.5, 127.5])
NOISE = NoiseModel(read_noise_dn=1.1, gain_e_per_dn=22.0)
PRIOR = ShapePrior.round_psf(0.4, 0.3, 0.2)
ZERO_POINT_1S_MAG = 18.97  # LORRI 4x4, V of 1 DN/s
RMS_LIMIT_PX = 0.12  # an axis, of the nine stars after shift and rotation
PROXIMA = ("0449855930", "0449855931", "0449855932")
# Target star: pixel, line, and their published sigmas.
PUBLISHED = {
    "0449855930": (144.738, 116.979, 0.152, 0.098),
    "0449855931": (144.004, 118.311, 0.129, 0.085),
    "0449855932": (143.109, 119.819, 0.105, 0.070),
    "0449933827": (125.102, 122.607, 0.138, 0.135),
    "0449933832": (124.873, 122.597, 0.113, 0.081),
    "0449933837": (125.028, 122.461, 0.079, 0.089),
}


@dataclass
class Frame:
    image: np.ndarray
    noise: float
    bad: np.ndarray
    stars: np.ndarray  # (n, 2) Tycho-2 stars through the WCS
    magnitude: np.ndarray
    exposure_s: float
    target: np.ndarray  # (2,)
    target_sigma: np.ndarray  # (2,)


def move(points, center, shift, twist):
    """Turn points about the center by a twist, positive from +pixel toward +line, then shift them."""
    c, s = np.cos(twist), np.sin(twist)
    return (points - center) @ np.array([[c, s], [-s, c]]) + center + shift


def unit(ra_deg, dec_deg):
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)


@pytest.fixture(scope="module")
def frames(data_dir):
    with np.load(data_dir / "stars" / "tycho2.npz") as table:
        ra, dec, magnitude = (table[name].astype(float) for name in ("ra_deg", "dec_deg", "mag"))
    directions = unit(ra, dec)
    return {met: read(data_dir, met, ra, dec, magnitude, directions) for met in PUBLISHED}


def read(data_dir, met, ra, dec, magnitude, directions):
    path = data_dir / "images" / "lorri_interstellar" / f"lor_{met}_0x633_pwcs2.fits"
    with fits.open(path) as hdus:
        header, image, quality = hdus[0].header.copy(), hdus[0].data.astype(float), hdus[2].data.astype(int)
    boresight = unit(header["SPCBRRA"], header["SPCBRDEC"])
    near = directions @ boresight > np.cos(np.radians(0.35))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FITSFixedWarning)
        stars = np.column_stack(WCS(header).all_world2pix(ra[near], dec[near], 0))
    on = np.all((stars > -0.5) & (stars < 255.5), axis=1)
    noise = 1.4826 * np.median(np.abs(image - np.median(image)))
    published = np.array(PUBLISHED[met])
    return Frame(
        image,
        noise,
        quality != 0,
        stars[on],
        magnitude[near][on],
        header["EXPTIME"],
        published[:2],
        published[2:],
    )


def fit(frame, start) -> StarCenters:
    return fit_stars(frame.image, frame.noise, frame.bad, start, PRIOR, noise_model=NOISE)[0]


def after_shift_and_rotation(observed, predicted):
    """Residuals (n, 2) after a least-squares shift and rotation about the detector's center."""
    design = np.zeros((len(observed), 2, 3))
    design[:, 0, 0] = design[:, 1, 1] = 1.0
    design[:, 0, 2], design[:, 1, 2] = -(predicted - CENTER)[:, 1], (predicted - CENTER)[:, 0]
    residual = (observed - predicted).reshape(-1)
    solution, *_ = np.linalg.lstsq(design.reshape(-1, 3), residual, rcond=None)
    return (residual - design.reshape(-1, 3) @ solution).reshape(-1, 2)


@pytest.mark.slow(keep=["0449855931", "0449855932"])
@pytest.mark.parametrize("met", PROXIMA)
def test_nine_stars_agree_with_the_wcs(frames, met):
    frame = frames[met]
    assert len(frame.stars) == 9
    found = fit(frame, frame.stars)
    assert found.usable.all()
    residual = after_shift_and_rotation(found.pixel_line, frame.stars)
    rms = np.sqrt(np.mean(residual**2, axis=0))
    assert np.all(rms < RMS_LIMIT_PX), rms


def test_centers_repeat_from_frame_to_frame_within_their_sigmas(frames):
    # The stars' motions since J2000 are common to the three frames; what differs is the centerfinding.
    fits_ = [fit(frames[met], frames[met].stars) for met in PROXIMA]
    residual = np.array(
        [after_shift_and_rotation(f.pixel_line, frames[m].stars) for f, m in zip(fits_, PROXIMA, strict=True)]
    )
    scatter = (residual - residual.mean(axis=0)).std(axis=(0, 1)) * np.sqrt(3.0 / 2.0)
    assert np.all(scatter < 0.05), scatter
    sigma = np.median([f.sigma_px for f in fits_], axis=(0, 1))
    assert np.all((scatter / sigma > 0.4) & (scatter / sigma < 2.5)), scatter / sigma


@pytest.mark.parametrize("met", PUBLISHED)
@pytest.mark.parametrize("offset", [(2.0, -2.0), (-2.0, -2.0)])
def test_target_star_agrees_with_its_publication_from_two_pixels_off(frames, met, offset):
    frame = frames[met]
    found = fit(frame, np.vstack([frame.stars, frame.target + offset]))
    assert found.usable[-1]
    assert found.snr[-1] > 100.0
    assert np.all(np.abs(found.pixel_line[-1] - frame.target) < 2.0 * frame.target_sigma)


@pytest.mark.parametrize("met", PROXIMA)
@pytest.mark.parametrize("shift", [(-10.5, -0.7), (38.0, 29.0)])
def test_proxima_field_is_identified_blind(frames, met, shift):
    frame = frames[met]
    found = detect(frame.image, frame.noise, frame.bad, sigma_px=0.35)
    predicted = move(frame.stars, CENTER, np.negative(shift), np.radians(0.17))
    result = identify(predicted, frame.magnitude, found, center_px=CENTER)
    moved = move(predicted, CENTER, result.shift_px, result.twist_rad)
    assert len(result.pairs) == 9
    assert result.confidence > 0.999
    assert np.abs(moved - frame.stars).max() < 0.5


@pytest.mark.parametrize("met", [met for met in PUBLISHED if met not in PROXIMA])
def test_the_single_star_of_the_wolf_field_is_found_but_not_for_sure(frames, met):
    frame = frames[met]
    assert len(frame.stars) == 1
    found = detect(frame.image, frame.noise, frame.bad, sigma_px=0.35)
    zero_point = ZERO_POINT_1S_MAG + 2.5 * np.log10(frame.exposure_s)
    result = identify(
        frame.stars - [8.7, 1.1], frame.magnitude, found, center_px=CENTER, zero_point_mag=zero_point
    )
    assert np.hypot(*(found.pixel_line[result.pairs[0, 1]] - frame.stars[0])) < 1.5
    assert 0.8 < result.confidence < 0.999


@pytest.mark.parametrize("method", ["matched_filter", "cross_correlation"])
def test_first_centers_of_real_stars_agree_with_least_squares(frames, method):
    frame = frames["0449855931"]
    final = fit(frame, frame.stars)
    template = (
        extract_template(frame.image, frame.bad, final.pixel_line[np.argmax(final.flux_dn)], 3.0)
        if method == "matched_filter"
        else gaussian_template(0.4, 7)
    )
    start = frame.stars + np.array([2.0, -3.0])
    first = correlate(
        frame.image, frame.noise, frame.bad, start, template, search_radius_px=6.0, method=method
    )
    assert first.usable.all()
    assert np.abs(first.pixel_line - final.pixel_line).max() < 0.5
