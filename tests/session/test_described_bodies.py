"""Bodies that an analyst describes in the picture: measured without ephemeris, and without any attitude."""

import json

import numpy as np
import pytest
from astropy.io import fits
from scipy.spatial.transform import Rotation

from opnav_workbench.errors import EstimationError, ImageError, SessionError
from opnav_workbench.estimation import estimate
from opnav_workbench.files import json_text
from opnav_workbench.geometry import apparent_direction
from opnav_workbench.observables.tdm import tdm_text
from opnav_workbench.processing import process
from opnav_workbench.scene import AssistedBody, assisted_target, predict_body
from opnav_workbench.session import ImageSession
from opnav_workbench.session.decisions import Decisions, load_decisions

RADII_KM = (1188.3, 1188.3, 1188.3)


def as_seen(session, name="PLUTO"):
    """What an analyst with perfect eyes would say of a body that the kernels know: place, range, phase, Sun, pole (deg)."""
    target, attitude = session.inputs.targets[name], session.camera_from_j2000
    camera = session.context.camera
    velocity = session.inputs.observer.velocity_km_s

    def place(position_km):
        return camera.project((attitude @ apparent_direction(position_km, velocity))[None])[0]

    def angle(direction):
        step = place(target.position_km + 1e-3 * target.range_km * direction) - center
        return float(np.degrees(np.arctan2(step[1], step[0])))

    center, sun = place(target.position_km), target.sun_position_km
    to_sun, pole = sun / np.linalg.norm(sun), target.body_from_j2000[2]
    below = target.body_from_j2000 @ -target.direction
    return {
        "center_px": center,
        "range_km": target.range_km,
        "phase_deg": float(np.degrees(np.arccos(-target.direction @ to_sun))),
        "sun_deg": angle(to_sun + target.direction * (-target.direction @ to_sun)),
        "north_deg": angle(pole - target.direction * (target.direction @ pole)),
        "sub_observer_deg": np.degrees([np.arctan2(below[1], below[0]), np.arcsin(below[2])]).tolist(),
    }


def by_eye(truth):
    """What a person says of Pluto with a click: a circle, 2 px off and a tenth too large."""
    pixel, line = truth.bodies["PLUTO"] + [1.6, -1.2]
    return {
        "center_px": (float(pixel), float(line)),
        "radius_px": 1.1 * 23.6,
        "radii_km": RADII_KM,
    }


@pytest.fixture
def seen(near):
    near.add_target("PLUTO")
    return as_seen(near)


@pytest.fixture
def unknown(resolved_truths):
    """The picture without kernels, and as if its header told no attitude."""
    return ImageSession.open(resolved_truths[0].picture, "new_horizons", attitude="unknown")


def test_a_described_body_is_the_ephemeris_state_that_looks_so(near, seen):
    by_kernels = near.inputs.targets["PLUTO"]
    body = AssistedBody(
        seen["center_px"], by_kernels.radii_km, *np.radians([seen["phase_deg"], seen["sun_deg"]]),
        range_km=seen["range_km"], north_angle_rad=np.radians(seen["north_deg"]),
        sub_observer_rad=np.radians(seen["sub_observer_deg"]),
    )  # fmt: skip
    velocity = near.inputs.observer.velocity_km_s
    told = assisted_target("PLUTO", body, near.context.camera, near.camera_from_j2000, velocity)
    np.testing.assert_allclose(told.position_km, by_kernels.position_km, rtol=0, atol=2e-9 * told.range_km)
    cosine = told.sun_position_km @ by_kernels.sun_position_km
    cosine /= np.linalg.norm(told.sun_position_km) * np.linalg.norm(by_kernels.sun_position_km)
    assert np.degrees(np.arccos(min(cosine, 1.0))) < 0.02  # an angle in the picture, by differences
    np.testing.assert_allclose(told.body_from_j2000, by_kernels.body_from_j2000, rtol=0, atol=1e-3)
    circle = AssistedBody(
        seen["center_px"], by_kernels.radii_km, 0.3, 0.2,
        radius_px=0.5 * predict_body(
            by_kernels, near.inputs.observer, near.context.camera, near.camera_from_j2000
        ).diameter_px,
    )  # fmt: skip
    far = assisted_target("PLUTO", circle, near.context.camera, near.camera_from_j2000, velocity)
    assert far.range_km == pytest.approx(by_kernels.range_km, rel=2e-4)


@pytest.mark.slow
def test_a_picture_without_any_attitude_gives_place_and_range(starless_truth, seen, tmp_path):
    truth = starless_truth
    unknown = ImageSession.open(truth.picture, "new_horizons", attitude="unknown")
    unknown.predict()
    unknown.describe_body("PLUTO", **by_eye(truth))
    lit = unknown.state.assisted["PLUTO"]  # told by the disk alone
    np.testing.assert_allclose(np.degrees(lit.phase_rad), seen["phase_deg"], rtol=0, atol=3.0)
    turn = (np.degrees(lit.sun_angle_rad) - seen["sun_deg"] + 180.0) % 360.0 - 180.0
    assert abs(turn * np.sin(lit.phase_rad)) < 3.0
    unknown.find_body("PLUTO")
    center = unknown.state.bodies[-1]
    off = center.pixel_line - truth.bodies["PLUTO"]
    assert (center.method, center.status) == ("ellipse", "ok")
    assert np.hypot(*off) < 0.2
    assert off @ np.linalg.solve(center.covariance_px2, off) < 16.0
    (observable,) = unknown.current_observables
    assert abs(observable.measured_range_km - seen["range_km"]) < 4.0 * observable.range_sigma_km
    # Its radii are as uncertain as on a first approach, unless the mission states them better.
    assert observable.range_sigma_km == pytest.approx(0.1 * seen["range_km"], rel=0.1)
    assert abs(observable.measured_range_km - seen["range_km"]) < 0.01 * seen["range_km"]
    # Nothing is said of the sky, nor against an ephemeris that is none.
    assert observable.residual_px is None
    assert observable.partials_px_per_km is None
    assert np.isnan(observable.ra_deg)
    result = json.loads(json_text(unknown.result()))
    assert (result["status"], result["bodies"][0]["ra_deg"]) == ("partial", None)
    assert any("the attitude is unknown" in message for message in result["messages"])
    unknown.find_stars()
    assert any("no star is looked for" in message for message in unknown.state.messages)
    unknown.undo()
    assert result["provenance"]["described_bodies"][0]["body"] == "PLUTO"
    with pytest.raises(SessionError, match="direction"):
        tdm_text([observable])
    # Kept, resumed, taken back.
    unknown.save(tmp_path / "kept")
    again = ImageSession.resume(tmp_path / "kept")
    np.testing.assert_array_equal(again.state.bodies[-1].pixel_line, center.pixel_line)
    again.undo()
    again.undo()
    assert not again.state.assisted
    assert "PLUTO" not in again.inputs.targets


@pytest.mark.slow
@pytest.mark.parametrize(("method", "phase", "sun"), [("ellipse", -5.0, 0.0), ("disk", 5.0, 5.0)])
def test_a_sun_beside_its_place_moves_a_center_no_farther_than_told(
    unknown, resolved_truths, seen, method, phase, sun
):
    truth = resolved_truths[0]
    wrong = {"phase_deg": seen["phase_deg"] + phase, "sun_deg": seen["sun_deg"] + sun}
    unknown.describe_body("PLUTO", **by_eye(truth) | wrong)
    unknown.find_body("PLUTO", method=method)
    off = unknown.state.bodies[-1].pixel_line - truth.bodies["PLUTO"]
    assert off @ np.linalg.solve(unknown.state.bodies[-1].covariance_px2, off) < 9.0
    assert np.hypot(*off) > {"ellipse": 0.02, "disk": 0.005}[method]  # what it does move


@pytest.mark.slow
def test_a_file_of_decisions_is_all_that_a_night_needs(starless_truth, tmp_path):
    truth = starless_truth
    bare = _without_geometry(truth.picture, tmp_path / "bare.fit")
    with pytest.raises(ImageError, match=r"position and velocity|attitude"):
        ImageSession.open(bare, "new_horizons")
    path = _one_circle(tmp_path, by_eye(truth))
    (outcome,) = process(bare, mission="new_horizons", decisions=path, out=tmp_path / "out")
    (body,) = outcome.result["bodies"]
    assert (outcome.result["status"], body["status"]) == ("partial", "ok")
    assert np.hypot(*(np.array(body["observed"]) - truth.bodies["PLUTO"])) < 0.2
    assert outcome.result["provenance"]["attitude_source"] == "unknown"
    # What an analyst did by hand is such a file, and gives the same bits.
    session = ImageSession.resume(tmp_path / "out/bare")
    session.write_decisions(tmp_path / "recorded.yaml")
    assert load_decisions(tmp_path / "recorded.yaml") == Decisions.from_session(session)
    (repeated,) = process(bare, mission="new_horizons", decisions=tmp_path / "recorded.yaml", out=None)
    assert json_text(repeated.result["bodies"]) == json_text(outcome.result["bodies"])


@pytest.mark.slow
def test_the_few_stars_of_the_same_picture_tell_its_attitude(unknown, resolved_truths):
    """Where nobody asked for the sky until stars are looked for: five of them."""
    truth = resolved_truths[0]
    unknown.predict()
    unknown.find_stars()
    unknown.repoint()
    assert unknown.state.pointing.n_stars >= 4
    off = _apart(unknown.state.pointing.camera_from_j2000, truth)
    np.testing.assert_allclose(off[:2], 0.0, rtol=0, atol=0.3 * unknown.context.camera.pixel_scale_rad)
    assert abs(off[2]) < 2e-3
    unknown.describe_body("PLUTO", **by_eye(truth) | {"lighting_sigma_deg": 0.0})
    unknown.find_body("PLUTO")
    (observable,) = unknown.current_observables
    assert np.isfinite(observable.ra_deg)


@pytest.mark.slow
def test_a_header_without_geometry_leaves_the_attitude_to_the_stars(resolved_truths, tmp_path):
    truth = resolved_truths[0]
    (outcome,) = process(_without_geometry(truth.picture, tmp_path / "bare.fit"), mission="new_horizons",
                         decisions=_one_circle(tmp_path, by_eye(truth)))  # fmt: skip
    pointing = outcome.result["pointing"]
    assert outcome.result["provenance"]["attitude_source"] == "none"
    found = Rotation.from_quat(pointing["quaternion_camera_from_j2000"], scalar_first=True).as_matrix()
    off, sigma = _apart(found, truth), np.sqrt(np.diag(pointing["covariance_rad2"]))
    assert np.all(np.abs(off) < 3.0 * sigma)  # the velocity is not known, either: 31 arcsec of aberration
    assert sigma.max() < 3e-3


def _apart(camera_from_j2000, truth):
    return Rotation.from_matrix(camera_from_j2000 @ truth.camera_from_j2000.T).as_rotvec()


def _one_circle(folder, said):
    """Return a file of decisions that describes Pluto in bare.fit."""
    pixel, line = said["center_px"]
    path = folder / "bodies.yaml"
    path.write_text(
        f"images:\n  bare.fit:\n    bodies:\n    - {{body: PLUTO, pixel: {pixel}, line: {line}, "
        f"radius_px: {said['radius_px']}, radii_km: 1188.3}}\n"
    )
    return path


def _without_geometry(picture, path):
    """The same picture with a header that tells its time, and nothing of attitude and trajectory."""
    with fits.open(picture) as file:
        kept = ("SIMPLE", "BITPIX", "NAXIS", "NAXIS1", "NAXIS2", "EXTEND", "MISSION", "INSTRU", "SFORMAT")
        times = [key for key in file[0].header if "UTC" in key or "ET" in key or "EXP" in key]
        header = fits.Header([card for card in file[0].header.cards if card.keyword in (*kept, *times)])
        fits.PrimaryHDU(file[0].data, header).writeto(path)
    return path


@pytest.mark.slow
def test_with_a_pointing_a_described_body_has_a_direction_but_no_residual(near, resolved_truths, seen):
    truth = resolved_truths[0]
    near.describe_body("PLUTO", **by_eye(truth))
    near.find_body("PLUTO")
    (observable,) = near.current_observables
    assert observable.status == "ok"
    assert observable.residual_px is None
    true = near.camera_from_j2000.T @ near.context.camera.unproject(truth.bodies["PLUTO"][None])[0]
    ra, dec = np.radians([observable.apparent_ra_deg, observable.apparent_dec_deg])
    got = [np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)]
    assert np.linalg.norm(got - true) < 0.3 * near.context.camera.pixel_scale_rad
    assert f"{observable.ra_deg:.6f}"[:9] in tdm_text([observable])
    with pytest.raises(EstimationError, match="nothing to estimate"):
        estimate([observable], ("spacecraft_position",))


@pytest.mark.slow
def test_a_described_body_stays_where_it_was_put_when_the_pointing_changes(unknown, resolved_truths):
    said = by_eye(resolved_truths[0]) | {"lighting_sigma_deg": 0.0}
    unknown.predict()
    unknown.describe_body("PLUTO", **said)
    for place in (lambda: None, lambda: unknown.nudge(5.0, -7.0, 0.3)):
        place()
        np.testing.assert_allclose(
            unknown.predict_body("PLUTO").pixel_line, said["center_px"], rtol=0, atol=1e-6
        )
    # Said again, it is found again.
    unknown.find_body("PLUTO", method="ellipse")
    first = unknown.state.bodies[-1]
    unknown.describe_body("PLUTO", **said | {"phase_deg": 30.0, "sun_deg": 10.0})
    assert not np.array_equal(unknown.state.bodies[-1].pixel_line, first.pixel_line)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"radius_px": None}, "give radius_px or range_km"),
        ({"radii_km": None}, "Give radii_km"),
        ({"radii_km": (1.0, -1.0, 1.0)}, "three positive"),
        ({"radii_km": (1.0, 1.0)}, "3 finite numbers"),
        ({"phase_deg": 190.0}, "0 .full. to 180"),
        ({"range_km": 10.0}, "inside a body"),
        ({"center_px": (np.nan, 1.0)}, "2 finite numbers"),
    ],
)
def test_what_cannot_be_is_told_and_leaves_nothing(unknown, resolved_truths, change, message):
    before = len(unknown.journal)
    with pytest.raises(SessionError, match=message):
        unknown.describe_body(change.pop("name", "VULCAN"), **by_eye(resolved_truths[0]) | change)
    assert len(unknown.journal) == before
    assert not unknown.state.assisted


@pytest.mark.slow
@pytest.mark.realdata
def test_enceladus_as_cassini_saw_it_from_a_circle_alone(data_dir, tmp_path):
    """A flight picture without kernels; its sky is coded in steps that hide the noise.

    Its limb pieces, with sky and Sun by hand, lay at pixel 513.3, line 601.4, 143,200 km away.
    """
    path = tmp_path / "bodies.yaml"
    path.write_text(
        'images:\n  "*":\n    bodies:\n    - {body: ENCELADUS, pixel: 520, line: 592, radius_px: 300, '
        "radii_km: [256.6, 251.4, 248.3], north_deg: -63.2, sub_observer_deg: [180, 0]}\n"
    )
    picture = data_dir / "images" / "resolved" / "N1489034146_2.IMG"
    (outcome,) = process(picture, mission="cassini", decisions=path)
    (body,) = outcome.result["bodies"]
    assert (outcome.result["status"], body["method"], body["status"]) == ("partial", "ellipse", "ok")
    off = np.array(body["observed"]) - [513.3, 601.4]
    # 3.9, at a sigma of 4.3: along the Sun's direction the center goes with size and Sun.
    assert np.hypot(*off) < 4.5
    assert abs(off[1]) < 0.5
    assert np.all(np.abs(off) < 2.0 * np.sqrt(np.diag(body["covariance_px2"])))
    assert body["measured_range_km"] == pytest.approx(143_200.0, rel=0.01)  # 142,050
    assert body["range_sigma_km"] < 1500.0  # 1,280
    path.write_text(path.read_text().replace("body: ENCELADUS", "body: ENCELADUS, lighting_sigma_deg: 0"))
    (scans,) = process(picture, mission="cassini", decisions=path, method="limb_scan")[0].result["bodies"]
    assert scans["status"] == "ok"
    # 3.7: a Sun that is believed exactly, 6 deg from where it is by hand, draws the center along.
    assert np.hypot(*(np.array(scans["observed"]) - [513.3, 601.4])) < 4.5
    assert scans["covariance_px2"][0][0] < body["covariance_px2"][0][0]
