"""What real pictures have and neither model nor trial: light that is not the body's, optics and detectors that fail.

Names in `DISTURBANCES` are those of ``python tests/bodies/disk_exam.py --disturbed NAME``. Light is disturbed before its
noise is drawn, data after it; the sky is then taken off as a session does.
"""

from dataclasses import replace

import numpy as np
from disk_truth import GAIN_E_PER_DN, READ_NOISE_DN, exposed, lorri, toward_place
from scipy.fft import dctn, idctn
from scipy.ndimage import gaussian_filter, gaussian_filter1d, rotate
from scipy.signal import fftconvolve

from opnav_workbench.bodies import body_outline
from opnav_workbench.image import sky_and_bodies
from opnav_workbench.image.background import pixel_noise

BIAS_DN = 100.0
SKY_SHARE = 0.05  # of the brightest parts: light that is left in the sky
EDGE_PX = 0.8  # of what is drawn here, before the pixels
SMALLEST_BODY_PX = 4.0
RIM_PX = np.array([2.0, 3.0, 4.0])


def disturbed(trial, name):
    """Return the picture of a trial, disturbed."""
    setup, rng = trial.setup, np.random.default_rng([trial.setup.seed, *name.encode()])
    disturb = DISTURBANCES[name]
    if disturb in OF_DATA:
        data, saturated = exposed(trial.light_dn, setup, rng)
        data = disturb(data, trial, rng)
    else:
        data, saturated = exposed(disturb(trial.light_dn.copy(), trial, rng), setup, rng)
    if disturb is level:  # left in the picture
        return replace(trial.picture, signal_dn=data, saturated=saturated)
    data = data + BIAS_DN
    sky, _ = sky_and_bodies(
        data, np.zeros_like(saturated), saturated, radius_px=SMALLEST_BODY_PX, psf_sigma_px=EDGE_PX
    )
    noise = pixel_noise(sky, READ_NOISE_DN, GAIN_E_PER_DN, bias_dn=BIAS_DN)
    return replace(trial.picture, signal_dn=data - sky.level_dn, noise_dn=noise, saturated=saturated)


# ---- Where things are.


def away_px(trial):
    """Pixels from the center (2, n_line, n_pixel), along pixel and line."""
    shape = trial.light_dn.shape
    return np.mgrid[: shape[0], : shape[1]][::-1] - trial.truth_px[:, None, None]


def _depth(trial):
    """Of pixels inside the true outline (n_line, n_pixel), their directions, and that outline."""
    (model,) = trial.picture.models
    target = model.target
    place = toward_place(lorri(), trial.truth_px) * np.linalg.norm(target.position_km)
    true = replace(target, position_km=place, radii_km=trial.body.axes_km)
    outline = body_outline(trial.picture.with_model(replace(model, target=true)), trial.name)
    away = away_px(trial)
    angle = np.arctan2(away[1], away[0])
    return outline.radius(angle.ravel()).reshape(angle.shape) - np.hypot(*away), angle, outline


def _disk(trial, center_px, radius_px, edge_px=EDGE_PX):
    away = np.hypot(*(away_px(trial) + (trial.truth_px - center_px)[:, None, None]))
    return gaussian_filter((away < radius_px).astype(float), edge_px)


def _beside(trial, share, rng):
    """A place at a share of the radius from the center, in any direction."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return trial.truth_px + share * 0.5 * trial.setup.diameter_px * np.array([np.cos(angle), np.sin(angle)])


# ---- Light.


def nothing(light, _trial, _rng):
    return light


def level(light, trial, _rng):
    """Light that nobody has taken off."""
    return light + SKY_SHARE * trial.setup.peak_dn


def gradient(light, trial, rng):
    """Stray light of a source beside the field, a polynomial of degree 2."""
    y, x = np.mgrid[-1.0 : 1.0 : 1j * light.shape[0], -1.0 : 1.0 : 1j * light.shape[1]]
    terms = np.tensordot(rng.normal(size=5), [x, y, x * x, x * y, y * y], axes=1)
    return light + 0.02 * trial.setup.peak_dn * (terms - terms.min()) / np.ptp(terms)


def clouds(light, _trial, rng):
    """A sky with structure of some 60 px, five times the noise."""
    structure = gaussian_filter(rng.standard_normal(light.shape), 25.0)
    return light + 5.0 * READ_NOISE_DN * (structure / structure.std() + 3.0)


def coma(light, trial, rng):
    """Dust about a nucleus: falls with the distance, brighter on one side."""
    away, radius = away_px(trial), 0.5 * trial.setup.diameter_px
    side = 1.0 + 0.5 * np.cos(np.arctan2(away[1], away[0]) - rng.uniform(0.0, 2.0 * np.pi))
    return light + SKY_SHARE * trial.setup.peak_dn * side * radius / np.maximum(np.hypot(*away), radius)


def haze(light, trial, _rng):
    """An atmosphere of 1.5 % of the radius in scale height, as bright as the limb below it."""
    depth, angle, outline = _depth(trial)
    around = np.linspace(-np.pi, np.pi, 721)
    at = [
        trial.truth_px[:, None] + (outline.radius(around) - within) * [np.cos(around), np.sin(around)]
        for within in RIM_PX
    ]
    pixel, line = np.clip(np.rint(at).astype(int), 0, light.shape[0] - 1).transpose(1, 0, 2)
    rim = gaussian_filter1d(light[line, pixel].mean(axis=0), 6.0, mode="wrap")
    height = max(0.0075 * outline.diameter_px, 0.3)
    air = 0.7 * np.interp(angle, around, rim) * np.exp(np.clip(depth / height, -60.0, 0.0))
    return light + gaussian_filter(np.where(depth < 0.0, air, 0.0), EDGE_PX)


def planetshine(light, trial, _rng):
    """The night side, and the day side as well, lit by a planet behind the camera."""
    depth, _, outline = _depth(trial)
    inside = 1.0 - np.clip(2.0 * depth / outline.diameter_px, 0.0, 1.0)
    shine = np.where(depth > 0.0, np.sqrt(1.0 - inside**2), 0.0)
    return light + gaussian_filter(0.03 * trial.setup.peak_dn * shine, EDGE_PX)


def moon(light, trial, rng):
    """An unknown body before it, dark or bright."""
    before = _disk(trial, _beside(trial, rng.uniform(0.2, 0.9), rng), 0.15 * trial.setup.diameter_px)
    return light * (1.0 - before) + before * trial.setup.peak_dn * rng.choice([0.0, 0.4])


def shadow(light, trial, rng):
    """That of another body over the limb, its edge a penumbra."""
    return light * (1.0 - _disk(trial, _beside(trial, 1.0, rng), 0.3 * trial.setup.diameter_px, 3.0))


def smear(light, _trial, rng):
    """2 to 6 px of motion that the PSF does not know."""
    line = np.zeros((15, 15))
    line[7] = np.clip(0.5 * rng.uniform(2.0, 6.0) + 0.5 - np.abs(np.arange(-7, 8)), 0.0, 1.0)
    kernel = np.maximum(rotate(line, rng.uniform(0.0, 180.0), reshape=False, order=1), 0.0)
    return np.maximum(fftconvolve(light, kernel / kernel.sum(), mode="same"), 0.0)


def defocus(light, _trial, _rng):
    return gaussian_filter(light, 2.0)


def streak(light, _trial, _rng):
    """What is read out without a shutter."""
    return light + 0.001 * light.sum(axis=0)


def ghost(light, _trial, rng):
    """A reflection between lenses."""
    return light + 0.02 * np.roll(gaussian_filter(light, 6.0), rng.integers(-80, 80, 2), axis=(0, 1))


def saturating(light, _trial, _rng):
    """A response that bends by 8 %."""
    return light * (1.0 - 0.08 * light / light.max())


# ---- Data.


def stripes(data, _trial, rng):
    """Lines with offsets of twice the noise."""
    return data + 2.0 * READ_NOISE_DN * rng.standard_normal((len(data), 1))


def jump(data, trial, rng):
    """Halves of the detector whose offsets differ by five times the noise, across the disk."""
    column = trial.truth_px[0] + rng.uniform(-0.6, 0.6) * trial.setup.diameter_px
    return data + 5.0 * READ_NOISE_DN * (np.arange(data.shape[1]) > column)


def dead(data, trial, rng):
    """5,000 hot pixels and two dead columns across the disk, which no mask names."""
    data[tuple(rng.integers(0, len(data), (2, 5000)))] += rng.exponential(0.5 * trial.setup.peak_dn, 5000)
    for away in rng.uniform(-0.5, 0.5, 2):
        data[:, int(np.clip(trial.truth_px[0] + away * trial.setup.diameter_px, 0, data.shape[1] - 1))] = 0.0
    return data


def lost_lines(data, trial, rng):
    """A packet of lines across the disk."""
    count = max(int(0.15 * trial.setup.diameter_px), 2)
    first = int(trial.truth_px[1] + rng.uniform(-0.5, 0.5) * trial.setup.diameter_px)
    data[max(first, 0) : max(first + count, 0)] = 0.0
    return data


def companded(data, trial, _rng):
    """Eight bits, by the root of the signal."""
    top = max(1.2 * trial.setup.peak_dn, data.max())
    return (np.rint(255.0 * np.sqrt(np.clip(data + 5.0, 0.0, None) / top)) / 255.0) ** 2 * top - 5.0


def compressed(data, trial, _rng):
    """Blocks of 8 x 8 whose finer waves are kept in coarser steps, as JPEG does."""
    n = len(data) // 8
    waves = dctn(data.reshape(n, 8, n, 8).transpose(0, 2, 1, 3), axes=(2, 3), norm="ortho")
    order = np.arange(8)
    step = 4.0 * READ_NOISE_DN * max(trial.setup.peak_dn / 1000.0, 0.3) * (1.0 + order[:, None] + order)
    step[0, 0] = READ_NOISE_DN
    kept = idctn(np.rint(waves / step) * step, axes=(2, 3), norm="ortho")
    return kept.transpose(0, 2, 1, 3).reshape(data.shape)


OF_DATA = (stripes, jump, dead, lost_lines, companded, compressed)
DISTURBANCES = {
    each.__name__: each
    for each in (
        nothing, level, gradient, clouds, coma, haze, planetshine, moon, shadow, smear, defocus, streak, ghost, saturating,
        *OF_DATA,
    )
}  # fmt: skip
