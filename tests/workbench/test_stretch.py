"""Stretches and limits against astropy's, and against what each must be."""

import numpy as np
import pytest
from astropy.visualization import AsinhStretch, LogStretch, SqrtStretch, ZScaleInterval

from opnav_workbench.workbench.stretch import COLORMAPS, LIMITS, STRETCHES, limits_of, shades


@pytest.fixture(scope="module")
def sky():
    rng = np.random.default_rng(3)
    image = rng.normal(100.0, 4.0, (256, 256))
    image[40:44, 60:64] = 5000.0
    return image


@pytest.mark.parametrize(
    ("name", "peer"), [("log", LogStretch(1000.0)), ("asinh", AsinhStretch(0.1)), ("sqrt", SqrtStretch())]
)
def test_stretches_are_those_of_ds9_and_astropy(name, peer):
    share = np.linspace(0.0, 1.0, 101)
    # astropy's log is log(1 + 1000 t)/log(1001): the same as here
    np.testing.assert_allclose(STRETCHES[name](share), peer(share, clip=False), atol=1e-12)


def test_every_limit_is_an_interval(sky):
    limits = limits_of(sky)
    assert set(limits) == set(LIMITS) - {"manual"}
    assert all(low < high for low, high in limits.values())
    assert limits["min-max"] == (sky.min(), sky.max())
    np.testing.assert_allclose(limits["99 %"], np.percentile(sky, (0.5, 99.5)))
    np.testing.assert_allclose(limits["zscale"], ZScaleInterval(n_samples=4000).get_limits(sky.ravel()))
    assert limits["sky"] == pytest.approx((100.0 - 6.0, 100.0 + 120.0), abs=2.0)  # -1.5 and +30 sigmas


def test_limits_of_a_body_reach_its_bright_pixels(sky):
    image = sky.copy()
    image[:128] += 3000.0
    assert limits_of(image)["sky"][1] > 3000.0


def test_limits_without_noise_or_without_pixels():
    flat = limits_of(np.full((8, 8), 7.0))
    assert flat["min-max"] == (6.5, 7.5)
    assert all(low < high for low, high in limits_of(np.full((8, 8), np.nan)).values())
    steps = np.zeros((64, 64))
    steps[::3, ::5] = 1.0  # noise below the digital step: most pixels share one value
    low, high = limits_of(steps)["sky"]
    assert low < 0.0
    assert high > 1.0


def test_unusable_pixels_do_not_choose_limits(sky):
    usable = np.ones(sky.shape, bool)
    usable[40:44, 60:64] = False
    assert limits_of(sky, usable)["min-max"][1] < 130.0


def test_contrast_and_bias():
    ramp = np.linspace(0.0, 1.0, 5)
    np.testing.assert_allclose(shades(ramp, 0, 1, "linear"), ramp)
    np.testing.assert_allclose(shades(ramp, 0, 1, "linear", contrast=2.0), [0, 0, 0.5, 1, 1])
    np.testing.assert_allclose(shades(ramp, 0, 1, "linear", bias=0.25), [0.25, 0.5, 0.75, 1, 1])


def test_colour_maps_are_256_colours_from_dark_to_bright():
    for name, colors in COLORMAPS.items():
        rgb = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in colors])
        assert rgb.shape == (256, 3), name
        assert rgb[-1].sum() > rgb[0].sum(), name
