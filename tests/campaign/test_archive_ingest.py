"""What becomes of runs in the archive: once, replaced, older, damaged, in any order."""

import contextlib
import json
import os
import sqlite3

import numpy as np
import pytest

from opnav_workbench.campaign import Campaign, archive
from opnav_workbench.campaign.run_folder import read_run
from opnav_workbench.errors import SessionError


def ingested(campaign, *folders):
    return [campaign.ingest_run(folder).result for folder in folders]


def test_everything_of_a_run_is_there(real_run, tmp_path):
    result = json.loads((real_run / "result.json").read_text())
    with Campaign(tmp_path / "c.sqlite") as campaign:
        report = campaign.ingest(real_run.parent)
        assert [(item.image, item.result) for item in report.results] == [("lorri_4x4.fit", "new")]
        images, bodies, stars = campaign.images(), campaign.bodies(), campaign.stars()
        (entry,) = campaign.entries()
        (provenance,) = campaign.provenance()
        steps = [item["step"] for item in campaign.journal()]
        pointing = campaign.pointings()[0]
    assert (images["utc"][0], images["status"][0]) == (result["utc"], "ok")
    assert images["et"][0] == result["et"]
    assert images["et"].unit == "s"
    assert list(bodies["body"]) == ["PLUTO", "CHARON"]
    first = result["bodies"][0]
    assert [bodies["residual_pixel"][0], bodies["residual_line"][0]] == first["residual_px"]
    assert bodies["covariance_oc_pixel_line"][0] == first["covariance_with_pointing_px2"][0][1]
    assert list(stars["star"]) == [star["id"] for star in result["stars"]]
    assert [s for s in stars["status"] if s == "used"] == ["used"] * 4
    assert pointing["n_stars"] == 4
    assert pointing["delta_twist_deg"] == result["pointing"]["delta_twist_deg"]
    assert (entry.folder, entry.resumable, entry.needs_analyst) == (real_run.resolve(), True, False)
    assert entry.path.name == "lorri_4x4.fit"
    assert entry.path.is_file()
    assert provenance["catalog"] == "bundled"
    assert provenance["kernels"] == result["provenance"]["kernels"]
    assert steps[0] == "predict"
    assert steps == [e["step"] for e in json.loads((real_run / "session.json").read_text())["journal"]]


def test_the_same_run_twice_changes_nothing(make_run, tmp_path):
    run = make_run(tmp_path / "run", 1)
    with Campaign(tmp_path / "c.sqlite") as campaign:
        assert ingested(campaign, run) == ["new"]
        before = campaign.path.read_bytes(), campaign.digest(), campaign.images()["folder"][0]
        assert ingested(campaign, run, run) == ["unchanged"] * 2
        assert (campaign.path.read_bytes(), campaign.digest(), campaign.images()["folder"][0]) == before
        assert campaign.history() == []


def test_a_run_that_stands_is_read_again_only_when_one_of_its_files_was_written(
    make_run, tmp_path, monkeypatch
):
    read = []
    monkeypatch.setattr(archive, "read_run", lambda place: read.append(place.name) or read_run(place))
    runs = [make_run(tmp_path / "a", 1), make_run(tmp_path / "b", 2)]
    path = tmp_path / "c.sqlite"

    def read_at_next_ingest():
        read.clear()
        with Campaign(path) as campaign:
            unchanged = campaign.ingest(runs).count("unchanged")
        return unchanged, read

    assert read_at_next_ingest() == (0, ["a", "b"])
    assert read_at_next_ingest() == (2, [])
    # Other content of the same length, with the times of before.
    result = runs[0] / "result.json"
    times = result.stat()
    result.write_text(result.read_text().replace('"status": "ok"', '"status": "no"', 1))
    os.utime(result, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert read_at_next_ingest() == (1, ["a"])
    make_run(tmp_path / "a", 1)
    assert read_at_next_ingest() == (2, ["a"])
    assert read_at_next_ingest() == (2, [])
    # Another folder of the picture stands now: this one is an older run again.
    with Campaign(path) as campaign:
        later = make_run(tmp_path / "later", 1, minute=9, edit=lambda result, _: result.update(utc=None))
        assert campaign.ingest_run(later).result == "replaced"
    assert read_at_next_ingest() == (1, ["a"])
    # An archive of version 2 knows no readings: all is read once more.
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.executescript("DROP TABLE readings; PRAGMA user_version = 2;")
    assert read_at_next_ingest() == (1, ["a", "b"])
    assert read_at_next_ingest() == (1, ["a"])


def test_a_reprocessed_picture_replaces_its_rows_and_leaves_history(make_run, tmp_path):
    def fewer_stars(result, session):
        result["stars"] = result["stars"][:2]
        result["status"], result["messages"] = "partial", ["few stars"]
        result["bodies"][0]["residual_px"] = [0.5, 0.25]

    run = tmp_path / "run"
    with Campaign(tmp_path / "c.sqlite") as campaign:
        ingested(campaign, make_run(run, 1))
        old = campaign.bodies()["residual_pixel"][0]
        assert ingested(campaign, make_run(run, 1, edit=fewer_stars, minute=5)) == ["replaced"]
        assert len(campaign.images()) == 1
        assert len(campaign.stars()) == 2
        assert len(campaign.observables()) == 2
        assert campaign.bodies()["residual_pixel"][0] == 0.5
        assert [entry.attention for entry in campaign.attention()] == [("few stars",)]
        (entry,) = campaign.history()
        assert (entry["image"], entry["status"]) == ("pic_001.fit", "ok")
        assert entry["summary"]["bodies"][0]["residual_pixel"] == old
        # Back to the first content: it stands again, and is no longer history.
        assert ingested(campaign, make_run(run, 1, minute=9)) == ["replaced"]
        (entry,) = campaign.history()
        assert entry["status"] == "partial"


def test_times_alone_are_no_other_content(make_run, tmp_path):
    def timed(result, session):
        result["processed_utc"] = "2026-05-05T00:00:00"

    run = tmp_path / "run"
    with Campaign(tmp_path / "c.sqlite") as campaign:
        ingested(campaign, make_run(run, 1))
        digest = campaign.digest()
        assert ingested(campaign, make_run(run, 1, edit=timed, minute=30)) == ["unchanged"]
        assert campaign.digest() == digest


def test_fields_that_no_column_knows_are_kept(make_run, tmp_path):
    def newer(result, session):
        result["weather"] = {"wind": 3}
        result["bodies"][0] |= {"flags": "cut by the edge", "chi2_reduced": 1.25, "curve": [1, 2]}
        result["stars"][1]["color"] = 0.7
        result["pointing"]["gyro"] = "ok"
        result["provenance"]["notes"] = ["clear night"]
        result["provenance"]["circles"] = [{"body": "PLUTO", "center_px": [1.0, 2.0], "radius_px": 3.0}]
        result["provenance"]["decisions"] = [
            {"star": "HIP 1", "verdict": "rejected", "reason": "hit", "who": "AB"}
        ]

    with Campaign(tmp_path / "c.sqlite") as campaign:
        ingested(campaign, make_run(tmp_path / "run", 1, edit=newer))
        bodies, stars, content = campaign.bodies(), campaign.stars(), campaign.dump()
        decisions = campaign.decisions()
    assert (bodies["flags"][0], bodies["chi2_reduced"][0]) == ("cut by the edge", 1.25)
    assert bodies["chi2_reduced"][1] != 1.25  # Charon's own, or nan
    assert np.isnan(stars["color"][0])
    assert stars["color"][1] == 0.7
    assert content["images"][0]["extra"]["weather"] == {"wind": 3}
    assert content["bodies"][0]["extra"]["curve"] == [1, 2]
    assert content["pointings"][0]["extra"]["gyro"] == "ok"
    assert [(d["subject"], d["verdict"], d["reason"]) for d in decisions] == [
        ("HIP 1", "rejected", "hit"), ("PLUTO", "circle", None), (None, "note", "clear night"),
    ]  # fmt: skip
    assert decisions[0]["extra"] == {"who": "AB"}


@pytest.mark.slow
def test_the_content_does_not_depend_on_the_order(make_run, make_failure, tmp_path):
    """Five pictures, two of them processed three times, one that failed before it was read: any order, one archive."""

    def changed(value):
        def edit(result, session):
            result["pointing"]["rms_px"] = value

        return edit

    runs = [make_run(tmp_path / f"a{i}", i) for i in range(4)]
    runs += [make_run(tmp_path / f"b{i}", i, edit=changed(0.1), minute=10 + i) for i in (1, 2)]
    runs += [make_run(tmp_path / f"c{i}", i, edit=changed(0.2), minute=5 - i) for i in (1, 2)]
    early = make_failure(tmp_path / "failed", "pic_003.fit")
    os.utime(early / "result.json", (1.0e9, 1.0e9))  # in 2001: before the good run of the same picture
    late = make_failure(tmp_path / "failed_late", "pic_009.fit")
    digests = set()
    for seed in range(4):
        order = np.random.default_rng(seed).permutation(len(runs) + 2)
        with Campaign(tmp_path / f"{seed}.sqlite") as campaign:
            for index in order:
                campaign.ingest_run([*runs, early, late][index])
            digests.add(campaign.digest())
            assert [entry.image for entry in campaign.entries()] == [
                "pic_009.fit", "pic_000.fit", "pic_001.fit", "pic_002.fit", "pic_003.fit"
            ]  # fmt: skip
            pointings = campaign.pointings()
            assert list(pointings["rms_px"][1:3]) == [0.1, 0.1]
            assert len(campaign.history()) == 5
    assert len(digests) == 1


def test_a_failure_is_followed_by_success_and_the_other_way_round(make_run, make_failure, tmp_path):
    with Campaign(tmp_path / "c.sqlite") as campaign:
        run = make_failure(tmp_path / "run", "pic_001.fit", "wrong kernel time")
        assert ingested(campaign, run) == ["new"]
        (entry,) = campaign.entries()
        assert (entry.status, entry.attention, entry.et) == ("failed", ("wrong kernel time",), None)
        assert not entry.resumable
        ingested(campaign, make_run(run, 1))
        assert [e.status for e in campaign.entries()] == ["ok"]
        # A failure writes its result beside the files of the older success; these do not count.
        (run / "result.json").write_text(
            (make_failure(tmp_path / "other", "pic_001.fit") / "result.json").read_text()
        )
        ingested(campaign, run)
        assert [(e.status, e.path) for e in campaign.entries()] == [("failed", None)]
        assert len(campaign.stars()) == 0
        assert sorted(h["status"] for h in campaign.history()) == ["failed", "ok"]


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda run: (run / "result.json").unlink(), "result.json is missing"),
        (lambda run: (run / "result.json").write_text('{"image": "pic'), "result.json cannot be read"),
        (lambda run: (run / "result.json").write_text("[]"), "no mapping"),
        (lambda run: (run / "result.json").write_text('{"status": "ok"}'), "damaged ('image')"),
        (lambda run: (run / "session.json").write_text("\x00"), "session.json cannot be read"),
        (lambda run: (run / "observables.ecsv").unlink(), "observables.ecsv is missing"),
        (lambda run: (run / "observables.ecsv").write_bytes(b"# %ECSV 1.0\n\xff"), "observables.ecsv is damaged"),
        (lambda run: edit_json(run, lambda r: r.update(status="fine")), "status 'fine' is none of"),
        (lambda run: edit_json(run, lambda r: r.update(et="noon")), "et is 'noon', not a number"),
        (lambda run: edit_json(run, lambda r: r["stars"][0].update(observed=[1.0])), "damaged"),
        (lambda run: edit_json(run, lambda r: r.update(sha256="0" * 64)), "of different pictures"),
        (lambda run: edit_json(run, lambda r: r["bodies"].pop()), "tell of different bodies"),
    ],
)  # fmt: skip
def test_damaged_runs_are_named_and_skipped(make_run, tmp_path, damage, reason):
    good, bad = make_run(tmp_path / "runs" / "good", 1), make_run(tmp_path / "runs" / "bad", 2)
    damage(bad)
    with Campaign(tmp_path / "c.sqlite") as campaign:
        said = []
        report = campaign.ingest(tmp_path / "runs", said.append)
        assert (report.count("new"), report.count("skipped")) == (1, 1)
        (skipped,) = report.skipped
        assert (skipped.folder, said[0]) == (bad, skipped)
        assert reason in skipped.reason
        assert [entry.folder for entry in campaign.entries()] == [good]


def edit_json(run, change):
    result = json.loads((run / "result.json").read_text())
    change(result)
    (run / "result.json").write_text(json.dumps(result))


def test_numbers_that_are_none_become_unknown(make_run, tmp_path):
    run = make_run(tmp_path / "run", 1)
    text = (run / "result.json").read_text()
    result = json.loads(text)
    result["pointing"]["chi2_reduced"] = float(
        "nan"
    )  # no file of ours holds it, and it must not enter the archive
    (run / "result.json").write_text(json.dumps(result))
    with Campaign(tmp_path / "c.sqlite") as campaign:
        assert ingested(campaign, run) == ["new"]
        assert np.isnan(campaign.pointings()["chi2_reduced"][0])
        assert campaign.dump()["pointings"][0]["chi2_reduced"] is None


def test_nothing_to_ingest_is_an_error(tmp_path):
    with Campaign(tmp_path / "c.sqlite") as campaign:
        with pytest.raises(SessionError, match="no folder"):
            campaign.ingest(tmp_path / "nowhere")
        (tmp_path / "empty").mkdir()
        with pytest.raises(SessionError, match="holds no run"):
            campaign.ingest([tmp_path / "empty"])


def test_the_runs_own_word_on_attention_counts(make_run, tmp_path):
    def unsure(result, session):
        result["attention"] = ["PLUTO moved by 5 sigma"]

    with Campaign(tmp_path / "c.sqlite") as campaign:
        ingested(campaign, make_run(tmp_path / "a", 1, edit=unsure), make_run(tmp_path / "b", 2))
        (entry,) = campaign.attention()
    assert (entry.image, entry.attention) == ("pic_001.fit", ("PLUTO moved by 5 sigma",))
