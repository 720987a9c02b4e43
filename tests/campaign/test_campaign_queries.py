"""Questions, exports and the command line of the archive."""

import csv
import io
import json

import numpy as np
import pytest
from astropy.table import QTable
from matplotlib.image import imread
from typer.testing import CliRunner

from opnav_workbench.campaign import Campaign, export_observables
from opnav_workbench.cli.campaign import campaign_app
from opnav_workbench.errors import SessionError
from opnav_workbench.observables import read_csv, read_json, read_tdm

WIDE = {"COLUMNS": "160", "NO_COLOR": "1", "TERM": "dumb"}


def invoke(*arguments):
    return CliRunner().invoke(campaign_app, [str(a) for a in arguments], env=WIDE)


@pytest.fixture(scope="module")
def archive(make_run, tmp_path_factory):
    """Twenty pictures, an hour apart from 2015-04-09; the last one doubtful, and one far off its trend."""
    folder = tmp_path_factory.mktemp("archive")

    def doubtful(result, session):
        result["status"], result["messages"] = "partial", ["CHARON: SNR 3.7 is below 5"]
        result["bodies"][1]["status"] = "uncertain"

    def off(result, session):
        body = result["bodies"][0]
        body["residual_px"][0] += 15.0 * np.sqrt(body["covariance_with_pointing_px2"][0][0])

    for i in range(20):
        edit = {19: doubtful, 7: off}.get(i, lambda result, session: None)
        make_run(folder / "runs" / f"r{i:02d}", i, edit=edit)
    with Campaign(folder / "campaign.sqlite") as campaign:
        assert campaign.ingest(folder / "runs").count("new") == 20
    return folder / "campaign.sqlite"


@pytest.mark.parametrize(
    ("what", "filters", "count"),
    [
        ("images", {}, 20),
        ("images", {"status": "partial"}, 1),
        ("images", {"status": "ok, partial"}, 20),
        ("images", {"since": "2015-04-09T05:00", "until": "2015-04-09T07:00"}, 3),
        ("images", {"until": "2015-04-09"}, 20),
        ("images", {"since": "2015-04-10"}, 0),
        ("images", {"mission": "new_horizons", "camera": "lorri 4x4"}, 20),
        ("bodies", {"body": "pluto"}, 20),
        ("bodies", {"body": "PLUTO,CHARON"}, 40),
        ("bodies", {"status": "uncertain"}, 1),
        ("bodies", {"image": "pic_003.fit"}, 2),
        ("stars", {"status": "used"}, 80),
        ("provenance", {}, 20),
        ("provenance", {"image": "pic_003.fit"}, 1),
        ("journal", {"image": "pic_003.fit", "since": "2015-04-10"}, 0),
        ("history", {}, 0),
        ("pointings", {"since": "2015-04-09 18:00:00Z"}, 2),
    ],
)
def test_filters(archive, what, filters, count):
    with Campaign(archive) as campaign:
        found = campaign.query(what, **filters)
        method = campaign.bodies()["method"][0]
        assert 1 <= len(campaign.bodies(method=method.upper())) <= 40
        assert len(campaign.bodies(method="none")) == 0
    assert len(found) == count
    assert list(found["image"]) == sorted(found["image"])  # in the order of time


def test_columns_have_units_and_descriptions(archive):
    with Campaign(archive) as campaign:
        tables = [campaign.query(what) for what in ("images", "pointings", "stars", "bodies")]
        observables = campaign.observables(body="CHARON", status="ok", until="2015-04-09T18:30")
    assert tables[3]["residual_pixel"].unit == "pix"
    assert tables[3]["ra_deg"].unit == "deg"
    assert tables[1]["delta_twist_deg"].unit == "deg"
    for table in tables[:3]:
        assert all(table[name].info.description for name in table.colnames), table.colnames
    assert len(observables) == 19
    assert observables["sigma_pixel_oc"].unit == "pix"
    assert observables["dpixel_dx"].unit == "pix / km"
    assert observables["pixel_oc"].info.description == "observed minus computed pixel"


def test_unknown_questions_are_one_line(archive):
    with Campaign(archive) as campaign:
        with pytest.raises(SessionError, match="unknown table 'planets'"):
            campaign.query("planets")
        with pytest.raises(SessionError, match="images have no body"):
            campaign.images(body="PLUTO")


def test_exports_read_back(archive, tmp_path):
    with Campaign(archive) as campaign:
        whole = campaign.observables()
        assert export_observables(campaign, tmp_path / "all.ecsv") == 40
        assert export_observables(campaign, tmp_path / "pluto.csv", body="PLUTO") == 20
        assert export_observables(campaign, tmp_path / "some.dat", "json", since="2015-04-09T18") == 4
        assert export_observables(campaign, tmp_path / "all.tdm", status="ok", until="2015-04-09T18:30") == 38
        for name, options, words in (
            ("x.doc", {}, "unknown format 'doc'"),
            ("x", {}, "no format given"),
            ("x.csv", {"body": "NIX"}, "no observable to export"),
        ):
            with pytest.raises(SessionError, match=words):
                export_observables(campaign, tmp_path / name, **options)
    back = QTable.read(tmp_path / "all.ecsv", format="ascii.ecsv")
    assert back.colnames == whole.colnames
    assert np.array_equal(back["pixel_o"].value, whole["pixel_o"].value)
    observables = read_csv(tmp_path / "pluto.csv")
    assert {o.name for o in observables} == {"PLUTO"}
    assert [o.image for o in observables] == [f"pic_{i:03d}.fit" for i in range(20)]
    assert len(read_json(tmp_path / "some.dat")) == 4
    assert read_tdm(tmp_path / "all.tdm") is not None
    assert sorted(p.name for p in tmp_path.iterdir()) == ["all.ecsv", "all.tdm", "pluto.csv", "some.dat"]


def test_query_as_table_csv_and_json(archive, tmp_path):
    shown = invoke("query", "bodies", "-a", archive, "--body", "PLUTO", "--until", "2015-04-09T01")
    assert shown.exit_code == 0, shown.output
    assert "pic_000.fit" in shown.output
    assert "2 targets" in shown.output
    rows = list(csv.DictReader(io.StringIO(invoke("query", "pointings", "-a", archive, "-f", "csv").stdout)))
    assert len(rows) == 20
    assert float(rows[3]["delta_pixel"]) == pytest.approx(np.random.default_rng(3).normal(0.0, 5.0))
    answer = invoke("query", "stars", "-a", archive, "-f", "json", "-o", tmp_path / "stars.json")
    assert answer.exit_code == 0, answer.output
    stars = json.loads((tmp_path / "stars.json").read_text())["stars"]
    assert len(stars) == 20 * 6
    assert any(star["observed_pixel"] is None for star in stars)
    attention = invoke("query", "-a", archive, "--attention")
    assert "pic_019.fit" in attention.output
    assert "1 picture" in attention.output
    assert invoke("query", "-a", archive, "--image", "nowhere.fit").output == "no pictures\n"
    for arguments, words in (
        (("query", archive.parent), "ask it so"),
        (("query", "-a", archive, "-f", "xml"), "unknown format 'xml'"),
        (("query", "-a", archive, "-o", tmp_path / "t"), "a table is for the terminal"),
        (("query", "bodies", "-a", archive, "--attention"), "bodies have none"),
        (("query", "-a", tmp_path / "none.sqlite"), "there is no campaign archive"),
    ):
        failed = invoke(*arguments)
        assert isinstance(failed.exception, SessionError)
        assert words in str(failed.exception)


def test_ingest_tells_what_became_of_the_runs(make_run, tmp_path):
    make_run(tmp_path / "runs" / "good", 1)
    (tmp_path / "runs" / "bad").mkdir()
    (tmp_path / "runs" / "bad" / "result.json").write_text("{")
    first = invoke("ingest", tmp_path / "runs", "-a", tmp_path / "c.sqlite")
    assert first.exit_code == 3
    assert "2 runs: 1 new, 1 skipped" in first.output
    assert "result.json cannot be read" in first.output
    again = invoke("ingest", tmp_path / "runs" / "good", "-a", tmp_path / "c.sqlite")
    assert again.exit_code == 0
    assert "1 run: 1 unchanged" in again.output


@pytest.mark.slow
def test_plot_and_export_commands(archive, tmp_path):
    shown = invoke("plot", "-a", archive, "--body", "PLUTO", "-o", tmp_path / "trends.png")
    assert shown.exit_code == 0, shown.output
    assert "O-C pixel is +" in shown.output
    assert shown.output.count("outlier") == shown.output.count("pic_007.fit: PLUTO") == 1
    picture = imread(tmp_path / "trends.png")
    assert picture.shape[1] > 1000
    assert np.ptp(picture[..., :3]) > 0.5
    written = invoke("export", tmp_path / "charon.csv", "-a", archive, "--body", "CHARON", "--status", "ok")
    assert "20 observables" in written.output
    assert len(read_csv(tmp_path / "charon.csv")) == 20


def test_an_empty_archive_is_drawn_too(tmp_path):
    with Campaign(tmp_path):
        pass
    shown = invoke("plot", "-a", tmp_path, "-o", tmp_path / "trends.png")
    assert shown.exit_code == 0, shown.output
    assert imread(tmp_path / "trends.png").shape[1] > 1000


def test_history_decisions_and_journal_answer(make_run, tmp_path):
    """A picture processed again, where an analyst has decided something."""

    def decided(result, session):
        result["provenance"]["decisions"] = [{"star": "HIP 1", "verdict": "rejected", "reason": "cosmic ray"}]

    make_run(tmp_path / "r", 0, edit=lambda result, session: result.update(messages=["first"]))
    with Campaign(tmp_path / "campaign.sqlite") as campaign:
        campaign.ingest(tmp_path / "r")
        make_run(tmp_path / "r", 0, edit=decided)
        assert campaign.ingest(tmp_path / "r").count("replaced") == 1
        (old,), (decision,) = campaign.query("history"), campaign.query("decisions")
        assert (old["image"], old["status"], old["folder"]) == ("pic_000.fit", "ok", str(tmp_path / "r"))
        assert (decision["subject"], decision["verdict"], decision["reason"]) == (
            "HIP 1",
            "rejected",
            "cosmic ray",
        )
        assert len(campaign.query("journal")) == len(campaign.journal())
        with pytest.raises(SessionError, match="history has no body"):
            campaign.query("history", body="PLUTO")
    for what in ("history", "decisions", "journal", "provenance"):
        answer = invoke("query", what, "--archive", tmp_path / "campaign.sqlite")
        assert (answer.exit_code, "pic_000.fit" in answer.output) == (0, True), answer.output
