"""Rendered pictures: flux, places and noise against moments, closed forms and a traced ellipsoid."""

from dataclasses import replace

import numpy as np
import pytest
import spiceypy

from opnav_workbench.bodies import TargetState
from opnav_workbench.camera import Camera
from opnav_workbench.errors import CameraError
from opnav_workbench.rehearsal import render_picture
from opnav_workbench.rehearsal.picture import body_points, electrons_from_magnitude
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.scene import Observer, StarPrediction

AT_REST = Observer(np.zeros(3), np.zeros(3), "kernels")
CENTER_PX, PIXEL_RAD = 511.5, 1e-5  # of the generic pinhole
MANY_E = 1e12  # so many that shot noise is 1e-6 of the flux and the picture is as good as noiseless


@pytest.fixture(scope="module")
def pinhole() -> Camera:
    return Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")


@pytest.fixture(scope="module")
def quiet(pinhole) -> Camera:
    """The same with one electron per DN and neither read noise nor saturation."""
    return replace(pinhole, gain_e_per_dn=1.0, read_noise_dn=0.0, saturation_dn=None)


def stars_at(places, mags) -> StarPrediction:
    places = np.asarray(places, float).reshape(-1, 2)
    n = len(places)
    return StarPrediction(
        id=np.array([f"s{i}" for i in range(n)]),
        mag=np.asarray(mags, float).reshape(n),
        directions=np.zeros((n, 3)),
        pixel_line=places,
        covariance_px2=np.zeros((n, 2, 2)),
        on_detector=np.ones(n, bool),
    )


NO_STARS = stars_at([], [])
MANY_E_MAG = 18.0 - 2.5 * np.log10(MANY_E)  # zero point 18, 1 s, gain 1


def moments(picture: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Flux, center (pixel, line) and second moments of all light."""
    line, pixel = np.mgrid[: picture.shape[0], : picture.shape[1]]
    flux = picture.sum()
    center = np.array([(picture * pixel).sum(), (picture * line).sum()]) / flux
    u, v = pixel - center[0], line - center[1]
    spread = np.array([(picture * u * u).sum(), (picture * v * v).sum(), (picture * u * v).sum()]) / flux
    return flux, center, spread


def test_magnitudes_become_electrons(pinhole):
    # Zero point 18, gain 10: magnitude 18 leaves 10 e/s, five magnitudes are a factor of 100.
    electrons = electrons_from_magnitude(pinhole, np.array([18.0, 13.0, 23.0]), 2.0)
    assert electrons == pytest.approx([20.0, 2000.0, 0.2], rel=1e-12)


@pytest.mark.parametrize("place", [(300.37, 511.81), (700.0, 20.5), (40.11, 1000.499)])
@pytest.mark.parametrize("sigma_px", [0.8, 1.6])
def test_a_star_has_its_flux_place_and_width(quiet, place, sigma_px):
    picture = render_picture(quiet, stars_at([place], [MANY_E_MAG]), [], 1.0, sigma_px, 0.0, 5)
    flux, center, spread = moments(picture)
    assert flux / MANY_E == pytest.approx(1.0, abs=1e-5)
    assert center == pytest.approx(np.array(place), abs=1e-5)  # px; shot noise 1e-6, sampling 1e-6
    # A Gaussian in square pixels: the pixel adds 1/12 px^2 of its own; sampling ripples by 2e-5.
    assert spread == pytest.approx(np.array([sigma_px**2 + 1 / 12, sigma_px**2 + 1 / 12, 0.0]), abs=1e-4)


def test_pixel_is_horizontal_and_line_vertical(quiet):
    picture = render_picture(quiet, stars_at([(10.0, 900.0)], [MANY_E_MAG]), [], 1.0, 0.8, 0.0, 5)
    assert np.unravel_index(np.argmax(picture), picture.shape) == (900, 10)


def test_light_beyond_the_edge_is_lost(quiet):
    picture = render_picture(quiet, stars_at([(-0.5, 300.0)], [MANY_E_MAG]), [], 1.0, 0.8, 0.0, 5)
    assert picture.sum() / MANY_E == pytest.approx(0.5, abs=1e-5)
    assert picture[:, 512:].sum() == 0.0  # nothing came in again on the other side


def lambert_radii(phase: float) -> float:
    """Center of light of a Lambert sphere, radii, from int cos(i) cos(e) over the lit visible surface."""
    disk = np.sin(phase) + (np.pi - phase) * np.cos(phase)
    return 3.0 * np.pi / 16.0 * np.sin(phase) * (1.0 + np.cos(phase)) / disk


def sun_toward(phase: float, around: float) -> np.ndarray:
    """Body to Sun, for a camera that looks along +Z, the Sun's side at angle `around` from +pixel."""
    side = np.sin(phase) * np.array([np.cos(around), np.sin(around)])
    return 1e10 * np.array([*side, -np.cos(phase)])


def ball(phase_deg: float, around: float, radius_px: float = 4.0) -> TargetState:
    radius = 1e8 * PIXEL_RAD * radius_px
    sun = sun_toward(np.radians(phase_deg), around)
    return TargetState("BALL", [0.0, 0.0, 1e8], [radius] * 3, np.array(spiceypy.rotate(0.7, 1)), sun)


# Measured: 1.1e-4 radii at 15 deg, and 1.3e-3 at worst, where the cells cut the terminator coarsely.
@pytest.mark.parametrize(
    ("phase_deg", "tolerance"), [(0.001, 1e-4), (15.0, 3e-4), (60.0, 2e-3), (90.0, 2e-3)]
)
@pytest.mark.parametrize("around", [0.0, 2.2, 4.0])
def test_lambert_sphere_has_the_closed_center_of_light(pinhole, phase_deg, tolerance, around):
    places, shares = body_points(ball(phase_deg, around), AT_REST, pinhole, np.eye(3))
    assert shares.sum() == pytest.approx(1.0, abs=1e-12)
    assert np.hypot(*(places - CENTER_PX).T).max() <= 4.0 + 1e-6  # all of it within the disk
    light = (shares @ places - CENTER_PX) / 4.0
    truth = lambert_radii(np.radians(phase_deg)) * np.array([np.cos(around), np.sin(around)])
    assert light == pytest.approx(truth, abs=tolerance)


def test_fifteen_degrees_are_a_tenth_of_the_radius():
    assert lambert_radii(np.radians(15.0)) == pytest.approx(0.0986, abs=5e-5)


def test_triaxial_body_against_tracing_each_ray(pinhole):
    axes = np.array([300.0, 200.0, 100.0])
    body_from_j2000 = np.array(spiceypy.eul2m(0.4, 1.1, -0.8, 3, 1, 3))
    sun = sun_toward(np.radians(50.0), 0.9)
    target = TargetState("POTATO", [0.0, 0.0, 1e7], axes, body_from_j2000, sun)
    places, shares = body_points(target, AT_REST, pinhole, np.eye(3))

    # Parallel rays along +Z on a fine grid: nearest intersection, outward normal, Lambert's cosine.
    x, y = (g.ravel() for g in np.meshgrid(*[np.linspace(-310.0, 310.0, 501)] * 2))
    start = np.stack([x, y, np.zeros_like(x)], axis=-1) @ body_from_j2000.T / axes
    along = body_from_j2000 @ [0.0, 0.0, 1.0] / axes
    a, b, c = along @ along, start @ along, (start**2).sum(axis=1) - 1.0
    hit = b * b - a * c > 0.0
    depth = (-b[hit] - np.sqrt(b[hit] ** 2 - a * c[hit])) / a
    normal = (start[hit] + depth[:, None] * along) / axes
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    light = np.clip(normal @ (body_from_j2000 @ sun) / np.linalg.norm(sun), 0.0, None)
    truth = np.array([light @ x[hit], light @ y[hit]]) / light.sum()  # km
    assert np.hypot(*truth) > 20.0  # far from the center, or this would test nothing
    seen = (shares @ places - CENTER_PX) * PIXEL_RAD * 1e7
    assert seen == pytest.approx(truth, abs=0.5)  # km of 300: 2e-3 radii, as for the sphere


def test_a_body_without_size_is_one_point_and_one_share(pinhole):
    places, shares = body_points(TargetState("DOT", [100.0, 0.0, 1e7]), AT_REST, pinhole, np.eye(3))
    assert places == pytest.approx(np.array([[CENTER_PX + 1.0, CENTER_PX]]), abs=1e-9)
    assert shares.tolist() == [1.0]


def test_a_disk_keeps_all_its_light_around_its_center_of_light(quiet):
    places, shares = body_points(ball(15.0, 2.2), AT_REST, quiet, np.eye(3))
    picture = render_picture(quiet, NO_STARS, [(places, shares, MANY_E_MAG)], 1.0, 0.8, 0.0, 5)
    flux, center, _ = moments(picture)
    assert flux / MANY_E == pytest.approx(1.0, abs=1e-5)
    shift = 4.0 * lambert_radii(np.radians(15.0)) * np.array([np.cos(2.2), np.sin(2.2)])
    assert center == pytest.approx(CENTER_PX + shift, abs=1.2e-3)  # px: 3e-4 of 4 px of radius


def test_a_body_behind_the_camera_leaves_no_light(quiet):
    behind = TargetState("DOT", [0.0, 0.0, -1e7])
    picture = render_picture(
        quiet, NO_STARS, [(*body_points(behind, AT_REST, quiet, np.eye(3)), MANY_E_MAG)], 1.0, 0.8, 0.0, 5
    )
    assert not picture.any()


def test_the_same_seed_gives_the_same_bits(pinhole):
    stars = stars_at([(100.2, 200.7)], [8.0])
    first, second, other = (render_picture(pinhole, stars, [], 1.0, 0.8, 50.0, seed) for seed in (1, 1, 2))
    assert first.tobytes() == second.tobytes()
    assert (first != other).mean() > 0.5


@pytest.mark.parametrize("sky_dn", [0.0, 20.0, 2000.0])
def test_noise_is_shot_read_and_rounding(pinhole, sky_dn):
    picture = render_picture(pinhole, NO_STARS, [], 1.0, 0.8, sky_dn, 9)
    sigma = np.sqrt(2.0**2 + sky_dn / 10.0 + 1.0 / 12.0)  # read noise 2 DN, gain 10 e/DN, whole DN
    # A million pixels tell the deviation to 0.07 %.
    assert picture.std() == pytest.approx(sigma, rel=0.02)
    assert picture.mean() == pytest.approx(sky_dn, abs=5.0 * sigma / 1024.0)
    assert (picture == np.rint(picture)).all()
    neighbours = np.corrcoef(picture[:, :-1].ravel(), picture[:, 1:].ravel())[0, 1]
    assert abs(neighbours) < 0.005  # 5 sigmas of no correlation


def test_saturation_clips(pinhole):
    picture = render_picture(pinhole, stars_at([(100.0, 200.0)], [2.0]), [], 1.0, 0.8, 0.0, 9)
    assert picture.max() == pinhole.saturation_dn
    assert picture[200, 100] == pinhole.saturation_dn


@pytest.mark.parametrize("field", ["zero_point_mag", "gain_e_per_dn", "read_noise_dn"])
def test_a_camera_of_unknown_brightness_is_refused(pinhole, field):
    with pytest.raises(CameraError, match=field):
        render_picture(replace(pinhole, **{field: None}), NO_STARS, [], 1.0, 0.8, 0.0, 1)
