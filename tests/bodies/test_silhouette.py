"""Outlines, free ellipses and the motion of a limb: closed forms, brute force, and trials of rough limbs."""

from dataclasses import replace

import numpy as np
import pytest

from opnav_workbench.bodies import displaced_model
from opnav_workbench.bodies.free_ellipse import compare_ellipses, pinhole_px
from opnav_workbench.bodies.silhouette import Silhouette, body_outline
from opnav_workbench.geometry import (
    apparent_direction,
    ellipse_from_conic,
    limb_cone,
    rotation_from_vector,
    unit,
)
from opnav_workbench.render import ShapeModel

RADII = np.array([700.0, 600.0, 450.0])
TURN = rotation_from_vector(np.array([0.5, -1.2, 0.3]))


def test_outline_is_the_conic_of_the_ellipsoid(body_stage):
    """Without distortion and aberration the outline is the conic, and its center is not the ellipse's."""
    still = replace(body_stage, velocity_km_s=np.zeros(3))
    model = still.body(500.0, 40.0, (700.3, 200.8), (1.0, 0.8, 0.65))
    target = model.target
    picture = still.picture(np.zeros((1024, 1024)), [model])
    outline = body_outline(picture, "BODY")
    points = pinhole_px(still.camera, outline.points(outline.angle_rad[::16]))
    camera = still.camera
    turn = still.camera_from_j2000
    cone = limb_cone(turn @ target.position_km, target.radii_km, turn @ target.body_from_j2000.T)
    axes = camera.focal_from_camera  # LORRI's mirror
    cone = axes @ cone @ axes.T
    plane = np.column_stack(
        [(points - camera.center_pixel_line) @ np.linalg.inv(camera.pixel_from_mm).T, np.ones(len(points))]
    )
    plane[:, :2] /= camera.focal_length_mm
    slope = 2.0 * np.linalg.norm((plane @ cone)[:, :2], axis=1)
    off_px = np.einsum("ni,ij,nj->n", plane, cone, plane) / slope / camera.pixel_scale_rad
    assert np.abs(off_px).max() < 1e-3  # chords between 2048 angles
    ellipse = ellipse_from_conic(cone)
    assert outline.diameter_px == pytest.approx(
        2.0 * np.sqrt(np.prod(ellipse.semi_axes)) / camera.pixel_scale_rad,
        rel=3e-3,  # distortion stretches it there
    )


def test_outline_feels_aberration_and_follows_the_prediction(body_stage):
    model = body_stage.body(120.0, 40.0, (300.0, 640.0), (1.0, 0.7, 0.9))
    picture = body_stage.picture(np.zeros((1024, 1024)), [model])
    outline, limb = body_outline(picture, "BODY"), picture.prediction("BODY").limb_px
    away = limb - outline.center_px
    radius = outline.radius(np.arctan2(away[:, 1], away[:, 0]))
    np.testing.assert_allclose(radius, np.hypot(*away.T), rtol=0, atol=2e-4)


def sphere_of_plates(n, bumps=0.0, seed=1):
    """A sphere of radius 1 (times RADII), with bumps."""
    rng = np.random.default_rng(seed)
    lat, lon = np.linspace(-np.pi / 2, np.pi / 2, n)[1:-1], np.arange(2 * n) * np.pi / n
    ring = [[np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)] for b in lat for a in lon]
    vertices = np.array([[0.0, 0.0, -1.0], *ring, [0.0, 0.0, 1.0]])
    for way, height in zip(unit(rng.normal(size=(25, 3))), rng.normal(size=25), strict=True):
        vertices = vertices * (1.0 + bumps * height * np.exp((unit(vertices) @ way - 1.0) / 0.08))[:, None]
    m, last = 2 * n, len(vertices) - 1
    plates = [[0, 1 + (k + 1) % m, 1 + k] for k in range(m)]
    for i in range(n - 3):
        for k in range(m):
            a, b = 1 + i * m + k, 1 + i * m + (k + 1) % m
            plates += [[a, b, a + m], [b, b + m, a + m]]
    plates += [[last, last - m + k, last - m + (k + 1) % m] for k in range(m)]
    return ShapeModel(vertices * RADII, plates)


def test_silhouette_is_the_hull_of_a_convex_shape(body_stage):
    """Every vertex lies within the outline; the outline of fine plates is nearly that of the ellipsoid."""
    model = body_stage.body(300.0, 40.0, (500.0, 500.0))
    target = replace(model.target, radii_km=RADII)
    shape = sphere_of_plates(60)
    plated = replace(model, target=target, shape=shape)
    smooth = replace(model, target=target)
    outlines = []
    for body in (plated, smooth):
        picture = body_stage.picture(np.zeros((1024, 1024)), [body])
        outlines.append(Silhouette(picture, "BODY").at(np.array([500.0, 500.0])))
    rough, fine = outlines
    # A facet of 3 deg lies (1 - cos 1.5 deg) of a radius within the surface: 0.05 px here, and its corners on it.
    assert np.abs(rough.radius_px - fine.radius_px).max() < 0.12
    placed = displaced_model(picture, "BODY", [500.0, 500.0]).target
    rays = placed.position_km + shape.vertices_km @ placed.body_from_j2000
    places = body_stage.camera.project(
        apparent_direction(rays, body_stage.velocity_km_s) @ body_stage.camera_from_j2000.T
    )
    away = places - rough.center_px
    beyond = np.hypot(*away.T) - rough.radius(np.arctan2(away[:, 1], away[:, 0]))
    assert beyond.max() < 0.01  # a vertex between two of the 2048 angles
    assert beyond.max() > -0.02  # and some lie on it


def test_free_ellipse_finds_the_radii_of_another_body():
    angle = np.linspace(0.2, 4.0, 150)
    rng = np.random.default_rng(3)
    around = np.linspace(0.0, 2.0 * np.pi, 400)

    def ellipse(a, b, at):
        tilt = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
        return np.array([500.0, 400.0]) + np.stack([a * np.cos(at), b * np.sin(at)], axis=-1) @ tilt.T

    pulls = []
    for _ in range(40):
        points = ellipse(103.0, 79.0, angle) + rng.normal(0.0, 0.05, (150, 2))
        free = compare_ellipses(
            points, 0.05**2 * np.eye(150), ellipse(100.0, 80.0, around), np.radians(218.0)
        )
        assert free.axes[0] @ [np.cos(0.4), np.sin(0.4)] == pytest.approx(1.0, abs=1e-6)
        pulls.append((free.ratio - [1.03, 0.9875]) / free.ratio_sigma)
    assert np.sqrt(np.mean(np.square(pulls))) == pytest.approx(1.0, abs=0.25)
    assert compare_ellipses(points, 0.05**2 * np.eye(150), ellipse(100.0, 80.0, around), 1.0) is None
