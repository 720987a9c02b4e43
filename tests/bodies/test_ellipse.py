"""The limb method against brute-force pictures: bias, error over sigma, range, rough shapes, and all that can befall."""

from dataclasses import replace

import numpy as np
import pytest

from opnav_workbench.bodies import BodyFlag, Circle, model_picture
from opnav_workbench.bodies.ellipse.centerfinder import find_ellipse
from opnav_workbench.bodies.silhouette import body_outline
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.render import LunarLambert, ShapeModel

SPHERE, TRIAXIAL = (1.0, 1.0, 1.0), (1.0, 0.8, 0.65)
BIAS_PX = 0.005
EMPTY = np.zeros((1024, 1024))


@pytest.mark.slow(keep=["5.0-0.0-axes0-32-True"])
@pytest.mark.parametrize(
    ("diameter", "phase", "axes", "rays", "solve_range"),
    [
        (5.0, 0.0, SPHERE, 32, True),
        (5.0, 90.0, TRIAXIAL, 48, False),
        (16.0, 60.0, TRIAXIAL, 32, True),
        (
            16.0,
            120.0,
            SPHERE,
            32,
            False,
        ),  # sized as well, sampling of 1/48 px moves a crescent this small by 0.01 px
        (60.0, 0.0, TRIAXIAL, 16, True),
        (60.0, 90.0, TRIAXIAL, 16, True),
    ],
)
def test_no_bias_against_brute_force(body_stage, diameter, phase, axes, rays, solve_range):
    """Limb-darkened disks of 16 to 48 rays a side of a pixel, without noise: what is left is sampling, of both."""
    true = np.array([511.27, 511.64])
    model = body_stage.body(diameter, phase, true, axes)
    half = int(diameter / 2 + 12)
    light = body_stage.brute_force(model, (511 - half, 511 - half, 2 * half + 2, 2 * half + 2), rays)
    picture = body_stage.picture(light, [model], offset_px=(3.2, -2.7))
    found = find_ellipse(picture, "BODY", solve_range=solve_range)
    assert found.status == "ok", found.messages
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=BIAS_PX)
    assert np.isfinite(found.range_km) == (solve_range and not found.flags & BodyFlag.SIZE_UNSOLVED)


@pytest.mark.slow
@pytest.mark.parametrize("sigma_px", [0.3, 1.5])
def test_no_bias_with_a_sharp_or_wide_psf(body_stage, sigma_px):
    stage, true = body_stage.with_psf(sigma_px), np.array([300.81, 640.33])
    model = stage.body(20.0, 70.0, true)
    light = stage.brute_force(model, (276, 616, 50, 50), 24)
    found = find_ellipse(stage.picture(light, [model], offset_px=(-4.4, 3.1)), "BODY", solve_range=False)
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=BIAS_PX)


def trials(stage, add_noise, diameter, phase, true, count, **options):
    """Pulls (count, 2) of the center and (count,) of the diameter with fresh noise on one brute-force picture."""
    model = stage.body(diameter, phase, true, TRIAXIAL)
    half = int(diameter / 2 + 10)
    light = stage.brute_force(model, (127 - half, 127 - half, 2 * half + 2, 2 * half + 2), 32)
    width = body_outline(stage.picture(light, [model]), "BODY").diameter_px
    rng, pulls, sizes, errors = np.random.default_rng(5), [], [], []
    for _ in range(count):
        data = add_noise(700.0 * light, rng)  # the brightest pixel has 110 sigma
        picture = stage.picture(light, [model], data=data, offset_px=rng.uniform(-2.0, 2.0, 2))
        found = find_ellipse(picture, "BODY", **options)
        errors.append(found.pixel_line - true)
        pulls.append(np.linalg.solve(np.linalg.cholesky(found.covariance_px2), errors[-1]))
        sizes.append((found.diameter_px - width) / found.diameter_sigma_px)
    return np.array(errors), np.array(pulls), np.array(sizes)


@pytest.mark.slow
def test_errors_are_what_the_covariance_says(binned_stage, add_noise, sample):
    true = np.array([127.31, 126.84])
    error, pull, size = trials(binned_stage, add_noise, 40.0, 60.0, true, sample.trials(40))
    assert np.sqrt(np.mean(pull**2)) == pytest.approx(1.0, abs=sample.within(0.25))  # 80 components
    assert np.sqrt(np.mean(size**2)) == pytest.approx(1.0, abs=sample.within(0.3))
    assert np.abs(error.mean(axis=0)).max() < sample.within(0.01)  # 3.5 sigma of the mean
    assert np.sqrt(np.mean(error**2)) < 0.03


@pytest.mark.slow
def test_errors_over_sigma_of_many_trials(binned_stage, add_noise):
    """0.9 to 1.1, as far as the 240 components of both bodies can tell (4.6 %), and those of each (6.5 %).

    500 trials gave 1.10 at 8 px.
    """
    pulls = []
    for diameter, phase in ((8.0, 40.0), (40.0, 100.0)):
        options = {"solve_range": diameter > 20.0}
        place = np.array([126.6, 127.9])
        error, pull, _ = trials(binned_stage, add_noise, diameter, phase, place, 60, **options)
        assert 0.78 < np.sqrt(np.mean(pull**2)) < 1.22
        assert np.abs(error.mean(axis=0)).max() < 0.006
        assert np.sqrt(np.mean(error**2)) < 0.03
        pulls.append(pull)
    assert 0.83 < np.sqrt(np.mean(np.square(pulls))) < 1.17


def test_range_from_the_apparent_size(body_stage):
    """The body stands 2 % farther than expected, and 5 px beside; a fixed range spoils the fit, and is said to."""
    true = np.array([600.4, 400.7])
    model = body_stage.body(150.0, 60.0, true, TRIAXIAL)
    far = replace(model, target=replace(model.target, position_km=1.02 * model.target.position_km))
    light = body_stage.light(far)
    picture = body_stage.picture(light, [model], offset_px=(4.0, -3.0))
    found = find_ellipse(picture, "BODY")
    assert found.range_km == pytest.approx(far.target.range_km, rel=3e-5)
    assert found.range_sigma_km < 3e-4 * found.range_km
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=BIAS_PX)
    np.testing.assert_allclose(found.detail.free.ratio, 1.0, atol=1e-3)
    fixed = find_ellipse(picture, "BODY", solve_range=False)
    assert fixed.detail.rough_px > 0.1
    assert np.sqrt(fixed.covariance_px2[0, 0]) > 20.0 * np.sqrt(found.noise_covariance_px2[0, 0])


@pytest.mark.slow(keep=["assumed0"])
@pytest.mark.parametrize("assumed", [(1.0, 0.86, 0.8), (0.94, 0.8, 0.8)])
def test_wrong_radii_are_told_from_the_free_ellipse(body_stage, assumed):
    true = np.array([500.0, 520.0])
    light = body_stage.light(body_stage.body(200.0, 5.0, true, (1.0, 0.8, 0.8)))
    model = body_stage.body(200.0, 5.0, true, assumed)
    found = find_ellipse(body_stage.picture(light, [model]), "BODY")
    assert found.status == "uncertain"
    assert "the radii or the pole of the ellipsoid are wrong" in " ".join(found.messages)
    assert found.detail.free.residual_rms_px < 0.02
    assert found.detail.rms_px > 0.5
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=0.1)


def test_local_albedo_does_not_move_the_limb(body_stage):
    """One side of the body half as bright as the other."""
    true = np.array([511.3, 511.8])
    model = body_stage.body(120.0, 40.0, true)
    light = body_stage.light(model)
    light[:, 500:] *= 0.5 + 0.5 / (1.0 + np.exp((np.arange(500, 1024) - 520.0) / 4.0))
    found = find_ellipse(body_stage.picture(light, [model], offset_px=(2.0, 1.0)), "BODY")
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=0.03)


@pytest.mark.slow
def test_hits_and_neighbours_are_rejected_with_reasons(body_stage, add_noise):
    true, rng = np.array([511.3, 511.8]), np.random.default_rng(2)
    model = body_stage.body(100.0, 40.0, true)
    light = body_stage.light(model)
    picture = body_stage.picture(light, [model], rng)
    points = find_ellipse(picture, "BODY").detail
    data = picture.signal_dn.copy()
    struck = points.points_px[points.status == "used"][[5, 20, 40]]
    for place in np.rint(struck + 1.0).astype(int):
        data[place[1], place[0]] += 3000.0
    found = find_ellipse(replace(picture, signal_dn=data), "BODY")
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=0.03)
    why = found.detail.reason[found.detail.status == "rejected"]
    assert len(why) >= 3
    assert all(why)
    assert set(found.detail.status) <= {"used", "not_chosen", "rejected"}
    assert np.all(found.detail.reason[found.detail.status == "used"] == "")


def test_limb_behind_another_body(body_stage):
    true = np.array([511.3, 511.8])
    model = body_stage.body(100.0, 40.0, true)
    moon = body_stage.body(40.0, 40.0, (470.0, 480.0), name="MOON", range_share=0.5)
    light = body_stage.light(model, moon)
    found = find_ellipse(body_stage.picture(light, [model, moon]), "BODY")
    assert found.flags & BodyFlag.OCCULTED
    assert "MOON stands there" in found.detail.reason
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=0.01)


@pytest.mark.slow
def test_covariance_holds_the_excess_of_the_stars(body_stage):
    model = body_stage.body(60.0, 40.0, (511.3, 511.8))
    picture = body_stage.picture(body_stage.light(model), [model])
    plain, more = (find_ellipse(p, "BODY") for p in (picture, replace(picture, excess_sigma_px=0.1)))
    np.testing.assert_allclose(more.covariance_px2 - plain.covariance_px2, 0.01 * np.eye(2), atol=1e-12)


def cube_of_craters():
    """A rough shape: an octahedron divided, its vertices moved in and out."""
    rng = np.random.default_rng(6)
    vertices = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    plates = np.array(
        [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    )
    for _ in range(4):
        corners = vertices[plates]
        middles = 0.5 * (corners + np.roll(corners, -1, axis=1))
        every = np.concatenate([vertices, middles.reshape(-1, 3)])
        vertices, index = np.unique(every.round(9), axis=0, return_inverse=True)
        old, new = index[: len(every) - 3 * len(plates)][plates], index[-3 * len(plates) :].reshape(-1, 3)
        plates = np.concatenate(
            [np.stack([old[:, k], new[:, k], new[:, k - 1]], axis=1) for k in range(3)] + [new]
        )
    vertices /= np.linalg.norm(vertices, axis=1)[:, None]
    bumps = rng.normal(size=(20, 3))
    bumps /= np.linalg.norm(bumps, axis=1)[:, None]
    height = (rng.normal(0.0, 0.05, 20) * np.exp((vertices @ bumps.T - 1.0) / 0.1)).sum(axis=1)
    return ShapeModel(vertices * (1.0 + height)[:, None] * [1000.0, 900.0, 700.0], plates)


@pytest.mark.slow
def test_silhouette_of_a_shape_model(body_stage, add_noise):
    true, rng = np.array([511.3, 511.8]), np.random.default_rng(2)
    model = body_stage.body(100.0, 60.0, true)
    target = replace(model.target, radii_km=None)
    shaped = replace(model, target=target, shape=cube_of_craters(), law=LunarLambert(0.5))
    picture = body_stage.picture(body_stage.light(shaped), [shaped], rng, offset_px=(3.0, -2.0))
    found = find_ellipse(picture, "BODY")
    assert found.status == "ok", found.messages
    assert found.detail.free is None
    error = found.pixel_line - true
    assert error @ np.linalg.solve(found.covariance_px2, error) < 14.0  # chi-squared, 1 in 1000
    np.testing.assert_allclose(error, 0.0, atol=0.03)
    # The ellipsoid of the same extent: the covariance knows that its limb is not that of the body.
    smooth = replace(shaped, shape=None, target=replace(target, radii_km=shaped.shape.radii_km))
    rough = find_ellipse(replace(picture, models=(smooth,)), "BODY")
    assert rough.detail.rough_px > 5.0 * np.median(rough.detail.sigma_px[rough.detail.status == "used"])
    assert rough.covariance_px2[0, 0] > 25.0 * found.covariance_px2[0, 0]


@pytest.fixture(scope="module")
def stood(body_stage):
    """A picture of a body of 120 px with noise, the body in it, and its place."""
    true, rng = np.array([511.8, 511.2]), np.random.default_rng(5)
    model = body_stage.body(120.0, 50.0, true, TRIAXIAL)
    return body_stage.picture(body_stage.light(model), [model], rng), model, true


@pytest.mark.parametrize("radius", [42.0, 78.0])
def test_circle_of_the_wrong_radius(stood, radius):
    picture, _, true = stood
    found = find_ellipse(picture, "BODY", circle=Circle(true + np.array([4.0, -3.0]), radius))
    assert (found.status, found.flags & BodyFlag.CIRCLE_MISFIT) == ("uncertain", BodyFlag.CIRCLE_MISFIT)
    assert "check the radii, the range or the circle" in " ".join(found.messages)
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=0.03)


@pytest.mark.parametrize("share", [0.7, 1.3])
def test_body_of_another_size_than_expected(stood, share):
    picture, model, true = stood
    other = replace(model, target=replace(model.target, radii_km=share * model.target.radii_km))
    found = find_ellipse(replace(picture, models=(other,)), "BODY")
    assert found.status == "uncertain"
    assert found.flags & BodyFlag.CIRCLE_MISFIT
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=0.03)
    assert found.range_km == pytest.approx(share * model.target.range_km, rel=2e-3)


def test_nothing_in_the_circle(stood):
    found = find_ellipse(stood[0], "BODY", circle=Circle([200.0, 300.0], 60.0))
    assert (found.status, found.pixel_line) == ("not_detected", None)
    assert "stands out of the sky within 30 px" in found.messages[0]


def test_all_saturated_and_core_saturated(stood):
    picture, _, true = stood
    bright = picture.signal_dn
    found = find_ellipse(replace(picture, saturated=bright > 0.02 * bright.max()), "BODY")
    assert (found.status, found.flags) == ("saturated", BodyFlag.OVEREXPOSED)
    assert "take a shorter exposure" in found.messages[0]
    core = find_ellipse(replace(picture, saturated=bright > 0.8 * bright.max()), "BODY")
    assert core.flags & BodyFlag.OVEREXPOSED
    np.testing.assert_allclose(core.pixel_line, true, rtol=0, atol=0.05)


@pytest.mark.slow(keep=["place0"])
@pytest.mark.parametrize("place", [(10.0, 500.0), (-15.0, 500.0), (500.0, 2.0)])
def test_cut_by_the_edge(body_stage, place):
    model = body_stage.body(120.0, 50.0, place)
    light = body_stage.light(model)
    found = find_ellipse(body_stage.picture(light, [model], np.random.default_rng(1)), "BODY")
    assert found.flags & BodyFlag.CUT_BY_EDGE
    error = found.pixel_line - place
    assert error @ np.linalg.solve(found.covariance_px2, error) < 14.0  # chi-squared, 1 in 1000
    assert "off the detector" in found.detail.reason


def test_off_the_detector_and_no_usable_pixels(stood, body_stage):
    away = body_stage.body(60.0, 50.0, (-300.0, 500.0))
    assert find_ellipse(body_stage.picture(EMPTY, [away]), "BODY").status == "off_detector"
    nothing = find_ellipse(replace(stood[0], bad=np.ones_like(stood[0].bad)), "BODY")
    assert (nothing.status, nothing.flags) == ("failed", BodyFlag.EMPTY)


def test_bodies_without_a_limb(body_stage):
    model = body_stage.body(2.0, 50.0, (500.0, 500.0))
    small = find_ellipse(body_stage.picture(EMPTY, [model]), "BODY")
    assert small.status == "failed"
    assert "2.0 px wide" in small.messages[0]
    point = replace(model, target=replace(model.target, radii_km=None), flux_e=1.0)
    assert "neither radii nor a shape" in find_ellipse(body_stage.picture(EMPTY, [point]), "BODY").messages[0]
    with pytest.raises(CenterfindingError, match="no model of 'EROS'"):
        find_ellipse(body_stage.picture(EMPTY, [model]), "EROS")


def test_pictures_of_the_solution_and_same_bits(stood):
    picture, _, _ = stood
    one, two = (find_ellipse(picture, "BODY") for _ in range(2))
    assert np.array_equal(one.pixel_line, two.pixel_line)
    assert np.array_equal(one.covariance_px2, two.covariance_px2)
    shown = one.pictures
    used = shown.mask
    assert shown.data_dn.shape == (shown.window[3], shown.window[2])
    residual = shown.difference_dn[used] / np.sqrt(9.0 + shown.model_dn[used] / 22.0)
    assert np.sqrt(np.mean(residual**2)) == pytest.approx(1.0, abs=0.05)
    again = model_picture(picture, shown.window, {"BODY": one.pixel_line}, range_scale=1.0)
    assert np.corrcoef(again.ravel(), shown.model_dn.ravel())[0, 1] > 0.99999
