"""Picture scenarios: what the files may say, and what a wrong one is told."""

import pickle

import numpy as np
import pytest
import yaml

from opnav_workbench.errors import MissionError
from opnav_workbench.mission import load_mission
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.simulation.scenario import load_picture_scenario, picture_scenario_names
from opnav_workbench.simulation.surfaces import surface_of
from opnav_workbench.targets import TargetState

BASE = """\
# line 1
mission: new_horizons
kernels: new_horizons/pluto_approach
seed: 7
bodies:
- name: PLUTO
  law: lunar_lambert
  albedo: 0.52
- name: CHARON
  law: {law: minnaert, k: 0.7}
pictures:
- name: one
  utc: 2015-07-09T04:29:00
  camera: lorri_1x1
  exposure_s: 0.1
"""


@pytest.fixture
def file(tmp_path):
    def write(old="", new=""):
        assert old in BASE
        path = tmp_path / "scenario.yaml"
        path.write_text(BASE.replace(old, new, 1))
        return path

    return write


def test_a_scenario_is_read_with_its_defaults(file):
    scenario = load_picture_scenario(file())
    assert [body.law.law for body in scenario.bodies] == ["lunar_lambert", "minnaert"]
    assert scenario.bodies[0].albedo.value == 0.52
    assert scenario.attitude.actual.source == "random"
    assert scenario.detector.shot_noise
    assert scenario.pictures[0].utc.isoformat() == "2015-07-09T04:29:00"
    assert scenario.pictures[0].level == "calibrated"
    assert all((scenario.switches.aberration, scenario.switches.parallax, scenario.switches.distortion))


def test_a_mapping_is_the_same_as_its_file(file):
    path = file()
    content = yaml.safe_load(path.read_text())
    assert load_picture_scenario(content).model_dump() == load_picture_scenario(path).model_dump()


def test_it_travels_to_other_processes_with_its_folder(file):
    scenario = load_picture_scenario(file())
    for copy in (pickle.loads(pickle.dumps(scenario)), scenario.model_copy(update={"seed": 3})):
        assert copy.folder == scenario.folder == file().parent


WRONG = [
    ("exposure_s: 0.1", "exposure_s: 0", 15, "exposure_s.*greater than 0"),
    ("law: lunar_lambert", "law: lunar", 7, "'lambert', 'lommel_seeliger', 'lunar_lambert'"),
    ("k: 0.7", "k: -0.7", 10, r"bodies\.1\.law\.k.*greater than 0"),
    ("k: 0.7", "kk: 0.7", 10, "kk: unknown field, did you mean k"),
    ("albedo: 0.52", "albedo: 52", 8, "albedo.*less than or equal to 2"),
    ("albedo: 0.52", "albedo: {map: mottled, dark: 0.5, bright: 0.4}", 8, "bright 0.4 is not above dark 0.5"),
    ("albedo: 0.52", "albedo: {map: file}", 8, "albedo.file: this field is required"),
    ("albedo: 0.52", "brightness: magnitude", 8, "give magnitude with source: magnitude"),
    ("seed: 7", "seed: -7", 4, "seed.*greater than or equal to 0"),
    ("seed: 7", "attitude: {actual: wild}", 4, "'none', 'random', 'error' or 'kernels'"),
    ("seed: 7", "attitude: {predicted: {source: fixed, ra_deg: 10}}", 4, "give ra_deg and dec_deg"),
    ("seed: 7", "attitude: {actual: {source: none, shift_px: [3, 4]}}", 4, "need source: error"),
    ("seed: 7", "detector: {cosmic_rays: {rate: 3}}", 4, "cosmic_rays.rate: unknown field"),
    ("seed: 7", "perturbations: {bodies: [{offset_km: [1, 2, 3]}]}", 4, "name: this field is required"),
    ("CHARON", "Pluto", 5, "bodies: PLUTO is given twice"),
    ("utc: 2015-07-09T04:29:00", "utc: tomorrow", 13, r"pictures\.0\.utc.*valid datetime"),
    ("utc: 2015-07-09T04:29:00", "start: 2015-07-09T04:29:00", 12, "start, stop and step_s"),
    ("camera: lorri", "cammera: lorri", 14, "cammera: unknown field, did you mean camera"),
    ("name: one", "name: ../one", 12, "name.*pattern"),
    ("seed: 7", "seed: 7\nseed: 8", 5, "seed is given twice"),
]


@pytest.mark.parametrize(("old", "new", "line", "message"), WRONG, ids=[new for _, new, _, _ in WRONG])
def test_an_error_names_the_line_and_what_is_allowed(file, old, new, line, message):
    with pytest.raises(MissionError, match=message) as caught:
        load_picture_scenario(file(old, new))
    text = str(caught.value)
    assert "scenario.yaml: " in text
    assert f"line {line}:" in text
    assert "\n" not in text


def test_a_scenario_without_pictures_is_refused(file):
    path = file()
    path.write_text(path.read_text().split("pictures:")[0] + "pictures: []\n")
    with pytest.raises(MissionError, match="line 11: pictures: no picture"):
        load_picture_scenario(path)


def test_a_series_has_its_own_names_and_times(file):
    series = "start: 2015-07-09T04:29:00\n  stop: 2015-07-09T04:30:00\n  step_s: 20"
    (entry,) = load_picture_scenario(file("utc: 2015-07-09T04:29:00", series)).pictures
    pictures = entry.expanded()
    assert [p.name for p in pictures] == ["one_0001", "one_0002", "one_0003", "one_0004"]
    assert [p.utc.second for p in pictures] == [0, 20, 40, 0]
    assert all(p.expanded() == (p,) for p in pictures)


def test_ready_scenarios_are_listed_and_load():
    names = picture_scenario_names()
    assert {
        "new_horizons/m7_2006",
        "new_horizons/pluto_charon",
        "new_horizons/pluto_limb",
        "new_horizons/pluto_barycenter",
        "osiris_rex/bennu_approach",
    } <= set(names)
    for name in names:
        scenario = load_picture_scenario(name)
        assert scenario.path.is_relative_to(kernels_meta_dir().resolve())
        assert scenario.description
        assert scenario.mission == name.split("/")[0]


def test_an_unknown_name_is_told_the_nearest():
    with pytest.raises(MissionError, match="did you mean new_horizons/pluto_charon"):
        load_picture_scenario("new_horizons/pluto_caron")
    with pytest.raises(MissionError, match=r"nowhere\.yaml cannot be read"):
        load_picture_scenario("nowhere.yaml")


def test_the_barycenter_case_differs_from_the_limb_case_by_its_perturbation_only():
    limb, moved = (
        load_picture_scenario(f"new_horizons/{name}").model_dump()
        for name in ("pluto_limb", "pluto_barycenter")
    )
    different = {key for key in limb if limb[key] != moved[key]}
    assert different == {"description", "perturbations"}


@pytest.mark.parametrize(
    ("said", "radii"),
    [
        ("radius_km: 1200.0", [1200.0, 1200.0, 1200.0]),
        ("radii_km: [1190.0, 1180.0, 1170.0]", [1190.0, 1180.0, 1170.0]),
    ],
)
def test_a_body_of_another_size_than_the_kernels_have(file, said, radii):
    path = file("  law: lunar_lambert\n", f"  law: lunar_lambert\n  {said}\n")
    scenario = load_picture_scenario(path)
    surface = surface_of(scenario.body("PLUTO"), scenario, ("bodies", 0))
    sun = np.array([0.0, 0.0, -5e9])
    target = TargetState(
        "PLUTO",
        np.array([0.0, 0.0, 1e6]),
        radii_km=np.full(3, 1188.3),
        body_from_j2000=np.eye(3),
        sun_position_km=sun,
    )
    mission = load_mission("new_horizons")
    made = surface.model(target, mission, mission.camera_named("lorri_1x1"), 0.1)
    assert made.target.radii_km.tolist() == radii


def test_a_body_has_one_form(file):
    with pytest.raises(MissionError, match="one of them"):
        load_picture_scenario(
            file("  law: lunar_lambert\n", "  radius_km: 1.0\n  radii_km: [1.0, 1.0, 1.0]\n")
        )
