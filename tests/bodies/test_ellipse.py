"""Limb points and the conic through them: bias, error over sigma, range, radii, rough shapes, and all that can befall."""

from dataclasses import replace

import numpy as np
import pytest

from opnav_workbench.bodies import BodyFlag, Circle
from opnav_workbench.bodies.ellipse import find_ellipse
from opnav_workbench.bodies.silhouette import body_outline
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.render import FigureUncertainty, LunarLambert, ShapeModel

SPHERE, TRIAXIAL = (1.0, 1.0, 1.0), (1.0, 0.8, 0.65)
BIAS_PX = 0.01  # what tables of light are good to
KNOWN = FigureUncertainty(2e-4, 2e-4, 2e-4, law_sigma=0.02)
EMPTY = np.zeros((1024, 1024))


def pulls(found, true):
    """Square of the error over its sigma, two degrees of freedom."""
    error = found.pixel_line - true
    return float(error @ np.linalg.solve(found.covariance_px2, error))


@pytest.mark.slow(keep=["5.0-0.0-axes0-32"])
@pytest.mark.parametrize(
    ("diameter", "phase", "axes", "rays"),
    [
        (5.0, 0.0, SPHERE, 32),
        (5.0, 90.0, TRIAXIAL, 48),
        (16.0, 60.0, TRIAXIAL, 32),
        (16.0, 120.0, SPHERE, 32),
        (60.0, 0.0, TRIAXIAL, 16),
        (60.0, 90.0, TRIAXIAL, 16),
    ],
)
def test_no_bias_against_brute_force(body_stage, diameter, phase, axes, rays):
    """Limb-darkened disks of 16 to 48 rays a side of a pixel, without noise; figure and law are stated, as they are."""
    true = np.array([511.27, 511.64])
    model = body_stage.body(diameter, phase, true, axes, figure=KNOWN)
    half = int(diameter / 2 + 12)
    light = body_stage.brute_force(model, (511 - half, 511 - half, 2 * half + 2, 2 * half + 2), rays)
    found = find_ellipse(body_stage.picture(light, [model], offset_px=(3.2, -2.7)), "BODY")
    assert found.status == "ok", found.messages
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=BIAS_PX)
    assert found.range_km == pytest.approx(
        model.target.range_km, rel=4.0 * found.range_sigma_km / found.range_km
    )


@pytest.mark.slow
@pytest.mark.parametrize("sigma_px", [0.3, 1.5])
def test_no_bias_with_a_sharp_or_wide_psf(body_stage, sigma_px):
    stage, true = body_stage.with_psf(sigma_px), np.array([300.81, 640.33])
    model = stage.body(20.0, 70.0, true, figure=KNOWN)
    light = stage.brute_force(model, (276, 616, 50, 50), 24)
    found = find_ellipse(stage.picture(light, [model], offset_px=(-4.4, 3.1)), "BODY")
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=BIAS_PX)


@pytest.mark.slow
@pytest.mark.parametrize(("diameter", "phase"), [(8.0, 40.0), (40.0, 100.0)])
def test_sigma_holds_noise_and_size(binned_stage, add_noise, sample, diameter, phase):
    """Errors stay within sigma, and below it: it holds an albedo of 1 % too, which these bodies do not have."""
    true = np.array([127.31, 126.84])
    model = binned_stage.body(diameter, phase, true, TRIAXIAL, figure=KNOWN)
    half = int(diameter / 2 + 10)
    light = binned_stage.brute_force(model, (127 - half, 127 - half, 2 * half + 2, 2 * half + 2), 32)
    width = body_outline(binned_stage.picture(light, [model]), "BODY").diameter_px
    rng, squares, sizes = np.random.default_rng(5), [], []
    for _ in range(sample.trials(12)):
        data = add_noise(700.0 * light, rng)  # the brightest pixel has 110 sigma
        picture = binned_stage.picture(light, [model], data=data, offset_px=rng.uniform(-2.0, 2.0, 2))
        found = find_ellipse(picture, "BODY")
        squares.append(pulls(found, true))
        sizes.append((found.diameter_px - width) / found.diameter_sigma_px)
    assert 0.3 < np.sqrt(0.5 * np.mean(squares)) < 1.0 + sample.within(0.35)
    assert np.sqrt(np.mean(np.square(sizes))) < 1.0 + sample.within(0.5)


@pytest.mark.slow
def test_range_from_the_apparent_size(body_stage):
    """The body stands 2 % farther than expected, and 5 px beside."""
    true = np.array([600.4, 400.7])
    model = body_stage.body(150.0, 60.0, true, TRIAXIAL, figure=replace(KNOWN, size_sigma=0.05))
    far = replace(model, target=replace(model.target, position_km=1.02 * model.target.position_km))
    picture = body_stage.picture(body_stage.light(far), [model], offset_px=(4.0, -3.0))
    found = find_ellipse(picture, "BODY")
    assert found.range_km == pytest.approx(far.target.range_km, rel=1e-3)
    assert found.range_sigma_km == pytest.approx(
        0.05 * found.range_km, rel=0.05
    )  # a body larger by so much looks alike
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=0.03)
    assert find_ellipse(picture, "BODY", solve_range=False).range_km != found.range_km


@pytest.mark.slow
@pytest.mark.parametrize("assumed", [(1.0, 0.86, 0.8), (0.94, 0.8, 0.8)])
def test_wrong_radii_are_told_from_the_free_ellipse(body_stage, assumed):
    """True radii of 1 : 0.8 : 0.8; the center is right all the same, as axes are as uncertain as on a first approach."""
    true = np.array([500.0, 520.0])
    light = body_stage.light(body_stage.body(200.0, 5.0, true, (1.0, 0.8, 0.8)))
    model = body_stage.body(200.0, 5.0, true, assumed)
    found = find_ellipse(body_stage.picture(light, [model]), "BODY")
    free = found.detail.free
    assert free.residual_rms_px < 0.05
    observed = np.sort(free.ellipse.semi_axes)
    true_axes = np.sort(body_stage_axes(body_stage, true))
    np.testing.assert_allclose(observed, true_axes, rtol=2e-3)
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=0.1)


def body_stage_axes(stage, place):
    """Semi-axes, px, of the limb of the true body."""
    outline = body_outline(stage.picture(EMPTY, [stage.body(200.0, 5.0, place, (1.0, 0.8, 0.8))]), "BODY")
    return np.array([outline.radius_px.min(), outline.radius_px.max()])


@pytest.mark.slow
def test_local_albedo_does_not_move_the_limb(body_stage):
    """One side of the body half as bright as the other."""
    true = np.array([511.3, 511.8])
    model = body_stage.body(120.0, 40.0, true)
    light = body_stage.light(model)
    light[:, 500:] *= 0.5 + 0.5 / (1.0 + np.exp((np.arange(500, 1024) - 520.0) / 4.0))
    found = find_ellipse(body_stage.picture(light, [model], offset_px=(2.0, 1.0)), "BODY")
    assert found.status == "ok", found.messages
    assert pulls(found, true) < 14.0
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=0.1)


@pytest.mark.slow
def test_hits_do_not_move_it(body_stage):
    true, rng = np.array([511.3, 511.8]), np.random.default_rng(2)
    model = body_stage.body(100.0, 40.0, true)
    picture = body_stage.picture(body_stage.light(model), [model], rng)
    points = find_ellipse(picture, "BODY").detail
    data = picture.signal_dn.copy()
    for place in np.rint(points.points_px[points.status == "used"][[5, 20, 40]] + 1.0).astype(int):
        data[place[1], place[0]] += 3000.0
    found = find_ellipse(replace(picture, signal_dn=data), "BODY")
    assert found.flags & BodyFlag.HIT
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=0.05)
    assert set(found.detail.status) <= {"used", "not_chosen", "rejected"}
    assert all(found.detail.reason)


def test_limb_behind_another_body(body_stage):
    true = np.array([511.3, 511.8])
    model = body_stage.body(100.0, 40.0, true)
    moon = body_stage.body(40.0, 40.0, (470.0, 480.0), name="MOON", range_share=0.5)
    found = find_ellipse(body_stage.picture(body_stage.light(model, moon), [model, moon]), "BODY")
    assert found.flags & BodyFlag.OCCULTED
    assert "another body hides or shades it here" in found.detail.reason
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=0.05)


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
def test_silhouette_of_a_shape_model(body_stage):
    true, rng = np.array([511.3, 511.8]), np.random.default_rng(2)
    model = body_stage.body(100.0, 60.0, true)
    target = replace(model.target, radii_km=None)
    shaped = replace(model, target=target, shape=cube_of_craters(), law=LunarLambert(0.5))
    picture = body_stage.picture(body_stage.light(shaped), [shaped], rng, offset_px=(3.0, -2.0))
    found = find_ellipse(picture, "BODY")
    assert found.status == "ok", found.messages
    assert found.detail.free is None
    assert pulls(found, true) < 14.0  # chi-squared, 1 in 1000
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=0.05)
    # The ellipsoid of the same extent: the covariance knows that its limb is not that of the body.
    smooth = replace(shaped, shape=None, target=replace(target, radii_km=shaped.shape.radii_km))
    rough = find_ellipse(replace(picture, models=(smooth,)), "BODY")
    assert rough.detail.rms_px > 3.0 * found.detail.rms_px
    assert rough.covariance_px2[0, 0] > 25.0 * found.covariance_px2[0, 0]


@pytest.fixture(scope="module")
def stood(body_stage):
    """A picture of a body of 120 px with noise, the body in it, and its place."""
    true, rng = np.array([511.8, 511.2]), np.random.default_rng(5)
    model = body_stage.body(120.0, 50.0, true, TRIAXIAL)
    return body_stage.picture(body_stage.light(model), [model], rng), model, true


@pytest.mark.parametrize("radius", [42.0, 78.0])
def test_a_poor_circle_only_tells_where_to_look(stood, radius):
    picture, _, true = stood
    found = find_ellipse(picture, "BODY", circle=Circle(true + np.array([4.0, -3.0]), radius))
    assert found.status == "ok", found.messages
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=0.06)


@pytest.mark.slow(keep=["1.3-False"])
@pytest.mark.parametrize(("share", "told"), [(0.7, True), (1.3, False)])
def test_body_of_another_size_than_expected(stood, share, told):
    """Sizes are uncertain by 10 %: 2.6 sigma of that are no misfit, 3.6 are."""
    picture, model, true = stood
    other = replace(model, target=replace(model.target, radii_km=share * model.target.radii_km))
    found = find_ellipse(replace(picture, models=(other,)), "BODY")
    assert found.status == ("uncertain" if told else "ok"), found.messages
    assert bool(found.flags & BodyFlag.CIRCLE_MISFIT) == told
    np.testing.assert_allclose(found.pixel_line, true, rtol=0, atol=0.06)
    assert found.range_km == pytest.approx(share * model.target.range_km, rel=5e-3)


def test_nothing_in_the_circle(stood):
    found = find_ellipse(stood[0], "BODY", circle=Circle([200.0, 300.0], 60.0))
    assert (found.status, found.pixel_line) == ("not_detected", None)
    assert "stands out of the sky within 30 px" in found.messages[0]


@pytest.mark.slow
def test_all_saturated_and_core_saturated(stood):
    picture, _, true = stood
    bright = picture.signal_dn
    found = find_ellipse(replace(picture, saturated=bright > 0.02 * bright.max()), "BODY")
    assert (found.status, found.flags) == ("saturated", BodyFlag.OVEREXPOSED)
    assert "take a shorter exposure" in found.messages[0]
    core = find_ellipse(replace(picture, saturated=bright > 0.8 * bright.max()), "BODY")
    assert core.flags & BodyFlag.OVEREXPOSED
    np.testing.assert_allclose(core.pixel_line, true, rtol=0, atol=0.06)


@pytest.mark.slow(keep=["place0"])
@pytest.mark.parametrize("place", [(10.0, 500.0), (-15.0, 500.0), (500.0, 2.0)])
def test_cut_by_the_edge(body_stage, place):
    model = body_stage.body(120.0, 50.0, place)
    light = body_stage.light(model)
    found = find_ellipse(body_stage.picture(light, [model], np.random.default_rng(1)), "BODY")
    assert found.flags & BodyFlag.CUT_BY_EDGE
    assert pulls(found, np.array(place)) < 14.0  # chi-squared, 1 in 1000
    assert any("off the detector" in reason for reason in found.detail.reason)


def test_off_the_detector_and_no_usable_pixels(stood, body_stage):
    away = body_stage.body(60.0, 50.0, (-300.0, 500.0))
    picture = body_stage.picture(EMPTY, [away])
    assert find_ellipse(picture, "BODY", search_radius_px=20.0).status == "off_detector"
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


@pytest.mark.slow
def test_the_same_picture_gives_the_same_bits(stood):
    one, two = (find_ellipse(stood[0], "BODY") for _ in range(2))
    assert np.array_equal(one.pixel_line, two.pixel_line)
    assert np.array_equal(one.covariance_px2, two.covariance_px2)
