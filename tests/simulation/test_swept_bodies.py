"""Bodies that turn and are flown around while lines are exposed: against a drawing for each line at its own time."""

from dataclasses import replace

import numpy as np
import pytest

from opnav_workbench.camera import Camera, RowTiming, row_sweep
from opnav_workbench.catalog import StarTable
from opnav_workbench.constants import AU_KM
from opnav_workbench.geometry import apparent_direction, rotation_from_vector, unit
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.render import AlbedoMap, BodyModel, LunarLambert, render_one
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.scene import Observer, following, turned_meanwhile, with_course
from opnav_workbench.simulation import DetectorEffects, PictureInputs, expose_picture
from opnav_workbench.simulation.attitude_path import moving_path
from opnav_workbench.targets import TargetState

SIZE, LINE_S, RANGE_KM = 72, 0.1, 50_000.0
RATE = 1.1  # pixels a line: the scan runs a tenth faster than lines are square
AT_REST = Observer(np.zeros(3), np.zeros(3), "kernels")
PSF = GaussianPsf(0.9, 0.9)


@pytest.fixture(scope="module")
def scanner() -> Camera:
    base = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/cubesat.yaml")
    middle = 0.5 * (SIZE - 1)
    rest = replace(
        base, n_pixel=SIZE, n_line=SIZE, center_pixel_line=np.full(2, middle), focal_from_camera=np.eye(3)
    )
    timing, turn = RowTiming(LINE_S, middle), np.array([RATE * rest.pixel_scale_rad / LINE_S, 0.0, 0.0])
    sweep = row_sweep(timing, SIZE, rest.pixel_scale_rad, lambda t: rotation_from_vector(turn * t))
    return replace(rest, rows=timing, sweep=sweep)


@pytest.fixture(scope="module")
def turning(scanner) -> BodyModel:
    """A mottled ellipsoid that turns by some pixels of its surface from its first line to its last."""
    rng = np.random.default_rng(5)
    toward = scanner.unproject([34.0, 41.0])
    radius = 18.0 * scanner.pixel_scale_rad * RANGE_KM
    start = rotation_from_vector([0.4, 1.0, -0.7])
    sun = AU_KM * unit(np.array([0.9, -0.2, -0.5]))
    body = TargetState("ROCK", toward * RANGE_KM, radius * np.array([1.0, 0.8, 0.65]), start, sun)
    spin, flown = np.array([0.03, 0.09, -0.05]), np.array([0.004, -0.003, 0.01]) * radius

    def at(time_s):
        turned = start @ rotation_from_vector(spin * time_s).T
        return replace(body.standing_at(body.position_km + flown * time_s), body_from_j2000=turned)

    coarse = np.kron(rng.uniform(0.15, 0.5, (9, 18)), np.ones((10, 10)))
    return BodyModel(
        with_course(body, float(scanner.sweep.time_s[-1]), at), LunarLambert(0.5), AlbedoMap(coarse)
    )


def drawn_at(camera, model, time_s):
    then = replace(model, target=model.target.at_time(time_s))
    seen = following(camera, then.target, np.zeros(3), np.eye(3))
    return render_one([then], 0, seen, np.eye(3), np.zeros(3), psf=PSF, sunlight_e=1e15).electrons


@pytest.mark.slow
def test_a_picture_mixes_drawings_of_several_times(scanner, turning):
    turned_px, _ = turned_meanwhile(scanner, turning.target, np.zeros(3), np.eye(3))
    assert turned_px > 2.0
    inputs = PictureInputs(
        name="a", camera=scanner, et=0.0, exposure_s=0.1, observer=AT_REST, predicted_camera_from_j2000=np.eye(3),
        path=moving_path(scanner, np.eye(3), 0.0, 0.1), stars=StarTable.empty(), psf=PSF, effects=DetectorEffects.none(),
        bodies=(turning,),
    )  # fmt: skip
    picture = expose_picture(inputs)
    sunlight = scanner.sunlight_e(0.1)
    mixed, lines = picture.noiseless_electrons / sunlight * 1e15, range(24, 60, 6)
    times = {line: (line - 0.5 * (SIZE - 1)) * LINE_S for line in lines}
    truth = np.array([drawn_at(scanner, turning, times[line])[line] for line in lines])
    peak = truth.max()
    assert np.abs(mixed[list(lines)] - truth).max() < 0.01 * peak
    assert np.abs(drawn_at(scanner, turning, 0.0)[list(lines)] - truth).max() > 0.05 * peak  # drawn once
    # what is told of it is of its center's line
    at = picture.rendering.bodies[0].center_px
    time_s = (at[1] - 0.5 * (SIZE - 1)) * LINE_S
    direction = apparent_direction(turning.target.at_time(time_s).direction, np.zeros(3))
    rest = replace(scanner, rows=None, sweep=None)
    turn = rotation_from_vector([RATE * rest.pixel_scale_rad / LINE_S * time_s, 0.0, 0.0])
    np.testing.assert_allclose(rest.project(turn @ direction), [at[0], 0.5 * (SIZE - 1)], atol=2e-3)
