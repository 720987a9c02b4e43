"""`opnav landmarks`: maplets made and shown, lengths read, faults in one line."""

import pytest
from typer.testing import CliRunner

from opnav_workbench.cli import app, main
from opnav_workbench.cli.landmarks import _km
from opnav_workbench.contracts import check_file
from opnav_workbench.errors import MissionError
from opnav_workbench.landmarks import Maplets


def test_maplets_of_an_ellipsoid_are_made_shown_and_checked(tmp_path):
    path = tmp_path / "m.npz"
    words = ["landmarks", "make", "BENNU", "--radii", "0.28", "0.27", "0.25", "--spacing", "40deg"]
    made = CliRunner().invoke(app, [*words, "--samples", "9", "--scale", "10m", "--out", str(path)])
    assert made.exit_code == 0, made.output
    maplets = Maplets.read(path)
    assert (maplets.body, maplets.samples, maplets.scale_km[0]) == ("BENNU", 9, pytest.approx(0.01))
    assert "ellipsoid" in maplets.source
    assert check_file(path).faults == ()
    told = CliRunner().invoke(app, ["landmarks", "show", str(path)])
    assert f"{len(maplets)}, latitude" in told.output
    path.write_bytes(b"no")
    assert len(check_file(path).faults) == 1


@pytest.mark.parametrize(("text", "km"), [("20m", 0.02), ("0.5km", 0.5), ("0.5", 0.5), ("180deg", 6.2832)])
def test_lengths_are_read_with_their_units(text, km):
    assert _km(text, 2.0) == pytest.approx(km, rel=1e-4)


@pytest.mark.parametrize("text", ["", "5 feet", "-1km", "nan", "0deg"])
def test_no_length_is_refused(text):
    with pytest.raises(MissionError, match="20m"):
        _km(text, 1.0)


def test_body_without_a_shape_costs_one_line(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["opnav", "landmarks", "make", "EROS", "--spacing", "5deg"])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 2
    assert "--shape FILE" in " ".join(capsys.readouterr().err.split())
