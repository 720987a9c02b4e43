"""Landmarks: maplets, their places and partials, centers and pose against truth drawn by another route."""

import dataclasses

import numpy as np
import pytest
from bumpy import Bumpy
from scipy import ndimage

from opnav_workbench.bodies import BodyPicture
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CenterfindingError, EstimationError, MissionError
from opnav_workbench.geometry import rotation_from_vector, vector_from_rotation
from opnav_workbench.landmarks import (
    Maplets,
    PosedLandmarks,
    PoseKnowledge,
    camera_position_from_landmarks,
    ellipsoid_shape,
    find_landmarks,
    find_lost_landmarks,
    finder,
    judge_landmarks,
    landmark_partials,
    make_maplets,
    place_from_silhouette,
    pose_from_landmarks,
    posed,
    predict_landmarks,
)
from opnav_workbench.landmarks.drawing import draw_templates
from opnav_workbench.landmarks.prediction import WholeBody, landmark_places
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.render import AlbedoMap, BodyModel, Lambert, LommelSeeliger, ShapeModel
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.stars import NoiseModel
from opnav_workbench.targets import TargetState

RADII = np.array([0.28, 0.27, 0.25])
SIZE, DIAMETER_PX = 128, 116.0
PSF_PX = 0.65


def camera_of(size):
    camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    return dataclasses.replace(
        camera, n_pixel=size, n_line=size, center_pixel_line=np.full(2, 0.5 * (size - 1))
    )


class Scene:
    """A picture of a bumpy body, and maplets of it that lack half of its albedo, and its law."""

    def __init__(self):
        self.camera = camera_of(SIZE)
        self.body = Bumpy.of(RADII, 192, octaves=range(2, 7), falloff=0.6, roughness=0.02, contrast=0.05)
        self.pixel_km = 2.0 * RADII[1] / DIAMETER_PX
        toward = np.array([0.8, 0.5, 0.33])
        toward /= np.linalg.norm(toward)
        self.place = toward * self.pixel_km / self.camera.pixel_scale_rad
        self.sun = np.array([0.9, -0.25, 0.45]) / np.linalg.norm([0.9, -0.25, 0.45])
        first = np.cross([0.0, 0.0, 1.0], -toward)
        first /= np.linalg.norm(first)
        self.turn = self.camera.focal_from_camera.T @ np.stack([first, np.cross(-toward, first), -toward])
        self.shape = self.body.shape(150)
        # Half of the pattern's variance is in details that the map does not have.
        wide = AlbedoMap(ndimage.gaussian_filter(self.body.albedo, 3.0, mode=("nearest", "wrap")))
        self.maplets = make_maplets(
            "BENNU",
            self.shape,
            11.0 * self.pixel_km,
            scale_km=self.pixel_km,
            samples=25,
            albedo=wide,
            source="test",
        )
        light = self.body.draw(
            self.camera, self.turn, self.place, self.sun, Lambert(), cells=2, psf_sigma=PSF_PX, step=1e-3
        )
        random = np.random.default_rng(3)
        electrons = 6000.0 * light / light.max()
        self.signal = random.poisson(electrons) + random.normal(scale=6.0, size=light.shape)

    def picture(self, *, place_error=(0.0, 0.0, 0.0), turned=(0.0, 0.0, 0.0), law=None):
        target = TargetState(
            "BENNU",
            -(self.place + np.array(place_error)),
            radii_km=RADII,
            body_from_j2000=np.eye(3),
            sun_position_km=1.6e8 * self.sun,
        )
        model = BodyModel(target, LommelSeeliger() if law is None else law, 1.0, self.shape)
        empty = np.zeros(self.signal.shape, dtype=bool)
        return BodyPicture(
            self.signal, np.full(self.signal.shape, 6.0), empty, empty, self.camera,
            rotation_from_vector(np.array(turned)) @ self.turn, np.zeros(3), (model,), GaussianPsf(PSF_PX, PSF_PX),
            noise_model=NoiseModel(6.0, 1.0),
        )  # fmt: skip

    def true_places(self, centers):
        target = dataclasses.replace(self.picture().models[0].target)
        return landmark_places(centers.place_km, target, self.camera, self.turn, np.zeros(3))


@pytest.fixture(scope="module")
def scene():
    return Scene()


# ---- Maplets


def test_maplets_of_a_sphere_are_round_and_spread():
    maplets = make_maplets("BENNU", ellipsoid_shape([0.25] * 3, 0.008), 0.08, samples=9)
    gaps = np.linalg.norm(maplets.place_km[:, None] - maplets.place_km[None], axis=2)
    assert gaps[~np.eye(len(maplets), dtype=bool)].min() > 0.075
    assert len(maplets) > 0.5 * 4.0 * np.pi * 0.25**2 / 0.08**2
    assert (
        np.abs(np.linalg.norm(maplets.points_km(), axis=-1) - 0.25).max() < 1.2e-4
    )  # chords of plates of 8 m
    up = maplets.place_km / np.linalg.norm(maplets.place_km, axis=1)[:, None]
    assert np.einsum("ni,ni->n", up, maplets.axes[:, 2]).min() > np.cos(0.01)


def test_maplets_take_the_albedo_of_a_map():
    lon = np.radians(np.arange(72) * 5.0 + 2.5)
    values = np.tile(1.0 + 0.5 * np.sin(lon), (36, 1))
    maplets = make_maplets(
        "BENNU", ellipsoid_shape([0.25] * 3, 0.01), 0.15, samples=9, albedo=AlbedoMap(values)
    )
    x, y, _ = np.moveaxis(maplets.points_km(), -1, 0)
    away = np.hypot(x, y) > 0.05
    assert np.abs(maplets.albedo - (1.0 + 0.5 * np.sin(np.arctan2(y, x))))[away].max() < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(("wave_m", "left_m"), [(24.0, 0.012), (12.0, 0.02)])
def test_samples_hold_what_they_can_tell_of_finer_terrain_and_little_else(wave_m, left_m):
    """Waves of 0.1 m on a plateau, 8 m between samples: three tell one of 24 m, none one of 12 m.

    Means of samples would lack 0.017 m of the first, and leave 0.04 m of the second.
    """
    step_km, scale_km, half_km = 0.002, 0.008, 0.08
    x, y = np.meshgrid(*[np.arange(-half_km, half_km + step_km, step_km)] * 2)
    height = 1e-4 * np.cos(2e3 * np.pi / wave_m * x)
    top = np.stack([x, y, height], axis=-1).reshape(-1, 3)
    n = len(x)
    i, j = (g.ravel() for g in np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij"))
    a, b, c, d = i * n + j, i * n + j + 1, (i + 1) * n + j + 1, (i + 1) * n + j
    plates = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    # A pyramid below closes the plateau.
    edge = np.concatenate([np.arange(n), np.arange(1, n) * n + n - 1, (n - 1) * n + np.arange(n - 2, -1, -1),
                           np.arange(n - 2, 0, -1) * n])  # fmt: skip
    sides = np.stack([np.roll(edge, -1), edge, np.full(len(edge), n * n)], 1)
    shape = ShapeModel(np.concatenate([top, [[0.0, 0.0, -1.0]]]), np.concatenate([plates, sides]))
    maplets = make_maplets("BENNU", shape, 0.03, scale_km=scale_km, samples=9)
    flat = np.flatnonzero(
        (maplets.axes[:, 2, 2] > 0.999) & (np.abs(maplets.place_km[:, :2]).max(axis=1) < 0.03)
    )
    east, _, up = maplets.points_km()[flat[0]].reshape(-1, 3).T
    true = 1e-4 * np.cos(2e3 * np.pi / wave_m * east) if wave_m > 2e3 * scale_km else np.zeros_like(up)
    left = (up - up.mean() - true + true.mean()).reshape(9, 9)
    assert np.abs(left[1:-1, 1:-1]).max() < 1e-3 * left_m, "beside the edges"


def test_file_gives_back_what_was_written(tmp_path):
    maplets = make_maplets("BENNU", ellipsoid_shape([0.28, 0.27, 0.25], 0.02), 0.1, samples=9, source="x")
    again = Maplets.read(maplets.write(tmp_path / "a.npz"))
    assert (again.body, again.source, again.id.tolist()) == ("BENNU", "x", maplets.id.tolist())
    assert np.array_equal(again.place_km, maplets.place_km)
    assert np.abs(again.heights_km - maplets.heights_km).max() < 1e-8
    assert len(again.take(slice(0, 2))) == 2


@pytest.mark.parametrize(
    "content", [b"no archive", b"", "truncated", "other"], ids=["text", "empty", "truncated", "other"]
)
def test_damaged_file_is_told_in_one_line(tmp_path, content):
    path = tmp_path / "a.npz"
    make_maplets("BENNU", ellipsoid_shape([0.25] * 3, 0.03), 0.1, samples=5).write(path)
    if content == "truncated":
        path.write_bytes(path.read_bytes()[:-300])
    elif content == "other":
        np.savez(path, a=np.ones(3))
    else:
        path.write_bytes(content)
    with pytest.raises(MissionError, match=r"a\.npz"):
        Maplets.read(path)


def test_bad_numbers_are_refused():
    shape = ellipsoid_shape([0.25] * 3, 0.05)
    for wrong in ({"spacing_km": 0.0}, {"spacing_km": 0.1, "samples": 8}, {"spacing_km": 1e-5}):
        with pytest.raises(MissionError):
            make_maplets("BENNU", shape, **wrong)


# ---- Prediction and partials


def test_partials_are_those_of_differences():
    camera, random = camera_of(144), np.random.default_rng(0)
    points, velocity = 0.25 * random.normal(size=(5, 3)), np.array([10.0, -25.0, 4.0])
    turn = rotation_from_vector(np.array([0.3, -0.2, 0.7]))
    spin = rotation_from_vector(np.array([-0.4, 0.9, 0.1]))
    position = turn.T @ camera.focal_from_camera.T @ np.array([0.002, -0.003, 5.0]) * 100.0
    target = TargetState("BENNU", position, body_from_j2000=spin)
    found = landmark_partials(points, target, camera, turn, velocity)

    def places(shift=0.0, camera_turn=(0.0, 0.0, 0.0), body_turn=(0.0, 0.0, 0.0), place=0.0):
        moved = dataclasses.replace(
            target,
            position_km=position - shift,
            body_from_j2000=rotation_from_vector(np.array(body_turn)) @ spin,
        )
        return landmark_places(
            points + place, moved, camera, rotation_from_vector(np.array(camera_turn)) @ turn, velocity
        )

    for name, field, step in (
        ("shift", "spacecraft_px_per_km", 1e-3),
        ("camera_turn", "attitude_px_per_rad", 1e-6),
        ("body_turn", "body_px_per_rad", 1e-4),
        ("place", "place_px_per_km", 1e-3),
    ):
        slopes = [(places(**{name: e}) - places(**{name: -e})) / (2.0 * step) for e in step * np.eye(3)]
        expected = np.stack(slopes, axis=-1)
        assert getattr(found, field) == pytest.approx(expected, abs=1e-6 * np.abs(expected).max()), name


@pytest.mark.slow
def test_far_and_dark_sides_are_not_searched(scene):
    picture = scene.picture()
    told = predict_landmarks(scene.maplets, picture.models[0], scene.camera, scene.turn, np.zeros(3))
    to_camera = np.sum(scene.maplets.place_km * scene.place, axis=1)
    assert not told.usable[to_camera < 0.0].any()
    assert 0.15 < told.usable.mean() < 0.45
    assert {"turned away", "on the night side"} <= set(told.reason.tolist())


# ---- What hides and shades


def test_a_coarse_shape_casts_no_second_shadow_where_a_maplet_knows_the_terrain():
    """A body whose shape bears a hill within a maplet that the maplet does not have, or has elsewhere."""
    ball = ellipsoid_shape([0.25] * 3, 0.012)
    maplets = make_maplets("BENNU", ball, 0.3, samples=25, scale_km=0.004)
    camera = camera_of(64)
    row = int(np.argmax(maplets.place_km @ [0.8, 0.5, 0.33]))
    maplets, up = maplets.take([row]), maplets.axes[row, 2]
    toward, sun = up + 0.3 * maplets.axes[0, 0], up + 1.2 * maplets.axes[0, 1]
    toward, sun = toward / np.linalg.norm(toward), sun / np.linalg.norm(sun)
    first = np.cross([0.0, 0.0, 1.0], -toward) / np.linalg.norm(np.cross([0.0, 0.0, 1.0], -toward))
    turn = camera.focal_from_camera.T @ np.stack([first, np.cross(-toward, first), -toward])
    target = TargetState(
        "BENNU", -toward * 0.0025 / camera.pixel_scale_rad, radii_km=np.full(3, 0.25), body_from_j2000=np.eye(3),
        sun_position_km=1.6e8 * sun,
    )  # fmt: skip

    def drawn(hill_km, beside, wide_km=0.014):
        away = np.linalg.norm(ball.vertices_km - maplets.place_km[0] - beside * maplets.axes[0, 1], axis=1)
        grown = ball.vertices_km * (1.0 + hill_km / 0.25 * np.exp(-0.5 * (away / wide_km) ** 2))[:, None]
        model = BodyModel(target, Lambert(), 1.0, ShapeModel(grown, ball.plates))
        psf = GaussianPsf(PSF_PX, PSF_PX)
        return draw_templates(maplets, model, WholeBody.of(model), camera, turn, np.zeros(3), psf, 31)

    plain, hill = drawn(0.0, 0.0), drawn(0.03, 0.0)
    assert plain.covered.mean() > 0.8
    assert np.array_equal(hill.covered, plain.covered)
    light = [templates.at(0, np.zeros(2))[0] for templates in (plain, hill)]
    assert light[1] == pytest.approx(light[0], abs=1e-12)
    # A hill beyond the maplet, between it and the Sun, does shade it.
    beyond = drawn(0.08, 0.09, 0.03)
    seen = beyond.covered[0] & plain.covered[0]
    assert beyond.at(0, np.zeros(2))[0][seen].min() < 0.05 < light[0][seen].min()


# ---- Centers and pose in a picture


@pytest.fixture(scope="module")
def found(scene):
    """Found from 2.5 px away, turned by half a degree of twist, with a law that shades otherwise."""
    px = scene.camera.pixel_scale_rad
    turned = np.array([2.0, -1.5, 0.0]) * px + scene.camera.boresight * 8e-3
    return find_landmarks(
        scene.picture(turned=tuple(turned), place_error=(0.005, 0.0, -0.008)), scene.maplets
    )


@pytest.mark.slow
def test_centers_are_right_and_know_how_well(scene, found):
    error = found.centers.observed_px - scene.true_places(found.centers)
    ok = found.accepted
    sigma = np.sqrt(np.diagonal(found.covariance_px2, axis1=1, axis2=2))
    assert ok.sum() > 25
    assert ok.mean() > 0.85
    assert np.sqrt(np.mean(error[ok] ** 2)) < 0.12
    assert 0.7 < np.sqrt(np.mean((error[ok] / sigma[ok]) ** 2)) < 1.4
    assert np.abs(error[ok]).max() < 0.6
    assert found.centers.law_share > 0.8  # the truth is Lambert's law, the second one of the templates


@pytest.mark.slow
def test_pose_is_that_of_truth_within_its_covariance(scene, found):
    pose = found.pose
    off = np.concatenate(
        [scene.place - pose.position_km, vector_from_rotation(scene.turn @ pose.camera_from_j2000.T)]
    )
    scale = np.sqrt(np.diag(pose.covariance))
    whitened = np.linalg.solve(np.linalg.cholesky(pose.covariance / np.outer(scale, scale)), off / scale)
    assert whitened @ whitened < 20.0  # 6 degrees of freedom: 0.3 %
    assert np.abs(pose.post_fit_px[found.accepted]).max() < 0.6


@pytest.mark.slow
def test_landmark_at_the_wrong_place_is_rejected(scene):
    picture = scene.picture()
    first = find_landmarks(picture, scene.maplets)
    names = first.centers.id[first.accepted][::3]
    rows = np.flatnonzero(np.isin(scene.maplets.id, names))
    place = scene.maplets.place_km.copy()
    # Across the line of sight, so that every one of them is seen 2.5 px from where it should be.
    across = np.cross(scene.place / np.linalg.norm(scene.place), scene.maplets.axes[rows, 0])
    place[rows] += 2.5 * scene.pixel_km * across / np.linalg.norm(across, axis=1)[:, None]
    wrong = dataclasses.replace(scene.maplets, place_km=place)
    again = find_landmarks(picture, wrong)
    of_wrong = np.isin(again.centers.id, names)
    assert of_wrong.sum() >= 5
    assert not again.accepted[of_wrong].any()
    assert again.accepted[~of_wrong].mean() > 0.8


@pytest.mark.slow
def test_analyst_outranks_the_consensus(scene, found):
    picture, name = scene.picture(), str(found.centers.id[found.accepted][0])
    landmarks = posed(found.centers, picture.models[0].target, scene.camera, scene.turn, np.zeros(3))
    judged = judge_landmarks(found.centers, landmarks, PoseKnowledge(), {name: ("rejected", "a shadow")})
    row = found.centers.id.tolist().index(name)
    assert (judged.status[row], judged.reason[row]) == ("rejected", "by the analyst: a shadow")
    assert judged.pose.n_landmarks == found.pose.n_landmarks - 1


@pytest.mark.slow
@pytest.mark.parametrize(("first", "agree"), [(24, True), (3, False)])
def test_a_first_pass_takes_some_and_all_where_these_do_not_agree(scene, found, monkeypatch, first, agree):
    searched = []
    monkeypatch.setattr(finder, "FIRST_LANDMARKS", first)
    templates = finder._templates
    monkeypatch.setattr(finder, "_templates", lambda *a: searched.append(len(a[1])) or templates(*a))
    turned = np.array([2.0, -1.5, 0.0]) * scene.camera.pixel_scale_rad
    again = find_landmarks(scene.picture(turned=tuple(turned)), scene.maplets)
    everyone = len(again.accepted)
    assert searched == ([first, everyone] if agree else [first, everyone, everyone])
    both = again.accepted & found.accepted
    assert both.mean() > 0.8
    moved = again.centers.observed_px[both] - found.centers.observed_px[both]
    assert np.sqrt(np.mean(moved**2)) < 0.02, "the second pass begins elsewhere and ends there"


@pytest.mark.slow
def test_black_picture_gives_no_landmark_and_says_so(scene):
    picture = dataclasses.replace(scene.picture(), signal_dn=np.zeros((SIZE, SIZE)))
    nothing = find_landmarks(picture, scene.maplets)
    assert nothing.pose is None
    assert not nothing.accepted.any()
    assert "no pose" in nothing.messages[0]


@pytest.mark.slow
def test_unknown_body_is_told(scene):
    with pytest.raises(CenterfindingError, match="EROS"):
        find_landmarks(scene.picture(), dataclasses.replace(scene.maplets, body="EROS"))


@pytest.mark.slow
def test_lost_over_a_body_the_silhouette_and_landmarks_tell_the_place(scene):
    """Believed is a place half as far, in another direction: not even the body's disk is where it was expected."""
    picture = scene.picture()
    model = picture.models[0]
    far_off = dataclasses.replace(
        model.target, position_km=0.5 * model.target.position_km + 0.3 * np.array([0.0, 0.0, RADII[0]])
    )
    picture = dataclasses.replace(picture, models=(dataclasses.replace(model, target=far_off),))
    start = place_from_silhouette(picture, "BENNU")
    off = start.position_km + scene.place
    assert off @ np.linalg.solve(start.covariance_km2, off) < 11.3  # 3 degrees of freedom: 1 %
    assert np.linalg.norm(off) < 0.05 * np.linalg.norm(scene.place)
    found = find_lost_landmarks(picture, scene.maplets)
    assert found.accepted.mean() > 0.8
    assert np.linalg.norm(found.pose.position_km - scene.place) < 0.01 * np.linalg.norm(scene.place)


@pytest.mark.slow
def test_no_body_in_sight_has_no_silhouette(scene):
    picture = dataclasses.replace(scene.picture(), signal_dn=np.zeros((SIZE, SIZE)))
    with pytest.raises(CenterfindingError, match="no lit body"):
        place_from_silhouette(picture, "BENNU")


# ---- Pose from measured places


def points_of_a_pose(random, n=40, sigma=0.1, false=0):
    camera = camera_of(1024)
    points = random.normal(size=(n, 3))
    points *= 0.25 / np.linalg.norm(points, axis=1)[:, None]
    points[:, 2] = -np.abs(points[:, 2])  # the near side
    turn = camera.focal_from_camera.T
    truth = TargetState("BENNU", [0.0, 0.0, 50.0], body_from_j2000=np.eye(3))
    observed = landmark_places(points, truth, camera, turn, np.zeros(3)) + random.normal(
        scale=sigma, size=(n, 2)
    )
    observed[:false] += random.uniform(-40.0, 40.0, size=(false, 2))
    shift = np.array([0.02, -0.03, 0.4])
    turned = np.array([1e-4, -1e-4, 2e-3])
    believed = PosedLandmarks(
        points, np.zeros((n, 3, 3)), observed, np.tile(sigma**2 * np.eye(2), (n, 1, 1)),
        dataclasses.replace(truth, position_km=truth.position_km - shift), camera,
        rotation_from_vector(turned) @ turn, np.zeros(3), np.zeros((2, 2)),
    )  # fmt: skip
    return believed, truth, turn


def pose_error(solution, truth, turn):
    off = np.concatenate(
        [-truth.position_km - solution.position_km, vector_from_rotation(turn @ solution.camera_from_j2000.T)]
    )
    scale = np.sqrt(np.diag(solution.covariance))
    return off / scale @ np.linalg.solve(solution.covariance / np.outer(scale, scale), off / scale)


@pytest.mark.slow
def test_pose_alone_scatters_as_its_covariance_says():
    square = []
    for seed in range(40):
        believed, truth, turn = points_of_a_pose(np.random.default_rng(seed))
        solution, used = pose_from_landmarks(believed)
        assert used.sum() > 35
        square.append(pose_error(solution, truth, turn))
    assert 0.7 < np.mean(square) / 6.0 < 1.35


@pytest.mark.slow
def test_third_of_false_landmarks_changes_nothing():
    for seed in range(8):
        believed, truth, turn = points_of_a_pose(np.random.default_rng(seed), false=14)
        solution, used = pose_from_landmarks(believed)
        wrong = (
            np.abs(
                believed.observed_px
                - landmark_places(believed.place_km, truth, believed.camera, turn, np.zeros(3))
            ).max(axis=1)
            > 1.0
        )
        assert not (used & wrong).any()
        assert pose_error(solution, truth, turn) < 25.0


def test_stars_attitude_makes_the_position_across_sharper():
    believed, truth, turn = points_of_a_pose(np.random.default_rng(1))
    believed = dataclasses.replace(believed, camera_from_j2000=turn)
    alone, _ = pose_from_landmarks(believed)
    position, covariance = camera_position_from_landmarks(believed, (1e-6) ** 2 * np.eye(3))
    assert covariance[0, 0] < 0.05 * alone.position_covariance_km2[0, 0]
    off = position + truth.position_km
    assert off @ np.linalg.solve(covariance, off) < 16.0


def test_three_landmarks_are_not_enough():
    believed, _, _ = points_of_a_pose(np.random.default_rng(1))
    with pytest.raises(EstimationError, match="of 3"):
        pose_from_landmarks(believed, usable=np.arange(40) < 3)


def test_false_covariance_is_refused():
    believed, _, _ = points_of_a_pose(np.random.default_rng(1))
    with pytest.raises(EstimationError, match="positive definite"):
        pose_from_landmarks(believed, PoseKnowledge(np.diag([1.0, 1.0, -1.0])))
