"""`opnav_workbench.process`: what the command does, from Python."""

import inspect
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

import opnav_workbench as opnav
from opnav_workbench.cli import app
from opnav_workbench.files import json_text
from opnav_workbench.processing import Processing, process_image
from opnav_workbench.rehearsal import DEMO_KERNELS
from opnav_workbench.session import BODY_METHODS
from opnav_workbench.session.autosave import STATE_FILE


@pytest.mark.slow
def test_it_writes_what_the_command_writes(demo_truths, tmp_path):
    picture, gone = demo_truths[0].picture, tmp_path / "gone.fit"
    options = {"mission": "new_horizons", "kernels": DEMO_KERNELS, "targets": "PLUTO,CHARON:unresolved"}
    said, done = [], []
    outcomes = opnav.process(
        [gone, picture],
        **options,
        out=tmp_path / "a",
        say=lambda name, _: said.append(name),
        done=done.append,
    )
    words = [word for name, value in options.items() for word in (f"--{name}", value)]
    command = ["process", str(gone), str(picture), *words, "--out", str(tmp_path / "b")]
    assert CliRunner().invoke(app, command).exit_code == 3
    # A state is kept where the machine was slow.
    files = [
        {p.relative_to(tmp_path / run) for p in (tmp_path / run).rglob("*") if p.name != STATE_FILE}
        for run in "ab"
    ]
    assert files[0] == files[1]
    for name in ("gone/result.json", f"{picture.stem}/result.json", f"{picture.stem}/observables.ecsv"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert list(outcomes) == done
    assert [outcome.failed for outcome in outcomes] == [True, False]
    assert "gone.fit" in outcomes[0].error
    assert set(said) == {gone.name, picture.name}
    methods = {body["name"]: body["method"] for body in outcomes[1].result["bodies"]}
    assert methods["CHARON"] == "unresolved"
    # Without a folder nothing is written, and the result is the same.
    before = sorted(tmp_path.rglob("*"))
    (outcome,) = opnav.process(picture, **options)
    assert json_text(outcome.result) + "\n" == (tmp_path / "a" / picture.stem / "result.json").read_text()
    assert (outcome.folder, sorted(tmp_path.rglob("*"))) == (None, before)


def test_what_would_fail_for_every_picture_is_refused_at_once(tmp_path):
    for options, said in (
        ({}, "mission: this field is required"),
        ({"mission": "apollo"}, "unknown mission"),
        ({"mission": "new_horizons", "modle": "euler"}, "modle: unknown field, did you mean model"),
        ({"mission": "new_horizons", "kernels": "none.tm"}, r"none\.tm"),
        ({"mission": "new_horizons", "decisions": tmp_path / "none.yaml"}, r"none\.yaml"),
        ({"mission": "new_horizons", "shapes": "PLUTO:none.obj"}, r"shape of PLUTO: no file none\.obj"),
    ):
        with pytest.raises(opnav.OpNavError, match=said):
            opnav.process("a.fit", **options, out=tmp_path / "run")
    with pytest.raises(opnav.SessionError, match="more than one picture is named a"):
        opnav.process(["a.fit", "b/a.fit"], mission="new_horizons", out=tmp_path / "run")
    assert not list(tmp_path.iterdir())


def test_signature_and_docstring_name_every_field():
    parameters = inspect.signature(opnav.process).parameters
    assert list(parameters) == ["images", *Processing.model_fields, "out", "say", "done", "figure"]
    section = inspect.getdoc(opnav.process).split("Parameters\n")[1].split("Returns\n")[0]
    documented = re.findall(r"^(\w+)(?: : .*)?\n {4}\S", section, re.MULTILINE)
    assert set(documented) == set(parameters)


def test_what_is_read_of_methods_is_the_one_list():
    """Program, files and workbench take their choices from it; docstrings and README repeat it in words."""
    listed = "method : {" + ", ".join(f'"{method}"' for method in BODY_METHODS) + "}"
    for documented in (opnav.process, opnav.ImageSession.find_body):
        assert listed in documented.__doc__, documented
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    assert "body centers: " + ", ".join(f"`{method}`" for method in BODY_METHODS) in readme
    words = re.search(r"# ([\w, ]+) or (\w+)\n    s\.find_body\(", readme)
    assert words is not None
    assert {*words[1].split(", "), words[2]} == set(BODY_METHODS)


def test_settings_reach_the_session(demo_truths):
    how = Processing(mission="new_horizons", targets="none", settings="max_stars=3,min_snr=4")
    outcome = process_image(demo_truths[1].picture, how.opened(), None)
    assert len(outcome.result["stars"]) <= 3
    assert outcome.result["provenance"]["settings"]["min_snr"] == 4.0


@pytest.mark.slow
def test_a_night_takes_the_method_that_stands_with_a_target(demo_truths, tmp_path):
    """Through command, plan, papermill and notebook: PLUTO:limb_scan is Pluto, found by its limb."""
    picture = demo_truths[1].picture
    words = ["nightly", picture, "-m", "new_horizons", "--kernels", DEMO_KERNELS, "--jobs", "1"]
    words += ["--targets", "PLUTO:limb_scan,CHARON", "--initial", "cross_correlation", "--out", tmp_path]
    answer = CliRunner().invoke(app, [str(word) for word in words])
    assert answer.exit_code == 0, answer.output
    result = opnav.process(
        picture, mission="new_horizons", kernels=DEMO_KERNELS, targets="PLUTO:limb_scan,CHARON",
        initial="cross_correlation",
    )[0].result  # fmt: skip
    written = (tmp_path / picture.stem / "result.json").read_text()
    methods = re.findall(r'"name": "(\w+)",\s*"method": "(\w+)"', written)
    assert ("PLUTO", "limb_scan") in methods
    assert methods == [(body["name"], body["method"]) for body in result["bodies"]]
