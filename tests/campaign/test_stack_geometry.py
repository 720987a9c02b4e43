"""Where pictures fall on the grid of a stack, and what resampling does to light and noise."""

from dataclasses import replace

import numpy as np
import pytest

from opnav_workbench.campaign.stacking import Grid, stack_pictures
from opnav_workbench.campaign.stacking.grid import cubic_rows, cubic_weights, resample, target_direction
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.geometry import apparent_direction, unit
from opnav_workbench.psf import GaussianPsf, add_sources


def grid_of(sky, follow="stars"):
    picture = sky.pictures[0]
    target = target_direction(picture) if follow == "target" else None
    return Grid(
        picture.camera, picture.camera_from_j2000, picture.observer_velocity_km_s, follow, target,
        np.zeros(2), (picture.camera.n_line, picture.camera.n_pixel),
    )  # fmt: skip


def test_stars_fall_where_each_camera_sees_them(make_sky):
    """Distorted camera, turned pictures, other velocities: against stars projected by each picture by itself."""
    sky = make_sky(3, twist=0.5)
    grid, rng = grid_of(sky), np.random.default_rng(0)
    look = sky.pictures[0].camera_from_j2000.T @ sky.pictures[0].camera.boresight
    stars = unit(look + rng.normal(0.0, 1.5e-4, (50, 3)))  # some ten pixels
    for i, one in enumerate(sky.pictures):
        picture = one.replace(observer_velocity_km_s=np.array([30.0 * i, -12.0, 5.0]))

        def seen(picture):
            apparent = apparent_direction(stars, picture.observer_velocity_km_s)
            return picture.camera.project(apparent @ picture.camera_from_j2000.T)

        here, there = seen(sky.pictures[0]), seen(picture)
        assert np.abs(grid.to_picture(here, picture) - there).max() < 1e-6
        assert np.abs(grid.from_picture(there, picture) - here).max() < 1e-6
        assert np.abs(here - there).max() > (0.5 if i else -1.0)
        step = 0.01
        slope = np.stack(
            [
                (grid.to_picture(here + step * axis, picture) - grid.to_picture(here - step * axis, picture))
                / (2.0 * step)
                for axis in np.eye(2)
            ],
            axis=2,
        )
        assert np.abs(grid.jacobian(here, picture) - slope).max() < 2e-4


def test_the_target_stands_still(make_sky):
    """A grid that follows the target sees it, and any offset from ephemeris, at one place in all pictures."""
    sky = make_sky(4, motion_px=5.0, offset_px=(0.6, -0.4), flux=1.0)
    stacked = stack_pictures(sky.pictures, "target", window_px=20, reject_hits=False)
    truth = sky.target(stacked)
    for picture, light in zip(sky.pictures, sky.light, strict=True):
        place = stacked.grid.to_picture(truth[None], picture)[0]
        line, pixel = np.indices(light.shape)
        centroid = [float((light * pixel).sum() / light.sum()), float((light * line).sum() / light.sum())]
        assert np.abs(place - centroid).max() < 0.02  # a centroid of pixels is as good as that for this PSF
        assert np.abs(stacked.grid.from_picture(place[None], picture)[0] - truth).max() < 1e-6
    assert np.abs(truth - stacked.predicted_px).max() > 0.3


def test_cubic_convolution_is_exact_for_parabolas():
    x = np.arange(12.0)
    parabola = 0.3 * x**2 - 2.0 * x + 5.0
    for place in (4.0, 4.25, 4.5, 4.99, 5.7):
        base = int(place)
        value = cubic_weights(np.array(place - base)) @ parabola[base - 1 : base + 3]
        assert value == pytest.approx(0.3 * place**2 - 2.0 * place + 5.0, abs=1e-12)
    fractions = np.linspace(0.0, 1.0, 101)
    assert np.abs(cubic_weights(fractions).sum(axis=1) - 1.0).max() < 1e-14


def test_light_and_level_are_conserved(make_sky):
    """Stars at 60 phases of two turned pictures: each flux to a percent, the mean to a thousandth; a level stays."""
    sky = make_sky(2, size=64, twist=0.4, seed=3)
    grid, rng = grid_of(sky), np.random.default_rng(1)
    picture, ratios = sky.pictures[1], []
    for _ in range(60):
        image = np.zeros((64, 64))
        add_sources(image, GaussianPsf(0.7, 0.7), rng.uniform(28.0, 36.0, (1, 2)), [1.0])
        ratios.append(np.nansum(resample(grid, picture.replace(signal_dn=image), 1.0)[0]))
    assert np.abs(np.array(ratios) - 1.0).max() < 0.01
    assert np.mean(ratios) == pytest.approx(1.0, abs=1e-3)
    level, variance = resample(grid, picture.replace(signal_dn=np.full((64, 64), 7.0)), 1.0)
    assert (
        np.nanmax(np.abs(level - 7.0)) < 7.0 * 1e-4
    )  # pixels are as large here as there, but for distortion
    assert np.nanmax(variance) <= picture.noise_dn[0, 0] ** 2 * (1.0 + 1e-3)
    assert np.nanmin(variance) > 0.25 * picture.noise_dn[0, 0] ** 2


def test_a_picture_on_its_own_grid_is_itself(make_sky):
    sky = make_sky(2, flux=100.0)
    image, variance = resample(grid_of(sky), sky.pictures[0].replace(signal_dn=sky.light[0]), 1.0)
    known = np.isfinite(image)
    assert known.sum() >= 32**2  # the four pixels about each must be there
    assert np.abs(image - sky.light[0])[known].max() < 1e-8
    assert np.abs(variance[known] - 4.0).max() < 1e-8


def test_bad_pixels_spoil_no_neighbour(make_sky):
    bad = np.zeros((10, 10), dtype=bool)
    bad[5, 5] = True
    places = np.array([[5.0, 5.0], [4.0, 5.0], [4.5, 5.0], [4.5, 2.5], [0.5, 5.0], [np.nan, 1.0]])
    rows = cubic_rows(places, np.ones(6), bad)
    assert rows.usable.tolist() == [False, True, False, True, False, False]
    assert rows.matrix[1].toarray().sum() == 1.0


@pytest.mark.slow(keep=["False"])
@pytest.mark.parametrize("subtract", [False, True])
def test_the_stack_is_the_linear_map_that_it_says(make_sky, exposed, subtract):
    """The operators make the same stack, and the covariance is that of many noisy stacks."""
    sky = make_sky(
        5, size=64, motion_px=6.0, stars=20 if subtract else 0, exposures=[10.0, 5.0, 10.0, 20.0, 10.0]
    )
    rng = np.random.default_rng(2)
    stacked = stack_pictures(exposed(sky, rng), "target", window_px=16, reject_hits=False, subtract=subtract)
    points = stacked.grid.centers()[16 * 6 + 5 :][:40]
    known = (stacked.count[tuple((points - stacked.grid.first).astype(int).T[::-1])]) == 5
    points = points[known]
    operators = stacked.operators(points)
    parts = [
        m @ f.signal_dn.ravel() for m, f in zip(operators, exposed_pictures(stacked, subtract), strict=True)
    ]
    image = stacked.image_dn[tuple((points - stacked.grid.first).astype(int).T[::-1])]
    level = image - np.sum(parts, axis=0)
    assert np.ptp(level) < (0.2 if subtract else 1e-9)  # the levels that were matched are not part of the map
    covariance = stacked.covariance_dn2(points)
    draws = np.zeros((1500, len(points)))
    for operator, picture in zip(operators, stacked.before_subtraction, strict=True):
        draws += rng.normal(size=(1500, picture.bad.size)) * picture.noise_dn.ravel() @ operator.T
    assert np.std(draws, axis=0) == pytest.approx(
        np.sqrt(np.diag(covariance)), rel=0.1
    )  # 1500 draws: 2 %, of 40
    near = np.cov(draws.T)[np.arange(len(points) - 1), np.arange(1, len(points))]
    assert near == pytest.approx(np.diag(covariance, 1), abs=0.12 * covariance.max())


def exposed_pictures(stacked, subtract):
    """The pictures that the operators act on: those before subtraction."""
    return stacked.before_subtraction if subtract else stacked.pictures


def test_what_cannot_be_stacked_is_one_line(make_sky):
    sky = make_sky(4)
    pictures = sky.pictures
    without = pictures[0].replace(target=None)
    other = pictures[1].replace(camera=replace(pictures[1].camera, name="OTHER"))
    for given, options, words in (
        (pictures[:1], {}, "two pictures at least"),
        ([without, *pictures[1:]], {}, "no target to follow"),
        ([pictures[0], other], {}, "one camera at a time"),
        ([pictures[0].replace(exposure_s=0.0), *pictures], {}, "exposure of 0.0 s"),
        (pictures, {"follow": "stars", "subtract": True}, "only a stack that follows the target"),
        (pictures, {"subtract": True}, "must move by"),
        ([without, without], {"follow": "stars", "window_px": 16}, "needs a target"),
    ):
        with pytest.raises(CenterfindingError, match=words):
            stack_pictures(given, **options)
    with pytest.raises(CenterfindingError, match="differ in shape"):
        pictures[0].replace(bad=np.zeros((2, 2), dtype=bool))
