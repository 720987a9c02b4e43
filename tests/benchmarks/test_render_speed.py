"""Speed of the adaptive rendering as a ratio against 5 x 5 rays in every pixel, measured in the same run."""

import numpy as np
import pytest

from opnav_workbench.camera import Camera
from opnav_workbench.constants import AU_KM
from opnav_workbench.geometry import rotation_from_vector
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.render import (
    AlbedoMap,
    BodyModel,
    LommelSeeliger,
    LunarLambert,
    ShapeModel,
    render_bodies,
)
from opnav_workbench.render.body import PlacedBody
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.targets import TargetState

PSF = GaussianPsf(0.65, 0.65)
RADIUS_KM = 1188.3
NAIVE = 5  # rays along a pixel's side


@pytest.fixture(scope="module")
def camera():
    return Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml")


def body(camera, diameter_px, radius_km=RADIUS_KM, place_px=(511.0, 511.0), name="BODY"):
    toward = camera.unproject(np.array([place_px]))[0]
    return TargetState(
        name,
        toward * 2.0 * radius_km / (diameter_px * camera.pixel_scale_rad),
        radii_km=radius_km * np.array([1.0, 0.95, 0.9]),
        body_from_j2000=rotation_from_vector(np.array([1.0, 0.4, -0.9])),
        sun_position_km=33.0 * AU_KM * np.array([0.6, -0.3, 0.74]),
    )


def adaptive(camera, models):
    return render_bodies(models, camera, np.eye(3), np.zeros(3), psf=PSF, sunlight_e=1e12)


def naive(camera, model, diameter_px):
    """Mean of 5 x 5 rays in every pixel of the window, each ray exact; without the PSF."""
    half = int(diameter_px / 2) + 4
    sub = (np.arange(NAIVE * 2 * half) + 0.5) / NAIVE + 511.0 - half - 0.5
    shown, light = PlacedBody(model, camera.pixel_scale_rad), []
    for part in np.array_split(sub, 2 * half):  # a line of pixels at a time: what the processor's cache holds
        rays = camera.unproject(np.stack(np.meshgrid(sub, part), axis=-1).reshape(-1, 2)).T
        light.append(
            shown.radiance(np.ascontiguousarray(rays)).reshape(NAIVE, 2 * half, NAIVE).mean(axis=(0, 2))
        )
    return np.array(light)


def compare(benchmark, fastest, peer, ours):
    """Note how many times faster ours is, where times are asked for: nothing here is judged by them."""
    if not benchmark.disabled:
        (peer_s, _), (ours_s, _) = fastest(peer, ours)
        benchmark.extra_info["times_faster_than_5x5"] = peer_s / ours_s


@pytest.mark.slow
def test_ellipsoid_of_500_px(benchmark, fastest, camera):
    model = BodyModel(body(camera, 500.0), LommelSeeliger())
    compare(benchmark, fastest, lambda: naive(camera, model, 500.0), lambda: adaptive(camera, [model]))
    rendering = benchmark(lambda: adaptive(camera, [model]))
    # Both show the same body; 5 x 5 rays are rough at the limb.
    light = naive(camera, model, 500.0).sum() * camera.pixel_scale_rad**2 / np.pi * 1e12
    assert rendering.electrons.sum() == pytest.approx(light, rel=5e-3)


@pytest.mark.slow
def test_pluto_with_a_map_and_charon_in_a_lorri_frame(benchmark, fastest, camera):
    albedo = AlbedoMap(np.random.default_rng(3).uniform(0.2, 0.9, (512, 1024)))
    pluto = BodyModel(body(camera, 190.0), LunarLambert(0.5), albedo)
    charon = BodyModel(body(camera, 97.0, 606.0, (820.0, 300.0), "CHARON"), LommelSeeliger(), 0.35)
    compare(
        benchmark,
        fastest,
        lambda: (naive(camera, pluto, 190.0), naive(camera, charon, 97.0)),
        lambda: adaptive(camera, [pluto, charon]),
    )
    rendering = benchmark(lambda: adaptive(camera, [pluto, charon]))
    total = sum(b.flux_e for b in rendering.bodies)
    assert rendering.electrons.sum() == pytest.approx(total, rel=3e-3)


@pytest.mark.slow
def test_shape_of_50_000_plates(benchmark, fastest, camera):
    n = 160
    latitude, longitude = np.linspace(-0.5, 0.5, n + 1) * np.pi, np.arange(n) * 2.0 * np.pi / n
    grid = np.cos(latitude)[:, None] * np.stack([np.cos(longitude), np.sin(longitude)])[:, None]
    up = np.broadcast_to(np.sin(latitude)[:, None], grid.shape[1:])
    sphere = np.stack([*grid, up], axis=-1)
    hills = 1.0 + 0.03 * np.sin(9.0 * sphere[..., 0]) * np.cos(8.0 * sphere[..., 1]) * np.sin(
        7.0 * sphere[..., 2]
    )
    vertices = (sphere * hills[..., None]).reshape(-1, 3) * RADIUS_KM
    row, column = (g.ravel() for g in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    a, b = row * n + column, row * n + (column + 1) % n
    shape = ShapeModel(
        vertices, np.concatenate([np.stack([a, b, b + n], -1), np.stack([a, b + n, a + n], -1)])
    )
    assert len(shape.plates) >= 50_000
    model = BodyModel(body(camera, 400.0), LommelSeeliger(), shape=shape)
    compare(benchmark, fastest, lambda: naive(camera, model, 400.0), lambda: adaptive(camera, [model]))
    rendering = benchmark(lambda: adaptive(camera, [model]))
    assert rendering.electrons.sum() == pytest.approx(rendering.bodies[0].flux_e, rel=5e-3)
