"""Values squeezed on board, and columns smeared in readout."""

import numpy as np
import pytest

from opnav_workbench.errors import ImageError
from opnav_workbench.image import KeywordMap, column_level, sky_and_bodies
from opnav_workbench.image.header import Header
from opnav_workbench.image.planes import expanded
from opnav_workbench.image.readout_smear import readout_smear
from opnav_workbench.mission import load_mission

KEYWORDS = KeywordMap(expansion_keyword="HOW", expansion={"TABLE": [0.0, 1.0, 4.0, 9.0]})


def test_table_turns_stored_values_into_dn():
    stored = np.array([[0.0, 3.0], [np.nan, 2.0]])
    image, remarks = expanded("a.img", stored, Header({"HOW": "TABLE"}), KEYWORDS)
    np.testing.assert_array_equal(image, [[0.0, 9.0], [np.nan, 4.0]])
    assert "expanded from 4 steps to 9 DN" in remarks[0]


@pytest.mark.parametrize("header", [{}, {"HOW": "NONE"}, {"HOW": "12BIT"}])
def test_other_pictures_stay_as_they_are(header):
    stored = np.array([[700.5, 3.0]])
    image, remarks = expanded("a.img", stored, Header(header), KEYWORDS)
    assert image is stored
    assert remarks == ()


@pytest.mark.parametrize("value", [4.0, -1.0, 2.5])
def test_values_that_the_table_does_not_have(value):
    with pytest.raises(ImageError, match=r"a\.img: HOW is TABLE, whose table has values 0 to 3"):
        expanded("a.img", np.array([[value, 0.0]]), Header({"HOW": "TABLE"}), KEYWORDS)


def test_the_cassini_table_is_a_smooth_root():
    """Steps grow with the value, as the photon noise does: 12 bits in 8, from the calibration report."""
    table = np.array(load_mission("cassini").keywords["expansion"]["TABLE"], float)
    assert (len(table), table[0], table[-1]) == (256, 1.0, 4095.0)
    steps = np.diff(table)
    assert steps.min() > 0.0
    assert np.all(np.abs(np.diff(steps)) <= 2.0)
    np.testing.assert_allclose(np.gradient(np.sqrt(table + 60.0))[30:-1], 0.22, atol=0.03)


def test_smear_is_taken_from_the_lines_without_the_body():
    rng = np.random.default_rng(1)
    smear = 50.0 + 100.0 * np.exp(-((np.arange(60) - 30.0) ** 2) / 50.0)
    picture = smear + rng.normal(0.0, 1.0, (200, 60))
    body = np.zeros((200, 60), bool)
    body[80:130, 20:40] = True
    picture[body] += 2000.0
    np.testing.assert_allclose(column_level(picture, body)[0], smear, atol=0.5)
    np.testing.assert_allclose(column_level(picture)[0], smear, atol=1.0)  # the median alone nearly does it
    with pytest.raises(ImageError, match="no column"):
        column_level(picture, True)


N, NOISE_DN = 512, 3.0
FROM_CENTER = np.hypot(*(np.mgrid[:N, :N] - np.array([260.0, 250.0])[:, None, None]))


def lit_disk(radius_px):
    """A disk whose one side is three times as bright as the other."""
    across = np.linspace(0.5, 1.5, N)
    return 1000.0 * across * np.clip(radius_px - FROM_CENTER + 0.5, 0.0, 1.0)


def noisy(light, seed=4):
    rng = np.random.default_rng(seed)
    return rng.poisson(20.0 * light) / 20.0 + rng.normal(0.0, NOISE_DN, light.shape)


def sky_of(picture):
    none = np.zeros(picture.shape, dtype=bool)
    return sky_and_bodies(picture, none, none, radius_px=4.0, psf_sigma_px=0.8)


@pytest.mark.parametrize(
    ("radius", "behind_only"),
    [(15.0, False), (60.0, False), (180.0, False), (15.0, True), (60.0, True)],
)
def test_what_a_body_leaves_along_its_columns_is_sky(radius, behind_only):
    """By the clearing and the reading as much, or by the reading alone; under the body too."""
    body = lit_disk(radius)
    through = 4e-4 * (np.cumsum(body, axis=0) if behind_only else body.sum(axis=0) + 0.0 * body)
    background, extended = sky_of(noisy(body + through + 20.0))
    off = np.abs(background.level_dn - through - 20.0)
    assert through.max() > 3.0 * NOISE_DN
    assert off[~extended].mean() < 0.1 * NOISE_DN
    assert off[~extended].max() < NOISE_DN
    assert np.median(off[body > 100.0]) < 0.5 * NOISE_DN
    assert not extended[:, FROM_CENTER.min(axis=0) > radius + 20.0].any()
    assert not extended[FROM_CENTER.min(axis=1) > radius + 20.0].any()  # nor the columns above and below


@pytest.mark.parametrize("radius", [15.0, 60.0])
@pytest.mark.parametrize(
    "stray",
    [
        lambda _: 0.0 * FROM_CENTER,
        lambda radius: 50.0 * np.minimum(1.0, radius / np.maximum(FROM_CENTER, 1.0)),  # a coma
        lambda radius: 50.0 * np.exp(-(np.maximum(FROM_CENTER - radius, 0.0) / 100.0)),
        lambda _: np.linspace(0.0, 50.0, N) + 0.0 * FROM_CENTER,
        lambda _: np.where(np.arange(N) > 255, 15.0, 0.0) + 0.0 * FROM_CENTER,  # halves of a detector
    ],
    ids=["none", "coma", "halo", "slope", "jump"],
)
def test_other_light_about_a_body_is_no_smear(radius, stray):
    picture = noisy(lit_disk(radius) + stray(radius) + 20.0)
    assert readout_smear(picture, np.zeros(picture.shape, dtype=bool), NOISE_DN) is None


def test_a_body_that_leaves_no_lines_to_read_smear_from_has_none():
    picture = noisy(lit_disk(400.0) + 20.0)
    assert readout_smear(picture, np.zeros(picture.shape, dtype=bool), NOISE_DN) is None
    empty = np.full((64, 64), np.nan)
    assert readout_smear(empty, np.isnan(empty), NOISE_DN) is None
