"""Whole simulated pictures without kernels: places, light, occultation, trails and seeds, from closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from opnav_workbench.camera import Camera
from opnav_workbench.catalog import StarTable
from opnav_workbench.constants import AU_KM
from opnav_workbench.errors import CameraError
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.render import BodyModel, Lambert
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.scene import Observer
from opnav_workbench.simulation import ApparentPlaceEffects, DetectorEffects, PictureInputs, expose_picture
from opnav_workbench.simulation.attitude_path import CameraMotion, moving_path
from opnav_workbench.simulation.cautions import cautions
from opnav_workbench.targets import TargetState

ARCSEC = np.pi / 648000.0
ALONG_Z = np.eye(3)
AT_REST = Observer(np.zeros(3), np.zeros(3), "kernels")
NOISELESS = DetectorEffects.none()


@pytest.fixture(scope="module")
def pinhole() -> Camera:
    return Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")


def stars_at(camera, places, mags, **columns):
    """Catalog stars that a camera at rest with attitude 1 sees at these places."""
    directions = camera.unproject(np.asarray(places, float))
    n = len(directions)
    values = {name: np.zeros(n) for name in ("pmra_rad_yr", "pmdec_rad_yr", "parallax_rad")}
    values |= {"rv_km_s": np.full(n, np.nan), "epoch_jyear": np.full(n, 2000.0), "sigma": np.zeros((n, 5))}
    values |= {"id": np.array([f"s{i}" for i in range(n)]), "band": np.full(n, "V")}
    values |= {"motion_known": np.ones(n, bool), "mag": np.asarray(mags, float)}
    values |= {
        "ra_rad": np.arctan2(directions[:, 1], directions[:, 0]),
        "dec_rad": np.arcsin(directions[:, 2]),
    }
    return StarTable(**(values | columns))


def inputs(camera, stars, **values):
    given = {
        "name": "a",
        "camera": camera,
        "et": 0.0,
        "exposure_s": 1.0,
        "observer": AT_REST,
        "predicted_camera_from_j2000": ALONG_Z,
        "path": moving_path(camera, ALONG_Z, 0.0, 1.0),
        "stars": stars,
        "psf": GaussianPsf(0.9, 0.7, 0.4),
        "effects": NOISELESS,
    }
    return PictureInputs(**(given | values))


def centroid(image, place, half=9):
    """First moments in a window: for noiseless pictures."""
    p0, l0 = (round(x) for x in place)
    box = image[l0 - half : l0 + half + 1, p0 - half : p0 + half + 1]
    line, pixel = np.mgrid[l0 - half : l0 + half + 1, p0 - half : p0 + half + 1]
    return np.array([(box * pixel).sum(), (box * line).sum()]) / box.sum()


PLACES = np.array([[100.2, 200.7], [511.5, 511.5], [900.49, 33.51], [640.0, 870.333]])


def test_stars_have_their_place_and_light(pinhole):
    mags = np.array([9.0, 10.0, 11.0, 12.0])
    picture = expose_picture(inputs(pinhole, stars_at(pinhole, PLACES, mags)))
    electrons = 10.0 ** (0.4 * (18.0 - mags)) * 10.0  # zero point 18, gain 10
    assert picture.star_flux_e == pytest.approx(electrons, rel=1e-12)
    assert picture.noiseless_electrons.sum() == pytest.approx(electrons.sum(), rel=1e-6)
    for place in PLACES:
        assert centroid(picture.noiseless_electrons, place) == pytest.approx(place, abs=0.002)
    assert np.allclose(picture.image_dn, picture.noiseless_electrons / 10.0, rtol=1e-12, atol=0.0)
    assert picture.star_drawn.all()


def test_a_star_beside_the_detector_lends_its_light(pinhole):
    picture = expose_picture(inputs(pinhole, stars_at(pinhole, [[-0.5, 300.0]], [9.0])))
    assert picture.noiseless_electrons.sum() / picture.star_flux_e[0] == pytest.approx(0.5, abs=1e-3)
    picture = expose_picture(inputs(pinhole, stars_at(pinhole, [[-2.0, 300.0]], [9.0])))
    assert not picture.star_drawn.any()
    assert 0.0 < picture.noiseless_electrons.sum() < 0.1 * picture.star_flux_e[0]


def test_a_star_without_magnitude_is_not_drawn(pinhole):
    picture = expose_picture(inputs(pinhole, stars_at(pinhole, PLACES[:2], [9.0, np.nan])))
    assert picture.star_drawn.tolist() == [True, False]
    assert picture.noiseless_electrons.sum() == pytest.approx(picture.star_flux_e[0], rel=1e-6)


def ball(camera, place, diameter_px, range_km=1e6):
    """A sphere at full phase."""
    toward = camera.unproject(np.array([place]))[0]
    radius = 0.5 * diameter_px * camera.pixel_scale_rad * range_km
    return TargetState("BALL", toward * range_km, [radius] * 3, np.eye(3), -AU_KM * toward)


def test_a_body_hides_the_stars_behind_it(pinhole):
    body = BodyModel(ball(pinhole, [500.0, 500.0], 40.0), Lambert(), 0.5, flux_e=1e6)
    places = [[500.0, 510.0], [500.0, 519.0], [500.0, 521.5], [470.0, 500.0]]
    picture = expose_picture(inputs(pinhole, stars_at(pinhole, places, [9.0] * 4), bodies=(body,)))
    assert picture.star_occulted.tolist() == [True, True, False, False]
    assert picture.star_drawn.tolist() == [False, False, True, True]
    drawn = picture.star_flux_e[~picture.star_occulted].sum()
    assert picture.noiseless_electrons.sum() == pytest.approx(
        1e6 + drawn, rel=5e-4
    )  # a disk of 40 px in pixels


def test_the_center_of_a_body_is_in_the_truth(pinhole):
    for diameter in (0.3, 3.0, 60.0):
        body = BodyModel(ball(pinhole, [300.3, 640.8], diameter), Lambert(), 0.5, flux_e=1e6)
        picture = expose_picture(
            inputs(pinhole, stars_at(pinhole, PLACES[:0].reshape(0, 2), []), bodies=(body,))
        )
        (drawn,) = picture.rendering.bodies
        assert drawn.center_px == pytest.approx([300.3, 640.8], abs=1e-6)
        assert drawn.diameter_px == pytest.approx(diameter, rel=1e-3)
        # at zero phase the light is centered on the figure
        found = centroid(picture.noiseless_electrons, [300.3, 640.8], half=45)
        assert found == pytest.approx([300.3, 640.8], abs=0.005)


# -- switches ------------------------------------------------------------------------------------------------------


def test_aberration_moves_stars_by_v_over_c(pinhole):
    moving = replace(AT_REST, velocity_km_s=np.array([14.5, 0.0, 0.0]))
    stars = stars_at(pinhole, PLACES, [9.0] * 4)
    on, off = (
        expose_picture(
            inputs(pinhole, stars, observer=moving, place_effects=ApparentPlaceEffects(aberration=a))
        )
        for a in (True, False)
    )
    shift = on.stars.pixel_line - off.stars.pixel_line
    # 14.5 km/s across the boresight: 9.98 arcsec = 4.837 px of 10 microrad, toward +X = +pixel
    assert shift[:, 0] == pytest.approx(14.5 / 299792.458 / 1e-5, rel=1e-4)
    assert shift[:, 1] == pytest.approx(0.0, abs=1e-3)
    assert off.stars.pixel_line == pytest.approx(PLACES, abs=1e-6)
    for picture in (on, off):
        for place in picture.stars.pixel_line:
            assert centroid(picture.noiseless_electrons, place) == pytest.approx(place, abs=0.002)


def test_parallax_moves_a_star_by_baseline_over_distance(pinhole):
    away = replace(AT_REST, position_km=np.array([0.0, 33.0 * AU_KM, 0.0]))
    stars = stars_at(pinhole, PLACES[:2], [9.0, 9.0], parallax_rad=np.array([0.1 * ARCSEC, 0.0]))
    on, off = (
        expose_picture(inputs(pinhole, stars, observer=away, place_effects=ApparentPlaceEffects(parallax=p)))
        for p in (True, False)
    )
    shift = on.stars.pixel_line - off.stars.pixel_line
    # 33 au at 10 pc: 3.3 arcsec, 1.6 px; the observer went toward +Y, so the star goes toward -line
    assert shift[0] == pytest.approx([0.0, -3.3 * ARCSEC / 1e-5], abs=2e-3)
    assert shift[1] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_proper_motion_moves_a_star_with_the_years(pinhole):
    stars = stars_at(pinhole, PLACES[1:2] + 30.0, [9.0], pmdec_rad_yr=np.array([2.0 * ARCSEC]))
    et = 15.0 * 365.25 * 86400.0
    on, off = (
        expose_picture(inputs(pinhole, stars, et=et, place_effects=ApparentPlaceEffects(proper_motion=m)))
        for m in (True, False)
    )
    shift = np.linalg.norm(on.stars.pixel_line - off.stars.pixel_line)
    assert shift == pytest.approx(30.0 * ARCSEC / 1e-5, rel=1e-3)
    assert off.stars.pixel_line[0] == pytest.approx(PLACES[1] + 30.0, abs=1e-6)


def test_distortion_moves_stars_by_the_cameras_own(pinhole):
    lorri = Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml")
    looking = lorri.focal_from_camera.T  # so that the pixel, line and boresight axes lie along X, Y, Z
    corner = np.array([[2.0, 2.0], [511.5, 511.5], [1021.0, 1021.0]])
    path = moving_path(lorri, looking, 0.0, 1.0)
    seen = lorri.unproject(corner) @ path.middle  # J2000
    table = stars_at(pinhole, pinhole.project(seen), [9.0] * 3)
    on, off = (
        expose_picture(inputs(lorri, table, path=path, place_effects=ApparentPlaceEffects(distortion=d)))
        for d in (True, False)
    )
    shift = on.stars.pixel_line - off.stars.pixel_line
    # facts: distorted minus ideal is (-1.38, -1.38) px at the first pixel, (1.06, 1.06) at the last
    assert on.stars.pixel_line == pytest.approx(corner, abs=1e-5)
    assert shift[0] == pytest.approx([-1.38, -1.38], abs=0.03)
    assert shift[1] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert shift[2] == pytest.approx([1.06, 1.06], abs=0.03)


# -- motion --------------------------------------------------------------------------------------------------------


def test_a_turning_camera_draws_trails_and_the_truth_has_their_middle(pinhole):
    path = moving_path(pinhole, ALONG_Z, 0.0, 1.0, motion=CameraMotion(rate_px_s=(12.0, 5.0)))
    picture = expose_picture(inputs(pinhole, stars_at(pinhole, PLACES[1:], [9.0] * 3), path=path))
    assert picture.star_trails.length_px == pytest.approx(13.0, abs=0.05)
    for place in PLACES[1:]:
        assert centroid(picture.noiseless_electrons, place, half=14) == pytest.approx(place, abs=0.01)
    box = picture.noiseless_electrons[490:533, 490:533]
    line, pixel = np.mgrid[490:533, 490:533] - 511.5
    spread = np.array([(box * pixel**2).sum(), (box * line**2).sum()]) / box.sum()
    widths = GaussianPsf(0.9, 0.7, 0.4).sigma_px ** 2 + 1.0 / 12.0
    # a uniform trail of length L adds L^2 / 12
    assert spread == pytest.approx(widths + np.array([12.0, 5.0]) ** 2 / 12.0, rel=0.01)


def test_a_tracked_body_is_sharp_among_trailed_stars(pinhole):
    path = moving_path(pinhole, ALONG_Z, 0.0, 1.0, motion=CameraMotion(rate_px_s=(12.0, 0.0)))
    body = BodyModel(ball(pinhole, [300.0, 600.0], 0.2), Lambert(), 0.5, flux_e=1e6)
    still = np.zeros((1, 2))
    tracked, carried = (
        expose_picture(
            inputs(
                pinhole,
                stars_at(pinhole, PLACES[:1], [9.0]),
                path=path,
                bodies=(body,),
                body_tracks_px=tracks,
            )
        )
        for tracks in ((still,), ())
    )
    assert tracked.body_trails.length_px.tolist() == [0.0]
    assert carried.body_trails.length_px == pytest.approx([12.0], abs=0.1)
    peak = tracked.noiseless_electrons[590:611, 280:321].max()
    assert carried.noiseless_electrons[590:611, 280:321].max() < 0.3 * peak


def test_every_body_has_its_own_trail(pinhole):
    east, still = np.linspace([-3.0, 0.0], [5.0, 0.0], 33), np.zeros((1, 2))
    places = [[300.0, 600.0], [700.0, 200.0]]
    bodies = tuple(BodyModel(ball(pinhole, p, 0.2), Lambert(), 0.5, flux_e=1e6) for p in places)
    picture = expose_picture(
        inputs(pinhole, stars_at(pinhole, PLACES[:1], [9.0]), bodies=bodies, body_tracks_px=(east, still))
    )
    assert picture.body_trails.length_px == pytest.approx([8.25, 0.0])
    for place, mean in zip(places, picture.body_trails.mean_px, strict=True):
        there = np.array(place) + mean
        assert centroid(picture.noiseless_electrons, there, half=10) == pytest.approx(there, abs=0.01)
    with pytest.raises(CameraError, match="1 tracks for 2 bodies"):
        expose_picture(replace(picture.inputs, body_tracks_px=(east,)))


# -- noise ---------------------------------------------------------------------------------------------------------


def test_the_same_inputs_give_the_same_bits_and_another_seed_does_not(pinhole):
    stars = stars_at(pinhole, PLACES, [9.0] * 4)
    first, second, other = (
        expose_picture(inputs(pinhole, stars, effects=DetectorEffects(), seed=seed)) for seed in (5, 5, 6)
    )
    assert first.image_dn.tobytes() == second.image_dn.tobytes()
    assert (first.image_dn != other.image_dn).mean() > 0.5
    assert first.noiseless_electrons.tobytes() == other.noiseless_electrons.tobytes()


# ---- What a person should know of a picture before it is used.


def told(pinhole, mags, flux_e=None, effects=NOISELESS, **values):
    """Cautions of a picture with stars, and a disk of 40 px in a corner of its own, where that has light."""
    body = BodyModel(ball(pinhole, [300.0, 800.0], 40.0), Lambert(), 0.5, flux_e=flux_e)
    stars = stars_at(pinhole, PLACES[: len(mags)].reshape(-1, 2), mags)
    bodies = () if flux_e is None else (body,)
    return cautions(expose_picture(inputs(pinhole, stars, bodies=bodies, effects=effects, **values)))


def test_a_picture_that_serves_is_not_warned_of(pinhole):
    assert told(pinhole, [9.0, 9.5, 10.0, 10.0], 1e6, DetectorEffects()) == ()


def test_saturation_is_told_with_the_exposure_that_would_not(pinhole):
    """The brightest pixel decides: the exposure that is named leaves it just below the end of the converter."""
    (said,) = told(pinhole, [9.0, 9.5, 10.0], 4e8, DetectorEffects())
    assert "BALL is saturated in " in said
    shorter = float(said.split("; ")[1].split(" s ")[0])
    assert 0.0 < shorter < 1.0
    assert told(pinhole, [9.0, 9.5, 10.0], 4e8 * 0.9 * shorter, DetectorEffects()) == ()
    assert told(pinhole, [2.0, 9.5, 10.0], None, DetectorEffects()) == ("1 star is saturated",)


def test_what_nothing_solves_is_told(pinhole):
    assert told(pinhole, [16.0, 16.0, 16.0], None, DetectorEffects()) == (
        "no star is bright enough to be found, and no body is on the detector: nothing solves this picture",
    )
    (said,) = told(pinhole, [9.0, 16.0], 1e6, DetectorEffects())
    assert said.startswith(
        "one star alone is bright enough to be found: no pointing will be solved, and BALL has places"
    )


def test_a_body_without_a_law_is_told(pinhole):
    (said,) = told(pinhole, [9.0, 9.5, 10.0], 1e6, DetectorEffects(), without_law=("BALL",))
    assert said.startswith("BALL is drawn by Lambert's law, as nobody says how it scatters light")
