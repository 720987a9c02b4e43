"""What a rehearsal hides: in the pictures it is where SPICE and plain geometry say, and the truth states it so."""

import numpy as np
import pytest
import spiceypy
from astropy.io import fits

from opnav_workbench.mission import load_mission
from opnav_workbench.rehearsal.making import new_rehearsal
from opnav_workbench.rehearsal.sealed_truth import reveal

LIGHT_KM_S = 299792.458
BASE = {
    "title": "Test",
    "description": "Pictures of the approach.",
    "mission": "new_horizons",
    "kernels": "new_horizons/pluto_approach",
    "targets": ["PLUTO", "CHARON"],
    "b_plane": "PLUTO BARYCENTER",
    "parameters": {"target_position": 5000.0},
    "epoch": "2015-07-09T00:00:00",
    "pictures": [
        {"name": "first", "utc": "2015-06-20T00:00:00", "camera": "lorri_4x4", "exposure_s": 0.1},
        {"name": "last", "utc": "2015-07-09T04:29:00", "camera": "lorri_4x4", "exposure_s": 0.1},
    ],
}
ESTIMATED = {"parameters": {"spacecraft_position": 500.0, "spacecraft_velocity": 1e-4}}


@pytest.fixture
def rehearse(tmp_path):
    """Return a function that makes a rehearsal with some perturbations, and reveals it."""

    def make(seed=3, base=BASE, name="case", **perturbations):
        package = new_rehearsal(base | {"perturbations": perturbations}, tmp_path / name, seed=seed)
        return package, reveal(package)

    return make


@pytest.fixture
def furnished():
    """Return a function that loads a package's kernels for plain spiceypy."""

    def load(package):
        for path in sorted(package.metakernel.parent.iterdir()):
            if path.suffix != ".tm":
                spiceypy.furnsh(str(path))

    yield load
    spiceypy.kclear()


def _seen(body, et, body_offset_km, craft_offset_km):
    """Apparent direction of a body, by iterated light time and SPICE's stellar aberration."""
    craft, _ = spiceypy.spkezr("-98", et, "J2000", "NONE", "0")
    where, light_s = craft[:3] + craft_offset_km, 0.0
    for _ in range(5):
        place, _ = spiceypy.spkezr(body, et - light_s, "J2000", "NONE", "0")
        seen = place[:3] + body_offset_km - where
        light_s = np.linalg.norm(seen) / LIGHT_KM_S
    return spiceypy.stelab(seen, craft[3:])


def _projected(direction, truth):
    camera = load_mission("new_horizons").camera_named("lorri_4x4")
    return camera.project(truth.camera_from_j2000 @ direction)


def test_barycenter_4500_km_toward_the_sun_takes_its_satellites_along(rehearse, furnished):
    package, truth = rehearse(target_barycenter={"body": "PLUTO BARYCENTER", "toward_sun_km": 4500.0})
    furnished(package)
    moved = truth.parameters["target_position"]
    epoch = spiceypy.str2et("2015-07-09T00:00:00")
    sun, _ = spiceypy.spkpos("SUN", epoch, "J2000", "NONE", "PLUTO BARYCENTER")
    np.testing.assert_allclose(moved, 4500.0 * sun / np.linalg.norm(sun), rtol=0, atol=1e-6)  # km
    for picture in truth.pictures.values():
        for body, center in picture.bodies.items():
            expected = _projected(_seen(body, picture.et, moved, np.zeros(3)), picture)
            np.testing.assert_allclose(center, expected, rtol=0, atol=1e-3)  # px
    # Published case, 15 deg off the line of sight: 4347 km down-track are 315 s of flight.
    assert truth.b_plane["time_of_flight_s"]["shift"] == pytest.approx(-315.0, abs=4.0)
    assert np.hypot(*(truth.b_plane[k]["shift"] for k in ("b_dot_t_km", "b_dot_r_km"))) == pytest.approx(
        1165, abs=40
    )


def test_the_picture_shows_the_body_where_the_truth_has_it(rehearse):
    package, truth = rehearse(target_barycenter={"body": "PLUTO BARYCENTER", "toward_sun_km": -4500.0})
    picture = package.pictures[-1]
    image = fits.getdata(picture.path).astype(float)
    center = truth.pictures["last"].bodies["PLUTO"]
    line, pixel = np.indices(image.shape)
    near = np.hypot(pixel - center[0], line - center[1]) < 14.0  # px; Pluto is 19 wide
    light = np.where(near, image, 0.0)
    found = np.array([(pixel * light).sum(), (line * light).sum()]) / light.sum()
    np.testing.assert_allclose(found, center, rtol=0, atol=1.0)  # px: phase moves its light off its center
    predicted = fits.getheader(picture.path)
    assert predicted["SPCTRANG"] == pytest.approx(6.318e6, rel=1e-3)


def test_spacecraft_errors_grow_with_time(rehearse, furnished):
    position, velocity = [40.0, -30.0, 20.0], [1e-4, -2e-4, 5e-5]
    package, truth = rehearse(
        base=BASE | ESTIMATED, spacecraft_ephemeris={"position_km": position, "velocity_km_s": velocity}
    )
    furnished(package)
    np.testing.assert_allclose(truth.parameters["spacecraft_position"], position, rtol=0, atol=1e-9)
    np.testing.assert_allclose(truth.parameters["spacecraft_velocity"], velocity, rtol=0, atol=1e-15)
    epoch = spiceypy.str2et("2015-07-09T00:00:00")
    for name, picture in truth.pictures.items():
        offset = np.array(position) + (picture.et - epoch) * np.array(velocity)
        expected = _projected(_seen("PLUTO", picture.et, np.zeros(3), offset), picture)
        np.testing.assert_allclose(picture.bodies["PLUTO"], expected, rtol=0, atol=1e-3)  # px
        predicted, _ = spiceypy.spkezr("-98", picture.et, "J2000", "NONE", "9")
        np.testing.assert_allclose(
            truth.states_km[name], predicted + np.concatenate([offset, velocity]), rtol=0, atol=1e-6
        )
    assert (picture.et - epoch) * velocity[0] < 2.0 < abs(truth.states_km["first"] - predicted)[0]


def test_b_plane_and_time_of_flight_are_moved_as_stated(rehearse, furnished):
    package, truth = rehearse(
        base=BASE | ESTIMATED,
        b_plane_target={"b_dot_t_km": 120.0, "b_dot_r_km": -85.0},
        time_of_flight_s=30.0,
    )
    furnished(package)
    shift = [truth.b_plane[k]["shift"] for k in ("b_dot_t_km", "b_dot_r_km", "time_of_flight_s")]
    np.testing.assert_allclose(shift, [120.0, -85.0, 30.0], rtol=0, atol=1e-5)
    # Far from the body the asymptote is the velocity: T across it and the ecliptic pole, R completes them.
    epoch = spiceypy.str2et("2015-07-09T00:00:00")
    state, _ = spiceypy.spkezr("-98", epoch, "J2000", "NONE", "9")
    speed = np.linalg.norm(state[3:])
    along = state[3:] / speed
    pole = spiceypy.pxform("ECLIPJ2000", "J2000", 0.0) @ [0.0, 0.0, 1.0]
    t = np.cross(along, pole) / np.linalg.norm(np.cross(along, pole))
    moved = truth.parameters["spacecraft_position"]
    np.testing.assert_allclose(
        [moved @ t, moved @ np.cross(along, t), moved @ along],
        [120.0, -85.0, -30.0 * speed],
        rtol=0,
        atol=0.05,
    )  # km
    assert not truth.parameters["spacecraft_velocity"].any()
    np.testing.assert_allclose(
        truth.relative_state_km[:3] - truth.predicted_state_km[:3], moved, rtol=0, atol=1e-6
    )


def test_attitude_error_is_beyond_40_px(rehearse):
    _, truth = rehearse(attitude={"shift_px": {"uniform": [45.0, 70.0]}, "twist_deg": -0.3})
    for pixel, line, twist in truth.attitude_errors.values():
        assert 44.9 < np.hypot(pixel, line) < 70.1
        assert twist == pytest.approx(-0.3, abs=1e-3)
    first, last = truth.attitude_errors.values()
    assert np.hypot(*(first - last)[:2]) > 1.0


def test_one_attitude_error_for_all(rehearse):
    _, truth = rehearse(attitude={"shift_px": 50.0, "every_picture": False})
    first, last = truth.attitude_errors.values()
    np.testing.assert_allclose(first, last, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_focal_length_scales_the_true_places(rehearse):
    straight = {"shift_px": 0.0}
    _, calm = rehearse(name="calm", attitude=straight)
    _, longer = rehearse(attitude=straight, camera={"focal_length": 2e-3})
    assert longer.camera_errors == {"focal length, relative": 2e-3}
    before, after = (_stars(truth.pictures["last"]) for truth in (calm, longer))
    assert len(before) >= 3
    for name, place in before.items():
        expected = 127.5 + (place - 127.5) * (1.0 + 2e-3)
        np.testing.assert_allclose(after[name], expected, rtol=0, atol=0.01)  # px


@pytest.mark.slow
def test_distortion_moves_the_corners(rehearse):
    _, calm = rehearse(name="calm", attitude={"shift_px": 0.0})
    _, bent = rehearse(attitude={"shift_px": 0.0}, camera={"corner_px": 0.8})
    before, after = (_stars(truth.pictures["last"]) for truth in (calm, bent))
    for name, place in before.items():
        out = (place - 127.5) / np.hypot(128.0, 128.0)
        expected = place + 0.8 * (out @ out) * out  # cubic, outward
        np.testing.assert_allclose(after[name], expected, rtol=0, atol=0.01)  # px


def _stars(picture):
    rows = picture.objects[(picture.objects["kind"] == "star") & picture.objects["on_detector"]]
    return {str(r["id"]): np.array([r["pixel"].value, r["line"].value]) for r in rows}


def test_albedo_is_mottled_and_drawn(rehearse):
    _, truth = rehearse(albedo={"bodies": ["PLUTO"], "dark": 0.1, "bright": 0.9})
    body = next(b for b in truth.pictures["last"].settings["bodies"] if b["name"] == "PLUTO")
    assert body["albedo"]["map"] == "mottled"
    assert body["albedo"]["dark"] == 0.1
    row = truth.pictures["last"].objects[0]
    away = np.hypot(row["mean_pixel"] - row["pixel"], row["mean_line"] - row["line"]).value
    assert row["id"] == "PLUTO"
    assert away > 0.1


def test_a_storm_hits_some_pictures_and_gaps_are_flagged(rehearse):
    package, truth = rehearse(
        cosmic_ray_storm={"pictures": 1, "rate_per_cm2_s": 2000.0},
        data_gaps={"pictures": 1, "lines": 3},
    )
    hits = sorted(len(p.cosmic_rays) for p in truth.pictures.values())
    area, open_s = (256 * 51.988e-4) ** 2, 0.1 + 0.013  # cm^2; exposure and frame transfer
    assert hits[0] == 0
    assert abs(hits[1] - 2000.0 * area * open_s) < 5.0 * np.sqrt(hits[1])
    gaps = []
    for picture in package.pictures:
        with fits.open(picture.path) as hdus:
            gaps.append(int((hdus[0].data < -100.0).all(axis=1).sum()))  # far below zero by the bias
    assert sorted(gaps) == [0, 3]


def test_lost_pictures_are_told_and_their_truth_is_kept(rehearse):
    package, truth = rehearse(lost_images={"missing": 1, "spare": ["last"]})
    assert [p.received for p in package.pictures] == [False, True]
    assert truth.lost == {"first": "not received"}
    assert set(truth.pictures) == {"first", "last"}
    assert "| no |" in package.briefing.read_text()


def test_truncated_picture_ends_early(rehearse):
    package, truth = rehearse(lost_images={"truncated": 1, "spare": ["last"]})
    sizes = [p.path.stat().st_size for p in package.pictures]
    assert 0.04 * sizes[1] < sizes[0] < 0.21 * sizes[1]
    assert list(truth.lost) == ["first"]
    assert all(p.received for p in package.pictures)


def test_truth_of_pictures_survives_the_seal(rehearse):
    package, truth = rehearse()
    picture = truth.pictures["last"]
    stars = picture.objects[picture.objects["kind"] == "star"]
    assert picture.picture == package.pictures[-1].path
    assert picture.n_stars >= 3
    assert str(stars["pixel"].unit) == "pix"
    assert np.isfinite(stars["mag"].value).all()
    assert truth.words == ("Nothing was perturbed but attitude and stars, by their usual errors.",)
    with pytest.raises(ValueError, match="read-only"):
        truth.parameters["target_position"][0] = 1.0
