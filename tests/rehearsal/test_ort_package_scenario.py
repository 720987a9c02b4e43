"""Rehearsal scenarios: what may stand in them, how they are drawn, and the ready ones."""

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from opnav_workbench.camera import Camera
from opnav_workbench.errors import CameraError, MissionError
from opnav_workbench.rehearsal.briefing import BriefingSection, as_html, as_markdown
from opnav_workbench.rehearsal.case import OrtGeometry, draw_amount, draw_case, perturbation_random
from opnav_workbench.rehearsal.making import new_rehearsal
from opnav_workbench.rehearsal.pictures import AddedRadial, camera_with_faults
from opnav_workbench.rehearsal.scenario import (
    Distribution,
    OrtPerturbations,
    load_ort_scenario,
    ort_scenario_names,
)
from opnav_workbench.rehearsal.sealed_truth import reveal
from opnav_workbench.resources import kernels_meta_dir

TRIALS = 2000
LOW_P = 1e-4  # a right distribution fails once in ten thousand times, and the seeds are fixed
GEOMETRY = OrtGeometry(
    epoch_et=0.0,
    relative_state=np.array([-3.7e6, 1.4e4, 7e3, 13.78, 0.0, 0.0]),
    gm_km3_s2=975.5,
    sunward=np.array([-0.96, 0.28, 0.0]),
)


def _content(**changes):
    content = {
        "title": "Test",
        "description": "Test.",
        "mission": "new_horizons",
        "kernels": "new_horizons/pluto_approach",
        "targets": ["PLUTO"],
        "b_plane": "PLUTO BARYCENTER",
        "parameters": {"target_position": 1000.0, "spacecraft_position": 1000.0},
        "pictures": [
            {
                "name": "p",
                "start": "2015-07-01T00:00:00",
                "step_s": 3600.0,
                "count": 6,
                "camera": "lorri_1x1",
                "exposure_s": 0.1,
            }
        ],
    }
    return content | changes


def _perturbed(**perturbations):
    return load_ort_scenario(_content(perturbations=perturbations))


# -- drawing -------------------------------------------------------------------------------------------------------


def test_numbers_follow_their_distribution():
    rng = np.random.default_rng(1)
    normal = [draw_amount(Distribution(normal=3.0, mean=10.0), rng) for _ in range(TRIALS)]
    assert stats.kstest(normal, stats.norm(10.0, 3.0).cdf).pvalue > LOW_P
    uniform = [draw_amount(Distribution(uniform=(2.0, 6.0)), rng) for _ in range(TRIALS)]
    assert stats.kstest(uniform, stats.uniform(2.0, 4.0).cdf).pvalue > LOW_P
    signed = np.array(
        [draw_amount(Distribution(uniform=(2.0, 6.0), either_sign=True), rng) for _ in range(TRIALS)]
    )
    assert stats.binomtest(int((signed > 0).sum()), TRIALS).pvalue > LOW_P
    assert stats.kstest(np.abs(signed), stats.uniform(2.0, 4.0).cdf).pvalue > LOW_P


def test_any_direction_means_any():
    scenario = _perturbed(target_barycenter={"body": "PLUTO BARYCENTER", "any_direction_km": 1000.0})
    moved = np.array([draw_case(scenario, GEOMETRY, seed).offsets["target_position"] for seed in range(500)])
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 1000.0, rtol=1e-12)
    for axis in moved.T:  # a uniform direction has uniform components
        assert stats.kstest(axis, stats.uniform(-1000.0, 2000.0).cdf).pvalue > LOW_P


def test_one_kind_more_changes_no_other():
    shift = {"body": "PLUTO BARYCENTER", "any_direction_km": {"normal": 500.0}}
    alone = draw_case(_perturbed(target_barycenter=shift), GEOMETRY, 5)
    more = draw_case(
        _perturbed(
            target_barycenter=shift,
            time_of_flight_s={"normal": 10.0},
            attitude={"shift_px": 50.0},
            lost_images={"missing": 2},
        ),
        GEOMETRY,
        5,
    )
    np.testing.assert_array_equal(alone.offsets["target_position"], more.offsets["target_position"])
    assert alone.missing == ()
    assert len(more.missing) == 2
    assert perturbation_random(5, "camera").random() != perturbation_random(5, "albedo").random()


@settings(max_examples=30, deadline=None)
@given(b_t=st.floats(-3000.0, 3000.0), b_r=st.floats(-3000.0, 3000.0), time_s=st.floats(-500.0, 500.0))
def test_every_b_plane_point_is_reached(b_t, b_r, time_s):
    scenario = _perturbed(b_plane_target={"b_dot_t_km": b_t, "b_dot_r_km": b_r}, time_of_flight_s=time_s)
    nominal = GEOMETRY.flyby()
    there = GEOMETRY.flyby(draw_case(scenario, GEOMETRY, 1).relative_state_error()).in_axes_of(nominal)
    np.testing.assert_allclose(there - nominal.in_axes_of(nominal), [b_t, b_r, time_s], rtol=0, atol=1e-5)


def test_a_flyby_that_cannot_be_is_refused():
    with pytest.raises(MissionError, match=r"perturbations: no trajectory has B\.T"):
        draw_case(_perturbed(b_plane_target={"b_dot_t_km": 1e12}), GEOMETRY, 1)


def test_offsets_grow_from_the_epoch():
    scenario = load_ort_scenario(
        _content(
            parameters={"spacecraft_position": 1.0, "spacecraft_velocity": 1.0},
            perturbations={
                "spacecraft_ephemeris": {"position_km": [1.0, 2.0, 3.0], "velocity_km_s": [1e-3, 0.0, 0.0]}
            },
        )
    )
    case = draw_case(scenario, GEOMETRY, 1)
    assert case.offset("spacecraft", 1000.0).tolist() == [2.0, 2.0, 3.0, 1e-3, 0.0, 0.0]
    assert case.relative_state_error().tolist() == [1.0, 2.0, 3.0, 1e-3, 0.0, 0.0]
    assert not case.offset("target", 1000.0).any()


def test_storms_and_gaps_fall_on_pictures_that_arrive():
    for seed in range(20):
        case = draw_case(
            _perturbed(
                lost_images={"missing": 2, "truncated": 1, "spare": ["p_6"]},
                cosmic_ray_storm={"pictures": 2, "rate_per_cm2_s": 100.0},
                data_gaps={"pictures": 3},
            ),
            GEOMETRY,
            seed,
        )
        lost = {*case.missing, *case.truncated}
        assert (len(case.missing), len(case.truncated), len(lost)) == (2, 1, 3)
        assert "p_6" not in lost
        assert not lost & {*case.storm, *case.gaps}
        assert (len(case.storm), len(case.gaps)) == (2, 3)


# -- camera --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lorri():
    return Camera.from_yaml(kernels_meta_dir() / "new_horizons/cameras/lorri_1x1.yaml")


def test_added_distortion_has_its_jacobian(lorri):
    added = AddedRadial(lorri.distortion, 3e-5)
    xy = np.random.default_rng(2).uniform(-6.6, 6.6, (50, 2))  # mm
    step = 1e-5
    by_differences = np.stack(
        [(added.distort(xy + step * e) - added.distort(xy - step * e)) / (2 * step) for e in np.eye(2)],
        axis=-1,
    )
    np.testing.assert_allclose(added.jacobian(xy), by_differences, rtol=0, atol=1e-8)
    np.testing.assert_allclose(added.undistort(added.distort(xy)), xy, rtol=0, atol=1e-9)


def test_faults_of_the_camera(lorri):
    assert camera_with_faults(lorri, 0.0, 0.0) is lorri
    bad = camera_with_faults(lorri, 0.0, 1.5)
    corner = lorri.unproject([[1023.5, 1023.5]])
    moved = (bad.project(corner) - lorri.project(corner))[0]
    assert np.hypot(*moved) == pytest.approx(1.5, rel=0.02)
    assert moved[0] > 0.0
    with pytest.raises(CameraError):
        camera_with_faults(lorri, 0.0, -400.0)


# -- schema --------------------------------------------------------------------------------------------------------

BROKEN = [
    ({"parameters": {"target_positon": 1.0}}, "unknown parameter 'target_positon'"),
    ({"parameters": {"range_scale:PLUTO": 1.0}}, "positions and velocities only"),
    ({"parameters": {"target_position": -1.0}}, "greater than 0"),
    ({"parameters": {}}, "at least 1"),
    ({"targets": []}, "at least 1"),
    ({"pictures": []}, "at least 1"),
    (
        {"perturbations": {"spacecraft_ephemeris": {"velocity_km_s": [0, 0, 1]}}},
        "change spacecraft_velocity, which",
    ),
    ({"perturbations": {"target_barycentre": {}}}, "did you mean target_barycenter"),
    ({"perturbations": {"time_of_flight_s": {"normal": 1, "uniform": [0, 1]}}}, "give normal"),
    ({"perturbations": {"time_of_flight_s": {"uniform": [2, 1]}}}, "the lower first"),
    ({"perturbations": {"time_of_flight_s": {"normal": -2}}}, "greater than 0"),
    ({"perturbations": {"lost_images": {"missing": 6}}}, "at least one must arrive"),
    ({"perturbations": {"lost_images": {"missing": 1, "spare": ["q"]}}}, "no picture q; there are p_1"),
    ({"perturbations": {"albedo": {"bodies": ["PLUTO"], "dark": 0.5, "bright": 0.4}}}, "is not above dark"),
    ({"perturbations": {"cosmic_ray_storm": {"pictures": 0, "rate_per_cm2_s": 1}}}, "greater than 0"),
]


@pytest.mark.parametrize(("change", "words"), BROKEN)
def test_what_is_wrong_is_said(change, words):
    with pytest.raises(MissionError, match=words) as caught:
        load_ort_scenario(_content(**change))
    assert "\n" not in str(caught.value)


def test_pictures_of_one_name_are_refused():
    one = {"name": "a", "utc": "2015-07-01T00:00:00", "camera": "lorri_1x1", "exposure_s": 0.1}
    with pytest.raises(MissionError, match="a is given twice"):
        load_ort_scenario(_content(pictures=[one, one]))
    with pytest.raises(MissionError, match="give either utc, or start"):
        load_ort_scenario(_content(pictures=[one | {"count": 2}]))


def test_a_file_is_named_with_its_line(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(_content(due_hours=-1.0), sort_keys=False))
    line = path.read_text().splitlines().index("due_hours: -1.0") + 1
    with pytest.raises(MissionError, match=rf"mine\.yaml: line {line}: due_hours"):
        load_ort_scenario(path)


def test_unknown_names():
    with pytest.raises(MissionError, match="did you mean new_horizons/pluto_stress"):
        load_ort_scenario("new_horizons/pluto_stres")
    with pytest.raises(MissionError, match="cannot be read"):
        load_ort_scenario("nothing.yaml")


def test_overlapping_pointings_are_refused(tmp_path):
    one = {
        "utc": "2015-07-01T00:00:00",
        "camera": "lorri_1x1",
        "exposure_s": 0.1,
        "pointing": {"twist_deg": 10.0},
    }
    scenario = _content(pictures=[one | {"name": "a"}, one | {"name": "b", "utc": "2015-07-01T00:00:02"}])
    with pytest.raises(MissionError, match="less than 4 s apart"):
        new_rehearsal(scenario, tmp_path / "case", seed=1)
    assert list(tmp_path.iterdir()) == []


@given(count=st.integers(1, 8), spare=st.sampled_from([["p_6"], ["p_1", "p_3", "p_4", "p_6"]]))
def test_fewer_pictures_span_the_sequence(count, spare):
    lost = {"missing": 1, "truncated": 1, "spare": spare}
    scenario = _perturbed(lost_images=lost).limited(count)
    names = [picture.name for picture in scenario.sequence()]
    assert len(names) == min(count, 6)
    assert names[-1] == "p_6"
    assert names[0] == "p_1" or count == 1
    lost = scenario.perturbations.lost_images
    assert lost.missing + lost.truncated < len(names)
    draw_case(scenario, GEOMETRY, 1)


@pytest.mark.parametrize("name", ort_scenario_names())
def test_ready_scenarios_hide_their_case(name):
    scenario = load_ort_scenario(name)
    stated = [
        amount
        for part in scenario.perturbations.model_dump(exclude_none=True).values()
        if isinstance(part, dict)
        for amount in part.values()
        if isinstance(amount, dict) and amount.get("uniform") and len(set(amount["uniform"])) == 1
    ]
    assert all(set(amount["uniform"]) == {0.0} for amount in stated)
    assert scenario.perturbations != OrtPerturbations()
    assert {
        "new_horizons/pluto_final_approach",
        "new_horizons/pluto_flyby_targeting",
        "new_horizons/pluto_stress",
    } <= set(ort_scenario_names())


FLYBYS = [
    name for name in ort_scenario_names() if load_ort_scenario(name).orbit is None
]  # in orbit: test_ort_orbit.py


@pytest.mark.slow(keep=["osiris_rex/bennu_rendezvous"])
@pytest.mark.parametrize("name", FLYBYS)
def test_ready_scenarios_make_packages(name, tmp_path):
    package = new_rehearsal(name, tmp_path / "case", seed=11, pictures=2)
    truth = reveal(package)
    assert len(package.pictures) == 2
    assert any(vector.any() for vector in truth.parameters.values())
    for group, vector in truth.parameters.items():  # a case that its own a priori sigmas would not rule out
        assert np.linalg.norm(vector) < 5.0 * np.linalg.norm(np.broadcast_to(package.parameters[group], 3))
    arrived = [truth.pictures[p.name] for p in package.received if p.name not in truth.lost]
    assert arrived
    for picture in arrived:
        assert picture.n_stars >= 2  # or nobody could find the twist


# -- briefing ------------------------------------------------------------------------------------------------------


def test_briefing_escapes_what_it_quotes():
    part = BriefingSection("A < B", ("one & two",), ("<script>",), ("x",), (("a | b",),), ("opnav <x>",))
    page, text = as_html("T <1>", "lead", [part]), as_markdown("T", "lead", [part])
    assert "<script>" not in page
    assert "A &lt; B" in page
    assert "a \\| b" in text


def test_briefing_page_stands_alone_and_tells_the_prediction(tmp_path):
    package = new_rehearsal(_content(), tmp_path / "case", seed=1, pictures=1)
    page, text = (package.folder / "briefing.html").read_text(), package.briefing.read_text()
    assert "://" not in page
    assert "src=" not in page
    for words in (
        "PLUTO BARYCENTER",
        "2015-07-14 11:49:5",
        "p_6",
        "1000, 1000, 1000 km",
        package.b_plane.pole,
    ):
        assert words in page
        assert words in text
