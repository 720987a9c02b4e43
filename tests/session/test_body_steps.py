"""Bodies in a session: the method that suits, circles, limb scans, neighbours, joint centers, and what the result says."""

import json
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from opnav_workbench.errors import KernelError, MissionError, SessionError
from opnav_workbench.files import json_text
from opnav_workbench.kernels.dsk_files import write_dsk
from opnav_workbench.mission import TargetSurface, load_mission
from opnav_workbench.render import FigureUncertainty
from opnav_workbench.session import BODY_METHODS, ImageSession
from opnav_workbench.session.body_models import body_model, body_model_if_known, body_picture

RIGHT_PX = 0.1  # of a body of uniform albedo, 10 to 50 px wide; what the methods can is tested where they are
METHODS = ("cross_correlation", "least_squares", "limb_scan", "ellipse")


def _center(session, name, method=None):
    found = [b for b in session.state.bodies if b.name == name and method in (None, b.method)]
    return found[-1]


def _error(session, truth, name, method=None):
    return np.hypot(*(_center(session, name, method).pixel_line - truth.bodies[name]))


# -- methods -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_large_disk_of_unknown_albedo_is_found_by_its_limb(near, resolved_truths):
    near.find_body("PLUTO")
    center = _center(near, "PLUTO")
    assert (center.method, center.status) == ("disk", "ok")
    assert near.journal[-1].parameters["method"] == "auto"
    assert _error(near, resolved_truths[0], "PLUTO") < RIGHT_PX


@pytest.mark.slow
def test_a_body_whose_surface_is_known_is_found_by_its_whole_disk(near, resolved_truths, tmp_path):
    mission = _with_map(tmp_path)
    session = ImageSession.open(resolved_truths[0].picture, mission)
    session.predict()
    session.find_stars()
    session.repoint()
    session.find_body("PLUTO")
    assert _center(session, "PLUTO").method == "least_squares"
    assert _error(session, resolved_truths[0], "PLUTO") < RIGHT_PX


def _with_map(folder):
    """The New Horizons mission with a (uniform) albedo map of Pluto."""
    mission = load_mission("new_horizons")
    np.save(folder / "map.npy", np.full((18, 36), 0.5))
    text = mission.path.read_text().replace("cameras/", f"{mission.path.parent}/cameras/")
    text = text.replace("target_stars: stars.yaml", f"target_stars: {mission.path.parent}/stars.yaml")
    old = "PLUTO: {law: {law: lunar_lambert, lunar_weight: 0.5}}"
    assert old in text
    new = "PLUTO: {law: {law: lunar_lambert, lunar_weight: 0.5}, albedo_map: {file: map.npy}}"
    (folder / "mission.yaml").write_text(text.replace(old, new))
    return folder / "mission.yaml"


def test_centerfinders_are_told_how_far_a_figure_may_be_wrong(near):
    near.add_target("PLUTO")
    near.add_target("CHARON")
    known = MappingProxyType({"PLUTO": TargetSurface(size_sigma=0.001, limb_roughness=0.002)})
    context = replace(near.context, mission=replace(near.context.mission, target_surfaces=known))
    assert body_model_if_known(context, near.inputs, "PLUTO").figure == FigureUncertainty(0.001, 0.05, 0.002)
    assert body_model_if_known(context, near.inputs, "CHARON").figure == FigureUncertainty()


def test_a_sphere_for_a_body_of_unknown_orientation_may_be_as_wrong_as_its_radii_differ(near):
    near.add_target("PLUTO")
    radii = np.array([1250.0, 1250.0, 1000.0])
    target = replace(near.inputs.targets["PLUTO"], radii_km=radii, body_from_j2000=None)
    figure = body_model_if_known(
        near.context, replace(near.inputs, targets={"PLUTO": target}), "PLUTO"
    ).figure
    assert figure.size_sigma == FigureUncertainty().size_sigma
    assert 0.1 < figure.axes_sigma < 0.13  # log-radii scatter by 0.105, and the default adds to it


def test_a_shape_model_is_trusted_more_than_an_ellipsoid(near, tmp_path):
    near.add_target("PLUTO")
    corners = 1188.0 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    plates = [
        (a, b, c) if (a + b + c) % 2 == 0 else (b, a, c) for a in (1, 2) for b in (3, 4) for c in (5, 6)
    ]
    lines = ["v {} {} {}".format(*v) for v in corners] + ["f {} {} {}".format(*p) for p in plates]
    (tmp_path / "octahedron.obj").write_text("\n".join(lines))
    for stated, expected in ((None, 0.02), (0.07, 0.07)):
        surface = TargetSurface(shape=tmp_path / "octahedron.obj", axes_sigma=stated)
        mission = replace(near.context.mission, target_surfaces=MappingProxyType({"PLUTO": surface}))
        model = body_model_if_known(replace(near.context, mission=mission), near.inputs, "PLUTO")
        assert model.shape is not None
        assert model.figure.axes_sigma == expected
    # In meters, taken for km: Pluto was a point of 1 m, and `ok` 8 sigmas off.
    surface = TargetSurface(shape=tmp_path / "octahedron.obj", shape_unit="m")
    mission = replace(near.context.mission, target_surfaces=MappingProxyType({"PLUTO": surface}))
    with pytest.raises(
        MissionError, match=r"reaches 1.188 km, its radii are stated as 1188 km; give the shape's unit"
    ):
        body_model(replace(near.context, mission=mission), near.inputs, "PLUTO")


@pytest.mark.slow(keep=["limb_scan", "ellipse"])
@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_pluto_and_says_so_in_the_result(near, resolved_truths, method):
    near.find_body("PLUTO", method)
    near.observables()
    assert _error(near, resolved_truths[0], "PLUTO", method) < RIGHT_PX
    body = json.loads(near.to_json())["bodies"][0]
    assert (body["name"], body["method"]) == ("PLUTO", method)
    assert body["diameter_px"] == pytest.approx(47.25, abs=0.1)
    assert (body["scans_used"] is not None) == (method == "limb_scan")
    assert body["chi2_reduced"] > 0.0
    assert np.all(np.linalg.eigvalsh(body["noise_covariance_px2"]) > 0.0)
    assert body["range_km"] == pytest.approx(2.533e6, rel=1e-3)


@pytest.mark.slow
def test_a_solved_range_and_its_diameter_stand_in_result_and_table(near):
    near.find_body("PLUTO", "least_squares", solve_range=True)
    table = near.observables()
    body = json.loads(near.to_json())["bodies"][0]
    # What the methods can is tested where they are; 0.05 px is a thousandth of the diameter.
    assert abs(body["measured_diameter_px"] - body["diameter_px"]) < 0.05
    assert body["measured_range_km"] == pytest.approx(body["range_km"], rel=1e-3)
    assert 0.0 < body["diameter_sigma_px"] < 0.05
    assert 0.0 < body["range_sigma_km"] < 1e-3 * body["range_km"]
    assert table["measured_diameter"][0].value == body["measured_diameter_px"]


@pytest.mark.slow
def test_the_same_request_replaces_its_older_answer(near):
    near.find_body("PLUTO", "ellipse")
    near.find_body("PLUTO")
    near.find_body("PLUTO", "disk")
    near.find_body("PLUTO", search_radius_px=20.0)
    assert [b.method for b in near.state.bodies] == ["ellipse", "disk"]
    assert len(near.state.requests) == 2


def test_one_sure_method_is_enough_for_the_result(near):
    near.find_body("PLUTO", "unresolved")  # too large for it
    near.observables()
    result = near.result()
    assert (result["status"], result["bodies"][0]["status"]) == ("partial", "failed")
    near.find_body("PLUTO")
    assert near.result()["status"] == "ok"
    assert [body["status"] for body in near.result()["bodies"]] == ["failed", "ok"]


def test_off_the_detector_is_a_status(near):
    near.find_body("CHARON")
    assert _center(near, "CHARON").status == "off_detector"
    assert _center(near, "CHARON").pixel_line is None


def test_a_body_that_cannot_be_drawn_is_a_status(near, monkeypatch):
    near.add_target("PLUTO")
    dark = replace(near.inputs.targets["PLUTO"], sun_position_km=None)
    targets = type(near.inputs.targets)({**near.inputs.targets, "PLUTO": dark})
    session = ImageSession(near.context, near.source, replace(near.inputs, targets=targets))
    session.find_body("PLUTO", "least_squares")
    assert _center(session, "PLUTO").status == "failed"
    assert "Sun" in _center(session, "PLUTO").messages[0]


def test_unknown_methods_are_answered_with_the_known(near):
    for method in ("eye", ""):
        with pytest.raises(SessionError, match=", ".join(BODY_METHODS)):
            near.find_body("PLUTO", method)
    with pytest.raises(SessionError, match="least_squares"):
        near.find_bodies(["PLUTO", "CHARON"], "limb_scan")
    with pytest.raises(SessionError, match="two bodies or more"):
        near.find_bodies(["PLUTO"])
    with pytest.raises(SessionError, match=r"circle is \(pixel, line, radius"):
        near.find_body("PLUTO", circle=(1.0, 2.0))


@pytest.mark.slow
def test_a_shape_among_the_kernels_is_drawn(near, resolved_truths, tmp_path):
    """An octahedron in Pluto's place: not its shape, and its least squares say so."""
    r = 1188.3
    corners = [[r, 0, 0], [-r, 0, 0], [0, r, 0], [0, -r, 0], [0, 0, r], [0, 0, -r]]
    plates = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    from opnav_workbench.kernels import KernelSet

    write_dsk(tmp_path / "pluto.bds", corners, plates, 999, "IAU_PLUTO")
    session = ImageSession.open(resolved_truths[0].picture, "new_horizons")
    with KernelSet([*(k.path for k in KernelSet.active().kernels()), tmp_path / "pluto.bds"]):
        session.predict()
        session.add_target("PLUTO")
        assert session.inputs.shapes["PLUTO"] == tmp_path / "pluto.bds"
        session.save(tmp_path / "run")
        session.find_stars()
        session.repoint()
        session.find_body("PLUTO", "least_squares")
    assert ImageSession.resume(tmp_path / "run").inputs.shapes == session.inputs.shapes
    near.find_body("PLUTO", "least_squares")
    with_shape, sphere = _center(session, "PLUTO"), _center(near, "PLUTO")
    assert with_shape.chi2_reduced > 3.0 * sphere.chi2_reduced


# -- circles and scans ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_analysts_circle_is_where_every_method_starts(near, resolved_truths):
    truth = resolved_truths[0].bodies["PLUTO"]
    near.set_circle("PLUTO", truth + np.array([3.0, -2.0]), 24.0)
    near.find_body("PLUTO")
    assert _error(near, resolved_truths[0], "PLUTO") < RIGHT_PX
    assert near.result()["provenance"]["circles"][0]["radius_px"] == 24.0
    near.set_circle("PLUTO", (200.0, 40.0), 24.0)  # empty sky
    near.find_body("PLUTO")
    assert _center(near, "PLUTO").status in ("not_detected", "failed")
    near.clear_circle("PLUTO")
    near.find_body("PLUTO")
    assert _error(near, resolved_truths[0], "PLUTO") < RIGHT_PX
    with pytest.raises(SessionError, match="no circle to clear"):
        near.clear_circle("PLUTO")


def test_a_circle_for_one_search_decides_nothing(near, resolved_truths):
    near.find_body("PLUTO", circle=(*resolved_truths[0].bodies["PLUTO"], 23.0))
    assert near.state.circles == {}
    assert _center(near, "PLUTO").status == "ok"


@pytest.mark.slow
def test_chosen_scans_make_the_standing_center_anew(near, resolved_truths):
    near.find_body("PLUTO", "limb_scan")
    near.observables()
    automatic = _center(near, "PLUTO")
    used = automatic.detail.used.tolist()
    chosen = used[::3]
    near.choose_scans("PLUTO", chosen, "even surface")
    mine = _center(near, "PLUTO")
    assert set(mine.detail.used.tolist()) <= set(chosen)
    assert _error(near, resolved_truths[0], "PLUTO") < RIGHT_PX
    np.testing.assert_array_equal(near.state.observables[0].observed_px, mine.pixel_line)
    result = near.result()
    assert result["bodies"][0]["scans_used"] == len(mine.detail.used)
    assert result["provenance"]["limb_scans"] == [
        {"body": "PLUTO", "numbers": tuple(chosen), "reason": "even surface"}
    ]
    near.choose_scans("PLUTO", None)
    np.testing.assert_array_equal(_center(near, "PLUTO").pixel_line, automatic.pixel_line)
    near.undo()
    near.undo()
    assert _center(near, "PLUTO") is automatic


def test_scans_chosen_before_the_search_are_used_by_it(near):
    near.choose_scans("PLUTO", range(0, 180, 4))
    near.find_body("PLUTO")
    assert set(_center(near, "PLUTO").detail.used.tolist()) <= set(range(0, 180, 4))


def test_predicting_again_keeps_circles_scans_and_notes(near):
    near.set_circle("PLUTO", (120.0, 134.0), 24.0)
    near.choose_scans("PLUTO", [1, 2, 3])
    near.note("hazy")
    near.predict()
    assert near.state.circles["PLUTO"].radius_px == 24.0
    assert near.state.scan_choices["PLUTO"].numbers == (1, 2, 3)
    assert near.state.user_notes == ("hazy",)


# -- several bodies ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_bodies_found_together_carry_their_correlation(pair, resolved_truths):
    pair.find_bodies(["PLUTO", "CHARON"])
    pair.observables()
    for name in ("PLUTO", "CHARON"):
        assert _error(pair, resolved_truths[1], name) < RIGHT_PX
    joint = pair.state.joint[0]
    assert joint.names == ("PLUTO", "CHARON")
    assert np.all(np.linalg.eigvalsh(joint.covariance_px2) > 0.0)
    bodies = {body["name"]: body for body in pair.result()["bodies"]}
    cross = bodies["PLUTO"]["joint_covariance_px2"]["CHARON"]
    np.testing.assert_array_equal(cross, np.array(bodies["CHARON"]["joint_covariance_px2"]["PLUTO"]).T)
    # One of them found anew by itself: they are no longer joint.
    pair.find_body("CHARON", "least_squares")
    assert pair.state.joint == ()
    assert pair.result()["bodies"][0]["joint_covariance_px2"] is None


@pytest.mark.slow
@pytest.mark.parametrize("order", [("PLUTO", "CHARON"), ("CHARON", "PLUTO")])
def test_the_order_in_which_bodies_are_found_does_not_matter(pair, order):
    for name in order:
        pair.find_body(name)
    found = {body.name: body for body in pair.state.bodies}
    assert all(body.status == "ok" for body in found.values())
    other = ImageSession(pair.context, pair.source, pair.inputs)
    other.predict()
    other.find_stars()
    other.repoint()
    for name in reversed(order):
        other.find_body(name)
    for body in other.state.bodies:
        np.testing.assert_allclose(body.pixel_line, found[body.name].pixel_line, atol=0.02)


@pytest.mark.slow
def test_a_neighbour_that_is_added_later_has_the_others_found_again(opened, demo_truths):
    """Without Charon, nine pixels off, the light beside Pluto is a riddle; with it, it is not."""
    opened.predict()
    opened.find_stars()
    opened.repoint()
    alone = replace(opened.context, mission=replace(opened.context.mission, default_targets=()))
    session = ImageSession(alone, opened.source, opened.inputs)
    session.predict()
    session.find_stars()
    session.repoint()
    session.find_body("PLUTO")
    session.observables()
    before = _center(session, "PLUTO")
    session.add_target("CHARON")
    after = _center(session, "PLUTO")
    assert after is not before
    assert after.status == "ok"
    assert session.state.observables[0].status == "ok"
    opened.find_body("PLUTO")  # the mission knows that Charon is there
    np.testing.assert_allclose(_center(opened, "PLUTO").pixel_line, after.pixel_line, atol=1e-6)
    assert _center(opened, "PLUTO").status == "ok"


@pytest.mark.slow
def test_a_body_beside_one_that_was_found_far_off_is_looked_for_there_too(pair, resolved_truths):
    """An ephemeris that is off by more than the search goes is off for the whole system."""
    off = np.array([60.0, -45.0])  # px at Charon's distance: 2.5 radii of Pluto, 12 of Charon
    camera, attitude = pair.context.camera, pair.camera_from_j2000
    pair.add_target("PLUTO")
    pair.add_target("CHARON")
    scale = camera.pixel_scale_rad * np.linalg.norm(pair.inputs.targets["PLUTO"].position_km)
    move = (attitude.T @ camera.focal_from_camera.T @ [*off, 0.0]) * scale
    targets = {
        name: replace(target, position_km=target.position_km + move)
        for name, target in pair.inputs.targets.items()
    }
    inputs = replace(pair.inputs, targets=type(pair.inputs.targets)(targets))
    session = ImageSession(pair.context, pair.source, inputs)
    session.predict()
    session.find_stars()
    session.repoint()
    session.find_body("PLUTO", search_radius_px=100.0)
    session.find_body("CHARON")
    for name in ("PLUTO", "CHARON"):
        assert _error(session, resolved_truths[1], name) < 0.3


# -- stars and bodies ----------------------------------------------------------------------------------------------


def test_the_light_of_a_disk_is_no_field_of_stars(near, resolved_truths):
    from opnav_workbench.session.star_field import star_detections

    place = resolved_truths[0].bodies["PLUTO"]
    n_line, n_pixel = near.context.extended.shape
    line, pixel = np.indices((n_line, n_pixel))
    distance = np.hypot(pixel - place[0], line - place[1])
    assert near.context.extended[distance < 20.0].all()
    assert not near.context.extended[distance > 40.0].any()
    found = star_detections(near.context).pixel_line
    assert np.hypot(*(found - place).T).min() > 24.0
    assert near.state.pointing.n_stars >= 4


@pytest.mark.slow
def test_a_star_behind_a_body_is_said_to_be_there(near):
    """A catalog star put behind Pluto's center: nobody can see it, and the result says why."""
    near.find_body("PLUTO")
    attitude, camera = near.camera_from_j2000, near.context.camera
    direction = camera.unproject(_center(near, "PLUTO").pixel_line[None])[0] @ attitude
    stars = near.inputs.stars
    row = int(np.argmax(stars.mag))
    ra, dec = np.array(stars.ra_rad), np.array(stars.dec_rad)
    aberrated = (
        near.state.a_priori.directions[0]
        - stars.directions(near.inputs.et, near.inputs.observer.position_km)[
            stars.id.tolist().index(str(near.state.a_priori.id[0]))
        ]
    )
    geometric = direction - aberrated
    ra[row] = np.arctan2(geometric[1], geometric[0])
    dec[row] = np.arcsin(geometric[2] / np.linalg.norm(geometric))
    mag = np.array(stars.mag)
    mag[row] = 8.0
    inputs = replace(near.inputs, stars=replace(stars, ra_rad=ra, dec_rad=dec, mag=mag))
    session = ImageSession(near.context, near.source, inputs)
    session.predict()
    session.add_target("PLUTO")
    session.find_stars()
    session.repoint()
    session.find_stars()
    star = next(s for s in session.result()["stars"] if s["id"] == str(stars.id[row]))
    assert star["status"] == "not_detected"
    assert "behind" in star["reason"]


# -- replay --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_everything_with_bodies_resumes_to_the_same_bits(near, tmp_path):
    near.set_circle("PLUTO", (121.0, 134.0), 23.0)
    near.find_body("PLUTO", "limb_scan")
    near.choose_scans("PLUTO", _center(near, "PLUTO").detail.used.tolist()[::2], "fewer")
    near.find_body("CHARON")
    near.find_body("PLUTO", "ellipse")
    near.undo()
    near.redo()
    near.observables()
    near.save(tmp_path)
    resumed = ImageSession.resume(tmp_path)
    expected = near.result()
    got = resumed.result()
    del expected["provenance"]["kernels"], got["provenance"]["kernels"]
    assert json_text(got) == json_text(expected)


def test_centerfinders_are_told_which_lights_are_stars_once_the_pointing_is(near):
    near.add_target("PLUTO")
    state, names = near.state, ("PLUTO",)
    told = body_picture(near.context, near.inputs, state, names, names)
    used = state.mask("used")
    assert len(told.stars_px) >= used.sum() >= 4
    away = np.hypot(*(told.stars_px[:, None] - state.centers.pixel_line[used]).T)
    assert away.min(axis=1).max() < 0.5
    assert told.stars_known_dn == state.centers.flux_dn[used].min() > 0.0
    lost = body_picture(near.context, near.inputs, state.replace(pointing=None), names, names)
    assert lost.stars_px is None


def test_a_body_has_one_name(near):
    with pytest.raises(KernelError, match="in capitals, PLUTO"):
        near.find_body("pluto")
