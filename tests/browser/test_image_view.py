"""The image view in a real page: readout, stretch, blink, overlays, tools, reload, themes; and without a kernel."""

import io
import re
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from opnav_workbench.mission import load_mission
from opnav_workbench.rehearsal import DEMO_MISSION
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench.stretch import COLORMAPS, limits_of, shades

pytestmark = pytest.mark.slow

ARCSEC_DEG = 1.0 / 3600.0
OPEN = """
import opnav_workbench as opnav
from opnav_workbench.rehearsal import DEMO_KERNELS
from opnav_workbench.workbench import ImageView
with opnav.KernelSet(DEMO_KERNELS):
    session = opnav.ImageSession.open({path!r}, "new_horizons")
    session.add_target("PLUTO")
    session.predict(); session.find_stars(); session.repoint(); session.find_body("PLUTO", method="unresolved")
heard = []
view = ImageView(session)
view.listen(lambda *at: heard.append(at), lambda *ends: heard.append(ends))
"""


FLIGHT = """
flight = opnav.ImageSession.open({path!r}, "new_horizons", catalog={catalog!r}, attitude="header")
flight.predict(); flight.find_stars(); flight.repoint()
view.show(flight)
"""
AS_NEW = """view.state.update(image="data", partner="", stretch="asinh", limits="sky", colormap="gray", inverted=False,
    contrast=1.0, bias=0.5, groups=["predicted", "observed", "magnitudes", "bodies"], drag="")
view._look_at_all(*json.loads(view.state.setup)["size"])
"""


@pytest.fixture(scope="module")
def views(module_notebook, demo_truths):
    """The demo's two pictures, each in a page of its own, opened when first asked for."""
    opened = {}

    def view(number):
        if number not in opened:
            nb = opened[number] = module_notebook(OPEN.format(path=str(demo_truths[number].picture)), "view")
            nb.command("application:toggle-left-area")
            nb.run_all()
            nb.view()
            nb.page.locator(".opnav-bridge").scroll_into_view_if_needed()
        return opened[number]

    return view


@pytest.fixture
def opened(views):
    """A view as it is at first."""

    def view(number=0):
        nb = views(number)
        nb.python(f"exec({'import json' + chr(10) + AS_NEW!r}) or 1")
        nb.settle()
        wait_painted(nb, '"asinh"', '"gray"')
        return nb

    return view


def readout(nb, pixel, line):
    """What the readout tells after the cursor has been moved to a place."""
    nb.page.mouse.move(*nb.xy(pixel, line))
    nb.page.wait_for_function(
        "() => document.querySelector('.opnav-read-place').textContent.startsWith('pixel')"
    )
    text = nb.page.inner_text(".opnav-readout")
    numbers = dict(re.findall(r"(pixel|line) (-?[\d.]+)", text))
    ra, dec = re.search(r"([\d.]+)° ([+−][\d.]+)°", text).groups()
    dn = float(re.search(r"(-?[\d.]+) DN", text).group(1))
    place = float(numbers["pixel"]), float(numbers["line"])
    return place, dn, (float(ra), float(dec.replace("−", "-"))), text


def shown_color(nb, pixel, line):
    """Color of the picture's own pixel, from what is given to the figure."""
    return nb.page.evaluate(
        """([pixel, line]) => { const data = Bokeh.documents.at(-1).get_model_by_name('opnav-shown').data;
        const image = data.image[0], block = data.dw[0] / image.shape[1];
        const word = image[Math.floor(line / block) * image.shape[1] + Math.floor(pixel / block)];
        return [word & 255, (word >> 8) & 255, (word >> 16) & 255]; }""",
        [pixel, line],
    )


def wait_painted(nb, *parts):
    nb.page.wait_for_function(
        "parts => parts.every(t => document.querySelector('.opnav-bridge').dataset.painted.includes(t))",
        arg=list(parts),
    )


@pytest.mark.parametrize("number", [0, 1], ids=["lorri", "mvic"])
def test_readout_is_right(opened, demo_truths, number):
    """To 0.01 px, 0.1 arcsec and the last digit of DN, at the picture's corners and between them."""
    nb = opened(number)
    truth = demo_truths[number].picture
    frame = ImageSession.open(truth, DEMO_MISSION, attitude="header").context
    camera = load_mission(DEMO_MISSION).camera_for(frame.picture.header)
    attitude = np.array(nb.python("session.camera_from_j2000.tolist()"))
    x0, x1 = nb.python("[view.models.x_range.start, view.models.x_range.end]")
    left, right = max(x0, -0.5) + 2, min(x1, camera.n_pixel - 0.5) - 2
    for pixel in np.linspace(left, right, 3):
        for line in np.linspace(1.0, camera.n_line - 2.0, 3):
            place, dn, sky, _ = readout(nb, pixel, line)
            np.testing.assert_allclose(place, (pixel, line), atol=0.0051)  # told with two decimals
            assert dn == pytest.approx(frame.picture.image_dn[round(place[1]), round(place[0])], abs=6e-4)
            x, y, z = attitude.T @ camera.unproject(np.array([place]))[0]
            ra, dec = np.degrees(np.arctan2(y, x)) % 360.0, np.degrees(np.arcsin(z))
            assert abs(sky[1] - dec) < 0.1 * ARCSEC_DEG
            assert abs(sky[0] - ra) * np.cos(np.radians(dec)) < 0.1 * ARCSEC_DEG
    body = nb.python("list(map(float, session.state.bodies[-1].pixel_line))")
    place, _, _, text = readout(nb, body[0] + 3.0, body[1] - 4.0)
    distance = float(re.search(r"PLUTO: ([\d.]+) px", text).group(1))
    assert distance == pytest.approx(np.hypot(place[0] - body[0], place[1] - body[1]), abs=0.012)


@pytest.mark.realdata
def test_readout_on_a_flight_frame(opened, data_dir):
    path = data_dir / "images/lorri_interstellar/lor_0449855930_0x633_pwcs2.fits"
    nb = opened()
    show = FLIGHT.format(path=str(path), catalog=f"npz:{data_dir / 'stars/tycho2.npz'}")
    nb.python(f"exec({show!r}) or 1")
    nb.page.wait_for_function(
        "setup => Bokeh.documents.at(-1).get_model_by_name('opnav-state').setup === setup",
        arg=nb.python("view.state.setup"),
    )
    context = ImageSession.open(path, DEMO_MISSION, attitude="header").context
    attitude = np.array(nb.python("flight.camera_from_j2000.tolist()"))
    place, dn, sky, _ = readout(nb, 200.0, 31.0)
    nb.python("view.show(session) or 1")
    assert dn == pytest.approx(context.picture.image_dn[round(place[1]), round(place[0])], rel=1e-6, abs=6e-4)
    x, y, z = attitude.T @ context.camera.unproject(np.array([place]))[0]
    assert abs(sky[0] - np.degrees(np.arctan2(y, x)) % 360.0) * np.hypot(x, y) < 0.1 * ARCSEC_DEG
    assert abs(sky[1] - np.degrees(np.arcsin(z))) < 0.1 * ARCSEC_DEG


def test_stretch_blink_and_overlays(opened, demo_truths):
    nb = opened()
    image = ImageSession.open(demo_truths[0].picture, DEMO_MISSION, attitude="header").context.picture
    limits = limits_of(image.image_dn, ~(image.bad | image.saturated))

    def expect(name, stretch, colormap):
        low, high = limits[name]
        for pixel, line in ((30, 40), (100, 101), (44, 68)):
            shade = shades(np.float32(image.image_dn[line, pixel]), low, high, stretch)
            wanted = COLORMAPS[colormap][round(float(shade) * 255)]
            rgb = [int(wanted[i : i + 2], 16) for i in (1, 3, 5)]
            assert np.abs(np.subtract(shown_color(nb, pixel, line), rgb)).max() <= 3, (stretch, name)

    wait_painted(nb, '"asinh"', '"gray"')
    expect("sky", "asinh", "gray")
    nb.click(128, 128)  # the view has the keys now
    for key, stretch in (("s", "log"), ("s", "sqrt"), ("s", "linear")):
        nb.press(key)
        wait_painted(nb, f'"{stretch}"')
        expect("sky", stretch, "gray")
    nb.press("S", "c")
    wait_painted(nb, '"heat"')
    expect("zscale", "linear", "heat")
    nb.until("[view.state.stretch, view.state.limits, view.state.colormap] == ['linear', 'zscale', 'heat']")
    # limits by number, contrast and bias by right drag
    nb.page.locator(".opnav-menu").nth(2).select_option("manual")
    nb.page.locator(".opnav-number").first.fill("-5")
    nb.page.keyboard.press("Enter")
    nb.settle()
    assert nb.until("view.state.low == -5.0")
    nb.drag((60, 60), (100, 90), button="right")
    nb.settle()
    assert nb.until("view.state.contrast != 1.0 and view.state.bias != 0.5")
    # blink: the model is made in Python on the first time
    nb.press("b")
    nb.until("view.state.image == 'model'")
    wait_painted(nb, "model ")
    model = shown_color(nb, 30, 40)
    nb.press("b")
    wait_painted(nb, "data ")
    assert shown_color(nb, 30, 40) != model
    nb.press("B")
    wait_painted(nb, "model ")
    wait_painted(nb, "data ")
    nb.press("B")
    # overlays
    visible = """() => { const seen = {}; for (const m of Bokeh.documents.at(-1).all_models)
      if (m.name?.startsWith?.('overlay:')) seen[m.name.slice(8)] = m.visible; return seen; }"""
    before = nb.page.evaluate(visible)
    assert before["predicted"]
    assert not before["grid"]
    nb.press("g", "v")
    nb.settle()
    after = nb.page.evaluate(visible)
    assert after["grid"]
    assert after["residuals"]
    nb.press("o")
    nb.until("view.state.groups == []")
    nb.page.wait_for_function(
        f"() => Object.entries(({visible})()).every(([name, on]) => !on || name === 'tools')"
    )
    nb.press("o")
    assert nb.until("'grid' in view.state.groups")
    assert nb.python("view.bridge.status.kind") == "info"


def test_clicks_drags_and_zoom(opened):
    nb = opened()
    nb.python("heard.clear() or 1")
    nb.click(100, 60)
    nb.settle()
    np.testing.assert_allclose(nb.python("heard[-1]"), (100, 60), atol=0.5)
    nb.python("view.drag_mode(True, 'circle') or 1")
    nb.page.wait_for_function(
        "() => Bokeh.documents.at(-1).get_model_by_name('opnav-state').drag === 'circle'"
    )
    nb.drag((100, 60), (120, 60))
    nb.settle()
    np.testing.assert_allclose(nb.python("heard[-1]"), (100, 60, 120, 60), atol=0.5)
    assert nb.python("view.models.x_range.start") == -0.5  # the picture has not moved
    nb.python("view.drag_mode(False) or 1")
    nb.page.wait_for_function("() => Bokeh.documents.at(-1).get_model_by_name('opnav-state').drag === ''")
    nb.drag((100, 60), (120, 70))
    nb.settle()
    assert nb.python("view.models.x_range.start") == pytest.approx(-20.5, abs=1.0)
    assert nb.python("len(heard)") == 2  # a drag that moves the picture is not told
    # zoom about the cursor; pixels stay square
    nb.page.mouse.move(*nb.xy(150, 100))
    nb.page.mouse.wheel(0, -300)
    nb.until("view.models.x_range.end - view.models.x_range.start < 250")
    nb.settle()
    nb.press("+")
    nb.settle()
    size = "abs(view.models.{0}_range.end - view.models.{0}_range.start)"
    assert nb.python(size.format("x")) == pytest.approx(nb.python(size.format("y")), rel=1e-6)
    at = nb.xy(150, 100)
    np.testing.assert_allclose(nb.xy(151, 101), np.add(at, (nb.xy(151, 100)[0] - at[0],) * 2), atol=0.01)
    nb.press("h")
    nb.settle()
    assert nb.python("[view.models.x_range.start, view.models.y_range.start]") == [-0.5, 255.5]


def test_the_cursor_goes_and_clicks_by_keys(opened):
    nb = opened()
    nb.click(128, 128)
    nb.python("heard.clear() or 1")
    place, *_ = readout(nb, 100, 60)
    nb.press("Control+Shift+ArrowRight", "Control+ArrowUp", "Control+ArrowUp")
    told = nb.page.inner_text(".opnav-read-place")
    assert told == f"pixel {place[0] + 10.0:.2f}  line {place[1] - 2.0:.2f}"
    assert nb.page.locator(".opnav-cross").first.is_visible()  # where it is
    nb.press("Control+Enter")
    nb.settle()
    np.testing.assert_allclose(nb.until("heard[-1:]")[0], (place[0] + 10.0, place[1] - 2.0), atol=0.01)
    # a box: begun, and ended somewhere else
    nb.python("view.drag_mode(True, 'box') or 1")
    nb.page.wait_for_function("() => Bokeh.documents.at(-1).get_model_by_name('opnav-state').drag === 'box'")
    nb.press("Control+Enter", "Control+Shift+ArrowDown", "Control+Shift+ArrowRight", "Control+Enter")
    nb.settle()
    ends = nb.until("len(heard) > 1 and heard[-1]")
    np.testing.assert_allclose(
        ends, (place[0] + 10.0, place[1] - 2.0, place[0] + 20.0, place[1] + 8.0), atol=0.01
    )
    nb.python("view.drag_mode(False) or 1")
    nb.page.mouse.move(*nb.xy(50, 50))  # the mouse takes over
    nb.page.wait_for_function("() => document.querySelector('.opnav-cross').hidden")


def test_residuals_are_a_thousand_times_as_long_within_three_keys(opened):
    nb = opened()
    nb.click(128, 128)
    nb.press("v")
    nb.python("view.state.update(vector_scale=1.0) or 1")
    nb.settle()
    nb.press("V", "V", "V")
    nb.settle()
    assert nb.until("view.state.vector_scale") == 1000.0
    assert "×1000" in nb.page.inner_text('.opnav-switch[data-group="residuals"]')
    drawn = nb.page.evaluate(
        """() => { const { data } = Bokeh.documents.at(-1).get_model_by_name('opnav-arrows');
        return data.end_pixel[0] - data.pixel[0]; }"""
    )
    assert drawn == pytest.approx(1000.0 * nb.python("float(view._vectors['d_pixel'][0])"))


def test_what_blinks_by_itself_says_so(opened):
    """No button is just "Auto"; the one that blinks does, and stops."""
    nb = opened()
    words = nb.page.locator(".opnav-bar button").all_inner_texts()
    assert not [word for word in words if word.strip().lower() in ("", "auto")]
    nb.page.get_by_role("button", name="Auto-blink").click()
    wait_painted(nb, "model ")
    wait_painted(nb, "data ")
    nb.page.get_by_role("button", name="Auto-blink").click()
    wait_painted(nb, "data ")


def screen(nb, pixel, line, half):
    """Colors (n, n, 3) of the screen about a place of the picture."""
    x, y = nb.xy(pixel, line)
    clip = {"x": round(x) - half, "y": round(y) - half, "width": 2 * half, "height": 2 * half}
    return np.asarray(Image.open(io.BytesIO(nb.page.screenshot(clip=clip))).convert("RGB")).astype(float)


def test_marks_are_seen_on_the_brightest_ground(opened):
    """A yellow ring on the heat map's yellow: something of it differs in brightness, as all who see little color need."""
    nb = opened()
    pixel, line = nb.python(
        "[float(view.models.sources['predicted'].data[axis][0]) for axis in ('pixel', 'line')]"
    )
    nb.python("view.state.update(colormap='heat', limits='manual', low=-2000.0, high=-1000.0) or 1")
    nb.settle()
    wait_painted(nb, '"heat"', "-2000")
    nb.page.mouse.move(5, 5)
    for groups in (["predicted"], ["observed"]):
        nb.python(f"view.state.update(groups={groups}) or 1")
        nb.page.wait_for_function(
            "groups => String(Bokeh.documents.at(-1).get_model_by_name('opnav-state').groups) === String(groups)",
            arg=groups,
        )
        nb.settle()
        seen = screen(nb, pixel, line, 14)
        light = seen @ [0.2126, 0.7152, 0.0722]
        ground = np.median(light)
        assert ground > 200.0  # the brightest of the map
        marked = np.abs(light - ground) > 80.0
        assert marked.sum() > 20, groups


def test_reload_and_two_pages(opened):
    nb = opened()
    nb.click(128, 128)
    nb.press("s", "g")
    nb.drag((100, 60), (120, 70))
    nb.settle()
    start = nb.python("view.models.x_range.start")
    nb.save()
    nb.open()
    nb.view()
    wait_painted(nb, '"log"')
    find = "name => Bokeh.documents.at(-1).get_model_by_name(name)"
    assert nb.page.evaluate(f"() => ({find})('opnav-picture').x_range.start") == start
    # a second page on the same kernel follows, and is followed
    other = nb.second()
    other.view()
    other.click(60, 60)
    other.press("c")
    other.settle()
    wait_painted(nb, '"heat"')
    nb.click(60, 60)
    nb.press("c")
    nb.settle()
    wait_painted(other, '"viridis"')
    assert nb.python("view.state.colormap") == "viridis"


def test_looks_in_light_and_dark(opened):
    nb = opened()
    nb.page.mouse.move(*nb.xy(60, 80))
    nb.shot("image_view_light")
    light = nb.page.evaluate(
        "() => getComputedStyle(document.querySelector('.opnav-bridge')).backgroundColor"
    )
    nb.dark()
    nb.page.wait_for_function("() => document.querySelector('.opnav-bridge').dataset.theme === 'dark'")
    nb.shot("image_view_dark")
    dark = nb.page.evaluate("() => getComputedStyle(document.querySelector('.opnav-bridge')).backgroundColor")
    assert light != dark
    axis = "() => Bokeh.documents.at(-1).get_model_by_name('opnav-picture').left[0].major_label_text_color"
    assert nb.page.evaluate(axis) == "#e6e9ec"
    # nothing is cut off: every word of the view is inside it
    nb.drag((60, 60), (100, 90), button="right")  # contrast and bias are told, too
    nb.page.wait_for_function(
        "() => document.querySelector('.opnav-read-shade').textContent.includes('bias')"
    )
    cut = nb.page.evaluate(
        """() => [...document.querySelectorAll('.opnav-bar *, .opnav-switches *, .opnav-readout *')]
        .filter(e => e.scrollWidth > e.clientWidth + 1 && e.clientWidth && getComputedStyle(e).overflow !== 'visible')
        .map(e => e.textContent)"""
    )
    assert cut == []
    # nor by what it lies in: where the words themselves end
    cut = nb.page.evaluate(
        """() => [...document.querySelectorAll('.opnav-readout div')].filter((line) => {
          const words = document.createRange();
          words.selectNodeContents(line);
          const { right } = words.getBoundingClientRect();
          for (let around = line; around; around = around.parentElement)
            if (getComputedStyle(around).overflow !== 'visible' && around.getBoundingClientRect().right < right - 1)
              return true;
          return false;
        }).map((line) => line.textContent)"""
    )
    assert cut == []
    nb.dark(False)


def test_saved_notebook_is_small_and_static_html_shows_the_picture(opened):
    nb = opened()
    nb.save()
    assert nb.path.stat().st_size < 100_000
    subprocess.run(
        [sys.executable, "-m", "nbconvert", "--to", "html", str(nb.path), "--log-level=ERROR"],
        check=True,
        timeout=120,
    )
    html = nb.path.with_suffix(".html").read_text()
    assert "data:image/png;base64" in html
    assert "needs a running kernel" in html
