"""What a target's center is worth with the pointing that it rests on, and what of it is given out."""

import json
from dataclasses import replace

import numpy as np
import pytest
from astropy.table import QTable

from opnav_workbench.geometry import geometric_direction
from opnav_workbench.kernels import KernelSet
from opnav_workbench.session import ImageSession
from opnav_workbench.session.pointing import with_observables
from opnav_workbench.session.result import result_dict

# With Pluto 47 px wide in the middle of 256 x 256 px, Charon is outside; the Sun stands behind the camera.
BEHIND, OUTSIDE = "SUN", "CHARON"
APPROACH = "new_horizons/pluto_approach"


def _result(session, **changes):
    """The result of a session with parts of its state changed."""
    state = session.state.replace(**changes)
    state = with_observables(session.context, session.inputs, state)
    return result_dict(session.context, session.source, session.inputs, state)


def _body(result, name="PLUTO"):
    (found,) = [body for body in result["bodies"] if body["name"] == name]
    return found


@pytest.fixture(scope="module")
def found_once(solved_sessions, copy_of):
    session = copy_of(solved_sessions[0])
    with KernelSet(APPROACH):
        session.find_body("PLUTO", "least_squares")
    assert session.state.bodies[0].status == "ok"
    return session


@pytest.fixture
def found(found_once, copy_of, approach):
    return copy_of(found_once)


# -- a target is never ok on a pointing that is unsolved or unsure -------------------------------------------------


def test_a_target_on_a_sure_pointing_is_ok(found):
    result = _result(found)
    assert (result["status"], _body(result)["status"], _body(result)["messages"]) == ("ok", "ok", ())


@pytest.mark.parametrize(
    ("doubt", "said"),
    [
        (lambda s: {"pointing": None}, "the pointing is not solved"),
        (
            lambda s: {"star_field": replace(s.star_field, sure=False)},
            "the star field is not identified for sure",
        ),
    ],
)
def test_a_target_on_an_unsure_pointing_is_uncertain_with_the_reason(found, doubt, said):
    changes = doubt(found.state)
    result, before = _result(found, **changes), found.state.bodies[0]
    body = _body(result)
    assert result["status"] in ("partial", "failed")
    assert body["status"] == "uncertain"
    assert any(said in message for message in body["messages"])
    # On the detector it stays measured: its place and its covariance are the center's own.
    np.testing.assert_array_equal(body["observed"], before.pixel_line)
    np.testing.assert_array_equal(body["covariance_px2"], before.covariance_px2)
    assert before.status == "ok"


def test_a_twist_that_is_not_solved_is_in_the_covariance_and_no_doubt(found):
    result = _result(found, pointing=replace(found.state.pointing, twist_solved=False))
    assert (result["status"], _body(result)["status"]) == ("partial", "ok")


def test_a_field_that_the_analyst_confirmed_star_by_star_is_sure(found):
    used = found.state.a_priori.id[found.state.mask("used")].tolist()
    unsure = replace(found.state.star_field, sure=False)
    found.accept_stars(used[1:], "seen")
    assert _body(_result(found, star_field=unsure))["status"] == "uncertain"
    found.accept_stars(used[:1], "seen")
    result = _result(found, star_field=unsure)
    assert (result["status"], _body(result)["status"]) == ("ok", "ok")
    assert result["identification"]["sure"]  # a decision outranks what the search made of it


@pytest.mark.slow
def test_files_say_the_same_as_the_result(found, tmp_path):
    found.reject_stars(found.state.a_priori.id.tolist(), "clouds")
    found.repoint()
    found.save(tmp_path)
    body = json.loads((tmp_path / "result.json").read_text())["bodies"][0]
    table = QTable.read(tmp_path / "observables.ecsv", format="ascii.ecsv")
    assert body["status"] == table["status"][0] == "uncertain"
    assert body["messages"]
    assert ImageSession.resume(tmp_path).result()["bodies"][0]["status"] == "uncertain"


# -- a target outside the field ------------------------------------------------------------------------------------


@pytest.mark.slow(keep=[OUTSIDE])
@pytest.mark.parametrize("name", [BEHIND, OUTSIDE])
def test_a_target_outside_the_field_does_not_spoil_the_picture(found, name):
    for method in ("auto", "ellipse"):
        found.find_body(name, method)
        result = found.result()
        assert _body(result)["status"] == "ok"
        assert [b["status"] for b in result["bodies"] if b["name"] == name][-1] == "off_detector"
        assert result["status"] == "ok"
        assert any(name in message for message in result["messages"])


@pytest.mark.slow(keep=["ellipse"])
@pytest.mark.parametrize("method", ["limb_scan", "ellipse", "least_squares"])
def test_the_sun_as_a_target_keeps_no_body_from_being_found(near, method):
    near.add_target("SUN")
    near.find_body("PLUTO", method)
    assert near.state.bodies[0].status == "ok"


def test_a_target_just_outside_that_was_searched_in_vain_is_off_the_detector(found):
    """Its ephemeris might have been off by enough to bring it in."""
    camera, sky = found.context.camera, found.inputs.observer.velocity_km_s
    found.add_target("CHARON")
    charon, lost = found.inputs.targets["CHARON"], replace(found.state.bodies[0], name="CHARON")
    lost = replace(lost, status="not_detected", pixel_line=None)
    for outside_px, told, status in ((5.0, "not_detected", "partial"), (20.0, "off_detector", "ok")):
        apparent = camera.unproject(np.array([[-0.5 - outside_px, 100.0]]))[0] @ found.camera_from_j2000
        place = charon.range_km * geometric_direction(apparent, sky)
        targets = {**found.inputs.targets, "CHARON": replace(charon, position_km=place)}
        state = found.state.replace(bodies=(*found.state.bodies, lost))
        inputs = replace(found.inputs, targets=targets)
        result = result_dict(found.context, found.source, inputs, state)
        assert _body(result, "CHARON")["diameter_px"] == pytest.approx(24.2, abs=0.1)
        assert (_body(result, "CHARON")["status"], result["status"]) == (told, status)


def test_a_target_in_the_field_that_was_not_found_spoils_it(found):
    lost = replace(found.state.bodies[0], status="not_detected", pixel_line=None)
    assert _result(found, bodies=(lost,))["status"] == "partial"


def test_a_target_whose_limb_alone_lies_off_the_detector_is_in_the_field(found):
    """Nearer than its disk fits into the picture: nobody measured what was asked for, and it is there."""
    lost = replace(found.state.bodies[0], status="off_detector", pixel_line=None)
    assert _result(found, bodies=(lost,))["status"] == "partial"


# -- a center that was found is in the result ----------------------------------------------------------------------


def test_a_center_is_in_result_and_files_without_asking_for_observables(found, tmp_path):
    found.save(tmp_path)
    body = json.loads((tmp_path / "result.json").read_text())["bodies"][0]
    assert (body["name"], body["status"]) == ("PLUTO", "ok")
    table = QTable.read(tmp_path / "observables.ecsv", format="ascii.ecsv")
    assert table["body"].tolist() == ["PLUTO"]
    before = found.to_json()
    found.observables()
    assert found.to_json() == before


def test_a_center_that_is_in_doubt_makes_the_picture_partial_without_asking_for_observables(found):
    doubtful = replace(found.state.bodies[0], status="uncertain", messages=("why",))
    state = found.state.replace(bodies=(doubtful,))
    assert not state.observables
    assert result_dict(found.context, found.source, found.inputs, state)["status"] == "partial"


def test_observables_follow_a_target_that_is_added_later(pair):
    pair.find_body("PLUTO", "least_squares")
    pair.observables()
    pair.add_target("CHARON")
    np.testing.assert_array_equal(pair.state.observables[0].observed_px, pair.state.bodies[0].pixel_line)


# -- the range from a body's size ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_range_is_given_out_by_a_center_that_is_ok_alone(near):
    near.find_body("PLUTO", "ellipse")
    center = near.state.bodies[0]
    assert center.status == "ok"
    body = _body(_result(near))
    assert (body["measured_range_km"], body["range_sigma_km"]) == (center.range_km, center.range_sigma_km)
    for worse in (
        replace(center, status="uncertain"),
        replace(center, range_sigma_km=np.nan),
        replace(center, range_sigma_km=0.0),
    ):
        body = _body(_result(near, bodies=(worse,)))
        assert np.isnan(body["measured_range_km"])
        assert np.isnan(body["range_sigma_km"])
