"""The archive in a browser: what is asked for is shown, nothing else of the disk, and to nobody else."""

import http.client
import json
import re
from contextlib import contextmanager
from threading import Event, Thread

import pytest

from opnav_workbench.campaign import Campaign
from opnav_workbench.cli.campaign_serve import CampaignServer
from opnav_workbench.report import campaign_pages


@contextmanager
def served(archive):
    """Yield a function that asks: (status, text, headers)."""
    with Campaign(archive) as campaign, CampaignServer(campaign) as server:
        Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()

        def ask(path, host=None, method="GET"):
            connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=30)
            connection.request(method, path, headers={"Host": host or server.names[0]})
            answer = connection.getresponse()
            return answer.status, answer.read().decode("utf-8", "replace"), dict(answer.getheaders())

        try:
            yield ask
        finally:
            server.shutdown()


@pytest.fixture
def night(tmp_path, make_run, make_failure):
    """Eleven pictures; two failed for one reason but for its numbers, one with a name that is no name."""
    out = tmp_path / "night"
    for number in range(8):
        make_run(out / f"p{number}", number)
    make_failure(out / "f1", "f1.fit", "no attitude at 2015-04-09T01:02 <b>(NH_LORRI)</b>")
    make_failure(out / "f2", "f2.fit", "no attitude at 2015-04-10T03:04 <b>(NH_LORRI)</b>")
    make_failure(out / "f3", "<i>.fit", "no FITS file")
    with Campaign(out) as campaign:
        campaign.ingest(out)
    make_run(out / "p0", 0, edit=lambda result, _: result.update(status="partial"), minute=9)
    with Campaign(out) as campaign:
        campaign.ingest(out)
    return out


def names_on(page):
    return re.findall(r"/picture/(\d+)\"", page)


def test_pictures_are_counted_grouped_searched_and_paged(night, monkeypatch):
    with served(night) as ask:
        status, page, headers = ask("/")
        assert status == 200
        assert "11 pictures" in page
        assert len(names_on(page)) == 11
        (cause,) = re.findall(r'<a href="/\?([^"]*)"><b>2</b> pictures</a>: (.*)', page)
        assert "&lt;b&gt;(NH_LORRI)&lt;/b&gt;" in cause[1]
        assert "<i>" not in page
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert len(names_on(ask("/?" + cause[0].replace("&amp;", "&"))[1])) == 2
        assert len(names_on(ask("/?status=failed")[1])) == 3
        assert len(names_on(ask("/?q=pic_003")[1])) == 1
        assert names_on(ask("/?q=%25")[1]) == []  # a sign of SQL's is a letter here
        monkeypatch.setattr("opnav_workbench.report.campaign_pages.ROWS_A_PAGE", 4)
        pages = [names_on(ask(f"/?page={number}")[1]) for number in (1, 2, 3, 4)]
        assert [len(names) for names in pages] == [4, 4, 3, 0]
        assert len({name for names in pages for name in names}) == 11


def test_how_the_night_goes_is_told_as_far_as_it_is_known(night):
    pictures = {"processed": 8, "to_process": 11, "failed": 3}
    status = {"state": "running", "updated_utc": "2026-01-01T00:00:00+00:00", "pictures": pictures}
    status |= {"pictures_per_minute": 31.25, "disk_free_mb": None}
    with served(night) as ask:
        (night / "status.json").write_text(json.dumps(status))  # of a version that did not count retries
        assert "running, 8 of 11 processed, 3 failed,\n31.2 a minute" in ask("/changes")[1]
        (night / "status.json").write_text(json.dumps(status | {"pictures": pictures | {"retries": 2}}))
        assert "3 failed, 2 tried again," in ask("/changes")[1]
        (night / "status.json").write_text('{"state": "runn')
        assert "The night" not in ask("/changes")[1]


def test_trends_that_take_long_are_told_of_and_hold_nobody_up(night, monkeypatch):
    go, real = Event(), campaign_pages.trends

    def slow(campaign):
        go.wait(20.0)
        return real(campaign)

    monkeypatch.setattr(campaign_pages, "trends", slow)
    monkeypatch.setattr(campaign_pages, "PATIENCE_S", 0.05)
    with served(night) as ask:
        waiting = ask("/trends")[1]
        assert "are being drawn" in waiting
        assert 'http-equiv="refresh"' in waiting
        assert "11 pictures" in ask("/")[1]
        go.set()
        assert ask("/trends.png")[2]["Content-Type"] == "image/png"
        ready = ask("/trends")[1]
        assert "Nothing is off its trend" in ready
        assert 'http-equiv="refresh"' not in ready


def test_what_changed_and_what_it_was_made_with(night):
    with served(night) as ask:
        changes = ask("/changes")[1]
        assert "pic_000.fit" in changes
        assert re.search(r'class="ok">ok</td><td class="partial">partial<', changes)
        assert re.search(r"latest_leapseconds.tls <code.*678e32bdb5a7", ask("/made-with")[1])


def test_only_files_of_a_run_are_given(night, tmp_path):
    (night / "p1" / "secret.txt").write_text("secret")
    (tmp_path / "elsewhere.png").write_bytes(b"secret")
    (night / "p1" / "summary.png").symlink_to(tmp_path / "elsewhere.png")
    with Campaign(night) as campaign:
        number = next(row["id"] for row in campaign.pictures_page(words="pic_001").rows)
    with served(night) as ask:
        assert ask(f"/picture/{number}/result.json")[0] == 200
        for path in (
            "secret.txt",
            "summary.png",
            "../p2/result.json",
            "%2e%2e/p2/result.json",
            "night.json",
            "",
        ):
            assert ask(f"/picture/{number}/{path}")[0] == (200 if path == "" else 404), path
        assert "secret" not in ask(f"/picture/{number}")[1]
        for path in (
            "/picture/99999",
            "/picture/-1",
            "/picture/x",
            "/etc/passwd",
            "/../../etc/passwd",
            "//",
            "/?page=0x",
        ):
            assert ask(path)[0] in (200, 404), path
        assert ask("/", host="evil.example")[0] == 403
        assert ask("/", method="POST")[0] == 501


@pytest.mark.slow
def test_a_notebook_is_made_a_page_when_it_is_asked_for(night):
    notebook = {"nbformat": 4, "nbformat_minor": 5, "metadata": {}, "cells": []}
    cell = {"cell_type": "markdown", "id": "a", "metadata": {}, "source": "# What was *done*"}
    (night / "p1" / "notebook.ipynb").write_text(json.dumps({**notebook, "cells": [cell]}))
    with Campaign(night) as campaign:
        number = next(row["id"] for row in campaign.pictures_page(words="pic_001").rows)
    with served(night) as ask:
        assert f'href="/picture/{number}/notebook.html"' in ask(f"/picture/{number}")[1]
        status, page, headers = ask(f"/picture/{number}/notebook.html")
        assert (status, "<em>done</em>" in page) == (200, True)
        assert headers["Content-Security-Policy"].startswith("sandbox")
        assert not (night / "p1" / "notebook.html").exists()
