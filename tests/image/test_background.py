"""The sky's level and noise against simulated pictures whose truth is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from opnav_workbench.errors import ImageError
from opnav_workbench.image import (
    Background,
    contained_bias_dn,
    darkest_sky,
    estimate_background,
    pixel_noise,
)

SIGMA = 2.0
SHAPES = [(1024, 1024), (256, 256), (128, 5024), (333, 517)]


def sky(shape, slope_sigma_px=0.0):
    line, pixel = np.mgrid[: shape[0], : shape[1]]
    return 50.0 + slope_sigma_px * SIGMA * (pixel - 0.6 * line)


def add_stars(image, rng, share):
    """Add Gaussian stars of 3 to 10^4 sigma total signal."""
    line, pixel = np.mgrid[-8:9, -8:9]
    for _ in range(round(share * image.size)):
        at = [int(rng.integers(8, n - 9)) for n in image.shape]
        dy, dx = rng.uniform(-0.5, 0.5, 2)
        star = np.exp(-((line - dy) ** 2 + (pixel - dx) ** 2) / (2.0 * 0.81)) / (2.0 * np.pi * 0.81)
        image[at[0] - 8 : at[0] + 9, at[1] - 8 : at[1] + 9] += SIGMA * 10.0 ** rng.uniform(0.5, 4.0) * star


def add_disk(image, rng, radius_px, brightness_dn, center):
    """Add a Lambert-like disk with its own shot noise; return where it is."""
    line, pixel = np.mgrid[: image.shape[0], : image.shape[1]]
    x, y = (pixel - center[0]) / radius_px, (line - center[1]) / radius_px
    inside = x**2 + y**2 < 1.0
    light = brightness_dn * np.clip(0.7 * x + 0.7 * np.sqrt(np.clip(1.0 - x**2 - y**2, 0.0, 1.0)), 0.0, 1.0)
    image += np.where(inside, light + rng.normal(size=image.shape) * np.sqrt(light / 20.0), 0.0)
    return inside


def check(background, truth, outside=np.s_[:]):
    """Bias of the level below 0.1 sigma, noise within 3 %, both well inside."""
    error = (background.level_dn - truth)[outside] / SIGMA
    assert abs(error.mean()) < 0.03
    assert np.sqrt((error**2).mean()) < 0.1
    assert abs(background.noise_dn[outside].mean() / SIGMA - 1.0) < 0.03


@pytest.mark.parametrize("shape", SHAPES)
def test_slope_and_stars(shape):
    rng = np.random.default_rng(1)
    truth = sky(shape, slope_sigma_px=0.02)
    image = truth + rng.normal(0.0, SIGMA, shape)
    add_stars(image, rng, share=0.0005)
    check(estimate_background(image), truth)


def test_crowded_field():
    rng = np.random.default_rng(2)
    truth = sky((512, 512))
    image = truth + rng.normal(0.0, SIGMA, truth.shape)
    add_stars(image, rng, share=0.003)  # half of all pixels lie within 8 px of a star
    background = estimate_background(image)
    assert abs((background.level_dn - truth).mean()) < 0.1 * SIGMA
    assert abs(background.noise_dn.mean() / SIGMA - 1.0) < 0.04


@pytest.mark.parametrize("brightness_dn", [5.0, 40.0, 2000.0])
@pytest.mark.parametrize("center", [(280.0, 250.0), (60.0, 400.0)])
def test_disk_over_a_third_of_the_picture(brightness_dn, center):
    rng = np.random.default_rng(3)
    truth = sky((512, 512), slope_sigma_px=0.005)
    image = truth + rng.normal(0.0, SIGMA, truth.shape)
    disk = add_disk(image, rng, 166.0, brightness_dn, center)
    background = estimate_background(image)
    error = (background.level_dn - truth) / SIGMA
    assert abs(error[~disk].mean()) < 0.1
    assert abs(background.noise_dn[~disk].mean() / SIGMA - 1.0) < 0.03
    if brightness_dn > 1000.0:
        assert abs(error[disk].mean()) < 0.2  # under a bright disk the sky's surface goes on


def test_steep_slope_is_not_noise():
    rng = np.random.default_rng(4)
    truth = sky((256, 256), slope_sigma_px=0.3)  # ten sigma across a tile
    check(estimate_background(truth + rng.normal(0.0, SIGMA, truth.shape)), truth)


def test_vignetting():
    rng = np.random.default_rng(5)
    line, pixel = np.mgrid[:512, :512] / 511.0 - 0.5
    truth = 100.0 - 60.0 * (line**2 + pixel**2)
    check(estimate_background(truth + rng.normal(0.0, SIGMA, truth.shape)), truth)


def test_noise_that_grows_across_the_picture():
    rng = np.random.default_rng(6)
    truth = np.broadcast_to(np.linspace(1.0, 3.0, 512), (512, 512))
    noise = estimate_background(rng.normal(0.0, truth)).noise_dn
    assert np.abs(noise / truth - 1.0).mean() < 0.03


def test_whole_numbers_of_a_quiet_sky():
    """A sigma of 0.4 DN lies below the step: the level keeps its fraction, the noise that of the rounding."""
    rng = np.random.default_rng(7)
    image = np.rint(rng.normal(10.3, 0.4, (256, 256)))
    background = estimate_background(image)
    assert background.level_dn.mean() == pytest.approx(10.3, abs=0.03)
    assert background.noise_dn.mean() == pytest.approx(image.std(), rel=0.05)


def test_masked_pixels_do_not_count():
    rng = np.random.default_rng(8)
    truth = sky((256, 256))
    image = truth + rng.normal(0.0, SIGMA, truth.shape)
    bad = np.zeros(truth.shape, bool)
    bad[:100], bad[rng.random(truth.shape) < 0.3] = True, True  # whole tiles, and a third of the others
    image[bad] = 1e6
    image[200, 200] = np.nan
    check(estimate_background(image, bad), truth)


def test_data_gap_does_not_pull_the_level():
    rng = np.random.default_rng(9)
    truth = sky((256, 256))
    image = truth + rng.normal(0.0, SIGMA, truth.shape)
    image[96:160] = 0.0
    background = estimate_background(image)
    assert abs((background.level_dn - truth)[:64].mean()) < 0.1 * SIGMA


@pytest.mark.parametrize("shape", [(3, 25), (1, 40), (17, 17), (48, 48), (16, 4096)])
def test_small_and_oblong_pictures(shape):
    rng = np.random.default_rng(10)
    background = estimate_background(50.0 + rng.normal(0.0, SIGMA, shape))
    tolerance = 6.0 * SIGMA / np.sqrt(np.prod(shape))
    assert abs(background.level_dn.mean() - 50.0) < tolerance
    assert background.level_dn.shape == background.noise_dn.shape == shape
    assert np.all((background.noise_dn > 0.5 * SIGMA) & (background.noise_dn < 2.0 * SIGMA))


def test_a_few_pixels_speak_for_the_picture():
    rng = np.random.default_rng(11)
    bad = np.ones((256, 256), bool)
    bad.ravel()[rng.choice(bad.size, 50, replace=False)] = False
    background = estimate_background(50.0 + rng.normal(0.0, SIGMA, bad.shape), bad)
    assert background.level_dn.mean() == pytest.approx(50.0, abs=1.5)
    assert background.noise_dn.mean() == pytest.approx(SIGMA, rel=0.5)


def test_picture_without_noise_keeps_weights_finite():
    image = np.zeros((128, 128))
    image[60:64, 60:64] = 0.25
    background = estimate_background(image)
    np.testing.assert_allclose(background.level_dn, 0.0, atol=1e-9)
    assert np.all(background.noise_dn > 0.0)


def test_same_picture_same_background():
    image = np.random.default_rng(12).normal(5.0, 1.0, (128, 128))
    first, second = estimate_background(image), estimate_background(image)
    np.testing.assert_array_equal(first.level_dn, second.level_dn)
    np.testing.assert_array_equal(first.noise_dn, second.noise_dn)
    assert not first.level_dn.flags.writeable


@settings(max_examples=25, deadline=None)
@given(scale=st.floats(1e-4, 1e4), offset=st.floats(-1e4, 1e4))
def test_linear_in_the_picture(scale, offset):
    image = np.random.default_rng(13).normal(0.0, 1.0, (96, 96))
    plain, scaled = estimate_background(image), estimate_background(scale * image + offset)
    tolerance = 1e-6 * scale + 1e-10 * abs(offset)
    np.testing.assert_allclose(scaled.level_dn, scale * plain.level_dn + offset, atol=tolerance)
    np.testing.assert_allclose(scaled.noise_dn, scale * plain.noise_dn, rtol=1e-5, atol=tolerance)


@pytest.mark.parametrize(
    ("image", "bad", "reason"),
    [
        (np.ones((8, 8)), np.ones((8, 8), bool), "all 64 pixels are masked"),
        (np.full((8, 8), np.nan), None, "all 64 pixels are masked"),
        (np.full((8, 8), 3.0), None, "hold the value 3"),
        (np.ones(8), None, "shape"),
        (np.ones((2, 8, 8)), None, "shape"),
        (np.ones((0, 8)), None, "shape"),
    ],
)
def test_no_background(image, bad, reason):
    with pytest.raises(ImageError, match=reason):
        estimate_background(image, bad)


class TestPixelNoise:
    SKY = Background(np.full((2, 3), 44.0), np.full((2, 3), 1.0))

    def test_model_is_a_floor_of_the_measurement(self):
        np.testing.assert_allclose(pixel_noise(self.SKY, 1.1, 22.0), np.sqrt(1.21 + 2.0), rtol=1e-12)
        np.testing.assert_array_equal(pixel_noise(self.SKY, 0.5, 1e4), 1.0)

    def test_unknown_camera_values_leave_the_measurement(self):
        np.testing.assert_array_equal(pixel_noise(self.SKY, None, float("nan")), 1.0)

    def test_bias_has_no_shot_noise(self):
        np.testing.assert_allclose(pixel_noise(self.SKY, 1.1, 22.0, bias_dn=44.0), 1.1, rtol=1e-12)

    @pytest.mark.parametrize(("sky_dn", "offset_dn"), [(3.0, 500.0), (40.0, 500.0), (3.0, 0.0), (520.0, 0.0)])
    def test_the_sky_tells_whether_the_bias_is_in_it(self, sky_dn, offset_dn):
        """A raw picture of a bias of 500 DN, one without it, and one of a sky as bright as the bias."""
        rng = np.random.default_rng(15)
        image = rng.poisson(sky_dn * 10.0, (256, 256)) / 10.0 + rng.normal(0.0, 2.0, (256, 256)) + offset_dn
        assert contained_bias_dn(estimate_background(image), 2.0, 10.0, 500.0) == offset_dn

    def test_signal_adds_its_shot_noise(self):
        signal = np.array([[0.0, 220.0, -5.0], [0.0, 0.0, 0.0]])
        noise = pixel_noise(self.SKY, None, 22.0, signal_dn=signal)
        np.testing.assert_allclose(noise[0], np.sqrt([2.0, 12.0, 2.0]), rtol=1e-12)

    def test_agrees_with_simulated_electrons(self):
        """Poisson sky and Gaussian read noise, digitized: model and measurement give the true scatter."""
        rng = np.random.default_rng(14)
        image = rng.poisson(23.0 * 22.0, (256, 256)) / 22.0 + rng.normal(0.0, 1.1, (256, 256))
        background = estimate_background(image)
        true = np.sqrt(1.1**2 + 23.0 / 22.0)
        assert background.noise_dn.mean() == pytest.approx(true, rel=0.02)
        assert pixel_noise(background, 1.1, 22.0).mean() == pytest.approx(true, rel=0.02)

    @pytest.mark.parametrize(("read", "gain"), [(-1.0, 1.0), (1.0, 0.0), (1.0, -2.0)])
    def test_impossible_camera(self, read, gain):
        with pytest.raises(ImageError, match="gain"):
            pixel_noise(self.SKY, read, gain)


class TestDarkestSky:
    """The sky about a body that fills most of a picture, coded in steps that hide its noise."""

    @pytest.mark.parametrize("step_dn", [3.0, 8.0])
    def test_a_sky_of_one_step_has_the_noise_of_rounding(self, step_dn):
        rng = np.random.default_rng(4)
        image = np.full((256, 256), 2000.0) + 40.0 * rng.standard_normal((256, 256))
        image[:64] = 22.0 + 0.2 * rng.standard_normal((64, 256))
        coded = step_dn * np.round(image / step_dn)
        level, noise = darkest_sky(coded, np.zeros(image.shape, dtype=bool), 1.0)
        assert abs(level - 22.0) <= step_dn
        # Of values anywhere in a step.
        assert noise == pytest.approx(step_dn / np.sqrt(12.0), rel=0.01)

    def test_a_sky_cut_at_zero(self):
        image = np.zeros((256, 256))
        image[64:] = 3.0 * np.random.default_rng(5).integers(1, 300, (192, 256))
        _, noise = darkest_sky(image, np.zeros(image.shape, dtype=bool), 1.0)
        assert noise == pytest.approx(3.0 / np.sqrt(12.0), rel=0.01)

    def test_a_sky_of_fine_steps_keeps_its_own_noise(self):
        image = np.full((256, 256), 2000.0)
        image[:64] = 0.01 * np.round(np.random.default_rng(6).normal(700.0, 200.0, (64, 256)))
        _, noise = darkest_sky(image, np.zeros(image.shape, dtype=bool), 3.0)
        assert noise == pytest.approx(2.0, rel=0.05)
