"""A rehearsal in orbit: landmarks on a map that is not quite true, pictures without stars, one batch, and its grade."""

import dataclasses
import json

import numpy as np
import pytest
from orbit_small import small_scenario
from typer.testing import CliRunner

from opnav_workbench.cli.ort import ort
from opnav_workbench.errors import EstimationError, MissionError, SessionError
from opnav_workbench.landmarks import ellipsoid_shape
from opnav_workbench.rehearsal import load_ort_scenario, open_rehearsal, ort_scenario_names
from opnav_workbench.rehearsal.orbit.solution import OrbitSolution
from opnav_workbench.rehearsal.orbit.team_map import coarse_shape, smoothed_shape
from opnav_workbench.simulation.terrain import Terrain, rough_shape

RADII = [0.283, 0.271, 0.25]


def test_a_made_surface_is_the_same_for_a_seed_and_finer_plates_only_add_to_it():
    shape = rough_shape(RADII, 0.012, 5)
    assert np.array_equal(shape.vertices_km, rough_shape(RADII, 0.012, 5).vertices_km)
    other = rough_shape(RADII, 0.012, 6)
    assert np.abs(other.vertices_km - shape.vertices_km).max() > 0.003
    finer = coarse_shape(rough_shape(RADII, 0.006, 5), 0.03)
    coarse = coarse_shape(shape, 0.03)
    away = np.linalg.norm(finer.vertices_km, axis=1) - np.linalg.norm(coarse.vertices_km, axis=1)
    assert np.abs(away).std() < 0.004  # boulders below the coarse plates


def test_without_hills_ridge_and_boulders_the_ellipsoid_is_left():
    bare = rough_shape(RADII, 0.02, 5, Terrain(hills=0.0, ridge=0.0, boulders=0.0))
    assert np.allclose(bare.vertices_km, ellipsoid_shape(RADII, 0.02).vertices_km)


def test_smoothing_takes_what_is_finer_and_leaves_what_is_wider():
    ball = ellipsoid_shape([1.0, 1.0, 1.0], 0.05)
    random = np.random.default_rng(1)
    rough = type(ball)(
        ball.vertices_km * (1.0 + 0.01 * random.normal(size=(len(ball.vertices_km), 1))), ball.plates
    )
    left = np.linalg.norm(smoothed_shape(rough, 0.1).vertices_km, axis=1)
    assert left.std() < 0.005
    assert left.mean() == pytest.approx(
        1.0 - 0.1**2, abs=0.003
    )  # a ball's mean over a width is smaller by its square


def test_a_scenario_is_of_a_flyby_or_in_orbit():
    content = load_ort_scenario("osiris_rex/bennu_orbit").model_dump(mode="json")
    with pytest.raises(MissionError, match="one of them"):
        load_ort_scenario(content | {"b_plane": "BENNU"})
    with pytest.raises(MissionError, match="one of them"):
        load_ort_scenario(content | {"orbit": None})
    with pytest.raises(MissionError, match="spacecraft_position and spacecraft_velocity"):
        load_ort_scenario(content | {"parameters": content["parameters"] | {"target_position": 1.0}})
    with pytest.raises(MissionError, match="odd"):
        load_ort_scenario(content | {"orbit": content["orbit"] | {"samples": 40}})
    flyby = load_ort_scenario("osiris_rex/bennu_rendezvous")
    with pytest.raises(MissionError, match="in orbit"):
        flyby.with_shape("bennu.obj")
    assert "osiris_rex/bennu_orbit" in ort_scenario_names()


def test_a_shape_takes_the_place_of_the_made_surface(tmp_path):
    file = tmp_path / "bennu.obj"
    file.write_text("v 0 0 0\n")
    with pytest.raises(MissionError, match="no file"):
        load_ort_scenario("osiris_rex/bennu_orbit").with_shape(tmp_path / "none.obj")
    body = load_ort_scenario("osiris_rex/bennu_orbit").with_shape(file, "m").bodies[0]
    assert body.terrain is None
    assert (body.shape.file, body.shape.unit) == (file, "m")


@pytest.mark.slow
def test_a_team_solves_it_blind_and_is_graded(tmp_path):
    (tmp_path / "scenario.yaml").write_text(json.dumps(small_scenario(tmp_path / "mission")))
    run = CliRunner()

    def call(*words):
        result = run.invoke(ort, [str(word) for word in words])
        assert result.exit_code == 0, result.output
        return result.output

    package, team = tmp_path / "ort", tmp_path / "run"
    call("new", tmp_path / "scenario.yaml", "--out", package, "--seed", 3, "-j", 1)
    told = open_rehearsal(package)
    assert told.b_plane is None
    assert told.orbit.body == "BENNU"
    assert "Prediction asked for" in (package / "briefing.md").read_text()
    assert "prime meridian" in call("solve", package, "--out", team, "-j", 1)
    solution = OrbitSolution.read(team / "solution.json")
    sources = {name: one["source"] for name, one in solution.attitudes.items()}
    assert sources == {"pair_1": "carried", "full_1": "landmarks"}
    results = {name: json.loads((team / name / "result.json").read_text()) for name in sources}
    assert {name: one["status"] for name, one in results.items()} == {"pair_1": "ok", "full_1": "partial"}
    assert any("landmarks of BENNU do" in words for words in results["full_1"]["messages"])
    with pytest.raises(EstimationError, match="the filter is for flybys"):
        run.invoke(ort, ["solve", str(package), "--out", str(team), "--filter"], catch_exceptions=False)
    output = call("score", package, "--solutions", team)
    score = json.loads((team / "score.json").read_text())
    assert score["grade"]["letter"] in "AB", output
    assert {p["verdict"] for p in score["pictures"]} == {"good"}
    assert [p["stars_asked"] for p in score["pictures"]] == [True, False, False]
    assert score["solution"]["all_parameters"]["sigmas"] < 3.0
    assert solution.chi2 < 1.5 * solution.degrees_of_freedom
    assert "Orbit, body and map" in (team / "score.html").read_text()

    # What is claimed must be what the pictures support; and a solution of another rehearsal is refused.
    bold = dataclasses.replace(solution, covariance=0.04 * solution.covariance)
    bold.write(team / "solution.json")
    result = run.invoke(ort, ["score", str(package), "--solutions", str(team)])
    assert result.exit_code == 3
    assert "claimed sigmas are down to 0.2" in result.output
    dataclasses.replace(solution, package="another").write(team / "solution.json")
    result = run.invoke(ort, ["score", str(package), "--solutions", str(team)])
    assert isinstance(result.exception, SessionError)
