"""What a person or a file may say to a command: out of range, one line; what was finished is kept and shown."""

import os
import shutil
import stat
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from opnav_workbench.campaign import Campaign
from opnav_workbench.cli import lab_server
from opnav_workbench.cli import process as process_command
from opnav_workbench.cli.catalog import catalog_app
from opnav_workbench.cli.program import main
from opnav_workbench.errors import CatalogError, MissionError, SessionError
from opnav_workbench.files import given_cell, inside, plain_cell, read_json
from opnav_workbench.kernels.making.attitude_history import even_epochs
from opnav_workbench.processing import Processing
from opnav_workbench.rehearsal.scenario import OrtEntry
from opnav_workbench.session.history import JournalEntry, journal_line, read_journal_file, stored_entry
from opnav_workbench.simulation.output import stretched
from opnav_workbench.simulation.scenario import PictureEntry
from opnav_workbench.yaml_file import check_model

sys.path.insert(0, str(Path(__file__).parents[1]))

from hostile import answer

HOW = Processing(mission="new_horizons", targets=())
BYTES = b"a\xff\xfe.fit"  # no UTF-8


@pytest.mark.parametrize(
    ("ra", "dec", "radius", "words"),
    [
        ("400", "0", "1", "ra 400 deg"),
        ("-1", "0", "1", "ra -1 deg"),
        ("nan", "0", "1", "ra nan deg"),
        ("1", "91", "1", "dec 91 deg"),
        ("1", "nan", "1", "dec nan deg"),
        ("1", "0", "-1", "-1 deg"),
        ("1", "0", "inf", "inf deg"),
    ],
)
def test_a_cone_out_of_range(ra, dec, radius, words):
    with pytest.raises(CatalogError, match=f"{words}.*give .* deg"):
        CliRunner().invoke(catalog_app, ["cone", "bundled", ra, dec, radius], catch_exceptions=False)


@pytest.mark.parametrize("port", [-1, 65536, 10**9])
def test_ports_beyond_range(port):
    with pytest.raises(SessionError, match="is no port; choose one from 1024 to 65535"):
        lab_server._free_port(port)


def test_the_token_stands_in_a_page_for_this_user_alone(tmp_path):
    server = lab_server.LabServer(tmp_path / "workbench.ipynb")
    before = os.umask(0)
    try:
        address = server.browser_page()
    finally:
        os.umask(before)
    page = tmp_path / lab_server.BROWSER_PAGE
    assert address == page.resolve().as_uri()
    assert server.token not in address
    assert f"url={server.url}" in page.read_text()
    assert stat.S_IMODE(page.stat().st_mode) == 0o600


@pytest.mark.parametrize("name", ["=1+1", "+A1", "-A1", "@SUM(A1)", "'quoted", "lor_1.fit", "-98", ""])
def test_cells_are_no_formulas_and_come_back(name):
    assert given_cell(plain_cell(name)) == name
    assert not plain_cell(name).startswith(("=", "+", "@"))


@pytest.mark.parametrize(
    "values",
    [
        {"step": ["note"]},
        {"step": "note", "parameters": [1, 2]},
        {"step": "note", "parameters": {}, "reason": None},
        ["step"],
        {"step": "note", "unknown": 1},
        5,
    ],
)
def test_a_journal_whose_step_is_none(tmp_path, values):
    with pytest.raises(TypeError):
        stored_entry(values)
    good = journal_line("s", 0, None, JournalEntry("note", {"text": "\udcff"}), {})
    path = tmp_path / "journal"
    path.write_bytes(good + good.replace(b'"step":"note"', b'"step":["note"]'))
    tail = read_journal_file(path, "s", ())
    assert [entry.step for entry in tail.entries] == ["note"]
    assert tail.entries[0].parameters == {"text": "\udcff"}


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a": ' + "9" * 5000 + "}", "\ufeff{}", "[]"])
def test_json_that_trips_its_reader(tmp_path, text):
    path = tmp_path / "result.json"
    path.write_text(text)
    with pytest.raises(SessionError, match="cannot be read"):
        read_json(path, "copy it again.")


def test_series_are_as_long_as_a_person_means():
    start = {"name": "a", "exposure_s": 1.0, "start": "2015-07-01T00:00:00"}
    with pytest.raises(MissionError, match="864001 pictures; 10000 at most"):
        check_model(start | {"stop": "2015-07-11T00:00:00", "step_s": 1.0}, PictureEntry, "s", MissionError)
    ort = start | {"camera": "c", "step_s": 1.0}
    with pytest.raises(MissionError, match="100000000 pictures; 10000 at most"):
        check_model(ort | {"count": 10**8}, OrtEntry, "s", MissionError)
    with pytest.raises(MissionError, match="beyond the calendar"):
        check_model(ort | {"count": 9, "step_s": 1e300}, OrtEntry, "s", MissionError)
    assert len(check_model(ort | {"count": 9}, OrtEntry, "s", MissionError).expanded()) == 9
    with pytest.raises(ValueError, match=r"1e\+09 attitudes, the limit is 3000000"):
        even_epochs(0.0, 1e6, 1e-3)


def test_a_folder_of_links_in_a_circle(tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(SessionError, match=r"cannot be followed|points outside"):
        inside(tmp_path / "loop", "a")


@pytest.mark.slow
def test_names_of_any_bytes_cost_their_neighbours_nothing(demo_truths, tmp_path, capsys):
    """Before, the first of them ended the batch."""
    picture, out = demo_truths[0].picture, tmp_path / "out"
    names = [BYTES, b"l" * 230 + b"\x1b[31m\nc$\\bad$.fit", b"good.fit"]
    files = [Path(os.fsdecode(os.fsencode(tmp_path) + b"/" + name)) for name in names]
    for file in files:
        shutil.copy(picture, file)
    pipe = tmp_path / "pipe.fit"
    os.mkfifo(pipe)
    outcomes = process_command.run_images([*files, pipe], HOW, out)
    assert [outcome.result["status"] for outcome in outcomes] == ["ok"] * 3 + ["failed"]
    assert outcomes[0].result["image"] == "a\\xff\\xfe.fit"
    shown = "".join(capsys.readouterr())
    assert "\x1b[31m" not in shown
    assert "a\\xff\\xfe" in shown


@pytest.mark.slow
def test_ctrl_c_shows_what_was_finished(demo_truths, tmp_path, monkeypatch, capsys):
    files = [demo_truths[0].picture, demo_truths[1].picture]
    solve = process_command.process_images

    def interrupted(images, how, out, say, done, **more):
        solve(images[:1], how, out, say, done, **more)
        raise KeyboardInterrupt

    monkeypatch.setattr(process_command, "process_images", interrupted)
    with pytest.raises(KeyboardInterrupt):
        process_command.run_images(files, HOW, tmp_path)
    shown = capsys.readouterr().out
    assert "lorri_4x4" in shown
    assert f"Results in {tmp_path}/" in shown.replace("\n", "")


def test_main_prints_one_line(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["opnav", "catalog", "cone", "npz:\udcff\n.npz", "1", "1", "1"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


def ended(monkeypatch, capsys, *arguments):
    """Run the program as a shell would; return exit status and standard error."""
    monkeypatch.setattr(sys, "argv", ["opnav", *arguments])
    with pytest.raises(SystemExit) as stop:
        main()
    return stop.value.code, capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("proces", "No such command 'proces'. Did you mean 'process'"),
        ("catalog cone bundled x 1 2", "Invalid value for 'ra'"),
        ("kernels make a.yaml --out", "Option '--out' requires an argument"),
        ("process", "Missing argument 'images'; opnav process --help tells what it takes"),
        ("doctor \udcff", "unexpected extra argument"),
    ],
)
def test_wrong_usage_is_one_line(line, words, monkeypatch, capsys):
    status, said = ended(monkeypatch, capsys, *line.split())
    assert status == 2
    assert said.startswith("error: ")
    assert words.lower() in said.lower()
    assert said.count("\n") == 1
    assert said.rstrip("\n").isprintable()


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(28, "No space left on device", "run/a"), "No space left on device (run/a); see to that"),
        (MemoryError(), "not enough memory"),
    ],
)
def test_the_machine_s_faults_are_one_line(error, words, monkeypatch, capsys):
    def fails(*_, **__):
        raise error

    monkeypatch.setattr("opnav_workbench.cli.catalog.catalog_status", fails)
    status, said = ended(monkeypatch, capsys, "catalog", "list")
    assert status == 2
    assert said.startswith(f"error: {words}")
    assert said.count("\n") == 1


def test_defects_of_ours_keep_their_traceback(monkeypatch):
    def fails(*_, **__):
        raise ZeroDivisionError

    monkeypatch.setattr("opnav_workbench.cli.catalog.catalog_status", fails)
    monkeypatch.setattr(sys, "argv", ["opnav", "catalog", "list"])
    with pytest.raises(ZeroDivisionError):
        main()


def test_a_full_disk_under_standard_output_is_told(monkeypatch, capsys):
    with Path("/dev/full").open("w", encoding="utf-8") as full, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", full)
        status, said = ended(monkeypatch, capsys, "catalog", "list")
        with pytest.raises(OSError, match="No space"):
            full.close()
    assert status == 2
    assert said.startswith("error: No space left on device")


def test_ctrl_c_ends_any_command_with_a_line(monkeypatch, capsys):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("opnav_workbench.cli.catalog.catalog_status", stopped)
    status, said = ended(monkeypatch, capsys, "catalog", "list")
    assert status == 130
    assert said == "stopped; what was finished is kept.\n"


@pytest.mark.parametrize(
    "line", ["serve EMPTY --no-browser", "query images --archive EMPTY", "compare EMPTY EMPTY"]
)
def test_an_empty_file_is_no_archive_and_stays_empty(line, tmp_path):
    """SQLite made a database of it, and `serve` served that."""
    (tmp_path / "a").touch()
    status, _, err = answer(["campaign", *line.replace("EMPTY", str(tmp_path / "a")).split()])
    assert (status, err.count("\n")) == (2, 1)
    assert "is empty (0 bytes)" in err
    assert (tmp_path / "a").read_bytes() == b""


def test_a_date_that_is_none_selects_nothing_by_mistake(tmp_path):
    archive = str(tmp_path / "a.sqlite")
    with Campaign(archive):
        pass
    status, _, err = answer(["campaign", "query", "images", "--archive", archive, "--since", "never"])
    assert (status, err) == (
        2, "error: --since 'never' is no date; write it like 2015-04-09 or 2015-04-09T12:30.\n"
    )  # fmt: skip


def test_maplets_that_are_none_are_no_pickles_to_be_trusted(tmp_path):
    (tmp_path / "a.npz").write_bytes(b"anything")
    _, _, err = answer(["landmarks", "show", str(tmp_path / "a.npz")])
    assert "not a whole npz file" in err
    assert "pickle" not in err


@pytest.mark.slow
def test_a_mission_that_fails_leaves_nothing(tmp_path):
    """What it left had to be deleted before the command could be given again."""
    out = tmp_path / "m"
    told = answer(f"mission new probe --fov-deg 10 --size 64x64 --catalog npz:none --out {out}".split())
    assert told[0] == 2
    assert not out.exists()


def test_a_picture_of_one_pixel_has_a_preview():
    assert stretched(np.full((1, 1), 7.0)).tolist() == [[0]]
