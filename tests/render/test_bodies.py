"""Several bodies in one picture: where they lie, who hides and shades whom, and what reaches the detector."""

from dataclasses import replace

import numpy as np
import pytest

from opnav_workbench.camera import Camera
from opnav_workbench.constants import AU_KM, SPEED_OF_LIGHT_KM_S
from opnav_workbench.errors import CameraError, MissionError
from opnav_workbench.geometry import apparent_direction, unit
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.render import BodyModel, FigureUncertainty, LommelSeeliger, render_bodies
from opnav_workbench.scene import Observer, predict_body
from opnav_workbench.targets import TargetState

FULL = LommelSeeliger()  # at zero phase its disk is equally bright all over


def test_center_of_figure_is_where_the_scene_predicts_it(stage, center_of):
    model = stage.model(60.0, 0.0, FULL, place_px=(900.2, 80.6))
    rendering = stage.render(model)
    observer = Observer(np.zeros(3), stage.velocity_km_s, "test")
    predicted = predict_body(model.target, observer, stage.camera, stage.camera_from_j2000)
    body = rendering.bodies[0]
    np.testing.assert_array_equal(body.center_px, predicted.pixel_line)
    assert body.diameter_px == predicted.diameter_px
    np.testing.assert_allclose(center_of(rendering.electrons), predicted.pixel_line, atol=0.002)


def test_aberration_moves_the_picture_as_theory_says(stage, center_of):
    model = stage.model(40.0, 0.0, FULL)
    moving, still = stage.render(model), stage.still().render(model)
    shift = center_of(moving.electrons) - center_of(still.electrons)
    toward = unit(model.target.position_km)
    beta = stage.velocity_km_s / SPEED_OF_LIGHT_KM_S
    across = (beta - toward @ beta * toward) @ stage.camera_from_j2000.T
    jacobian = stage.camera.project_jacobian(toward @ stage.camera_from_j2000.T)
    np.testing.assert_allclose(shift, jacobian @ across, atol=0.003)
    assert np.linalg.norm(shift) > 3.0


def test_distortion_moves_the_picture_as_the_camera_says(stage, center_of):
    camera = stage.camera
    ideal = Camera(
        name="ideal", frame=camera.frame, instrument_id=1, n_pixel=camera.n_pixel, n_line=camera.n_line,
        focal_length_mm=camera.focal_length_mm, center_pixel_line=camera.center_pixel_line,
        pixel_from_mm=camera.pixel_from_mm, focal_from_camera=camera.focal_from_camera,
    )  # fmt: skip
    model = stage.model(30.0, 0.0, FULL, place_px=(990.0, 985.0))
    with_it, without = stage.render(model), replace(stage, camera=ideal).render(model)
    shift = center_of(with_it.electrons) - center_of(without.electrons)
    direction = apparent_direction(model.target.position_km, stage.velocity_km_s) @ stage.camera_from_j2000.T
    np.testing.assert_allclose(shift, camera.project(direction) - ideal.project(direction), atol=0.003)
    assert shift.min() > 0.8  # LORRI: some 1.06 px in that corner


def test_a_nearer_body_hides_a_farther_one(stage):
    far = stage.model(80.0, 30.0, FULL)  # the shadow of the nearer one passes by
    toward = unit(far.target.position_km)
    near = replace(far.target, name="NEAR", position_km=far.target.position_km - toward * 3e6)
    near = replace(near, radii_km=0.5 * far.target.radii_km * near.range_km / far.target.range_km)
    plain = stage.render(far)
    both = stage.render(far, BodyModel(near, FULL, 0.0))
    hidden, front = both.bodies
    line, pixel = np.indices(plain.electrons.shape)
    behind = np.hypot(pixel - 400.37, line - 600.71) < 20.0
    expected = plain.electrons[behind].sum() / plain.electrons.sum()
    assert expected > 0.2
    assert hidden.occulted_fraction == pytest.approx(expected, abs=0.005)
    assert hidden.flux_e == pytest.approx((1.0 - expected) * plain.bodies[0].flux_e, rel=0.01)
    assert both.electrons.sum() == pytest.approx((1.0 - expected) * plain.electrons.sum(), rel=2e-3)
    assert both.electrons[601, 400] < 1e-6 * plain.electrons[601, 400]
    assert front.occulted_fraction == 0.0
    swapped = stage.render(BodyModel(near, FULL, 0.0), far)
    np.testing.assert_allclose(swapped.electrons, both.electrons, atol=1e-12 * both.electrons.max())


def test_a_farther_body_hides_nothing_but_is_hidden(stage):
    front = stage.model(80.0, 30.0, FULL)
    toward = unit(front.target.position_km)
    behind = replace(
        front.target,
        name="BEHIND",
        position_km=front.target.position_km + toward * 3e6,
        radii_km=0.2 * front.target.radii_km,
    )
    alone, both = stage.render(front), stage.render(front, BodyModel(behind, FULL, 1.0))
    np.testing.assert_array_equal(both.electrons, alone.electrons)
    assert both.bodies[1].occulted_fraction == 1.0
    assert both.bodies[1].flux_e == 0.0
    assert np.isnan(both.bodies[1].light_px).all()


def test_a_moon_casts_its_shadow(stage):
    planet = stage.model(100.0, 40.0, FULL)
    sunward = unit(planet.target.sun_position_km)
    moon = replace(
        planet.target,
        name="MOON",
        position_km=planet.target.position_km + 20.0 * planet.target.radii_km[0] * sunward,
        radii_km=0.2 * planet.target.radii_km,
    )
    plain = stage.render(planet).electrons
    shaded = stage.render(planet, BodyModel(moon, FULL, 0.0)).electrons
    # The shadow falls on the subsolar point; it is as large as the moon, less half the width of the penumbra.
    point = planet.target.position_km + planet.target.radii_km[0] * sunward
    place = stage.camera.project(apparent_direction(point, stage.velocity_km_s) @ stage.camera_from_j2000.T)
    column, row = np.rint(place).astype(int)
    assert shaded[row, column] < 1e-3 * plain[row, column]
    lost_px = (1.0 - shaded / np.where(plain > 0.5 * plain.max(), plain, np.inf))[
        plain > 0.5 * plain.max()
    ].sum()
    assert lost_px == pytest.approx(np.pi * 10.0**2 * np.cos(np.radians(40.0)), rel=0.03)
    beyond = replace(moon, position_km=planet.target.position_km - 20.0 * planet.target.radii_km[0] * sunward)
    dark = stage.render(BodyModel(beyond, FULL, 1.0), planet)
    assert dark.bodies[0].flux_e == 0.0


def test_stars_behind_a_body_are_hidden(stage):
    rendering = stage.render(stage.model(100.0, 130.0, FULL, axes=(1.0, 0.8, 0.6)))
    rng = np.random.default_rng(5)
    places = np.array([400.37, 600.71]) + rng.uniform(-70.0, 70.0, (4000, 2))
    directions = stage.camera.unproject(places) @ stage.camera_from_j2000
    hidden = rendering.occults(directions)
    # The limb as the scene predicts it, night side included.
    observer = Observer(np.zeros(3), stage.velocity_km_s, "test")
    target = stage.target(100.0, 130.0, axes=(1.0, 0.8, 0.6))
    limb = predict_body(target, observer, stage.camera, stage.camera_from_j2000).limb_px
    edge = np.roll(limb, -1, axis=0) - limb
    arm = places[:, None] - limb
    side = edge[:, 0] * arm[..., 1] - edge[:, 1] * arm[..., 0]
    inside = (side > 0.0).all(axis=1) | (side < 0.0).all(axis=1)
    assert 500 < hidden.sum() < 3500
    assert np.mean(hidden != inside) < 2e-3  # 180 chords run up to 0.01 px inside the limb


def test_windows_are_cut_from_the_whole_picture(stage):
    models = [
        stage.model(120.0, 60.0, FULL, place_px=(20.0, 15.0)),
        stage.model(0.5, 60.0, FULL, place_px=(90.0, 40.0), name="DOT"),
        stage.model(3.0, 60.0, FULL, place_px=(95.0, 90.0), name="SMALL"),
    ]
    whole = stage.render(*models).electrons
    window = (30, 10, 80, 100)
    part = stage.render(*models, window=window)
    assert part.electrons.shape == (100, 80)
    np.testing.assert_allclose(part.electrons, whole[10:110, 30:110], atol=5e-4 * whole.max(), rtol=0)


def test_light_off_the_detector_is_lost_but_known(stage):
    on, off = stage.model(60.0, 30.0, FULL), stage.model(60.0, 30.0, FULL, place_px=(-0.5, 600.71))
    whole, half = stage.render(on), stage.render(off)
    assert half.bodies[0].flux_e == pytest.approx(whole.bodies[0].flux_e, rel=3e-3)
    share = half.electrons.sum() / half.bodies[0].flux_e
    assert 0.3 < share < 0.7
    gone = stage.render(stage.model(60.0, 30.0, FULL, place_px=(-200.0, 600.0)))
    assert gone.electrons.max() == 0.0
    assert gone.bodies[0].flux_e > 0.0


@pytest.mark.slow
def test_a_body_larger_than_the_detector_fills_it(stage):
    rendering = stage.render(stage.model(4000.0, 10.0, FULL, place_px=(511.0, 511.0)), sunlight_e=1e12)
    inner = rendering.electrons[20:-20, 20:-20]
    light = 1e12 / 33.0**2 / np.pi * stage.camera.pixel_scale_rad**2
    np.testing.assert_allclose(inner, light, rtol=0.05)  # I/F 1 but for a phase of 10 deg, and distortion
    assert rendering.electrons[:3].min() > 0.9 * light  # light from beside the detector is spread onto it


def test_a_body_behind_the_camera_shows_nothing(stage):
    target = stage.target(50.0, 20.0)
    behind = replace(target, position_km=-target.position_km)
    rendering = stage.render(BodyModel(behind, FULL, 1.0))
    assert rendering.electrons.max() == 0.0
    assert np.isnan(rendering.bodies[0].center_px).all()


@pytest.mark.parametrize("diameter_px", [0.4, 2.5, 50.0])
def test_given_flux_is_kept(stage, diameter_px):
    model = replace(stage.model(diameter_px, 70.0, FULL), flux_e=12345.0, albedo=0.3)
    rendering = stage.render(model)
    assert rendering.bodies[0].flux_e == pytest.approx(12345.0, rel=1e-9)
    assert rendering.electrons.sum() == pytest.approx(12345.0, rel=1e-3)


def test_a_point_has_its_flux_and_place(stage, center_of):
    point = BodyModel(TargetState("SPECK", 1e9 * stage.direction((300.2, 200.4))), flux_e=1000.0)
    rendering = stage.render(point)
    assert rendering.electrons.sum() == pytest.approx(1000.0, rel=1e-6)
    np.testing.assert_allclose(center_of(rendering.electrons), [300.2, 200.4], atol=1e-4)
    planet = stage.target(100.0, 20.0, place_px=(300.0, 200.0))
    hidden = stage.render(BodyModel(planet, FULL, 0.0), point).bodies[1]
    assert hidden.occulted_fraction == 1.0
    assert hidden.flux_e == 0.0


def test_elongated_psf_keeps_light_and_orientation(stage, center_of):
    psf = GaussianPsf(2.0, 0.6, 0.7)
    model = stage.model(20.0, 0.0, FULL)
    picture = stage.render(model, psf=psf).electrons
    line, pixel = np.indices(picture.shape)
    x, y = pixel - center_of(picture)[0], line - center_of(picture)[1]
    found = (
        np.array([(x * x * picture).sum(), (x * y * picture).sum(), (y * y * picture).sum()]) / picture.sum()
    )
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    spread = turn @ np.diag([4.0, 0.36]) @ turn.T
    disk = 10.0**2 / 4.0 + 1.0 / 12.0  # a uniform disk, and the pixel
    np.testing.assert_allclose(found, [spread[0, 0] + disk, spread[0, 1], spread[1, 1] + disk], atol=0.02)


def test_the_same_inputs_give_the_same_bits(stage):
    models = [stage.model(150.0, 60.0, FULL), stage.model(2.0, 60.0, FULL, place_px=(700.0, 300.0))]
    np.testing.assert_array_equal(stage.render(*models).electrons, stage.render(*models).electrons)


def test_impossible_models_are_refused(stage):
    target = stage.target(50.0, 20.0)
    with pytest.raises(MissionError, match="has no radii; give flux_e"):
        BodyModel(TargetState("DUST", [0.0, 0.0, 1.0]))
    with pytest.raises(MissionError, match=r"albedo is -0\.1"):
        BodyModel(target, FULL, -0.1)
    with pytest.raises(MissionError, match="the Sun's direction is unknown"):
        BodyModel(replace(target, sun_position_km=None))
    with pytest.raises(MissionError, match="orientation is unknown"):
        BodyModel(replace(target, body_from_j2000=None, radii_km=np.array([3.0, 2.0, 1.0])))
    for wrong in (0.0, -0.1, 1.0, np.nan, np.inf):
        with pytest.raises(MissionError, match=r"size_sigma is .*above 0 and below 1"):
            FigureUncertainty(size_sigma=wrong)
    inside = replace(target, position_km=0.5 * target.radii_km[0] * unit(target.position_km))
    with pytest.raises(CameraError, match="it must stand outside"):
        stage.render(BodyModel(inside))
    with pytest.raises(CameraError, match=r"window .* is empty"):
        stage.render(BodyModel(target), window=(0, 0, 0, 5))


def test_sunlight_falls_with_the_square_of_the_distance(stage):
    target = stage.target(30.0, 0.0)
    near = replace(target, sun_position_km=target.sun_position_km / 11.0)
    far, close = stage.render(BodyModel(target, FULL)), stage.render(BodyModel(near, FULL))
    assert close.bodies[0].flux_e == pytest.approx(121.0 * far.bodies[0].flux_e, rel=1e-3)
    assert np.linalg.norm(near.sun_position_km) == pytest.approx(3.0 * AU_KM)


def test_a_wide_camera_with_strong_distortion_is_followed(stage, center_of):
    camera = Camera(
        name="wide", frame="WIDE", instrument_id=1, n_pixel=1000, n_line=800, focal_length_mm=7.6,
        center_pixel_line=[499.5, 399.5], pixel_from_mm=np.eye(2) / 0.0022 * 0.4,
        focal_from_camera=np.eye(3), distortion=stage.camera.distortion,
    )  # fmt: skip
    target = TargetState(
        "BALL",
        [1200.0, -700.0, 6000.0],
        radii_km=[300.0] * 3,
        sun_position_km=-np.array([1200.0, -700.0, 6000.0]) * 1e5,
    )
    rendering = render_bodies(
        [BodyModel(target, FULL)], camera, np.eye(3), np.zeros(3), psf=GaussianPsf(0.8, 0.8), sunlight_e=1.0
    )
    # The light is summed over the surface, without pixels: it checks their solid angles, off axis and distorted.
    assert rendering.electrons.sum() == pytest.approx(rendering.bodies[0].flux_e, rel=1e-3)
    np.testing.assert_allclose(center_of(rendering.electrons), rendering.bodies[0].light_px, atol=0.02)
