"""Speed of whole simulated pictures as ratios against naive references measured in the same run.

The ratios hold; seconds are those that pytest-benchmark prints with --benchmark-enable.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf

from opnav_workbench.camera import Camera
from opnav_workbench.catalog import StarTable
from opnav_workbench.constants import AU_KM
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.render import AlbedoMap, BodyModel, LunarLambert
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.scene import Observer
from opnav_workbench.simulation import PictureInputs, expose_picture
from opnav_workbench.simulation.attitude_path import moving_path
from opnav_workbench.simulation.surfaces import mottled_map
from opnav_workbench.targets import TargetState

STARS = 2000
PEER_STARS = 100  # the loop over whole pictures is timed on these and scaled
PEER_ROWS = 8  # lines of the brute-force sphere, timed and scaled
SUBSAMPLES = 32  # of the brute-force reference of the acceptance criteria, along each side of a pixel
LEAST_GAIN, MOST_NOISES = 5.0, 6.0
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


def star_at_a_time(picture) -> None:
    """Add PEER_STARS, each as a whole picture of a Gaussian integrated over pixels."""
    edge = np.arange(1025) - 0.5
    image = np.zeros((1024, 1024))
    for (x, y), flux in zip(picture.stars.pixel_line[:PEER_STARS], picture.star_flux_e, strict=False):
        u, v = (0.5 * np.diff(erf((edge - c) / (np.sqrt(2.0) * 0.85))) for c in (x, y))
        image += flux * v[:, None] * u


def brute_force_disk(camera, body) -> None:
    """Trace PEER_ROWS lines of a sphere at SUBSAMPLES x SUBSAMPLES rays a pixel."""
    center = camera.project((body.position_km / body.range_km)[None])[0]
    half = 0.5 * PLUTO_PX
    step = (np.arange(SUBSAMPLES) + 0.5) / SUBSAMPLES - 0.5
    pixels = (np.arange(-int(half), int(half) + 1)[:, None] + step).ravel() + center[0]
    sun = body.sun_position_km / np.linalg.norm(body.sun_position_km)
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


def whole_s(stars_s: float, disk_s: float) -> float:
    """Scale the times of the two parts to the whole frame."""
    return stars_s * STARS / PEER_STARS + disk_s * PLUTO_PX / PEER_ROWS


@pytest.mark.slow
def test_frame_with_pluto_charon_and_2000_stars(benchmark, fastest, inputs):
    """Against adding one star at a time and tracing 32 x 32 rays a pixel: at least five times as fast."""
    picture = benchmark.pedantic(expose_picture, args=(inputs,), rounds=3, iterations=1, warmup_rounds=1)
    (ours, _), (stars_s, _), (disk_s, _) = fastest(
        lambda: expose_picture(inputs),
        lambda: star_at_a_time(picture),
        lambda: brute_force_disk(inputs.camera, inputs.bodies[0].target),
        enough=lambda ours, stars_s, disk_s: whole_s(stars_s, disk_s) > LEAST_GAIN * ours,
    )
    naive = whole_s(stars_s, disk_s)
    assert picture.star_drawn.sum() > 0.95 * STARS
    assert [round(body.diameter_px) for body in picture.rendering.bodies] == [190, 97]
    assert naive / ours > LEAST_GAIN, f"{naive:.2f} s naive, {ours:.2f} s ours"


def test_a_star_field_costs_little_more_than_its_noise(benchmark, fastest, inputs):
    """A field of 2,000 stars takes less than six times as long as drawing the noise of a megapixel."""
    field = replace(inputs, bodies=())
    benchmark.pedantic(expose_picture, args=(field,), rounds=3, iterations=1, warmup_rounds=1)
    rng = np.random.default_rng(1)

    def noise():
        rng.poisson(np.full((1024, 1024), 10.0))
        rng.normal(0.0, 1.0, (1024, 1024))

    (ours, _), (peer, _) = fastest(
        lambda: expose_picture(field), noise, enough=lambda ours, peer: ours < MOST_NOISES * peer
    )
    assert ours / peer < MOST_NOISES
