"""`opnav export`: many processed pictures into one file, every format, one-line errors."""

import json

import numpy as np
import pytest
import typer
from astropy.table import QTable
from typer.testing import CliRunner

from opnav_workbench.cli.export import FORMATS, export
from opnav_workbench.errors import SessionError
from opnav_workbench.observables import (
    Observable,
    read_csv,
    read_ecsv,
    read_json,
    read_tdm,
    tdm_table,
    write_ecsv,
)

app = typer.Typer()
app.command()(export)


def opnav(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "160"})


def observable(name, image, et, method="limb_scan"):
    place = np.array([500.0, 400.0])
    return Observable(
        image=image,
        utc="2015-07-12T08:46:57",
        et=et,
        name=name,
        method=method,
        status="ok",
        reference_body="PLUTO BARYCENTER",
        a_priori_px=place,
        predicted_px=place,
        observed_px=place + 0.25,
        residual_px=np.full(2, 0.25),
        covariance_px2=0.01 * np.eye(2),
        total_covariance_px2=0.02 * np.eye(2),
        diameter_px=80.0,
        measured_diameter_px=np.nan,
        partials_px_per_km=np.ones((2, 3)),
        partials_px_per_rad=np.ones((2, 3)),
        apparent_ra_deg=270.001,
        apparent_dec_deg=-14.0,
        ra_deg=270.0,
        dec_deg=-14.001,
        residual_arcsec=np.zeros(2),
        snr=10.0,
        messages=(),
    )


@pytest.fixture
def run(tmp_path):
    """Two processed pictures; the later one stands first in the alphabet."""
    for image, et in (("b", 4.8e8), ("a", 4.9e8)):
        folder = tmp_path / "run" / image
        write_ecsv(
            [observable(n, f"{image}.fit", et) for n in ("PLUTO", "CHARON")], folder / "observables.ecsv"
        )
        result = {"mission": "new_horizons", "bodies": [], "pointing": None}
        (folder / "result.json").write_text(json.dumps(result))
    return tmp_path / "run"


READERS = {
    "csv": read_csv,
    "ecsv": read_ecsv,
    "json": read_json,
    "tdm": lambda path: tdm_table(read_tdm(path)),
}


@pytest.mark.slow(keep=["json"])
@pytest.mark.parametrize("name", FORMATS)
def test_every_format_holds_all_pictures_in_time_order(run, tmp_path, name):
    out = tmp_path / f"approach.{name}"
    answer = opnav(run, "--out", out)
    assert answer.exit_code == 0, answer.output
    assert "4 observables of 2 pictures (CHARON 2, PLUTO 2), 4 with a center" in answer.output
    back = READERS[name](out)
    assert len(back) == 4
    if isinstance(back, QTable):
        assert set(back["observer"]) == {"NEW HORIZONS"}  # the mission of result.json told it
    else:
        assert [o.image for o in back] == ["b.fit", "b.fit", "a.fit", "a.fit"]
        assert {o.observer for o in back} == {"NEW HORIZONS"}


def test_results_targets_and_methods_choose(run, tmp_path):
    out = tmp_path / "one.json"
    answer = opnav(
        run / "a" / "result.json", "-f", "json", "-o", out, "--targets", "charon", "--methods", "limb_scan"
    )
    assert answer.exit_code == 0, answer.output
    (only,) = read_json(out)
    assert (only.name, only.image) == ("CHARON", "a.fit")
    # What was exported can be exported again.
    answer = opnav(out, "-o", tmp_path / "again.tdm", "--spacecraft", "NH", "--originator", "KINETX")
    assert answer.exit_code == 0, answer.output
    message = read_tdm(tmp_path / "again.tdm")
    assert message.header["ORIGINATOR"] == "KINETX"
    assert message.segments[0].participants() == ("CHARON", "NH")


def test_result_without_its_table(run, tmp_path):
    (run / "a" / "observables.ecsv").unlink()
    answer = opnav(run / "a" / "result.json", "-o", tmp_path / "x.csv")
    assert isinstance(answer.exception, SessionError)
    assert "no observable to export; there are: none" in str(answer.exception)


@pytest.mark.slow(
    keep=[
        "arguments0-nowhere is no folder",
        "arguments1-holds no observables.ecsv",
        "arguments2-unknown format 'xml'; choose --format tdm | csv | json | ecsv",
    ]
)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nowhere", "--format", "csv"), "nowhere is no folder"),
        ((".", "--format", "csv"), "holds no observables.ecsv"),
        (("run", "--format", "xml"), "unknown format 'xml'; choose --format tdm | csv | json | ecsv"),
        (("run",), "no format given"),
        (("run", "-f", "csv", "--targets", "NIX"), "there are: CHARON (limb_scan), PLUTO (limb_scan)"),
        (("run", "-f", "tdm", "--frame", "B1950"), "unknown frame 'B1950'; choose one of ICRF, EME2000"),
    ],
)
def test_errors_are_one_line(run, tmp_path, monkeypatch, arguments, message):
    empty = tmp_path / "empty"
    empty.mkdir()
    monkeypatch.chdir(empty if arguments[0] == "." else tmp_path)
    answer = opnav(*arguments)
    assert isinstance(answer.exception, SessionError), answer.output
    assert message in str(answer.exception)
    assert "\n" not in str(answer.exception)
    assert not list(tmp_path.rglob("observables.csv"))


def test_help_shows_an_example():
    output = opnav("--help").output
    assert "opnav export run --format tdm --out approach.tdm" in output


def test_rows_that_are_no_observables_are_not_handed_on(run, tmp_path):
    """A table whose columns were shifted can be read; what it says is none of what a body can be."""
    table = run / "a" / "observables.ecsv"
    table.write_text(table.read_text().replace(" ok ", " 0.002 ", 1))
    answer = opnav(run, "-o", tmp_path / "x.csv")
    assert isinstance(answer.exception, SessionError)
    assert "a.fit PLUTO: status '0.002'" in str(answer.exception)
    assert not (tmp_path / "x.csv").exists()
