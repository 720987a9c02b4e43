"""Landmarks in a session: found, decided, taken back, replayed, written and read; the picture drawn by another route."""

import dataclasses
import json
import sys
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
import yaml
from astropy.io import fits

from opnav_workbench.cli.process import Reporter
from opnav_workbench.contracts import check_file
from opnav_workbench.errors import SessionError
from opnav_workbench.geometry import vector_from_rotation
from opnav_workbench.landmarks import make_maplets
from opnav_workbench.mission import load_mission
from opnav_workbench.observables import read_ecsv
from opnav_workbench.processing import Outcome
from opnav_workbench.render import Lambert
from opnav_workbench.scene import Observer
from opnav_workbench.session import ImageSession, load_decisions
from opnav_workbench.session.autosave import STATE_FILE
from opnav_workbench.targets import TargetState

sys.path.insert(0, str(Path(__file__).parents[1] / "landmarks"))
from bumpy import Bumpy

BODY, RADII = "BENNU", np.array([0.28, 0.27, 0.25])
OFF_PX = np.array([4.0, -3.0])


class Stage:
    """A LORRI picture of a bumpy body 130 px wide, the mission that knows it, and where the camera really was."""

    def __init__(self, demo, folder):
        self.session = ImageSession.open(demo.picture, "new_horizons")
        camera = self.session.context.camera
        body = Bumpy.of(RADII, 192, octaves=range(2, 7), falloff=0.6, roughness=0.02, contrast=0.03)
        pixel_km = self.pixel_km = 2.0 * RADII[1] / 130.0
        turn = self.session.inputs.a_priori_camera_from_j2000
        toward = camera.boresight @ turn
        self.place = -toward * pixel_km / camera.pixel_scale_rad
        sun = -toward + 0.6 * np.cross(toward, [0.0, 0.0, 1.0])
        sun /= np.linalg.norm(sun)
        light = body.draw(
            camera, turn, self.place, sun, Lambert(), cells=2, psf_sigma=camera.psf.sigma_px, step=1e-3
        )
        random = np.random.default_rng(5)
        with fits.open(demo.picture) as files:
            level = random.poisson(3000.0 * light / light.max()) + random.normal(scale=3.0, size=light.shape)
            files[0].data = (level + 20.0).astype(np.float32)
            files.writeto(folder / "body.fit")
        self.picture, self.maplets, self.turn = folder / "body.fit", folder / "b.npz", turn
        shape = body.shape(150)
        make_maplets(BODY, shape, 12.0 * pixel_km, scale_km=pixel_km, samples=25, source="test").write(
            self.maplets
        )
        rows = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in shape.vertices_km]
        rows += [f"f {a} {b} {c}" for a, b, c in shape.plates + 1]
        (folder / "b.obj").write_text("\n".join(rows))
        # Believed is a place some pixels off.
        across = np.linalg.pinv(camera.project_jacobian((turn @ -self.place)[None])[0] @ turn) @ OFF_PX
        self.target = TargetState(
            BODY, -self.place - across, radii_km=RADII, body_from_j2000=np.eye(3), sun_position_km=1.6e8 * sun
        )
        mission = load_mission("new_horizons").path
        content = yaml.safe_load(mission.read_text())
        for entry in content["cameras"]:
            entry["file"] = str(mission.parent / entry["file"])
        for key in ("default_targets", "target_photometry", "target_stars"):
            content.pop(key, None)
        surface = {"shape": "b.obj", "maplets": "b.npz", "law": {"law": "lambert"}}
        self.mission = folder / "mission.yaml"
        self.mission.write_text(yaml.safe_dump(content | {"target_surfaces": {BODY: surface}}))

    def open(self):
        session = ImageSession.open(self.picture, self.mission)
        session._history.inputs = dataclasses.replace(
            session.inputs,
            targets=MappingProxyType({BODY: self.target}),
            observer=Observer(np.zeros(3), np.zeros(3), "header"),
        )
        session.predict()
        return session


@pytest.fixture(scope="module")
def stage(demo_truths, tmp_path_factory):
    return Stage(demo_truths[0], tmp_path_factory.mktemp("landmarks"))


@pytest.fixture(scope="module")
def found(stage):
    session = stage.open()
    session.find_landmarks(BODY)
    return session


@pytest.mark.slow
def test_landmarks_tell_where_the_camera_was(stage, found):
    solution = found.state.landmarks[0]
    assert solution.accepted.mean() > 0.8
    assert np.nanmedian(solution.centers.residual_px, axis=0) == pytest.approx(OFF_PX, abs=0.15)
    pose = solution.pose
    off = np.concatenate(
        [stage.place - pose.position_km, vector_from_rotation(stage.turn @ pose.camera_from_j2000.T)]
    )
    scale = np.sqrt(np.diag(pose.covariance))
    assert off / scale @ np.linalg.solve(pose.covariance / np.outer(scale, scale), off / scale) < 25.0
    assert "landmarks accepted; rms" in found.journal[-1].outcome


@pytest.mark.slow
def test_process_prints_how_many_landmarks_were_found_and_where_they_put_the_camera(
    stage, found, capsys, monkeypatch
):
    monkeypatch.setenv("COLUMNS", "120")
    result = json.loads(found.to_json())
    Reporter(1).table([Outcome(stage.picture, stage.picture.parent, result)], stage.picture.parent)
    lines = capsys.readouterr().out.splitlines()
    rows = lines[lines.index(next(line for line in lines if line.strip().startswith("Landmarks"))) :]
    picture, body, accepted, of, rms, moved, sigma = next(line for line in rows if BODY in line).split()
    solution = found.state.landmarks[0]
    assert (picture, body) == ("body", BODY)
    assert (int(accepted), int(of)) == (solution.accepted.sum(), len(solution.accepted))
    assert float(rms) == pytest.approx(result["landmarks"][0]["pose"]["rms_px"], abs=6e-4)
    true_km = np.linalg.norm(stage.place + stage.target.position_km)
    assert float(moved) == pytest.approx(true_km, abs=4.0 * float(sigma))
    largest = np.sqrt(np.linalg.eigvalsh(solution.pose.position_covariance_km2)[-1])
    assert float(sigma) == pytest.approx(largest, rel=0.06), "two digits are printed"


@pytest.mark.slow
def test_a_body_without_a_pose_has_its_counts_and_dashes(stage, found, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    result = json.loads(found.to_json())
    result["landmarks"][0]["pose"] = None
    Reporter(1).table([Outcome(stage.picture, stage.picture.parent, result)], stage.picture.parent)
    row = next(line.split() for line in capsys.readouterr().out.splitlines() if BODY in line)
    assert row[3:] == [str(len(found.state.landmarks[0].accepted)), "–", "–", "–"]


@pytest.mark.slow
def test_decisions_stand_in_journal_result_and_file_and_are_taken_again(stage, found, tmp_path):
    ids = found.state.landmarks[0].centers.id[found.state.landmarks[0].accepted][:2].tolist()
    found.reject_landmarks(BODY, ids, "a shadow")
    rejected = json.loads(found.to_json())
    of_ids = [p for p in rejected["landmarks"][0]["points"] if p["id"] in ids]
    assert {(p["status"], p["reason"]) for p in of_ids} == {("rejected", "by the analyst: a shadow")}
    decisions = load_decisions(found.write_decisions(tmp_path / "d.yaml"))
    again = ImageSession.open(stage.picture, stage.mission)
    again._history.inputs = found.inputs
    decisions.apply(again)
    assert json.loads(again.to_json())["landmarks"] == rejected["landmarks"]
    found.undo()
    assert json.loads(found.to_json())["landmarks"] != rejected["landmarks"]
    with pytest.raises(SessionError, match="no landmark X"):
        found.reject_landmarks(BODY, ["X"], "")


@pytest.mark.slow
def test_a_position_sigma_takes_part_in_search_pose_journal_and_decisions(stage, found, tmp_path):
    """Told that the place is known to a thousandth of a pixel, the pose stays there and the attitude takes the shift."""
    held = stage.open()
    sigma_km = 1e-3 * stage.pixel_km
    for wrong in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(SessionError, match="position sigma"):
            held.find_landmarks(BODY, position_sigma_km=wrong)
    held.find_landmarks(BODY, position_sigma_km=sigma_km)
    pose = held.state.landmarks[0].pose
    assert np.linalg.norm(pose.position_shift_km) < 0.05 * np.linalg.norm(
        stage.target.position_km + stage.place
    )
    assert np.sqrt(np.diag(pose.position_covariance_km2)).max() <= 1.01 * sigma_km
    assert np.diag(found.state.landmarks[0].pose.position_covariance_km2).max() > (100.0 * sigma_km) ** 2
    assert json.loads(held.to_json())["landmarks"][0]["position_sigma_km"] == sigma_km
    decisions = load_decisions(held.write_decisions(tmp_path / "d.yaml"))
    again = ImageSession.open(stage.picture, stage.mission)
    again._history.inputs = held.inputs
    decisions.apply(again)
    assert json.loads(again.to_json())["landmarks"] == json.loads(held.to_json())["landmarks"]


@pytest.mark.slow
def test_a_lost_body_is_found_from_its_silhouette_whatever_was_believed(stage, tmp_path):
    session = stage.open()
    # 60 pixels beside its place, and a third nearer.
    side = np.cross(stage.target.position_km, [0.0, 0.0, 1.0])
    wrong = 0.67 * stage.target.position_km + 60.0 * stage.pixel_km * side / np.linalg.norm(side)
    target = dataclasses.replace(stage.target, position_km=wrong)
    session._history.inputs = dataclasses.replace(session.inputs, targets=MappingProxyType({BODY: target}))
    session.predict()
    session.find_landmarks(BODY)
    assert session.state.landmarks[0].accepted.sum() < 5
    with pytest.raises(SessionError, match="lost body"):
        session.find_landmarks(BODY, search_radius_px=20.0, lost=True)
    session.find_landmarks(BODY, lost=True)
    solution = session.state.landmarks[0]
    assert solution.accepted.mean() > 0.8
    off = stage.place - solution.pose.position_km
    assert off @ np.linalg.solve(solution.pose.position_covariance_km2, off) < 16.0
    folder = session.save(tmp_path / "run")
    assert check_file(folder / "result.json").faults == ()
    again = ImageSession.resume(folder)
    assert json.loads(again.to_json())["landmarks"] == json.loads(session.to_json())["landmarks"]
    decisions = load_decisions(session.write_decisions(tmp_path / "d.yaml"))
    assert [one.lost for one in next(iter(decisions.images.values())).landmarks][-1:] == [True]


@pytest.mark.slow
def test_files_are_sound_hold_every_landmark_and_resume_the_same(found, tmp_path):
    table = found.observables()
    n = int(found.state.landmarks[0].accepted.sum())
    assert len(table) == n
    assert set(table["method"]) == {"landmark"}
    folder = found.save(tmp_path / "run")
    for name in ("result.json", "session.json", "observables.ecsv"):
        assert check_file(folder / name).faults == (), name
    assert len(read_ecsv(folder / "observables.ecsv")) == n
    again = ImageSession.resume(folder)
    assert json.loads(again.to_json())["landmarks"] == json.loads(found.to_json())["landmarks"]


@pytest.mark.slow
def test_landmarks_alone_are_a_part_of_a_result_and_their_state_is_kept(found, tmp_path, monkeypatch):
    result = json.loads(found.to_json())
    assert result["pointing"] is None
    assert result["status"] == "partial"
    assert any(f"landmarks of {BODY} do" in message for message in result["messages"])
    monkeypatch.setattr("opnav_workbench.session.session.SAVE_KEEPS_AFTER_S", 0.0)
    folder = found.save(tmp_path / "run")

    def sought_again(*_arguments, **_options):
        raise AssertionError("the landmarks were looked for again")

    monkeypatch.setattr("opnav_workbench.session.landmark_steps.find_landmarks", sought_again)
    again = json.loads(ImageSession.resume(folder).to_json())
    assert again["landmarks"] == result["landmarks"]
    (folder / STATE_FILE).unlink()
    with pytest.raises(AssertionError, match="looked for again"):
        ImageSession.resume(folder)


def test_a_body_without_maplets_is_told(opened, tmp_path):
    for wrong, words in (({}, "opnav landmarks make"), ({"maplets": tmp_path / "no.npz"}, "no file")):
        with pytest.raises(SessionError, match=words):
            opened.find_landmarks("PLUTO", **wrong)
    with pytest.raises(SessionError, match="find_landmarks"):
        opened.accept_landmarks("PLUTO", ["a"])
