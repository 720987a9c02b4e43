"""``opnav simulate``: tables, files, options and errors as a user sees them."""

import json
import shlex
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from opnav_workbench.cli import app
from opnav_workbench.cli.program import main
from opnav_workbench.cli.simulate import _next_command
from opnav_workbench.simulation import load_picture_scenario

WIDE = {"COLUMNS": "160", "NO_COLOR": "1", "TERM": "dumb"}
SCENARIO = """\
mission: new_horizons
kernels: new_horizons/pluto_opnav
bodies:
- name: PLUTO
- name: CHARON
pictures:
- name: first
  utc: 2015-04-09T12:00:00
  camera: lorri_4x4
  exposure_s: 0.1
  stretch: [log, linear]
- name: second
  utc: 2015-04-09T12:01:00
  camera: lorri_4x4
  exposure_s: 0.2
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(SCENARIO)
    return path


def invoke(*arguments):
    return CliRunner().invoke(app, ["simulate", *map(str, arguments)], env=WIDE)


def test_pictures_and_bodies_are_told_in_tables(file, tmp_path):
    answer = invoke(file, "--out", tmp_path / "out")
    assert answer.exit_code == 0, answer.output
    assert "LORRI 4x4" in answer.output
    for word in ("first", "second", "PLUTO", "CHARON", "SNR", "diameter px", "first.fit", "first_linear.png"):
        assert word in answer.output
    assert "first: CHARON is drawn by Lambert's law, as nobody says how it scatters light" in answer.output
    assert (tmp_path / "out" / "first.fit").is_file()
    assert (tmp_path / "out" / "second_log.png").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("only", ["fc1", ""])
def test_what_is_simulated_is_solved_by_the_command_that_is_printed(only, tmp_path, monkeypatch):
    """A mission out of the box, its files bare of any geometry that its archive has not: no option is to be guessed."""
    monkeypatch.chdir(tmp_path)
    answer = invoke("dawn/star_fields", "--out", "my pictures", *(("--only", only) if only else ()))
    (line,) = (line for line in answer.output.splitlines() if line.startswith("Next: "))
    program, *words = shlex.split(line.removeprefix("Next: "))
    assert (program, words[0]) == ("opnav", "process")
    pictures = sorted(tmp_path.glob(words[1]))
    assert len(pictures) == (1 if only else 2)
    arguments = ["process", *map(str, pictures), *words[2:], "--no-figure", "--out", "run"]
    solved = CliRunner().invoke(app, arguments, env=WIDE)
    assert solved.exit_code == 0, solved.output
    for picture in pictures:
        assert json.loads((tmp_path / "run" / picture.stem / "result.json").read_text())["status"] == "ok"


def test_only_seed_and_jobs(file, tmp_path):
    for name, options in {"a": ("--seed", 1), "b": ("--seed", 1, "--jobs", 2), "c": ("--seed", 2)}.items():
        answer = invoke(file, "--out", tmp_path / name, "--only", "second", *options)
        assert answer.exit_code == 0, answer.output
    pictures = [(tmp_path / name / "second.fit").read_bytes() for name in "abc"]
    assert pictures[0] == pictures[1] != pictures[2]
    assert not (tmp_path / "a" / "first.fit").exists()
    assert json.loads((tmp_path / "c" / "second.truth.json").read_text())["settings"]["seed"] == 2


def test_other_kernels_and_catalog(file, tmp_path):
    file.write_text(file.read_text().replace("new_horizons/pluto_opnav", "nowhere/at_all"))
    options = ("--kernels", "new_horizons/pluto_opnav", "--catalog", "bundled", "--only", "first")
    answer = invoke(file, "--out", tmp_path / "out", *options)
    assert answer.exit_code == 0, answer.output


def test_ready_scenarios_are_listed():
    answer = invoke("--list")
    assert answer.exit_code == 0
    for name in ("new_horizons/m7_2006", "new_horizons/pluto_barycenter", "osiris_rex/bennu_approach"):
        assert name in answer.output
    assert "Figure 13" in answer.output


ERRORS = [
    ("exposure_s: 0.1", "exposure_s: 0.0", "line 10: pictures.0.exposure_s"),
    ("name: CHARON", "name: CHAROM", "line 5: bodies.1.name"),
    ("camera: lorri_4x4", "camera: lorri", "line 9: pictures.0.camera: unknown camera 'lorri'"),
    ("2015-04-09T12:00:00", "2019-04-09T12:00:00", "line 8: pictures.0.utc"),
]


@pytest.mark.parametrize(("old", "new", "message"), ERRORS, ids=[new for _, new, _ in ERRORS])
def test_errors_are_one_line_with_the_line_of_the_file(
    file, tmp_path, capsys, monkeypatch, old, new, message
):
    file.write_text(SCENARIO.replace(old, new, 1))
    monkeypatch.setattr("sys.argv", ["opnav", "simulate", str(file), "--out", str(tmp_path / "out")])
    for name, value in WIDE.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(SystemExit) as stop:
        main()
    error = capsys.readouterr().err
    assert stop.value.code == 2
    assert message in error
    assert error.strip().count("\n") == 0
    assert not (tmp_path / "out").exists()


def test_no_scenario_and_unknown_names_are_told_where_to_look():
    for arguments, words in (((), "simulate --list"), (("new_horizons/pluto_carn",), "did you mean")):
        answer = invoke(*arguments)
        assert answer.exit_code != 0
        assert words in str(answer.exception)


def test_help_has_an_example():
    answer = invoke("--help")
    assert answer.exit_code == 0
    assert "opnav simulate new_horizons/pluto_charon" in answer.output


def test_the_next_command_asks_for_no_body_that_was_not_drawn():
    """Star fields of missions whose files name a target: its kernels are not among those made for the stars."""
    report = SimpleNamespace(files=[Path("out/a.fit")])
    for name, bare in (
        ("near/star_fields", True),
        ("dawn/star_fields", False),
        ("new_horizons/pluto_charon", False),
    ):
        said = _next_command(load_picture_scenario(name), Path("out"), [report])
        assert said.endswith("--targets none") is bare
