"""A field far off its a priori pointing: the wider searches, two stars marked by hand, and pictures without a field."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from opnav_workbench.errors import CenterfindingError, ImageError, SessionError
from opnav_workbench.geometry import quaternion_from_matrix, rotation_from_vector, vector_from_rotation
from opnav_workbench.mission import load_mission
from opnav_workbench.psf import add_sources
from opnav_workbench.rehearsal import DEMO_PICTURES
from opnav_workbench.scene import apparent_stars
from opnav_workbench.session import ImageSession, Settings
from opnav_workbench.stars import Identification

MISSION = load_mission("new_horizons")
CAMERA = MISSION.camera_for(DEMO_PICTURES[1].header)
RIGHT_PX = 0.5  # of the boresight, after the fit of 15 stars
RIGHT_TWIST_DEG = 0.02
NO_WIDE_SEARCH = Settings(wider_shift_px=0.0, widest_shift_px=0.0)


def pointed_off(truth, shift_px, twist_deg, to: Path) -> Path:
    """Copy the MVIC demo picture, its header attitude off by a shift and a twist."""
    turn = np.array([-shift_px[1], shift_px[0], 0.0]) * CAMERA.pixel_scale_rad
    axes = CAMERA.focal_from_camera.T
    wrong = (
        rotation_from_vector(axes @ turn)
        @ rotation_from_vector(axes @ [0.0, 0.0, np.radians(twist_deg)])
        @ truth.camera_from_j2000
    )
    path = Path(shutil.copy(truth.picture, to / "off.fit"))
    with fits.open(path, mode="update") as hdus:
        for key, value in zip(MISSION.keywords["quaternion"], quaternion_from_matrix(wrong.T), strict=True):
            hdus[0].header[key] = float(value)
    return path


def altered(truth, to: Path, change) -> Path:
    """Copy the picture with its pixels changed."""
    path = Path(shutil.copy(truth.picture, to / "altered.fit"))
    with fits.open(path, mode="update") as hdus:
        hdus[0].data = change(np.array(hdus[0].data, dtype=np.float32))
    return path


def attitude_error(attitude, truth):
    """Boresight error (px) and twist error (deg) of an attitude."""
    between = CAMERA.focal_from_camera @ vector_from_rotation(attitude @ truth.camera_from_j2000.T)
    return np.hypot(*between[:2]) / CAMERA.pixel_scale_rad, abs(np.degrees(between[2]))


def assert_right(session, truth):
    error_px, error_deg = attitude_error(session.camera_from_j2000, truth)
    assert error_px < RIGHT_PX
    assert error_deg < RIGHT_TWIST_DEG
    assert session.state.pointing.twist_solved


def processed(path, **options):
    session = ImageSession.open(path, MISSION, **options)
    session.predict()
    session.find_stars()
    return session


@pytest.mark.slow(keep=["shift_px1--75.0"])
@pytest.mark.parametrize(
    ("shift_px", "twist_deg"), [((150.0, -90.0), 1.5), ((-700.0, 600.0), -75.0), ((30.0, 20.0), 180.0)]
)
def test_a_field_far_off_is_found_by_a_wider_search(truth, tmp_path, shift_px, twist_deg):
    session = processed(pointed_off(truth, shift_px, twist_deg, tmp_path))
    assert session.state.star_field.search == "wide"
    assert session.state.star_field.sure
    session.repoint()
    assert_right(session, truth)
    result = json.loads(session.to_json())
    assert result["identification"]["search"] == "wide"
    assert result["identification"]["confidence"] > 0.999
    assert result["pointing"]["n_stars"] >= 14
    assert any("off its a priori place" in message for message in result["messages"])
    steps = result["pointing"]["iterations"]
    for name in ("delta_pixel", "delta_line"):
        assert result["pointing"][name] == pytest.approx(sum(step[name] for step in steps), abs=1e-6)


@pytest.mark.slow
def test_a_wide_search_is_resumed_and_goes_on_as_usual(truth, tmp_path):
    session = processed(pointed_off(truth, (-700.0, 600.0), -75.0, tmp_path))
    session.repoint()
    session.find_stars()
    assert session.state.star_field.search == "wide"  # said by the identification, kept by the refinement
    star = json.loads(session.to_json())["stars"][0]["id"]
    session.reject_stars([star], "a test")
    session.repoint()
    assert_right(session, truth)
    session.save(tmp_path / "run")
    again = ImageSession.resume(tmp_path / "run")
    np.testing.assert_allclose(again.camera_from_j2000, session.camera_from_j2000, atol=1e-12)
    assert [e.step for e in again.journal] == [e.step for e in session.journal]


def test_without_wide_searches_the_field_is_not_identified(truth, tmp_path):
    path = pointed_off(truth, (150.0, -90.0), 1.5, tmp_path)
    session = processed(path, settings=NO_WIDE_SEARCH)
    assert session.state.centers is None
    assert session.state.star_field is None
    assert "not identified" in session.state.messages[0]
    with pytest.raises(SessionError, match="not identified"):
        session.repoint()


def marks(truth, session, count=2):
    """Places, as a hand would mark them, and names of the brightest stars of the true field."""
    catalog = session.inputs.stars
    places = CAMERA.project(
        apparent_stars(catalog, session.inputs.et, session.inputs.observer) @ truth.camera_from_j2000.T
    )
    inside = np.flatnonzero(CAMERA.on_detector(places, -5.0))
    chosen = inside[np.argsort(catalog.mag[inside])[:count]]
    return places[chosen] + [[1.5, -1.0], [-2.0, 1.0]], catalog.id[chosen].tolist()


@pytest.mark.slow(keep=["True"])
@pytest.mark.parametrize("named", [True, False])
def test_two_marked_stars_give_the_field(truth, tmp_path, named):
    path = pointed_off(truth, (80.0, 40.0), 20.0, tmp_path)
    session = ImageSession.open(path, MISSION, settings=NO_WIDE_SEARCH if named else None)
    session.predict()
    places, ids = marks(truth, session)
    session.two_star_pointing(places, ids if named else None, reason="I know this field")
    found = session.state.star_field
    assert (found.search, found.sure) == ("marked", True)
    assert np.hypot(*found.shift_px) == pytest.approx(np.hypot(80.0, 40.0), abs=3.0)
    assert abs(np.degrees(found.twist_rad)) == pytest.approx(20.0, abs=0.2)
    session.find_stars()
    session.repoint()
    assert_right(session, truth)
    entry = next(e for e in session.journal if e.step == "two_star_pointing")
    assert entry.reason == "I know this field"
    assert entry.parameters["ids"] == (ids if named else None)
    assert "confidence" in entry.outcome
    session.save(tmp_path / "run")
    again = ImageSession.resume(tmp_path / "run")
    np.testing.assert_allclose(again.camera_from_j2000, session.camera_from_j2000, atol=1e-12)
    session.undo()
    session.undo()
    session.undo()
    assert session.state.star_field is None


def test_wrong_marks_are_refused_or_not_sure(truth, tmp_path):
    session = ImageSession.open(truth.picture, MISSION)
    with pytest.raises(SessionError, match="predict"):
        session.two_star_pointing([[10.0, 10.0], [90.0, 90.0]], ["a", "b"])
    session.predict()
    places, ids = marks(truth, session)
    with pytest.raises(SessionError, match="no star nobody"):
        session.two_star_pointing(places, [ids[0], "nobody"])
    with pytest.raises(SessionError, match="two stars"):
        session.two_star_pointing(places[:1])
    with pytest.raises(SessionError, match="two stars"):
        session.two_star_pointing(places, [ids[0], ids[0]])
    with pytest.raises(CenterfindingError, match="apart"):
        session.two_star_pointing(np.add(places, [[0.0, 0.0], [300.0, 0.0]]), ids)
    with pytest.raises(CenterfindingError, match="at least"):
        session.two_star_pointing([places[0], places[0] + 1.0], ids)
    assert session.journal[-1].step == "predict"
    # The right places, names exchanged: the other stars say no.
    session.two_star_pointing(places, ids[::-1])
    assert not session.state.star_field.sure
    session.find_stars()
    if session.state.mask("used").any():
        session.repoint()
    assert session.result()["status"] != "ok"


def test_an_empty_sky_gives_a_message_and_no_pointing(truth, tmp_path):
    noise = np.random.default_rng(1)
    session = processed(altered(truth, tmp_path, lambda data: noise.normal(100.0, 2.0, data.shape)))
    result = json.loads(session.to_json())
    assert (result["status"], result["pointing"], result["identification"]) == ("failed", None, None)
    (message,) = result["messages"]
    assert "not identified: no star detected" in message
    assert "mark two stars" in message


@pytest.mark.parametrize("value", [np.nan, 1e6])
def test_a_picture_without_a_usable_pixel_is_refused(truth, tmp_path, value):
    path = altered(truth, tmp_path, lambda data: np.full_like(data, value))
    with pytest.raises(ImageError, match=r"masked|usable|finite"):
        processed(path)


@pytest.mark.slow
def test_a_field_of_saturated_stars_is_identified_and_its_stars_say_why_they_are_not_used(truth, tmp_path):
    def overexposed(data):
        return np.where(data > 15.0, 1e6, data)

    session = processed(altered(truth, tmp_path, overexposed))
    statuses = [star["status"] for star in json.loads(session.to_json())["stars"]]
    assert statuses.count("saturated") >= 5
    found = session.state.star_field
    assert found.sure
    assert attitude_error(found.camera_from_j2000, truth)[0] < 2.0
    session.repoint()
    result = json.loads(session.to_json())
    assert result["messages"]
    assert result["status"] != "ok" or attitude_error(session.camera_from_j2000, truth)[0] < RIGHT_PX


@pytest.mark.slow(keep=["1-1"])
@pytest.mark.parametrize(("count", "seed"), [(1, 0), (1, 1), (2, 0), (2, 1)])
def test_pictures_of_one_or_two_stars_are_right_or_not_ok(truth, tmp_path, count, seed):
    """One star never is more than a proposal; two are as good as their place and brightness say."""
    session = ImageSession.open(truth.picture, MISSION)
    session.predict()
    places, ids = marks(truth, session, count)
    flux = session.context.picture.exposure_s * 10.0 ** (
        -0.4 * (session.inputs.stars.mag[np.isin(session.inputs.stars.id, ids)] - CAMERA.zero_point_mag)
    )

    def few(data):
        picture = np.random.default_rng(seed).normal(100.0, 2.0, data.shape)
        add_sources(picture, CAMERA.psf_model, places, flux)
        return picture

    alone = processed(altered(truth, tmp_path, few))
    result = json.loads(alone.to_json())
    assert result["messages"]
    if alone.state.mask("used").any():
        alone.repoint()
    status = json.loads(alone.to_json())["status"]
    if count == 1:
        assert status != "ok"
    elif status == "ok":
        error_px, _ = attitude_error(alone.camera_from_j2000, truth)
        assert error_px < 4.0  # the marks are off by that


@pytest.mark.slow
def test_a_catalog_of_another_epoch_or_a_wrong_camera_is_never_confidently_wrong(truth, tmp_path):
    session = ImageSession.open(truth.picture, MISSION)
    stars = session.inputs.stars
    random = np.random.default_rng(5)
    moved = random.normal(0.0, 40.0 * CAMERA.pixel_scale_rad, (2, len(stars)))
    for name, ra, dec in (
        ("moved", stars.ra_rad + moved[0], stars.dec_rad + moved[1]),
        ("stretched", *stretched(stars.ra_rad, stars.dec_rad, 1.07)),
    ):
        np.savez(tmp_path / f"{name}.npz", ra_deg=np.degrees(ra), dec_deg=np.degrees(dec), mag=stars.mag)
        wrong = processed(truth.picture, catalog=f"npz:{tmp_path / name}.npz")
        if wrong.state.mask("used").any():
            wrong.repoint()
        assert json.loads(wrong.to_json())["status"] != "ok", name


def stretched(ra, dec, factor):
    """Directions as a camera of another focal length would have to see them."""
    return ra.mean() + factor * (ra - ra.mean()), dec.mean() + factor * (dec - dec.mean())


# ---- Every star seen twice: a ghost, or a camera that jumped.


def seen_twice(truth, to: Path, share: float) -> Path:
    """The picture and, 8 px away, its like of some part of the light."""
    return altered(
        truth, to, lambda data: data + share * np.roll(data - np.median(data), (5, -6), axis=(0, 1))
    )


def stars_and_pointing(session):
    session.predict()
    for _ in range(2):
        session.find_stars()
        session.repoint()


@pytest.mark.parametrize("share", [0.6, 0.2])
def test_the_brighter_images_are_the_stars(demo_truths, tmp_path, share):
    truth = demo_truths[1]
    session = ImageSession.open(seen_twice(truth, tmp_path, share), MISSION)
    stars_and_pointing(session)
    assert_right(session, truth)
    assert session.result()["status"] == "ok"
    assert any("second image" in message for message in session.state.messages)


@pytest.mark.slow
def test_a_trail_is_no_second_image(demo_truths, tmp_path):
    truth = demo_truths[1]
    steps = range(-4, 5)
    trail = altered(truth, tmp_path, lambda d: np.mean([np.roll(d, k, axis=1) for k in steps], axis=0))
    with fits.open(trail, mode="update") as hdus:  # two maxima, as noise or a rate that changes makes them
        hdus[0].data = 0.8 * hdus[0].data + 0.1 * (np.roll(hdus[0].data, 3, 1) + np.roll(hdus[0].data, -3, 1))
    session = ImageSession.open(trail, MISSION)
    stars_and_pointing(session)
    assert not any("second image" in message for message in session.state.messages)
    assert attitude_error(session.camera_from_j2000, truth)[0] < RIGHT_PX


def test_of_two_images_as_bright_none_is_taken_but_by_the_analyst(demo_truths, tmp_path):
    truth = demo_truths[1]
    session = ImageSession.open(seen_twice(truth, tmp_path, 1.0), MISSION)
    session.predict()
    session.find_stars()
    assert session.state.star_field is None
    with pytest.raises(SessionError):
        session.repoint()
    assert session.result()["status"] == "failed"
    assert any(
        "second image" in message and "mark two stars" in message for message in session.state.messages
    )
    stars = session.state.a_priori
    places = stars.places(CAMERA, truth.camera_from_j2000)
    one, two = np.argsort(np.where(CAMERA.on_detector(places), stars.mag, np.inf))[:2]
    session.two_star_pointing([places[one], places[two]], [str(stars.id[one]), str(stars.id[two])])
    session.find_stars()
    session.repoint()
    assert attitude_error(session.camera_from_j2000, truth)[0] < RIGHT_PX


def test_a_pointing_on_a_proposal_says_why_it_is_partial(demo_truths, tmp_path, monkeypatch):
    truth = demo_truths[1]
    session = ImageSession.open(truth.picture, MISSION)
    monkeypatch.setattr(Identification, "sure", property(lambda _: False))
    stars_and_pointing(session)
    assert session.result()["status"] == "partial"
    assert any("is a proposal" in message for message in session.state.messages)
