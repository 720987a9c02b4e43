"""The catalog commands: what a user reads, and what a script reads."""

import json

import numpy as np
import pytest
from astropy.table import QTable
from typer.testing import CliRunner

from opnav_workbench.catalog import UNKNOWN_MOTION_MAS_YR
from opnav_workbench.catalog.vizier import VizierCatalog
from opnav_workbench.cli.catalog import catalog_app
from opnav_workbench.errors import CatalogError

RUN = CliRunner()


@pytest.fixture
def three_stars(tmp_path):
    path = tmp_path / "three.npz"
    np.savez(
        path,
        ra_deg=np.array([10.0, 10.1, 10.2]),
        dec_deg=np.array([-20.0, -20.1, -19.9]),
        mag=np.array([7.0, 5.0, 9.0]),
        id=np.array(["one", "two", "three"]),
        pmra_mas_yr=np.array([100.0, 0.0, np.nan]),
        pmdec_mas_yr=np.array([-50.0, 0.0, np.nan]),
        epoch_jyear=2000.0,
        sigma_mas=5.0,
    )
    return f"npz:{path}"


def run(*words):
    result = RUN.invoke(catalog_app, list(words), catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_list_names_every_kind():
    shown = run("list")
    for kind in ("bundled", "tycho2:DIR", "ucac2:DIR", "ucac4:DIR", "hip2:DIR", "npz:FILE", "vizier:NAME"):
        assert kind in shown


def test_info(three_stars):
    shown = run("info", three_stars)
    assert "n stars" in shown
    assert "brightest mag" in shown
    assert " 5" in shown


def test_info_of_a_merged_catalog_tells_of_each_part(three_stars):
    lines = run("info", f"{three_stars}+{three_stars}").splitlines()
    assert sum(line.split()[:2] == ["n", "stars"] for line in lines) == 3  # the whole and its two parts
    assert not any("n_stars" in line for line in lines)


def test_cone_for_people(three_stars, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    lines = run("cone", three_stars, "10.1", "-20", "0.12").splitlines()
    assert [line.split()[0] for line in lines[1:3]] == ["two", "one"]  # brightest first
    assert "100.0" in lines[2]
    assert "2 stars" in lines[-1]


def test_a_narrow_terminal_cuts_no_number(three_stars, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    shown = run("cone", three_stars, "10.1", "-20", "0.5")
    assert "…" not in shown
    assert "-20.100000" in shown


def test_cone_for_programs(three_stars):
    found = json.loads(run("cone", three_stars, "10.1", "-20", "0.5", "--json"))
    assert [star["id"] for star in found["stars"]] == ["two", "one", "three"]
    assert found["stars"][1]["pmra_mas_yr"] == pytest.approx(100.0)
    assert found["stars"][2]["motion_known"] is False
    assert found["stars"][2]["rv_km_s"] is None  # nan is not JSON


def test_places_at_an_epoch(three_stars):
    found = json.loads(run("cone", three_stars, "10.1", "-20", "0.5", "--epoch", "2020.0", "--json"))
    one = next(star for star in found["stars"] if star["id"] == "one")
    assert one["dec_deg"] == pytest.approx(-20.0 - 20 * 0.050 / 3600.0, abs=1e-9)
    assert one["ra_deg"] == pytest.approx(10.0 + 20 * 0.100 / 3600.0 / np.cos(np.radians(20.0)), abs=1e-8)


def test_sigmas_are_those_of_the_places_shown(three_stars, monkeypatch):
    """Twenty years on the unknown motion of a star tells: 15 mas/yr, beside the 5 mas of its place."""
    words = ("cone", three_stars, "10.1", "-20", "0.5")
    then, later = (json.loads(run(*words, *more, "--json"))["stars"][2] for more in ((), ("--epoch", "2020")))
    assert then["sigma_mas"] == pytest.approx([5.0, 5.0])
    assert later["sigma_mas"] == pytest.approx([np.hypot(5.0, 20 * UNKNOWN_MOTION_MAS_YR)] * 2, rel=1e-3)
    monkeypatch.setenv("COLUMNS", "80")
    assert run(*words, "--epoch", "2020").splitlines()[3].split()[-1] == f"{later['sigma_mas'][0]:.2f}"


def test_magnitude_limit_plot_and_table(three_stars, tmp_path):
    chart, table = tmp_path / "chart.png", tmp_path / "stars.ecsv"
    shown = run(
        "cone", three_stars, "10.1", "-20", "0.5", "--mag", "8", "--plot", str(chart), "--out", str(table)
    )
    assert "2 stars" in shown
    assert all(f"Written: {path}" in shown for path in (chart, table))
    assert chart.read_bytes().startswith(b"\x89PNG")
    assert list(QTable.read(table)["id"]) == ["two", "one"]


def test_empty_cone(three_stars, tmp_path):
    chart = tmp_path / "chart.png"
    assert "0 stars" in run("cone", three_stars, "200", "40", "0.1", "--plot", str(chart))
    assert chart.is_file()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--epoch", "20150"), "no Julian year"),
        (("--exclude", "BRIGHT"), "unknown flag BRIGHT; use DOUBLE"),
    ],
)
def test_wrong_options_say_so(three_stars, words, message):
    with pytest.raises(CatalogError, match=message):
        run("cone", three_stars, "10", "-20", "1", *words)


@pytest.mark.parametrize(
    ("dec", "radius", "message"),
    [("-95", "1", r"dec -95 deg .* -90 to 90 deg"), ("20", "200", r"200 deg; give 0 to 180 deg")],
)
def test_numbers_off_the_sky_are_told_in_degrees(three_stars, dec, radius, message):
    with pytest.raises(CatalogError, match=message):
        run("cone", three_stars, "10", dec, radius)


def test_fetch(monkeypatch):
    asked = []
    monkeypatch.setattr(VizierCatalog, "fetch", lambda self, *cone: asked.append((self.name, *cone)) or 12)
    shown = run("fetch", "gaia-dr3", "--cone", "217.39", "-62.68", "0.5", "--mag", "16")
    assert asked == [("vizier:gaia-dr3", 217.39, -62.68, 0.5, 16.0)]
    assert "12 stars" in shown
    with pytest.raises(CatalogError, match="unknown VizieR catalog"):
        run("fetch", "sao", "--cone", "0", "0", "1")


def test_build_converts_now(three_stars):
    assert "n stars" in run("build", three_stars)
