"""Pictures whose attitude nobody told, or told wrong: the stars alone tell it, or why they cannot."""

import re
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.io import fits

from opnav_workbench.errors import OpNavError
from opnav_workbench.geometry import rotation_from_vector
from opnav_workbench.mission import load_mission
from opnav_workbench.processing import process
from opnav_workbench.rehearsal import DEMO_PICTURES
from opnav_workbench.session import ImageSession, Settings, load_decisions
from opnav_workbench.session.star_field import star_detections

MISSION = load_mission("new_horizons")
CAMERA = MISSION.camera_for(DEMO_PICTURES[0].header)
PATCH_DEG, STARS = 2.0, 3000  # 20 stars in a picture of 0.29 deg
ATTITUDE_KEYS = MISSION.keywords["quaternion"]


@pytest.fixture(scope="module")
def sky(demo_truths, tmp_path_factory):
    """A patch of sky about the demo picture's attitude: its catalog, directions and magnitudes."""
    rng = np.random.default_rng(4)
    center = demo_truths[0].camera_from_j2000.T @ CAMERA.boresight
    ra, dec = np.degrees(np.arctan2(center[1], center[0])), np.degrees(np.arcsin(center[2]))
    dec = dec + rng.uniform(-PATCH_DEG, PATCH_DEG, STARS)
    ra = ra + rng.uniform(-PATCH_DEG, PATCH_DEG, STARS) / np.cos(np.radians(dec))
    mag = rng.uniform(7.0, 10.5, STARS)
    path = tmp_path_factory.mktemp("sky") / "patch.npz"
    np.savez(
        path, ra_deg=ra % 360.0, dec_deg=dec, mag=mag, epoch_jyear=2015.3, pmra_mas_yr=0.0, pmdec_mas_yr=0.0
    )
    a, d = np.radians(ra), np.radians(dec)
    vectors = np.column_stack([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)])
    return f"npz:{path}", vectors, mag


@pytest.fixture
def paint(demo_truths, tmp_path, sky):
    """Write the stars of the patch into the demo picture, as a camera sees them that may be another."""

    def write(turn_deg=(0.0, 0.0, 0.0), focal=1.0, laid=lambda image: image, attitude="wrong"):
        rng = np.random.default_rng(5)
        told = demo_truths[0].camera_from_j2000
        true = rotation_from_vector(CAMERA.focal_from_camera.T @ np.radians(turn_deg)) @ told
        _, vectors, mag = sky
        camera = replace(CAMERA, focal_length_mm=CAMERA.focal_length_mm * focal)
        places = camera.project(vectors @ true.T)
        seen = np.flatnonzero(np.isfinite(places).all(axis=1) & camera.on_detector(places))
        line, pixel = np.mgrid[: camera.n_line, : camera.n_pixel]
        zero_point = CAMERA.zero_point_mag + 2.5 * np.log10(0.1)
        sigma = np.hypot(CAMERA.psf.sigma_px, np.sqrt(1.0 / 12.0))
        image = rng.normal(0.0, 1.2, line.shape)
        for row in seen:
            square = (pixel - places[row, 0]) ** 2 + (line - places[row, 1]) ** 2
            flux = 10.0 ** (-0.4 * (mag[row] - zero_point))
            image += flux * np.exp(-0.5 * square / sigma**2) / (2.0 * np.pi * sigma**2)
        path = shutil.copy(demo_truths[0].picture, tmp_path / "lost.fit")
        with fits.open(path, mode="update") as hdus:
            hdus[0].data[:] = laid(image)
            if attitude == "silent":
                for key in ATTITUDE_KEYS:
                    del hdus[0].header[key]
        return path, true, len(seen)

    return write


def solved(session):
    session.predict()
    session.find_stars()
    session.repoint()
    session.find_stars()
    session.repoint()
    return session


def error_px(session, true):
    """How far the solved boresight is off the one that was painted, without the aberration that was not."""
    inputs = session.inputs
    velocity = inputs.observer.velocity_km_s / 299792.458
    found = session.camera_from_j2000.T @ CAMERA.boresight
    apart = true.T @ CAMERA.boresight - found
    aberration = velocity - (velocity @ found) * found
    return float(np.linalg.norm(apart + aberration)) / CAMERA.pixel_scale_rad


@pytest.mark.slow
@pytest.mark.parametrize("attitude", ["none", "auto"])
def test_stars_tell_an_attitude_that_nobody_told(paint, sky, attitude, tmp_path):
    path, true, n_stars = paint((0.7, -0.5, 140.0), attitude="silent")
    session = solved(ImageSession.open(path, MISSION, catalog=sky[0], attitude=attitude))
    result = session.result()
    assert (result["status"], result["provenance"]["attitude_source"]) == ("ok", "none")
    assert any("no a priori attitude" in message for message in result["messages"])
    assert result["pointing"]["n_stars"] >= 0.7 * n_stars
    assert error_px(session, true) < 0.2
    again = ImageSession.open(path, MISSION, catalog=sky[0], attitude=attitude)
    load_decisions(session.write_decisions(tmp_path / "decisions.yaml")).apply(again)
    np.testing.assert_array_equal(again.camera_from_j2000, session.camera_from_j2000)


def test_a_body_by_hand_takes_the_attitude_that_the_sky_told(paint, sky):
    """Opened without any attitude; then the whole sky is asked, and the body stays where the analyst put it."""
    path, true, n_stars = paint((0.7, -0.5, 140.0), attitude="silent")
    session = ImageSession.open(path, MISSION, catalog=sky[0], attitude="unknown")
    session.predict()
    session.describe_body(
        "VULCAN", (100.0, 80.0), 20.0, radii_km=np.array([30.0]), phase_deg=40.0, sun_deg=0.0
    )
    assert session.is_without_sky
    for _ in range(2):
        session.find_stars()
        session.repoint()
    assert not session.is_without_sky
    assert session.state.pointing.n_stars >= 0.7 * n_stars
    assert error_px(session, true) < 0.2
    assert not any("attitude of the unknown" in message for message in session.state.messages)
    np.testing.assert_allclose(session.predict_body("VULCAN").pixel_line, [100.0, 80.0], rtol=0, atol=1e-6)
    seen = true @ session.inputs.targets["VULCAN"].direction  # but for the aberration, which was not painted
    assert np.hypot(*(CAMERA.project(seen[None])[0] - [100.0, 80.0])) < 30.0


def test_header_proven_wrong(paint, sky):
    path, true, n_stars = paint((1.0, 0.9, -70.0))
    session = solved(ImageSession.open(path, MISSION, catalog=sky[0], settings=Settings(widest_shift_px=0.0)))
    assert session.result()["identification"]["search"] == "lost"
    told = session.inputs.a_priori_camera_from_j2000
    off = np.degrees(np.arccos((told.T @ CAMERA.boresight) @ (true.T @ CAMERA.boresight)))
    (message,) = (m for m in session.result()["messages"] if "header is wrong" in m)
    assert float(message.split("lies ")[1].split()[0]) == pytest.approx(off, abs=0.02)
    assert session.state.pointing.n_stars >= 0.7 * n_stars
    assert error_px(session, true) < 0.2


@pytest.mark.slow
def test_what_the_sky_told_is_kept(paint, sky, tmp_path):
    path, _, _ = paint((1.0, 0.9, -70.0))
    session = ImageSession.open(path, MISSION, catalog=sky[0], settings=Settings(widest_shift_px=0.0))
    session.autosave(tmp_path / "run")
    solved(session)
    session.autosave(None)
    resumed = ImageSession.resume(tmp_path / "run")
    np.testing.assert_array_equal(resumed.camera_from_j2000, session.camera_from_j2000)
    assert resumed.inputs.lost.message == session.inputs.lost.message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("laid", "deg"),
    [(np.rot90, 90), (lambda image: np.rot90(image, 2), 180), (lambda image: np.rot90(image, 3), 270)],
)
def test_turned_picture_is_partial(paint, sky, laid, deg):
    path, _, n_stars = paint(laid=laid)
    session = solved(ImageSession.open(path, MISSION, catalog=sky[0]))
    result = session.result()
    assert result["pointing"]["n_stars"] >= 0.7 * n_stars  # they fit as well as any
    assert result["status"] == "partial"
    (line,) = result["provenance"]["contradictions"]
    assert line in result["messages"]
    assert f"turned by {deg} deg against the attitude of the header" in line
    # An attitude that was wrong is left out: then nothing speaks against the stars.
    alone = solved(ImageSession.open(path, MISSION, catalog=sky[0], attitude="none"))
    assert alone.result()["status"] == "ok"


@pytest.mark.slow
@pytest.mark.parametrize("turn_deg", [(0.0, 0.0, 60.0), (0.01, 0.01, 88.0), (0.0, 0.0, 0.6)])
def test_attitude_that_is_only_wrong_is_told(paint, sky, turn_deg):
    path, true, _ = paint(turn_deg)
    session = solved(ImageSession.open(path, MISSION, catalog=sky[0]))
    result = session.result()
    assert result["status"] == "ok"
    assert error_px(session, true) < 0.3
    told = [m for m in result["messages"] if "off the attitude of the header" in m]
    assert len(told) == (1 if turn_deg[2] > 1.0 else 0)


@pytest.mark.slow(keep=["transpose-with pixel and line exchanged"])
@pytest.mark.parametrize(
    ("laid", "along"),
    [
        (np.fliplr, "along pixel"),
        (np.flipud, "along line"),
        (np.transpose, "with pixel and line exchanged"),
    ],
)
def test_mirrored_picture_is_named_without_a_search_of_the_sky(paint, sky, laid, along):
    path, _, _ = paint(laid=laid)
    session = ImageSession.open(path, MISSION, catalog=sky[0], settings=Settings(lost_detections=0))
    session.predict()
    session.find_stars()
    (message,) = session.result()["messages"]
    assert f"the picture is mirrored {along}" in message
    assert "correct the axes in the camera file" in message


def test_mirrored_picture_is_named(paint, sky):
    path, _, _ = paint(laid=np.flipud)
    session = ImageSession.open(path, MISSION, catalog=sky[0])
    session.predict()
    session.find_stars()
    assert session.result()["status"] == "failed"
    assert any("the picture is mirrored along line" in message for message in session.result()["messages"])


@pytest.mark.slow
def test_mirrored_picture_without_attitude(paint, sky):
    path, _, _ = paint(laid=np.flipud, attitude="silent")
    with pytest.raises(OpNavError, match="mirrored \\(along line, or along pixel and turned by 180 deg\\)"):
        ImageSession.open(path, MISSION, catalog=sky[0])


@pytest.mark.slow
def test_another_focal_length(paint, sky):
    path, true, n_stars = paint((0.3, 0.2, 33.0), focal=1.04, attitude="silent")
    session = solved(ImageSession.open(path, MISSION, catalog=sky[0], attitude="none"))
    assert session.context.settings.focal_scale == pytest.approx(1.04, abs=1e-3)
    assert session.state.pointing.n_stars >= 0.7 * n_stars
    assert error_px(session, true) < 0.3
    assert any("+4.0" in message and "calibrate" in message for message in session.result()["messages"])


@pytest.mark.slow
def test_another_focal_length_is_told_where_the_attitude_is_wrong_too(paint, sky):
    path, _, _ = paint((0.3, 0.2, 33.0), focal=1.04)
    session = ImageSession.open(path, MISSION, catalog=sky[0])
    session.predict()
    session.find_stars()
    assert session.result()["status"] == "failed"
    (message,) = (m for m in session.result()["messages"] if "the focal length is +4.0" in m)
    told = re.search(r"--attitude none, or Settings\(focal_scale=([0-9.]+)\)", message)
    assert float(told[1]) == pytest.approx(1.04, abs=1e-3)


@pytest.mark.slow
def test_processing_without_an_attitude(paint, sky, tmp_path):
    path, _, _ = paint((0.7, -0.5, 140.0))
    (outcome,) = process(
        [path], mission="new_horizons", catalog=sky[0], attitude="none", targets="none", out=tmp_path / "out"
    )
    assert outcome.result["status"] == "ok"


@pytest.mark.slow
def test_processing_waits_for_the_index_where_the_attitude_is_wrong(paint, sky, tmp_path, monkeypatch):
    # A person at the workbench does not: there the whole sky is searched when he asks.
    monkeypatch.setattr("opnav_workbench.stars.lost_in_space.is_index_at_hand", lambda *_: False)
    path, _, n_stars = paint((1.0, 0.9, -70.0))
    session = ImageSession.open(path, MISSION, catalog=sky[0], settings=Settings(widest_shift_px=0.0))
    session.predict()
    session.find_stars()
    assert session.state.star_field is None
    (outcome,) = process(
        [path], mission="new_horizons", catalog=sky[0], targets="none", settings={"widest_shift_px": 0.0}
    )
    assert outcome.result["status"] == "ok"
    assert outcome.result["pointing"]["n_stars"] >= 0.7 * n_stars


class StandIn(SimpleNamespace):
    """A context, of which each is its own."""

    __hash__ = object.__hash__


def test_hot_pixels_do_not_crowd_the_stars_out():
    rng = np.random.default_rng(3)
    sigma = CAMERA.psf.sigma_px
    places = rng.uniform(10, 502, (20, 2))
    line, pixel = np.mgrid[:512, :512]
    image = rng.normal(0.0, 1.2, line.shape)
    for x, y in places:
        image += 60.0 * np.exp(-0.5 * ((pixel - x) ** 2 + (line - y) ** 2) / (sigma**2 + 1.0 / 12.0))
    image[tuple(rng.integers(0, 512, (2, 600)))] += 2000.0
    none = np.zeros(image.shape, bool)
    context = StandIn(
        camera=CAMERA, picture=SimpleNamespace(saturated=none), not_stars=none, signal_dn=image,
        noise_dn=np.full(image.shape, 1.2),
    )  # fmt: skip
    found = star_detections(context).pixel_line
    assert (np.linalg.norm(found[:, None] - places, axis=2).min(axis=0) < 1.0).mean() > 0.9


@pytest.mark.slow
def test_noise_alone_is_no_field(paint, sky):
    path, _, _ = paint(attitude="silent")
    rng = np.random.default_rng(6)
    with fits.open(path, mode="update") as hdus:
        hdus[0].data[:] = rng.normal(0.0, 1.2, hdus[0].data.shape)
        hdus[0].data[rng.integers(5, 250, 30), rng.integers(5, 250, 30)] += 60.0
    with pytest.raises(OpNavError, match="the header gives no attitude"):
        ImageSession.open(path, MISSION, catalog=sky[0])
