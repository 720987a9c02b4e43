"""Thousands of stars in the picture: seen with their dark edges, and painted at the cost of a few; counted, not timed."""

import numpy as np
import pytest

pytestmark = pytest.mark.slow

SETUP = """
import numpy as np
from opnav_workbench.workbench import ImageView
view = ImageView()
view._begin((1024, 1024))
view.set_image("data", np.full((1024, 1024), 60000, np.uint16), label="image")
groups = list(view.state.groups)
rng = np.random.default_rng(2)
places = rng.uniform(5.0, 1018.0, (2000, 2))
places[0] = 512.0, 512.0
def show(n):
    for kind, turn in (("predicted", 0.0), ("used", 0.5)):
        view.models.fill(kind, {"pixel": places[:n, 0] + turn, "line": places[:n, 1]})
    none = np.zeros(n)
    vectors = {"pixel": places[:n, 0], "line": places[:n, 1], "d_pixel": none + 0.1, "d_line": none}
    view.models.fill("vectors", vectors)
    return n
"""
# Zooms by a key, and counts what is stroked until the picture is painted so.
STROKES = """(key) => new Promise(done => {
  const proto = CanvasRenderingContext2D.prototype, old = proto.stroke;
  let strokes = 0;
  proto.stroke = function (...a) { strokes += 1; return old.apply(this, a); };
  document.querySelector('.opnav-bridge').dispatchEvent(new KeyboardEvent('keydown', { key, bubbles: true }));
  setTimeout(() => { proto.stroke = old; done(strokes); }, 400);
})"""
SEEN = """() => { const doc = Bokeh.documents.at(-1), tagged = [...doc.all_models].filter(m => m.tags.includes('stars'));
  return [doc.get_model_by_name('opnav-marks').data.image.length, tagged.filter(m => m.visible).length]; }"""
# Colours of the picture about a place of it, as the page shows them.
COLORS = """([x, y, reach]) => { const view = opnavFigure('opnav-picture');
  const layer = view.canvas_view.primary, ratio = layer.pixel_ratio;
  const [sx, sy] = [view.frame.x_scale.compute(x), view.frame.y_scale.compute(y)];
  const side = 2 * reach * ratio;
  const { data } = layer.ctx.getImageData((sx - reach) * ratio, (sy - reach) * ratio, side, side);
  return [...data]; }"""


@pytest.fixture(scope="module")
def page_with_marks(module_notebook):
    nb = module_notebook(SETUP, "view")
    nb.run_all()
    nb.view()
    return nb


@pytest.fixture
def nb(page_with_marks):
    """The view as it comes: all of the picture, and the groups that are shown at first."""
    nb = page_with_marks
    nb.python("view._look_at_all(1024, 1024) or view.state.update(groups=groups, vector_scale=0.0) or 1")
    nb.page.locator(".opnav-bridge").focus()
    return nb


def show(nb, count):
    nb.python(f"show({count})")
    nb.page.wait_for_function(
        "n => Bokeh.documents.at(-1).get_model_by_name('opnav-picture').renderers.some("
        "r => r.name === 'overlay:predicted' && r.data_source.data.pixel.length === n)",
        arg=count,
    )
    nb.settle()


def colors(nb, reach):
    return np.array(nb.page.evaluate(COLORS, [512.0, 512.0, reach]), float).reshape(-1, 4)[:, :3]


def near(seen, color):
    return int((np.abs(seen - np.array(color)).max(axis=1) < 60.0).sum())


def test_two_thousand_marks_cost_a_paint_of_few_strokes(nb):
    show(nb, 100)
    few = nb.page.evaluate(STROKES, "+")
    nb.page.evaluate(STROKES, "h")
    show(nb, 2000)
    many = nb.page.evaluate(STROKES, "+")
    assert nb.page.evaluate(SEEN) == [1, 0]  # one picture of marks, and none by itself
    assert few > 100
    assert many < few  # ten and more thousand, were each mark and each edge of one stroked


def test_marks_of_a_crowd_are_seen_with_dark_edges_on_a_bright_ground(nb):
    nb.press("g")  # something to wait for
    show(nb, 2000)
    yellow, blue = (0xF0, 0xE4, 0x42), (0x56, 0xB4, 0xE9)
    seen = colors(nb, 8)
    assert near(seen, yellow) >= 4
    assert near(seen, blue) >= 4
    assert (seen.max(axis=1) < 150.0).sum() >= 8  # the edge; the ground is nearly white
    nb.page.evaluate("() => Bokeh.documents.at(-1).get_model_by_name('opnav-state').setv({ groups: [] })")
    nb.settle()
    assert near(colors(nb, 8), yellow) == near(colors(nb, 8), blue) == 0


def test_few_in_sight_are_strokes_again(nb):
    show(nb, 2000)
    x, y = nb.xy(512.0, 512.0)
    nb.page.mouse.move(x, y)
    for _ in range(8):  # about the cursor
        nb.page.evaluate(STROKES, "+")
    images, strokes = nb.page.evaluate(SEEN)
    assert images == 0
    assert strokes > 0
    assert near(colors(nb, 8), (0xF0, 0xE4, 0x42)) >= 4


def test_arrows_of_a_crowd_grow_in_the_page_alone(nb):
    """The page scales residual vectors: no array comes from the kernel at the key."""
    show(nb, 2000)
    nb.page.evaluate(STROKES, "v")
    nb.python("view.state.update(vector_scale=10.0) or 1")
    nb.page.wait_for_function(
        "() => Bokeh.documents.at(-1).get_model_by_name('opnav-state').vector_scale === 10"
    )
    nb.settle()
    before = colors(nb, 30)
    nb.page.evaluate(
        "() => { globalThis.patches = []; const doc = Bokeh.documents.at(-1);"
        " const old = doc.apply_json_patch.bind(doc);"
        " doc.apply_json_patch = (json, arrays) => { patches.push(JSON.stringify(json)); return old(json, arrays); }; }"
    )
    nb.page.evaluate(STROKES, "V")
    nb.settle()
    assert nb.python("view.state.vector_scale") == 100.0
    arrived = nb.page.evaluate("() => patches")
    assert not any("_pixel" in one for one in arrived)
    green = (0x00, 0x9E, 0x73)
    assert near(colors(nb, 30), green) > near(before, green)
