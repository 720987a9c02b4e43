"""What the analyst measures in the picture, by what is seen: numbers in the card, places on the page, colors on the screen.

The picture is made here, so that its truth is known: a Gaussian star on a ramp of sky, and a second picture of one gray.
"""

import io
import re

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from PIL import Image

from opnav_workbench.camera import Camera
from opnav_workbench.geometry import radec_from_unit
from opnav_workbench.resources import kernels_meta_dir

pytestmark = pytest.mark.slow

STAR, FLUX, SIGMA = (200.3, 150.7), 20000.0, 1.2
SETUP = f"""
import json
import numpy as np
from opnav_workbench.camera import Camera
from opnav_workbench.psf import box_integrals
from opnav_workbench.resources import kernels_meta_dir
from opnav_workbench.workbench import ImageView
from opnav_workbench.workbench.readout import sky_readout
star = box_integrals(np.array([{STAR}]), np.array([[np.log({SIGMA}), 0.0, 0.0]]), np.array([[0, 0]]), 512).value[0]
frame = np.random.default_rng(1).normal(100.0, 1.0, (512, 512)) + {FLUX} * star
view = ImageView()
view._begin(frame.shape)
view.state.message = ""
view.set_image("data", frame, label="image")
view.set_image("gray", np.full(frame.shape, 104.0), label="gray", same_limits=True)
camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
view.state.camera = json.dumps(sky_readout(camera, np.eye(3)[[1, 2, 0]]).as_page_values())
"""
CARD = ".opnav-card"


@pytest.fixture(scope="module")
def nb(module_notebook):
    nb = module_notebook(SETUP, "view")
    nb.command("application:toggle-left-area")
    nb.run_all()
    nb.view()
    nb.page.locator(".opnav-figure").first.hover()
    nb.page.locator(".opnav-bridge").focus()
    return nb


@pytest.fixture
def tool(nb):
    """Take a tool by its key; it is put away at the end."""

    def take(key, title):
        nb.press(key)
        nb.page.locator(f"{CARD}:visible b", has_text=title).wait_for()

    yield take
    nb.press("Escape")
    nb.page.locator(CARD).wait_for(state="hidden")


def row(nb, name):
    return nb.page.locator(f"{CARD}-rows tr", has=nb.page.locator(f"td:text-is('{name}')")).inner_text()


def numbers(text):
    return [float(number.replace("−", "-")) for number in re.findall(r"[+−-]?\d+\.?\d*", text)]


def test_histogram_has_limits_to_drag(nb, tool):
    tool("H", "Histogram")
    card, stage = (nb.page.locator(one).bounding_box() for one in (CARD, ".opnav-image"))
    assert card["x"] >= stage["x"]
    assert card["x"] + card["width"] <= stage["x"] + stage["width"]
    truth = np.array(nb.python("np.percentile(frame, [0, 50, 100]).tolist()"))
    median, low, high = numbers(row(nb, "median"))
    assert (low, median, high) == pytest.approx(tuple(truth), rel=1e-3)
    plot = nb.page.locator(f"{CARD} .frame").bounding_box()
    grip = nb.page.locator(f"{CARD} .limit.high .grip").bounding_box()
    before = nb.python("list(view.images.limits('sky'))")
    nb.page.mouse.move(grip["x"] + grip["width"] / 2, plot["y"] + 40)
    nb.page.mouse.down()
    nb.page.mouse.move(plot["x"] + 0.5 * plot["width"], plot["y"] + 40, steps=3)
    nb.page.mouse.up()
    nb.settle()
    limits, low, high = nb.python("[view.state.limits, view.state.low, view.state.high]")
    assert limits == "manual"
    assert low == pytest.approx(before[0])
    assert high < before[1]
    white = numbers(row(nb, "white"))
    assert white[0] == pytest.approx(high, rel=1e-4)
    above = 100.0 * nb.python("float((frame > view.state.high).mean())")
    assert white[1] == pytest.approx(above, rel=0.06)
    nb.python("view.state.update(limits='sky') or 1")


def test_line_cut_goes_through_the_star(nb, tool):
    tool("T", "Line cut")
    nb.drag((STAR[0] - 10.0, STAR[1]), (STAR[0] + 10.0, STAR[1]))
    assert numbers(row(nb, "to"))[-1] == pytest.approx(20.0, abs=0.5)  # to a screen pixel
    plot = nb.page.locator(f"{CARD} .frame").bounding_box()
    curve = nb.page.locator(f"{CARD} .data").get_attribute("d")
    places = np.array([[float(v) for v in pair.split()] for pair in re.split("[ML]", curve)[1:]])
    assert len(places) == pytest.approx(41, abs=1)
    peak = places[places[:, 1].argmin(), 0] - places[0, 0]
    assert peak / (places[-1, 0] - places[0, 0]) == pytest.approx(0.5, abs=0.04)
    # The place under the pointer on the plot is the place that the readout tells.
    nb.page.mouse.move(plot["x"] + 0.5 * plot["width"], plot["y"] + 20)
    told = numbers(nb.page.inner_text(".opnav-read-place"))
    assert told == pytest.approx(STAR, abs=0.5)


def test_aperture_tells_sum_center_and_width(nb, tool):
    tool("O", "Aperture")
    nb.click(STAR[0] + 1.0, STAR[1] - 1.0)
    nb.page.wait_for_function(
        f"() => document.querySelector('{CARD}-rows').textContent.includes('pixel {STAR[0]:.1f}')"
    )
    assert numbers(row(nb, "center")) == pytest.approx(STAR, abs=0.02)
    total, sigma, radius = numbers(row(nb, "sum"))[:3]
    assert (total, radius) == pytest.approx((FLUX, 5.0), rel=0.005)
    assert sigma < 20.0
    fwhm_px, fwhm_arcsec = numbers(row(nb, "FWHM"))
    assert fwhm_px == pytest.approx(2.3548 * SIGMA, abs=0.02)
    scale = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml").pixel_scale_rad
    assert fwhm_arcsec == pytest.approx(fwhm_px * np.degrees(scale) * 3600.0, rel=0.01)


def test_distance_and_angle_are_those_of_the_sky(nb, tool):
    tool("M", "Distance")
    nb.drag((100.0, 100.0), (300.0, 250.0))
    ends = np.array([numbers(row(nb, name)) for name in ("from", "to")])
    assert ends == pytest.approx(np.array([[100.0, 100.0], [300.0, 250.0]]), abs=1.0)
    assert numbers(row(nb, "length"))[0] == pytest.approx(np.hypot(*(ends[1] - ends[0])), abs=0.02)
    camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    ra, dec = radec_from_unit(camera.unproject(ends) @ np.eye(3)[[1, 2, 0]])
    first, last = SkyCoord(ra, dec, unit="rad")
    arcsec = float(
        nb.page.locator(f"{CARD}-rows tr", has_text="on the sky").inner_text().split()[-1].strip("″")
    )
    assert arcsec == pytest.approx(first.separation(last).arcsec, rel=1e-3)
    assert numbers(row(nb, "position angle"))[0] == pytest.approx(first.position_angle(last).deg, abs=0.02)


def test_two_pictures_side_by_side_and_under_a_curtain(nb):
    shown = nb.page.locator(".opnav-stage > .opnav-figure")
    nb.press("D")
    nb.page.locator(".opnav-second").wait_for()
    nb.settle()
    left, right = (shown.nth(i).bounding_box() for i in (0, 1))
    assert right["x"] >= left["x"] + left["width"]
    assert right["x"] + right["width"] <= 1280
    place = (120.0, 200.0)
    here, there = nb.xy(*place), nb.xy(*place, figure="opnav-second")
    assert here[1] == pytest.approx(there[1], abs=1.0)  # the same line at the same height
    assert len(colors(nb, there)) == 1  # one gray
    assert len(colors(nb, here)) > 3  # noise
    nb.page.mouse.move(*there)
    assert numbers(nb.page.inner_text(".opnav-read-place")) == pytest.approx(place, abs=1.0)
    assert "| 104 DN" in nb.page.inner_text(".opnav-read-value")
    nb.press("Y")
    nb.page.locator(".opnav-curtain").wait_for()
    nb.settle()
    box = nb.page.locator(".opnav-curtain").bounding_box()
    at = box["x"] + box["width"] / 2
    nb.page.mouse.move(at, box["y"] + 60)
    nb.page.mouse.down()
    nb.page.mouse.move(nb.xy(100.0, 0.0)[0], box["y"] + 60, steps=3)
    nb.page.mouse.up()
    nb.page.mouse.move(5, 5)
    assert len(colors(nb, nb.xy(80.0, 300.0))) > 3
    assert len(colors(nb, nb.xy(120.0, 300.0))) == 1
    nb.press("Y")
    nb.page.locator(".opnav-curtain").wait_for(state="hidden")
    assert len(colors(nb, nb.xy(120.0, 300.0))) > 3


def colors(nb, place):
    """Colors on the screen about a place."""
    x, y = place
    clip = {"x": x - 5, "y": y - 5, "width": 10, "height": 10}
    shown = np.asarray(Image.open(io.BytesIO(nb.page.screenshot(clip=clip))).convert("RGB"))
    return set(map(tuple, shown.reshape(-1, 3).tolist()))
