"""Pixels in squares where a disk's light is smooth: none is lost, and the light of a square is the mean of its pixels'."""

import numpy as np
import pytest

from opnav_workbench.bodies.disk.blocks import PixelSquares, limb_samples
from opnav_workbench.bodies.disk.hidden_albedo import ArcHats
from opnav_workbench.bodies.disk.limb_cells import limb_pixels, limb_places, square_corners
from opnav_workbench.bodies.disk.limb_light import limb_light
from opnav_workbench.bodies.silhouette import Silhouette
from opnav_workbench.bodies.subarray import Cutout

INWARD_PX, OUTWARD_PX, SHARP_PX = 36.0, 9.0, 3.2
CENTER = np.array([500.3, 431.8])


@pytest.fixture(scope="module")
def disk(body_stage):
    model = body_stage.body(400.0, 60.0, CENTER)
    light = body_stage.light(model)
    picture = body_stage.picture(light, [model], np.random.default_rng(1))
    return picture, Silhouette(picture, "BODY").at(CENTER), light


def pixels_of(data, use=None):
    use = np.ones(data.shape, dtype=bool) if use is None else use
    window = (0, 0, *data.shape[::-1])
    return Cutout(window, data, np.full(data.shape, 2.0), use, np.zeros(data.shape, dtype=bool), 20.0)


def test_every_usable_pixel_counts_once(disk):
    _, outline, _ = disk
    rng = np.random.default_rng(2)
    data = rng.normal(size=(1022, 1019)) + 7.0  # no multiple of a square's side
    use = rng.random(data.shape) > 0.001
    data[~use] = np.nan
    pixels = pixels_of(data, use)
    samples = limb_samples(PixelSquares(pixels, outline, 30.0), outline, INWARD_PX, OUTWARD_PX, SHARP_PX)
    assert set(samples.side) == {1.0, 2.0, 4.0, 8.0}
    seen = np.zeros(data.shape, dtype=int)
    for x, y, side, mean in zip(
        samples.places.pixel, samples.places.line, samples.side, samples.data_dn, strict=True
    ):
        half = 0.5 * (side - 1.0)
        square = np.s_[int(y - half) : int(y + half) + 1, int(x - half) : int(x + half) + 1]
        seen[square] += 1
        assert mean == pytest.approx(data[square].mean(), abs=1e-12)
    np.testing.assert_allclose(samples.variance_dn2, 4.0 / samples.side**2)
    assert seen.max() == 1
    assert not seen[~use].any()
    near = limb_pixels(outline, data.shape, INWARD_PX - 6.0, OUTWARD_PX - 2.0)
    assert np.array_equal(seen[near.index] == 1, use[near.index])
    assert len(samples.side) < 0.5 * np.count_nonzero(seen)


def test_the_light_of_a_square_is_that_of_its_pixels(disk):
    picture, outline, light = disk
    hats = ArcHats(np.linspace(0.0, 0.5, 5))
    reach = (INWARD_PX + 10.0, OUTWARD_PX + 4.0)
    tables = limb_light(picture, "BODY", outline, 1.0, reach, hats, np.zeros(2), np.zeros(5), fine=True)
    samples = limb_samples(
        PixelSquares(pixels_of(light), outline, 30.0), outline, INWARD_PX, OUTWARD_PX, SHARP_PX
    )
    places = samples.places
    corners = square_corners(outline, places, samples.spread_px)
    model = tables.over(places.angle_rad, places.depth_px, corners)[1][0]
    scale = float(model @ samples.data_dn / (model @ model))
    lit = model > 0.2 * model.max()
    for side in (2.0, 4.0, 8.0):
        of_side = lit & (samples.side == side)
        away = samples.data_dn[of_side] / (scale * model[of_side]) - 1.0
        assert abs(away.mean()) < 3e-4
        assert np.sqrt(np.mean(away**2)) < 1.5e-3
        middle = tables.at(places.angle_rad[of_side], places.depth_px[of_side], 1)[0]
        off = samples.data_dn[of_side] / (scale * middle) - 1.0
        assert abs(away.mean()) < abs(off.mean())
    whole = limb_places(outline, places.pixel, places.line)
    np.testing.assert_array_equal(whole.depth_px, places.depth_px)


@pytest.mark.parametrize(("diameter", "phase"), [(20.0, 80.0), (60.0, 110.0), (300.0, 60.0)])
def test_the_light_of_a_square_is_that_of_its_pixels_about_the_middle_and_on_the_terminator(
    body_stage, diameter, phase
):
    """There rays turn in a square, and light ends in it: with means over depths alone, disks of 20 px were 5 sigma off."""
    model = body_stage.body(diameter, phase, CENTER)
    light = body_stage.light(model)
    picture = body_stage.picture(light, [model], np.random.default_rng(1))
    outline = Silhouette(picture, "BODY").at(CENTER)
    inward = min(0.5 * diameter, INWARD_PX)
    hats = ArcHats(np.linspace(0.0, 0.5, 5))
    tables = limb_light(
        picture,
        "BODY",
        outline,
        1.0,
        (inward + 4.0, OUTWARD_PX + 4.0),
        hats,
        np.zeros(2),
        np.zeros(5),
        fine=True,
    )
    samples = limb_samples(
        PixelSquares(pixels_of(light), outline, 30.0), outline, inward, OUTWARD_PX, SHARP_PX
    )
    places, wide = samples.places, samples.side > 1.0
    corners = square_corners(outline, places, samples.spread_px)
    model = tables.over(places.angle_rad, places.depth_px, corners)[1][0]
    scale = float(model @ samples.data_dn / (model @ model))
    away = samples.data_dn - scale * model
    assert wide.any()
    assert np.abs(away[wide]).max() < 4e-3 * light.max()
    assert np.sqrt(np.mean(away[wide] ** 2)) < 1e-3 * light.max()
