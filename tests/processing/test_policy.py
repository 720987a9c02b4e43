"""One picture without a person: an outcome whatever happens, its own folder, and the same again when repeated."""

import json
import os
import shutil
from dataclasses import replace

import pytest

from opnav_workbench.campaign.run_folder import read_run
from opnav_workbench.errors import OpNavError, SessionError
from opnav_workbench.kernels import KernelSet
from opnav_workbench.processing import Processing, process_image
from opnav_workbench.rehearsal import DEMO_KERNELS, DEMO_TARGETS
from opnav_workbench.session import ImageSession
from opnav_workbench.session.decisions import Decisions, load_decisions

HOW = Processing(mission="new_horizons", targets=())
POLICY = HOW.opened()
FILES = ["observables.ecsv", "result.json", "session.json", "summary.png"]


@pytest.fixture
def picture(demo_truths):
    return demo_truths[0].picture


def _names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.slow
def test_a_picture_gets_its_folder_with_all_files(demo_truths, tmp_path):
    words = []
    for truth in demo_truths:
        outcome = process_image(truth.picture, POLICY, tmp_path, words.append)
        assert not outcome.failed
        assert outcome.error == ""
        assert outcome.folder == tmp_path / truth.picture.stem
        assert _names(outcome.folder) == FILES
        written = json.loads((outcome.folder / "result.json").read_text())
        assert written["status"] == outcome.result["status"] == "ok"
    assert _names(tmp_path) == ["lorri_4x4", "mvic_framing"]
    steps = ["predicting", "finding stars", "solving the pointing", "computing observables"]
    assert words == ["reading", *steps, "writing"] * 2
    # Without a figure none stands there: an older one would show another result.
    again = process_image(demo_truths[0].picture, POLICY, tmp_path, figure=False)
    assert _names(again.folder) == sorted({*FILES} - {"summary.png"})


@pytest.mark.slow
def test_targets_of_the_mission_are_taken_with_kernels(picture, tmp_path):
    words = []
    with KernelSet(DEMO_KERNELS):
        outcome = process_image(picture, HOW.changed(targets=None).opened(), tmp_path, words.append)
    assert [f"finding {body['name']}" for body in outcome.result["bodies"]] == words[4:-2]
    assert {body["name"] for body in outcome.result["bodies"]} >= set(DEMO_TARGETS)
    without = process_image(picture, HOW.changed(targets=None).opened(), tmp_path)
    assert without.result["bodies"] == []


@pytest.mark.slow
def test_an_unknown_target_costs_no_pointing(picture, tmp_path):
    with KernelSet(DEMO_KERNELS):
        outcome = process_image(picture, HOW.changed(targets=("PLUTO", "VULCAN")).opened(), tmp_path)
    assert outcome.result["status"] == "partial"
    assert any("VULCAN" in message for message in outcome.result["messages"])
    assert [body["name"] for body in outcome.result["bodies"]] == ["PLUTO"]


@pytest.mark.slow
def test_a_target_outside_the_field_is_told_and_spoils_no_picture(picture, tmp_path):
    """Toward Pluto, the Sun is behind the camera."""
    with KernelSet(DEMO_KERNELS):
        outcome = process_image(picture, HOW.changed(targets=("PLUTO", "SUN")).opened(), tmp_path)
    assert outcome.result["status"] == "ok"
    statuses = {body["name"]: body["status"] for body in outcome.result["bodies"]}
    assert statuses == {"PLUTO": "ok", "SUN": "off_detector"}
    assert any(message.startswith("SUN: ") for message in outcome.result["messages"])
    run = read_run(outcome.folder)
    assert run.image["attention"] == []
    assert {row["body"]: row["status"] for row in run.parts["bodies"]} == statuses


def _never_opened(*_, **__):
    raise OpNavError("an error of ours")


@pytest.mark.parametrize("name", ["missing.fit", "empty.fit", "."])
def test_bad_input_is_an_outcome(tmp_path, name):
    (tmp_path / "empty.fit").touch()
    outcome = process_image(tmp_path / name, POLICY, tmp_path / "run")
    assert outcome.failed
    assert outcome.error
    assert "\n" not in outcome.error
    assert outcome.result["messages"] == [outcome.error]
    assert json.loads((outcome.folder / "result.json").read_text()) == outcome.result


@pytest.mark.parametrize("step", ["open", "predict", "find_stars", "repoint", "compute_observables", "save"])
def test_an_error_in_any_step_is_an_outcome(picture, tmp_path, monkeypatch, step):
    monkeypatch.setattr(ImageSession, step, _never_opened)
    outcome = process_image(picture, POLICY, tmp_path)
    assert outcome.failed
    assert outcome.error == "an error of ours"
    written = json.loads((tmp_path / picture.stem / "result.json").read_text())
    assert (written["status"], written["messages"]) == ("failed", ["an error of ours"])


def test_an_unforeseen_error_leaves_its_traceback(picture, tmp_path, monkeypatch):
    def surprise(*_, **__):
        raise ZeroDivisionError("two\nlines")

    monkeypatch.setattr(ImageSession, "repoint", surprise)
    outcome = process_image(picture, POLICY, tmp_path)
    assert outcome.failed
    assert outcome.error.startswith("unforeseen ZeroDivisionError: two lines")
    assert "surprise" in (tmp_path / picture.stem / "traceback.txt").read_text()


@pytest.mark.parametrize("name", ["...fit", "..fit"])
def test_a_name_that_would_leave_its_folder_is_refused(picture, tmp_path, name):
    """The stem of ``...fit`` is ``..``, that of ``..fit`` is the folder of all pictures itself."""
    bad = tmp_path / name
    shutil.copy(picture, bad)
    if bad.stem not in ("..", "."):
        pytest.skip(f"this Python takes {bad.stem!r} as the stem, which is harmless")
    out = tmp_path / "runs" / "run"
    out.mkdir(parents=True)
    outcome = process_image(bad, POLICY, out)
    assert outcome.failed
    assert outcome.result["messages"] == [outcome.error]
    assert _names(tmp_path / "runs") == ["run"]
    assert _names(out) == []


def test_a_link_that_leads_out_of_the_folder_is_refused(picture, tmp_path):
    outside, out = tmp_path / "outside", tmp_path / "run"
    outside.mkdir()
    out.mkdir()
    (out / picture.stem).symlink_to(outside, target_is_directory=True)
    outcome = process_image(picture, POLICY, out)
    assert outcome.failed
    assert "outside" in outcome.error
    assert _names(outside) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is read-only to root")
def test_a_folder_that_cannot_be_written(picture, tmp_path):
    tmp_path.chmod(0o500)
    outcome = process_image(picture, POLICY, tmp_path)
    tmp_path.chmod(0o700)
    assert outcome.failed
    assert "cannot write" in outcome.error


def test_replaying_decisions_is_bit_identical(picture, tmp_path):
    first = process_image(picture, POLICY, tmp_path / "first", figure=False)
    star = next(s["id"] for s in first.result["stars"] if s["status"] == "used")
    file = tmp_path / "decisions.yaml"
    file.write_text(f'images: {{{picture.name}: {{reject: [{{star: "{star}", reason: smeared}}]}}}}')
    decided = replace(POLICY, decisions=load_decisions(file))
    runs = [process_image(picture, decided, tmp_path / run, figure=False) for run in ("a", "b")]
    assert [(run.folder / "result.json").read_bytes() for run in runs][1:] == [
        (tmp_path / "a" / picture.stem / "result.json").read_bytes()
    ]
    row = next(s for s in runs[0].result["stars"] if s["id"] == star)
    assert (row["status"], row["reason"]) == ("rejected", "by the analyst: smeared")
    assert runs[0].result["pointing"]["n_stars"] == first.result["pointing"]["n_stars"] - 1
    # What was decided is in the result, and resuming makes the same decisions.
    assert runs[0].result["provenance"]["decisions"] == [
        {"star": star, "verdict": "rejected", "reason": "smeared"}
    ]
    ImageSession.resume(runs[0].folder).save(tmp_path / "resumed")
    assert (tmp_path / "resumed" / "result.json").read_bytes() == (
        runs[0].folder / "result.json"
    ).read_bytes()


@pytest.mark.slow
def test_rejecting_every_star_fails_with_the_reason(picture, tmp_path):
    stars = [s["id"] for s in process_image(picture, POLICY, tmp_path).result["stars"]]
    verdicts = {"reject": [{"star": star, "reason": "clouds"} for star in stars]}
    decisions = Decisions.model_validate({"images": {"*": verdicts}})
    outcome = process_image(picture, replace(POLICY, decisions=decisions), tmp_path)
    assert outcome.failed
    assert "no usable star" in outcome.error


def test_policy_is_checked_before_any_picture():
    with pytest.raises(SessionError, match="euler"):
        HOW.changed(model="guess")
