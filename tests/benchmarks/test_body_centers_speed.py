"""Speed of the body centerfinders, as ratios against rendering and a general least-squares solver in the same run."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from opnav_workbench import bodies
from opnav_workbench.bodies import (
    BodyPicture,
    choose_subarray,
    displaced_model,
    find_cross_correlation,
    find_least_squares,
    find_unresolved_body,
    model_picture,
)
from opnav_workbench.camera import Camera
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.render import BodyModel, FigureUncertainty, render_bodies
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.stars import NoiseModel
from opnav_workbench.targets import TargetState

NOISE_DN, GAIN, PEAK_DN = 3.0, 22.0, 1200.0
TRUE_PX, OFF_PX = (511.3, 508.8), (4.2, -3.7)
RADIUS_KM = 1188.3
KNOWN = FigureUncertainty(
    5e-5, 5e-5, 5e-5, law_sigma=0.02
)  # what is drawn is a sphere of this size, and Lambert's
# A center costs a search and few renderings: these bounds hold on a busy machine, and fail where a fit renders for every
# parameter and step (a general solver: 25 and more). A disk whose light was extrapolated is fitted twice.
MAX_RENDERINGS = 20.0  # 13 to 16 on a quiet machine, 19 where others fill its caches
MAX_LARGE_RENDERINGS = 5.0  # of a large disk, for an unresolved one


def picture_of(diameter_px):
    camera = Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml")
    toward = camera.unproject(np.array([TRUE_PX]))[0]
    distance = 2.0 * RADIUS_KM / (diameter_px * camera.pixel_scale_rad)
    sun = 4.9e9 * np.array([np.sin(0.7), 0.0, np.cos(0.7)])
    target = TargetState("PLUTO", toward * distance, radii_km=[RADIUS_KM] * 3, sun_position_km=sun)
    model = BodyModel(target, figure=KNOWN)
    psf = GaussianPsf(0.8, 0.8)
    light = render_bodies([model], camera, np.eye(3), np.zeros(3), psf=psf, sunlight_e=1e15).electrons
    signal = PEAK_DN * light / light.max()
    noise = np.sqrt(NOISE_DN**2 + signal / GAIN)
    data = signal + np.random.default_rng(int(diameter_px)).normal(size=signal.shape) * noise

    def picture(scene):
        return BodyPicture(
            data,
            NOISE_DN,
            False,
            False,
            camera,
            np.eye(3),
            np.zeros(3),
            scene,
            psf,
            1e15,
            NoiseModel(NOISE_DN, GAIN),
        )

    true = picture((model,))
    return picture((displaced_model(true, "PLUTO", np.add(TRUE_PX, OFF_PX)),))


@pytest.fixture(scope="module", params=[200.0, 600.0], ids=["200px", "600px"])
def resolved(request):
    return picture_of(request.param)


def rendering_of(picture):
    window = choose_subarray(picture, "PLUTO").window
    return lambda: model_picture(picture, window, {"PLUTO": TRUE_PX})


@pytest.mark.slow(keep=["200px-least_squares"])
@pytest.mark.parametrize("method", ["cross_correlation", "least_squares", "limb_scan", "ellipse"])
def test_center_against_one_rendering(benchmark, fastest, resolved, method):
    finder = getattr(bodies, f"find_{method}", None)
    if finder is None:
        pytest.skip(f"no method {method}")
    (one_s, _), (taken_s, found) = fastest(
        rendering_of(resolved),
        lambda: finder(resolved, "PLUTO"),
        enough=lambda one_s, taken_s: taken_s < MAX_RENDERINGS * one_s,
        times=(3, 1),
    )
    # Where no times are asked for, what was just found will do.
    benchmark.pedantic(lambda: found if benchmark.disabled else finder(resolved, "PLUTO"), rounds=1)
    benchmark.extra_info.update(seconds=taken_s, renderings=taken_s / one_s)
    np.testing.assert_allclose(found.pixel_line, TRUE_PX, atol=0.03)
    assert taken_s < MAX_RENDERINGS * one_s


@pytest.mark.slow
def test_least_squares_against_a_general_solver(benchmark, fastest):
    """scipy's solver with numeric derivatives, on the same pixels, from the same start, after the same search."""
    picture = picture_of(80.0)
    part = choose_subarray(picture, "PLUTO")
    data = picture.signal_dn[part.slices]
    start = find_cross_correlation(picture, "PLUTO").pixel_line + 0.1
    light = model_picture(picture, part.window, {"PLUTO": start})
    scale = np.sum(light * data) / np.sum(light**2)

    def residuals(p):
        model = p[2] * scale * model_picture(picture, part.window, {"PLUTO": p[:2]}) + p[3]
        return ((data - model) / NOISE_DN).ravel()

    def solver():
        return least_squares(
            residuals, [*start, 1.0, 0.0], x_scale=[1, 1, 0.1, 1], diff_step=[1e-4, 1e-4, 1e-3, 1e-3]
        )

    (peer_s, peer), (own_s, _) = fastest(
        solver, lambda: find_least_squares(picture, "PLUTO"), enough=lambda peer_s, own_s: own_s < peer_s
    )
    found = benchmark.pedantic(lambda: find_least_squares(picture, "PLUTO"), rounds=3)
    benchmark.extra_info.update(seconds=own_s, times_faster=peer_s / own_s)
    np.testing.assert_allclose(found.pixel_line, peer.x[:2], atol=0.01)
    assert own_s < peer_s


def test_unresolved_body(benchmark, fastest):
    """With its correction, rendered and fitted again, a small body costs less than a 200 px one costs one rendering."""
    small, large = picture_of(1.0), picture_of(200.0)
    (one_s, _), (taken_s, _) = fastest(
        rendering_of(large),
        lambda: find_unresolved_body(small, "PLUTO"),
        enough=lambda one_s, taken_s: taken_s < MAX_LARGE_RENDERINGS * one_s,
        times=(3, 1),
    )
    found = benchmark.pedantic(lambda: find_unresolved_body(small, "PLUTO"), rounds=3)
    benchmark.extra_info.update(seconds=taken_s, renderings_of_200_px=taken_s / one_s)
    np.testing.assert_allclose(found.pixel_line, TRUE_PX, atol=0.05)
    assert taken_s < MAX_LARGE_RENDERINGS * one_s
