"""Figures and tables in the manner of the paper."""

import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable, Table

from opnav_workbench.report.paper import (
    PaperMarks,
    PaperPanel,
    PaperRow,
    captioned,
    panels_figure,
    paper_comparison,
    peak_figure,
    shown_table,
    sky_panel,
)
from opnav_workbench.stars.peaks import paraboloid_coefficients


def bump(size=16, center=(8.4, 10.6), width=1.5):
    line, pixel = np.indices((size, size))
    return 100.0 * np.exp(-((pixel - center[0]) ** 2 + (line - center[1]) ** 2) / (2.0 * width**2))


@pytest.mark.slow
def test_panel_shows_pixels_where_they_are():
    figure = panels_figure([PaperPanel(bump(), "star", first=(100.0, 200.0))])
    (picture,) = figure.axes[0].images
    assert picture.get_extent() == [99.5, 115.5, 215.5, 199.5]
    assert figure.axes[0].get_ylim() == (215.5, 199.5)  # lines grow downward
    assert picture.norm.vmin == pytest.approx(bump().min())
    assert picture.norm.vmax == pytest.approx(bump().max())


def test_panels_fill_rows_and_share_one_legend():
    marks = [
        PaperMarks(np.array([[3.0, 4.0]]), "star"),
        PaperMarks(np.array([[5.0, 6.0]]), "box", shape="box"),
    ]
    figure = panels_figure([PaperPanel(bump(), bar="", marks=marks) for _ in range(3)], columns=2)
    assert len([axes for axes in figure.axes if axes.axison]) == 3
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["star", "box"]
    (circle, box) = figure.axes[0].patches
    assert tuple(circle.center) == (3.0, 4.0)
    assert (box.get_x() + 12.0, box.get_y() + 12.0) == (5.0, 6.0)


def test_signed_stretch_is_even_about_zero():
    figure = panels_figure([PaperPanel(bump() - 20.0, stretch="signed")])
    norm = figure.axes[0].images[0].norm
    assert norm.vmin == -norm.vmax


def test_blank_and_constant_pictures_are_drawn():
    values = bump()
    values[2:5] = np.nan
    for panel in (PaperPanel(values), PaperPanel(np.zeros((8, 8))), PaperPanel(values, stretch="log")):
        assert captioned(panels_figure([panel]), "Figure 1", "a").png.startswith(b"\x89PNG")


def test_relief_holds_the_paraboloid_of_the_peak():
    figure = peak_figure(PaperPanel(bump(), first=(0.25, 0.0)))
    relief = figure.axes[1]
    assert relief.get_xlim()[0] < 8.65 < relief.get_xlim()[1]
    assert relief.get_zlim()[1] > 90.0


def test_paraboloid_coefficients_are_exact_on_a_paraboloid():
    y, x = np.indices((3, 3)) - 1.0
    patch = 7.0 + 0.5 * x - 0.25 * y - 2.0 * x**2 - 3.0 * y**2 + 0.75 * x * y
    np.testing.assert_allclose(
        paraboloid_coefficients(patch[None])[0], [7.0, 0.5, -0.25, -2.0, -3.0, 0.75], atol=1e-12
    )


def test_faint_star_stands_out_of_the_sky():
    image = np.random.default_rng(3).normal(0.0, 2.0, (200, 200))
    image[95:112, 45:62] += 0.3 * bump(17, (8.0, 8.0), 0.9)
    panel = sky_panel(image)
    line, pixel = np.unravel_index(np.argmax(panel.values), panel.values.shape)
    assert abs(line - 103) <= 2
    assert abs(pixel - 53) <= 2


def test_comparison_shows_numbers_and_keeps_them(tmp_path):
    rows = [
        PaperRow("pixel", 8.46, 8.5, "px"),
        PaperRow("line", None, np.nan, "px", remark="a < b"),
        PaperRow("stars", None, 31, digits=0),
    ]
    comparison = paper_comparison(rows, "Table 1")
    shown = comparison._repr_html_()
    for text in ("Table 1", "8.46", "8.50", "+0.04", "a &lt; b", "here − paper"):
        assert text in shown
    kept = Table.read(comparison.write(tmp_path / "table1.ecsv"), format="ascii.ecsv")
    assert kept["paper"][0] == 8.46
    assert np.isnan(kept["paper"][2])
    assert kept["here"][2] == 31.0


def test_empty_columns_are_left_out():
    shown = paper_comparison([PaperRow("stars", 3, 4, digits=0)])._repr_html_()
    assert "remark" not in shown
    assert "unit" not in shown


def test_table_is_shown_with_units_and_without_types():
    table = QTable({"star": ["a", "b"], "mag": [8.25, np.nan], "pixel": [1.5, 2.0] * u.pix})
    table["mag"].info.format = "+.2f"
    shown = shown_table(table, "Stars")._repr_html_()
    assert "pixel (pix)" in shown
    assert "+8.25" in shown
    assert "nan" not in shown
    assert "float64" not in shown
