"""The panels around the picture, by what is seen: star table, list, compass, crosshair, hover, PNG, lock, files."""

import io
import re

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS
from PIL import Image

from opnav_workbench.cli.lab import LabParameters
from opnav_workbench.processing import Processing
from opnav_workbench.rehearsal import DEMO_CATALOG, DEMO_KERNELS

pytestmark = pytest.mark.slow

ROWS = ".ow-window .star-table tbody tr"
YELLOW, ORANGE = (0xF0, 0xE4, 0x42), (0xE6, 0x9F, 0x00)
STATE = "Bokeh.documents.at(-1).get_model_by_name('opnav-state')"
# Where a place in the picture is on the page.
AT = """([x, y]) => {
  const views = function* (v, seen = new Set()) { if (!v || seen.has(v)) return; seen.add(v); yield v;
    for (const child of v.child_views ?? []) yield* views(child, seen); };
  for (const root of Bokeh.index.roots) for (const view of views(root))
    if (view.model?.name === 'opnav-picture') {
      const box = view.canvas_view.el.getBoundingClientRect();
      return [box.left + view.frame.x_scale.compute(x), box.top + view.frame.y_scale.compute(y)];
    }
}"""


@pytest.fixture(scope="module")
def bench(open_bench, demo_truths):
    how = Processing(mission="new_horizons", kernels=DEMO_KERNELS, catalog=DEMO_CATALOG)
    opened = open_bench("panels", LabParameters(tuple(str(one.picture) for one in demo_truths), how))
    opened.said("lorri_4x4.fit: ")
    opened.press("f")
    opened.said("4 of 4 stars found")
    return opened


@pytest.fixture(autouse=True)
def _no_errors(bench):
    yield
    bench.check_errors()


@pytest.fixture
def table(bench):
    bench.press("y")
    bench.page.locator(".ow-window .star-table").wait_for()
    yield bench.page
    bench.press("y")
    bench.page.locator(".ow-window .star-table").wait_for(state="detached")


def place(page, pixel, line):
    return tuple(page.evaluate(AT, [pixel, line]))


def facts(page):
    """Id -> (pixel, line) of the stars in the picture."""
    data = page.evaluate(
        "() => { const { data } = Bokeh.documents.at(-1).get_model_by_name('opnav-facts');"
        " return [[...data.id], [...data.pixel], [...data.line]]; }"
    )
    return {name: (x, y) for name, x, y in zip(*data, strict=True)}


def seen_near(page, at, reach, color):
    """How many pixels of the screen about a place are of a color."""
    x, y = at
    box = {"x": x - reach, "y": y - reach, "width": 2 * reach, "height": 2 * reach}
    shot = np.array(Image.open(io.BytesIO(page.screenshot(clip=box))).convert("RGB"), float)
    return int((np.abs(shot - np.array(color)).max(axis=2) < 60.0).sum())


def column(page, number):
    return [float(text) for text in page.locator(f"{ROWS} td:nth-child({number})").all_inner_texts()]


def test_the_star_table_sorts_by_what_its_heading_says(table):
    """Magnitudes (third column) and O-C (seventh), each way around."""
    for heading, number in (("mag", 3), ("O−C", 7)):
        seen = []
        for turn in ("ascending", "descending"):
            head = table.locator(".ow-window .star-table th", has_text=heading)
            head.click()
            table.locator(f".ow-window .star-table th[aria-sort={turn}]", has_text=heading).wait_for()
            seen.append(column(table, number))
        assert seen[0] == sorted(seen[0])
        assert seen[1] == sorted(seen[1], reverse=True)
        assert len(set(seen[0])) > 1
    table.locator(".ow-window .star-table th", has_text="star").click()


def test_table_picture_and_plot_show_one_star(table):
    """A row chosen is ringed in the picture and stands out in the plot; a star clicked in either is the row's."""
    page, stars = table, facts(table)
    here = f"{ROWS}.here"
    rows = page.locator(ROWS, has_text="in use")
    for number in (2, 1):
        star = rows.nth(number).get_attribute("data-star")
        rows.nth(number).click()
        page.locator(f'{here}[data-star="{star}"]').wait_for()
        page.locator(f'.ow-window .ow-plot .pt.here[data-arg="{star}"]').first.wait_for()
        page.wait_for_function(
            """([x, y]) => { const { data } = Bokeh.documents.at(-1).get_model_by_name('opnav-focus');
            return Math.hypot(data.pixel[0] - x, data.line[0] - y) < 1; }""",
            arg=list(stars[star]),
        )
    other = rows.nth(0).get_attribute("data-star")
    page.mouse.click(*place(page, *stars[other]))
    page.locator(f'{here}[data-star="{other}"]').wait_for()
    page.locator(f'.ow-window .ow-plot .pt:not(.here)[data-arg="{star}"] .reach').first.click(force=True)
    page.locator(f'{here}[data-star="{star}"]').wait_for()


def test_the_list_is_filtered_sorted_and_has_thumbnails(bench):
    page = bench.page
    names = page.locator(".ow-window .ow-queue li .name")
    first, second = names.all_inner_texts()
    images = page.locator(".ow-window .ow-queue li img")
    images.nth(1).wait_for()  # the neighbor is opened ahead
    assert page.evaluate(
        "() => [...document.querySelectorAll('.ow-window .ow-queue li img')].every(one => one.naturalWidth > 8)"
    )
    shades = [np.array(Image.open(io.BytesIO(images.nth(n).screenshot())).convert("L")) for n in (0, 1)]
    assert all(shade.std() > 3.0 for shade in shades)  # something is seen in each
    bench.press("/")
    page.keyboard.type("lorri")
    page.wait_for_function("() => document.querySelectorAll('.ow-window .ow-queue li').length === 1")
    assert names.all_inner_texts() == [first]
    page.keyboard.press("Enter")
    page.locator(".ow-window .ow-queue input").fill("")
    page.wait_for_function("() => document.querySelectorAll('.ow-window .ow-queue li').length === 2")
    order = page.locator(".ow-window .ow-queue select[data-act=list_order]")
    order.select_option("by name")
    page.wait_for_function(
        "names => String([...document.querySelectorAll('.ow-window .ow-queue li .name')].map(one => one.innerText))"
        " === String(names)",
        arg=sorted([first, second]),
    )
    order.select_option("as given")
    page.evaluate("() => document.querySelector('.opnav-workbench').focus()")


def test_the_star_under_the_cursor_is_told(bench):
    page = bench.page
    bench.press("h")
    page.evaluate("opnavDrawn()")
    for name, at in facts(page).items():
        page.mouse.move(*place(page, *at))
        page.wait_for_function(
            "name => document.querySelector('.ow-window .opnav-read-star').textContent.startsWith(name)",
            arg=name,
        )
        told = page.inner_text(".ow-window .opnav-read-star")
        assert re.search(r"\d\.\d mag\s+SNR \d+\s+O−C [+−]\d+\.\d+ [+−]\d+\.\d+", told), told


def test_north_and_east_are_where_the_readout_says(bench):
    """Along each arrow of the compass the readout's angle grows, and the arrow is seen until N takes it away."""
    page = bench.page
    data = page.evaluate(
        "() => { const { data } = Bokeh.documents.at(-1).get_model_by_name('opnav-compass');"
        " return ['pixel', 'line', 'end_pixel', 'end_line'].map(name => [...data[name]]); }"
    )
    names = page.evaluate(
        "() => [...Bokeh.documents.at(-1).get_model_by_name('opnav-compass-names').data.text]"
    )
    degrees = {}
    for name, x0, y0, x1, y1 in zip(names, *data, strict=True):
        if name not in ("N", "E"):
            continue
        for end, at in (("from", (x0, y0)), ("to", (x1, y1))):
            page.mouse.move(*place(page, *at))
            page.evaluate("opnavDrawn()")
            told = page.inner_text(".ow-window .opnav-read-degrees")
            degrees[name, end] = [float(one.replace("−", "-")) for one in re.findall(r"[+−]?\d+\.\d+", told)]
    ra, dec = np.subtract(degrees["E", "to"], degrees["E", "from"])
    assert ra > 0.0
    assert abs(dec) < 0.05 * ra
    ra, dec = np.subtract(degrees["N", "to"], degrees["N", "from"])
    assert dec > 0.0
    assert abs(ra) < 0.05 * dec
    page.mouse.move(5, 5)
    middle = place(page, data[0][0], data[1][0])
    assert seen_near(page, middle, 30, ORANGE) > 10
    bench.press("N")
    page.wait_for_function(f"() => !{STATE}.groups.includes('compass')")
    page.evaluate("opnavDrawn()")
    assert seen_near(page, middle, 30, ORANGE) == 0
    bench.press("N")


def test_the_crosshair_goes_through_the_cursor(bench):
    page = bench.page
    bench.press("X")
    x, y = place(page, 60.0, 200.0)
    page.mouse.move(x, y)
    cross = page.locator(".ow-window .opnav-cross").first
    cross.wait_for()
    box = cross.bounding_box()
    along, down = (float(cross.evaluate(f"e => parseFloat(e.style.getPropertyValue('--{n}'))")) for n in "xy")
    assert (box["x"] + along, box["y"] + down) == pytest.approx((x, y), abs=1.0)
    bench.press("X")
    page.mouse.move(x + 3, y)
    cross.wait_for(state="hidden")


def test_the_view_is_saved_as_it_is_seen(bench):
    page = bench.page
    with page.expect_download() as download:
        bench.press("P")
    assert download.value.suggested_filename == "lorri_4x4.png"
    saved = np.array(Image.open(download.value.path()).convert("RGB"), float)
    assert min(saved.shape[:2]) >= 480
    assert (np.abs(saved - np.array(YELLOW)).max(axis=2) < 60.0).sum() > 50  # the predicted places
    assert saved.std() > 5.0


def test_another_picture_is_locked_on_sky_or_pixel(bench):
    """By pixels it is laid as it is; by the sky as the stars say, which is elsewhere."""
    page = bench.page
    choice = page.locator(".ow-window select[title='Picture that is shown']")
    other = choice.locator("option", has_text="mvic_framing.fit").get_attribute("value")
    choice.select_option(other)
    lock = page.locator(".ow-window button", has_text=re.compile("^Lock: "))
    lock.wait_for()
    bits = """() => { const { image } = Bokeh.documents.at(-1).get_model_by_name('opnav-shown').data;
      let sum = 0; for (const word of image[0]) sum = (31 * sum + word) % 1000003; return sum; }"""
    page.wait_for_function(
        "key => document.querySelector('.ow-window .opnav-bridge').dataset.painted.startsWith(key)", arg=other
    )
    seen = {lock.inner_text(): page.evaluate(bits)}
    for _ in range(2):  # to the other one, and back
        before = page.evaluate(bits)
        lock.click()
        page.wait_for_function(
            "([key, before]) => document.querySelector('.ow-window .opnav-bridge').dataset.painted.startsWith(key)"
            f" && ({bits})() !== before",
            arg=[other, before],
        )
        page.evaluate("opnavDrawn()")
        assert seen.setdefault(lock.inner_text(), page.evaluate(bits)) == page.evaluate(bits)
    assert set(seen) == {"Lock: sky", "Lock: pixel"}
    choice.select_option("data")
    page.evaluate("() => document.querySelector('.opnav-workbench').focus()")


def test_regions_and_solved_wcs_are_written_by_what_the_page_offers(bench):
    page = bench.page
    bench.press("p")
    bench.said("pointing: ")
    bench.press("4")
    for act, name in (("write_regions", "regions.reg"), ("write_fits", "picture_wcs.fits")):
        page.locator(f'.ow-window .ow-panel [data-act="{act}"]').click()
        bench.said(name)
    (folder,) = bench.folder.rglob("picture_wcs.fits")
    wcs = WCS(fits.getheader(folder))
    circles = re.findall(r"circle\(([\d.]+),([\d.]+)", folder.with_name("regions.reg").read_text())
    places = np.array(circles, float) - 1.0  # DS9 counts from 1
    assert len(places) == 4
    bench.press("1")
    at = tuple(places[0])
    page.mouse.move(*place(page, *at))
    page.evaluate("opnavDrawn()")
    told = page.inner_text(".ow-window .opnav-read-degrees")
    ra, dec = (float(one.replace("−", "-")) for one in re.findall(r"[+−]?\d+\.\d+", told))
    found = wcs.all_pix2world([at], 0)[0]
    # The readout tells apparent directions, the WCS those of the catalog: 20 arcsec of aberration at most.
    np.testing.assert_allclose((found[0] - ra) * np.cos(np.radians(dec)), 0.0, atol=40.0 / 3600.0)
    np.testing.assert_allclose(found[1], dec, atol=40.0 / 3600.0)


# Kept from before: elements of the panel that bear a mark, of those that there are.
KEPT = """() => { const all = [...document.querySelectorAll('.ow-window .ow-panel .card, .ow-window .ow-panel img')];
  return [all.filter((one) => one.keptMark).length, all.length]; }"""
MARK = "() => document.querySelectorAll('.ow-window .ow-panel :is(.card, img)').forEach((one) => { one.keptMark = true; })"
# BokehJS' questions for styles, which make the browser work out all of them at once.
ASKED = """() => { const ask = globalThis.getComputedStyle; globalThis.asked = [];
  globalThis.getComputedStyle = (node, ...rest) => {
    if (/\\bbk-/.test(node.className)) asked.push(node.className);
    return ask(node, ...rest);
  }; }"""


def test_a_step_from_star_to_star_makes_no_picture_anew(bench):
    page = bench.page
    here = page.inner_text(".ow-window .ow-panel .focus b.id")
    page.evaluate(MARK)
    bench.press("n")
    page.wait_for_function(
        "(id) => document.querySelector('.ow-window .ow-panel .focus b.id').textContent !== id", arg=here
    )
    kept, there = page.evaluate(KEPT)
    assert kept == there > 8
    shown = page.inner_text(".ow-window .ow-panel .focus b.id")
    assert page.get_attribute(".ow-window .ow-panel .card.here", "data-star") == shown
    assert page.locator(".ow-window .ow-panel .card.here").count() == 1


def test_zoom_and_room_ask_for_no_style(bench):
    page = bench.page
    page.evaluate(ASKED)
    for key in ("+", "h", "F", "F"):
        bench.press(key)
        page.evaluate("() => opnavDrawn()")
    assert page.evaluate("() => asked") == []
