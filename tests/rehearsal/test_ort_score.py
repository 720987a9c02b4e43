"""The score of a rehearsal, without pictures: sigma levels, verdicts on pictures, bodies, stars, grade, log."""

import json
from dataclasses import replace

import numpy as np
import pytest
from astropy import units as u
from scipy.stats import chi2, norm

from opnav_workbench.camera import Camera
from opnav_workbench.errors import SessionError
from opnav_workbench.geometry import camera_from_j2000, quaternion_from_matrix, rotation_from_vector
from opnav_workbench.rehearsal.results import PictureResult, picture_results
from opnav_workbench.rehearsal.score import RULE, SECTIONS, grade_rehearsal
from opnav_workbench.rehearsal.sealed_truth import log_path, logged_delivery
from opnav_workbench.rehearsal.solution import SOLUTION_FILE, OrtSolution
from opnav_workbench.rehearsal.truth_checks import (
    SolutionScore,
    check_against_truth,
    score_picture,
    score_stars,
    sigma_ratios,
)
from opnav_workbench.report.rehearsal import solution_page
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.simulation import Truth
from opnav_workbench.simulation.picture import Trails
from opnav_workbench.simulation.truth import BodyTruth, body_rows, star_rows, truth_table

SIGMA_PX = 0.1
ATTITUDE = camera_from_j2000(4.7, -0.25, 0.7, np.eye(3))


@pytest.fixture(scope="module")
def camera():
    return Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml")


def body(name, place, *, on_detector=True, occulted=0.0):
    return BodyTruth(
        name, np.array(place, float), np.array(place, float), 1e6, 10.0, 50.0, on_detector, occulted
    )


@pytest.fixture
def truth(tmp_path):
    """Six stars, the last two too faint to find; Pluto in the field, Charon off it."""
    places = np.array([[100, 100], [900, 120], [500, 800], [300, 640], [700, 300], [200, 900]], float)
    trails = Trails(places, places, np.zeros(6))
    flux = np.array([9e4, 8e4, 7e4, 6e4, 2e3, 1e3])
    stars = star_rows(
        [f"S{i}" for i in range(6)], np.arange(6) + 8.0, flux, trails, np.ones(6, bool), np.zeros(6, bool)
    )
    bodies = body_rows([body("PLUTO", (400.0, 500.0)), body("CHARON", (1500.0, 500.0), on_detector=False)])
    return Truth(
        tmp_path / "a.fit",
        "new_horizons",
        "LORRI 1x1",
        "2015-07-01T00:00:00",
        1.0,
        0.1,
        ATTITUDE,
        ATTITUDE,
        truth_table(stars, bodies),
    )


def result(truth, *, off_px=0.0, turned_rad=(0.0, 0.0, 0.0), star_off_px=0.0, sigma_rad=1e-6):
    """A result.json of that picture, with as much wrong as asked."""
    rows = truth.objects[truth.objects["kind"] == "star"]
    stars = [
        {
            "id": str(row["id"]),
            "status": "used" if i < 4 else "not_detected",
            "observed": [
                row["pixel"].to_value(u.pix) + (star_off_px if i == 0 else 0.0),
                row["line"].to_value(u.pix),
            ]
            if i < 4
            else None,
            "sigma_px": [0.02, 0.02],
            "snr": row["flux"].value / 1e3,
        }
        for i, row in enumerate(rows)
    ]
    turned = rotation_from_vector(np.array(turned_rad)) @ ATTITUDE
    pointing = {
        "quaternion_camera_from_j2000": quaternion_from_matrix(turned).tolist(),
        "covariance_rad2": (sigma_rad**2 * np.eye(3)).tolist(),
    }
    pluto = {
        "name": "PLUTO",
        "method": "limb_scan",
        "status": "ok",
        "observed": [400.0 + off_px, 500.0],
        "covariance_px2": (SIGMA_PX**2 * np.eye(2)).tolist(),
        "diameter_px": 50.0,
    }
    return {"status": "ok", "pointing": pointing, "stars": stars, "bodies": [pluto]}


def picture(truth, camera, content, *, name="a", lost="", targets=("PLUTO", "CHARON"), disk=0.0):
    reported = PictureResult(name, content["status"], tuple(content.get("messages", ())), content)
    return score_picture(reported, truth, camera, targets, lost=lost, utc=truth.utc, disk_sigma_px=disk)


def test_sigma_level_is_that_of_the_probability():
    """Two components, correlated: the level of a normal error that is as improbable as the Mahalanobis distance."""
    covariance = np.array([[1.0, 0.6], [0.6, 2.0]])
    error = np.array([1.5, -2.0])
    check = check_against_truth("x", ("a", "b"), ("px", "px"), error, np.zeros(2), covariance)
    square = error @ np.linalg.solve(covariance, error)
    assert check.sigmas == pytest.approx(norm.isf(0.5 * chi2.sf(square, 2)), rel=1e-9)
    assert check.component_sigmas == pytest.approx(error / np.sqrt([1.0, 2.0]))


@pytest.mark.parametrize(("off", "verdict"), [(2.9, "good"), (3.1, "poor"), (4.9, "poor"), (5.1, "wrong")])
def test_verdict_by_sigmas(off, verdict):
    assert check_against_truth("x", ("",), ("km",), [off], [0.0], [[1.0]]).verdict == verdict


def test_singular_covariance_gives_no_credit():
    assert (
        check_against_truth("x", ("a", "b"), ("km", "km"), [1.0, 1.0], [0.0, 0.0], np.zeros((2, 2))).verdict
        == "wrong"
    )


def test_sigma_ratios_see_the_worst_direction():
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    claimed = turn @ np.diag([0.01, 4.0]) @ turn.T
    assert sigma_ratios(claimed, np.eye(2)) == pytest.approx((0.1, 2.0))


def test_a_good_picture(truth, camera):
    found = picture(truth, camera, result(truth))
    assert found.verdict == "good"
    assert found.pointing.sigmas == pytest.approx(0.0, abs=1e-6)
    assert (found.stars.found, found.stars.missed, found.stars.false) == (4, (), ())
    assert [c.verdict for c in found.centers] == ["good", "absent"]


def test_errors_are_seen(truth, camera):
    """Center 0.4 px off is 4 sigma (3.56 of a normal error in two dimensions); what the team adds for disks eases it."""
    found = picture(truth, camera, result(truth, off_px=0.4, turned_rad=(0.0, 4e-6, 0.0), star_off_px=3.0))
    assert found.centers[0].check.sigmas == pytest.approx(norm.isf(0.5 * np.exp(-8.0)), rel=1e-6)
    assert found.centers[0].verdict == "poor"
    assert found.pointing.sigmas == pytest.approx(norm.isf(0.5 * chi2.sf(16.0, 3)), rel=1e-3)
    assert abs(found.pointing.error[0]) == pytest.approx(4e-6 / camera.pixel_scale_rad, rel=0.01)
    assert found.stars.false == ("S0",)
    assert not found.stars.good
    assert picture(truth, camera, result(truth, off_px=0.4), disk=0.2).centers[0].verdict == "good"


def test_bright_star_not_found_is_missed_and_a_faint_one_not(truth):
    content = result(truth)
    content["stars"][1] |= {"status": "not_detected", "observed": None, "snr": None}
    assert score_stars(content, truth).missed == ("S1",)


def test_bodies_missed_unsure_and_invented(truth, camera):
    content = result(truth)
    content["bodies"][0] |= {"status": "uncertain"}
    assert picture(truth, camera, content).centers[0].verdict == "unsure"
    content["bodies"] = [content["bodies"][0] | {"name": "CHARON", "status": "ok"}]
    assert [c.verdict for c in picture(truth, camera, content).centers] == ["missed", "false"]


def test_lost_pictures(truth, camera):
    """Named as failed it is right; with a result claimed it costs the grade, whatever else is good."""
    failed = {"status": "failed", "messages": ["truncated"]}
    named = picture(truth, camera, failed, name="b", lost="cut off")
    claimed = picture(truth, camera, result(truth), name="b", lost="cut off")
    assert (named.verdict, claimed.verdict) == ("lost, named", "claimed though lost")
    good = picture(truth, camera, result(truth))
    assert grade_rehearsal([good, named], solution(), ()).letter == "A"
    assert grade_rehearsal([good, claimed], solution(), ()).letter == "D"
    assert "b is lost (cut off)" in grade_rehearsal([good, claimed], solution(), ()).faults[0].words
    assert picture(truth, camera, failed).verdict == "not solved"
    assert picture(truth, camera, {"status": "missing"}).verdict == "not reported"


def solution(off=0.0, ratio=(1.0, 1.0), probability=0.5):
    """A scored solution whose parameters are so many sigmas off."""
    three = check_against_truth(
        "target_position", tuple("xyz"), ("km",) * 3, [off, 0.0, 0.0], np.zeros(3), np.eye(3)
    )
    plane = check_against_truth("B-plane", ("B·T", "B·R"), ("km", "km"), [0.0, 0.0], [0.0, 0.0], np.eye(2))
    time = check_against_truth("arrival", ("time",), ("s",), [0.0], [0.0], [[1.0]])
    return SolutionScore(delivered(probability), None, (three,), three, plane, time, np.zeros(3), ratio)


def delivered(probability=0.5):
    return OrtSolution(
        package="p",
        epoch_utc="2015-07-11T09:00:00",
        parameters=("target_position",),
        correction=np.zeros(3),
        sigma_before=np.full(3, 5.0),
        covariance=np.eye(3),
        b_plane_body="PLUTO BARYCENTER",
        b_plane_before=np.zeros(3),
        b_plane_after=np.zeros(3),
        b_plane_covariance_before=25.0 * np.eye(3),
        b_plane_covariance=np.eye(3),
        chi2_before=100.0,
        chi2_after=4.0,
        degrees_of_freedom=4,
        probability=probability,
    )


@pytest.mark.parametrize(
    ("spoiled", "letter"),
    [
        ({}, "A"),
        ({"off": 4.5}, "C"),  # 3.7 sigma of a normal error in three dimensions
        ({"off": 6.5}, "F"),
        ({"ratio": (0.4, 1.0)}, "D"),
        ({"ratio": (0.1, 1.0)}, "F"),
        ({"ratio": (1.0, 4.0)}, "C"),
        ({"probability": 1e-9}, "A"),  # costs points, no more
    ],
)
def test_grade_of_a_solution(truth, camera, spoiled, letter):
    good = picture(truth, camera, result(truth))
    graded = grade_rehearsal([good], solution(**spoiled), ())
    assert graded.letter == letter
    assert graded.passed == (letter in "ABC")
    if spoiled:
        assert graded.points < 100.0


def test_points_add_up(truth, camera):
    good = picture(truth, camera, result(truth))
    graded = grade_rehearsal([good], solution(), ())
    assert sum(SECTIONS.values()) == graded.points == 100.0
    unsolved = picture(truth, camera, {"status": "failed"})
    half = grade_rehearsal([good, unsolved], solution(), ())
    # Half of the pictures, pointings, stars and centers: 15, 15, 10 and 20 points.
    assert half.points == pytest.approx(70.0)
    assert (
        grade_rehearsal([good], None, ()).letter
        == grade_rehearsal([good], solution(), ("solution.json",)).letter
        == "F"
    )
    assert all(
        name in RULE
        for name in ("pictures 15", "pointing 15", "stars 10", "centers 20", "estimate 20", "B-plane 20")
    )


def test_wrong_field_and_small_center_sigmas_are_faults(truth, camera):
    turned = picture(truth, camera, result(truth, turned_rad=(1e-4, 0.0, 0.0)))
    assert grade_rehearsal([turned], solution(), ()).letter == "D"
    off = [picture(truth, camera, result(truth, off_px=0.45)) for _ in range(6)]
    faults = grade_rehearsal(off, solution(), ()).faults
    assert any("sigmas far too small" in fault.words for fault in faults)


def test_solution_file_round_trip_and_refusals(tmp_path):
    path = tmp_path / SOLUTION_FILE
    cutoff = {"picture": "a", "et": 4.0, "pictures": 1, "b_plane": np.ones(3), "covariance": np.eye(3)}
    replace(delivered(), history=(cutoff,)).write(path)
    again = OrtSolution.read(path)
    assert again.history[0]["picture"] == "a"
    np.testing.assert_array_equal(again.history[0]["b_plane"], np.ones(3))
    assert again.labels == ("target_position x", "target_position y", "target_position z")
    assert again.b_plane_covariance == pytest.approx(np.eye(3))
    with pytest.raises(SessionError, match="covariance is nan"):
        replace(delivered(), covariance=np.full((3, 3), np.nan)).write(tmp_path / "bad.json")
    assert not (tmp_path / "bad.json").exists()
    content = json.loads(path.read_text())
    for change, words in (
        ({"correction": [1.0]}, "shape"),
        ({"covariance": (-np.eye(3)).tolist()}, "no covariance"),
        ({"schema": "x"}, "no solution of a rehearsal"),
        ({"parameters": ["colour"]}, "unknown parameter"),
        ({"history": [{"picture": "a", "et": 4.0, "pictures": 1}]}, "lacks b_plane"),
        ({"history": ["a"]}, "indices"),
    ):
        path.write_text(json.dumps(content | change))
        with pytest.raises(SessionError, match=words):
            OrtSolution.read(path)
    path.write_text(json.dumps({k: v for k, v in content.items() if k != "covariance"}))
    with pytest.raises(SessionError, match="lacks covariance"):
        OrtSolution.read(path)


def test_results_folder(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a/result.json").write_text(json.dumps({"status": "failed", "messages": ["truncated"]}))
    first, second = picture_results(["a", "b"], tmp_path)
    assert (first.status, first.messages, second.status) == ("failed", ("truncated",), "missing")
    (tmp_path / "a/result.json").write_text("{")
    with pytest.raises(SessionError, match="cannot be read"):
        picture_results(["a"], tmp_path)
    with pytest.raises(SessionError, match="no folder of results"):
        picture_results(["a"], tmp_path / "c")


def test_log_of_reveals(tmp_path):
    """Written before the truth is opened, taken back when that fails; a later change of a file is named."""
    run, key = tmp_path / "run", tmp_path / "p.key"
    (run / "a").mkdir(parents=True)
    (run / "a/result.json").write_text("{}")
    solved = run / SOLUTION_FILE
    solved.write_text("1")
    delivery = (key, "p", run, ["a"], solved)
    with pytest.raises(SessionError, match="no key"), logged_delivery(*delivery):
        pass
    key.write_text("k")
    with pytest.raises(SessionError, match="1 line"), logged_delivery(*delivery):
        raise SessionError(f"{len(log_path(key).read_text().splitlines())} line")
    assert log_path(key).read_text() == ""
    with logged_delivery(*delivery) as first:
        assert set(first.files) == {SOLUTION_FILE, "a/result.json"}
    assert (first.altered, first.opened_before) == ((), ())
    solved.write_text("2")
    with logged_delivery(*delivery) as second:
        pass
    assert second.altered == (SOLUTION_FILE,)
    assert second.opened_before == (first.utc,)
    assert len(log_path(key).read_text().splitlines()) == 2


@pytest.mark.slow
def test_page_of_a_solution_without_history_and_with(tmp_path):
    residual = {
        "image": "a.fit",
        "body": "PLUTO",
        "kind": "center",
        "et": 0.0,
        "sigmas": 0.0,
        "used": True,
        "reason": "",
    }
    residual |= {"before": np.ones(2), "after": np.zeros(2), "covariance": np.eye(2)}
    bare = replace(delivered(), residuals=(residual,))
    rows = tuple(
        {
            "picture": str(k),
            "et": 86400.0 * k,
            "pictures": k + 1,
            "b_plane": np.ones(3),
            "covariance": np.eye(3),
        }
        for k in range(2)
    )
    assert "Flyby by data cutoff" not in solution_page(bare)
    assert "Flyby by data cutoff" in solution_page(replace(bare, history=rows))
