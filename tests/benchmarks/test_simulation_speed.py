"""Speed of whole simulated pictures as ratios against naive references measured in the same run.

The ratios hold; seconds are those that pytest-benchmark prints with --benchmark-enable.
"""

import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf

from opnav_workbench.bodies import TargetState
from opnav_workbench.camera import Camera
from opnav_workbench.catalog import StarTable
from opnav_workbench.geometry import AU_KM
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.render import AlbedoMap, BodyModel, LunarLambert
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.scene import Observer
from opnav_workbench.simulation import PictureInputs, expose_picture
from opnav_workbench.simulation.attitude_path import moving_path
from opnav_workbench.simulation.mottled import mottled_map

STARS = 2000
PEER_STARS = 100  # the loop over whole pictures is timed on these and scaled
PEER_ROWS = 8  # lines of the brute-force sphere, timed and scaled
SUBSAMPLES = 32  # of the brute-force reference of the acceptance criteria, along each side of a pixel
PLUTO_PX, CHARON_PX = 190.0, 97.0


@pytest.fixture(scope="module")
def lorri() -> Camera:
    return Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml")


def sphere(camera, name, place, diameter_px, range_km=2.5e6) -> TargetState:
    toward = camera.unproject(np.array([place]))[0]
    radius = 0.5 * diameter_px * camera.pixel_scale_rad * range_km
    phase = np.radians(15.0)
    sun = 33.0 * AU_KM * np.array([np.sin(phase), 0.0, np.cos(phase)])  # LORRI looks along -Z
    return TargetState(name, toward * range_km, [radius] * 3, np.eye(3), sun, magnitude=0.5)


@pytest.fixture(scope="module")
def inputs(lorri) -> PictureInputs:
    rng = np.random.default_rng(7)
    places = rng.uniform(0.0, 1023.0, (STARS, 2))
    seen = lorri.unproject(places)
    stars = StarTable(
        id=np.array([f"s{i}" for i in range(STARS)]),
        ra_rad=np.arctan2(seen[:, 1], seen[:, 0]),
        dec_rad=np.arcsin(seen[:, 2]),
        pmra_rad_yr=np.zeros(STARS),
        pmdec_rad_yr=np.zeros(STARS),
        parallax_rad=np.zeros(STARS),
        rv_km_s=np.full(STARS, np.nan),
        mag=rng.uniform(8.0, 14.0, STARS),
        band=np.full(STARS, "V"),
        epoch_jyear=np.full(STARS, 2000.0),
        sigma=np.zeros((STARS, 5)),
        motion_known=np.ones(STARS, bool),
    )
    albedo = AlbedoMap(mottled_map(1))
    bodies = tuple(
        BodyModel(sphere(lorri, name, place, size), LunarLambert(0.5), albedo, flux_e=flux)
        for name, place, size, flux in (
            ("PLUTO", (430.3, 520.7), PLUTO_PX, 4e8),
            ("CHARON", (800.0, 250.0), CHARON_PX, 8e7),
        )
    )
    return PictureInputs(
        name="benchmark",
        camera=lorri,
        et=0.0,
        exposure_s=0.1,
        observer=Observer(np.zeros(3), np.array([1.0, -13.0, 3.0]), "kernels"),
        predicted_camera_from_j2000=np.eye(3),
        path=moving_path(lorri, np.eye(3), 0.0, 0.1),
        stars=stars,
        psf=GaussianPsf(0.9, 0.8, 0.3),
        bodies=bodies,
    )


def star_at_a_time(picture) -> float:
    """Seconds to add every star as a whole picture of a Gaussian integrated over pixels: PEER_STARS, scaled."""
    edge = np.arange(1025) - 0.5
    image = np.zeros((1024, 1024))
    began = time.perf_counter()
    for (x, y), flux in zip(picture.stars.pixel_line[:PEER_STARS], picture.star_flux_e, strict=False):
        u, v = (0.5 * np.diff(erf((edge - c) / (np.sqrt(2.0) * 0.85))) for c in (x, y))
        image += flux * v[:, None] * u
    return (time.perf_counter() - began) * STARS / PEER_STARS


def brute_force_disk(camera, body) -> float:
    """Seconds to trace a sphere at SUBSAMPLES x SUBSAMPLES rays a pixel: PEER_ROWS lines, scaled to its disk."""
    center = camera.project((body.position_km / body.range_km)[None])[0]
    half = 0.5 * PLUTO_PX
    step = (np.arange(SUBSAMPLES) + 0.5) / SUBSAMPLES - 0.5
    pixels = (np.arange(-int(half), int(half) + 1)[:, None] + step).ravel() + center[0]
    sun = body.sun_position_km / np.linalg.norm(body.sun_position_km)
    began = time.perf_counter()
    for line in range(PEER_ROWS):
        lines = np.round(center[1]) + line + step
        grid = np.stack([g.ravel() for g in np.meshgrid(pixels, lines)], axis=-1)
        rays = camera.unproject(grid)
        along = rays @ body.position_km
        square = along**2 - body.range_km**2 + body.radii_km[0] ** 2
        hit = square > 0.0
        points = rays[hit] * (along[hit] - np.sqrt(square[hit]))[:, None] - body.position_km
        normal = points / body.radii_km[0]
        np.clip(normal @ sun, 0.0, None)
    return (time.perf_counter() - began) * PLUTO_PX / PEER_ROWS


def test_frame_with_pluto_charon_and_2000_stars(benchmark, inputs):
    """Against adding one star at a time and tracing 32 x 32 rays a pixel: at least five times as fast."""
    picture = benchmark.pedantic(expose_picture, args=(inputs,), rounds=3, iterations=1, warmup_rounds=1)
    began = time.perf_counter()
    expose_picture(inputs)
    ours = time.perf_counter() - began
    naive = star_at_a_time(picture) + brute_force_disk(inputs.camera, inputs.bodies[0].target)
    assert picture.star_drawn.sum() > 0.95 * STARS
    assert [round(body.diameter_px) for body in picture.rendering.bodies] == [190, 97]
    assert naive / ours > 5.0, f"{naive:.2f} s naive, {ours:.2f} s ours"


def test_a_star_field_costs_little_more_than_its_noise(benchmark, inputs):
    """A field of 2,000 stars takes less than six times as long as drawing the noise of a megapixel."""
    field = replace(inputs, bodies=())
    benchmark.pedantic(expose_picture, args=(field,), rounds=3, iterations=1, warmup_rounds=1)
    rng = np.random.default_rng(1)

    def noise():
        rng.poisson(np.full((1024, 1024), 10.0))
        rng.normal(0.0, 1.0, (1024, 1024))

    def seconds(call):
        took = []
        for _ in range(3):
            began = time.perf_counter()
            call()
            took.append(time.perf_counter() - began)
        return min(took)

    assert seconds(lambda: expose_picture(field)) / seconds(noise) < 6.0
