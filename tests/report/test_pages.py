"""Pages and notebook HTML from templates: what is written is escaped, numbers keep the digits of their sigmas."""

from importlib import resources

import matplotlib.figure
import numpy as np
import pytest
from astropy.table import Table
from jinja2 import UndefinedError

from opnav_workbench.report.pages import few_colors, night_causes, night_pages, render_template
from opnav_workbench.report.paper import PaperRow, captioned, paper_comparison, shown_table
from opnav_workbench.templating import png_url

AWKWARD = "<b>Pluto</b> & Charon"
ESCAPED = "&lt;b&gt;Pluto&lt;/b&gt; &amp; Charon"


def _row(name: str, **changes: object) -> dict[str, object]:
    pointing = {
        "delta_pixel": 1.234,
        "delta_line": -0.5,
        "delta_twist_deg": 0.00123,
        "n_stars": 12,
        "rms_px": 0.0567,
    }
    body = {
        "name": "PLUTO",
        "method": "limb_scan",
        "status": "ok",
        "residual_px": [0.1234, -0.2],
        "residual_arcsec": [0.3, 0.4],
        "sigma_px": [0.01, 0.02],
    }
    row = {"name": name, "state": "now", "status": "ok", "utc": "2015-04-09T01:02:03.456", "attention": []}
    return row | {"pointing": pointing, "bodies": [body], "seconds": 12.3, "files": ["result.json"]} | changes


def _night(*rows: dict[str, object]) -> dict[str, object]:
    return {
        "version": "1",
        "written_utc": "2026-01-02T03:04:05+00:00",
        "mission": AWKWARD,
        "kernels": None,
        "catalog": "bundled",
        "counts": {"ok": 1},
        "processed_now": 1,
        "not_archived": [],
        "notes": [],
        "images": list(rows),
    }


def first_page(summary, out):
    return night_pages(summary, out)["summary.html"]


@pytest.fixture(scope="module")
def png():
    figure = matplotlib.figure.Figure(figsize=(4.0, 3.0))
    figure.subplots().imshow(np.arange(12.0).reshape(3, 4))
    return captioned(figure, "", "").png


def test_templates_and_style_are_files_of_the_package():
    names = {item.name for item in resources.files("opnav_workbench.report").joinpath("templates").iterdir()}
    assert {"page.html", "page_style.css", "night_page.html", "ort_page.html", "plan_page.html"} <= names


def test_night_page_escapes_and_formats(tmp_path):
    missing = {"pointing": None, "bodies": [], "utc": None, "seconds": None, "status": "failed"}
    page = first_page(_night(_row("a b"), _row("lost", **missing, attention=[AWKWARD])), tmp_path)
    assert page.count(ESCAPED) == 3  # title, heading, reason
    assert AWKWARD not in page
    assert 'id="a%20b"' in page
    for text in ("+1.23", "-0.50", "+0.0012", "0.057", "+0.123 ± 0.010", "limb scan", "12.3"):
        assert text in page, text
    assert "://" not in page


def test_small_picture_stands_in_the_page(tmp_path, png):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "summary.png").write_bytes(png)
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "summary.png").write_bytes(png[:100])  # a broken one costs the picture, not the page
    page = first_page(_night(_row("a"), _row("b")), tmp_path)
    assert page.count('src="data:image/png;base64,') == 1
    assert png_url(few_colors(png, 260)) in page


def test_many_pictures_are_pages_and_their_causes_lines(tmp_path, png):
    gap = "no attitude of NH_LORRI at 2015-04-09T01:{:02d}:00 UTC; add a CK"
    rows = [_row(f"p{i:04d}", attention=[gap.format(i % 60)] if i % 2 else []) for i in range(1100)]
    rows[7]["attention"].append(f"{rows[7]['name']}.fit: truncated")
    (tmp_path / "p0600").mkdir()
    (tmp_path / "p0600" / "summary.png").write_bytes(png)
    pages = night_pages(_night(*rows), tmp_path)
    assert list(pages) == ["summary.html", "summary-2.html", "summary-3.html"]
    assert [page.count("<tr id=") for page in pages.values()] == [500, 500, 100]
    first, second, _ = pages.values()
    assert first.count("<li id=") == 2
    assert "<b>550 pictures</b>: no attitude" in first
    assert 'href="summary-2.html#p0601"' in first
    assert 'src="p0600/summary.png"' in second
    assert 'href="summary.html#cause-0"' in second
    assert "Needs an analyst" not in second
    assert [(len(cause.rows), cause.rows[0]["name"]) for cause in night_causes(rows)] == [
        (550, "p0001"),
        (1, "p0007"),
    ]


def test_few_colors_keeps_the_shape(png):
    assert len(few_colors(png)) < len(png)
    with pytest.raises(OSError, match="cannot identify"):
        few_colors(b"no picture")


def test_a_name_that_a_template_misses_is_an_error():
    with pytest.raises(UndefinedError, match="caption"):
        render_template("captioned_figure.html", number="Figure 1", picture="")


def test_caption_and_table_escape():
    figure = captioned(matplotlib.figure.Figure(figsize=(1.0, 1.0)), "Figure 4", AWKWARD)
    assert f"<b>Figure 4.</b> {ESCAPED}" in figure._repr_html_()
    table = paper_comparison([PaperRow(AWKWARD, 8.46, 8.50, "px")], AWKWARD)._repr_html_()
    assert table.count(ESCAPED) == 2
    assert "remark" not in table  # an empty column is left out


def test_numbers_stand_at_the_right_and_only_words_wrap():
    html = shown_table(Table({"star": ["a"], "mag": [8.25], "remark": ["long"]}))._repr_html_()
    cells = {
        text: style
        for style, text in (
            cell.removeprefix('<td style="').split('">')
            for cell in html.split("\n")
            if cell.startswith("<td")
        )
    }
    assert "text-align:right;white-space:nowrap" in cells["8.25</td>"]
    assert "text-align:left;white-space:nowrap" in cells["a</td>"]
    assert "nowrap" not in cells["long</td>"]


def test_night_page_names_what_is_off_its_trend(tmp_path):
    off = [{"image": "a.fit", "series": "pointing error, line", "deviation": -7.25}]
    night = _night(_row("a") | {"path": "/in/a.fit"}, _row("b") | {"path": "/in/b.fit"})
    page = first_page(night | {"trends": {"figure": "trends.png", "outliers": off, "why_not": ""}}, tmp_path)
    assert '<a href="summary.html#a">a</a>: pointing error, line is -7.2 robust sigmas off' in page
    assert 'src="trends.png"' in page
    none = {"figure": None, "outliers": [], "why_not": "2 pictures are too few"}
    assert "Not drawn: 2 pictures are too few." in first_page(night | {"trends": none}, tmp_path)
