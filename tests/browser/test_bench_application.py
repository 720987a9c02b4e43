"""The workbench that `opnav lab` opens, by what is seen: where it stands, how large the picture is, what lies on top.

One server, one browser page and one kernel serve the whole file; the tests build on one another's state only by asking for
the picture that they need.
"""

import os
import re
import shutil
import signal
from types import SimpleNamespace

import pytest

from opnav_workbench.cli.lab import LabParameters
from opnav_workbench.processing import Processing
from opnav_workbench.rehearsal import DEMO_CATALOG, DEMO_KERNELS

pytestmark = pytest.mark.slow

# Of the bench and of the picture's frame, in px of the page; and what lies in the middle of the picture.
GEOMETRY = """() => {
  const rect = (e) => { const r = e.getBoundingClientRect(); return [r.left, r.top, r.right, r.bottom].map(Math.round); };
  const benches = [...document.querySelectorAll('.opnav-workbench')]; // of other notebooks too
  const bench = benches.find((one) => one.getBoundingClientRect().width);
  const figure = bench.querySelector('.opnav-stage .opnav-figure');
  const [left, top, right, bottom] = rect(figure);
  const on_top = document.elementFromPoint((left + right) / 2, (top + bottom) / 2);
  const { frame_width, frame_height } = Bokeh.documents.at(-1).get_model_by_name('opnav-picture');
  return { bench: rect(bench), figure: [left, top, right, bottom], frame: [frame_width, frame_height],
    panel: rect(bench.querySelector('.ow-panel')), on_top: on_top?.className ?? '', inside: figure.contains(on_top),
    window: [innerWidth, innerHeight] };
}"""


@pytest.fixture(scope="module")
def bench(lab, open_bench, demo_truths):
    """A bench on the demo's two pictures and a file that is none."""
    folder = lab.root / "alone"
    folder.mkdir()
    pictures = [shutil.copy(truth.picture, folder) for truth in demo_truths]
    broken = folder / "third.fit"
    broken.write_bytes(b"no picture")
    how = Processing(mission="new_horizons", kernels=DEMO_KERNELS, catalog=DEMO_CATALOG)
    opened = open_bench("alone", LabParameters((*map(str, pictures), str(broken)), how))
    opened.said("lorri_4x4.fit: ")
    return SimpleNamespace(page=opened.page, broken=broken, good=demo_truths[0].picture, opened=opened)


@pytest.fixture(autouse=True)
def _no_errors(bench):
    yield
    bench.opened.check_errors()


def said(page, text):
    page.wait_for_function("t => document.querySelector('.ow-status')?.textContent.includes(t)", arg=text)
    page.evaluate("opnavDrawn()")


def settled(page, ready=lambda seen: True):
    """Geometry once it no longer changes, and is `ready` as far as it gets: a busy kernel answers a key late."""
    before, still = None, False
    for _ in range(100):
        page.evaluate("opnavDrawn()")
        page.wait_for_timeout(50)  # what is gathered before it is told, and observers
        now = page.evaluate(GEOMETRY)
        still = now == before
        if still and ready(now):
            return now
        before = now
    assert still, f"the page does not come to rest: {before}"
    return before


def show_tab(page, key):
    """Show a tab by its key, and wait for it."""
    page.keyboard.press(key)
    page.locator(".ow-panel .tabs button[aria-pressed=true]", has_text=key).wait_for()


def go(page, name):
    page.evaluate("() => document.querySelector('.opnav-workbench').focus()")
    page.locator(".ow-queue li", has_text=name).click()


BEHIND = "() => getComputedStyle(document.querySelector('#main .jp-Notebook')).visibility"


def test_it_stands_alone_in_the_window_and_runs(bench):
    page = bench.page
    seen = settled(page)
    assert seen["bench"] == [0, 0, 1280, 800]
    assert seen["inside"]
    assert min(seen["frame"]) >= 480
    assert seen["figure"][3] <= 800
    assert page.locator("#opnav-cover").count() == 0
    assert page.evaluate(BEHIND) == "hidden"  # nor painted
    texts = page.locator(".jp-OutputArea-output").all_text_contents()
    (pending,) = [text for text in texts if "SelectionPending" in text]
    assert len(pending.strip().splitlines()) == 1
    # Keys arrive without a click.
    page.keyboard.press("f")
    said(page, "4 of 4 stars found")


def test_one_key_gives_the_picture_the_window_and_back(bench):
    page = bench.page
    before = settled(page)
    page.keyboard.press("F")
    seen = settled(page, lambda now: min(now["frame"]) >= 700)
    assert min(seen["frame"]) >= 700
    assert seen["figure"][3] <= 800
    assert page.locator(".ow-panel").is_hidden()
    page.keyboard.press("F")
    assert settled(page, before.__eq__) == before
    # The splitter gives the picture what it takes from the panel.
    bar = page.locator(".ow-split").bounding_box()
    page.mouse.move(bar["x"] + 2, 400)
    page.mouse.down()
    page.mouse.move(bar["x"] + 122, 400, steps=3)
    page.mouse.up()
    wider = settled(page, lambda now: now["frame"][0] > before["frame"][0] + 20)
    assert wider["panel"][0] - before["panel"][0] == pytest.approx(120, abs=3)
    assert wider["frame"][0] > before["frame"][0] + 20
    page.mouse.dblclick(bar["x"] + 122, 400)
    assert settled(page, lambda now: now["frame"] == before["frame"])["frame"] == before["frame"]


def test_keys_are_heard_when_what_had_the_focus_is_folded_away(bench):
    page = bench.page
    page.locator(".ow-panel .tabs button").first.focus()
    page.keyboard.press("F")
    page.locator(".ow-panel").wait_for(state="hidden")
    page.wait_for_function("() => document.activeElement === document.body")  # the browser's doing
    page.keyboard.press("F")
    page.locator(".ow-panel").wait_for()
    assert page.evaluate("() => document.activeElement.matches('.opnav-workbench')")
    settled(page)


@pytest.mark.parametrize("place", ["window", "notebook"])
def test_theme_does_not_move_the_picture(bench, place):
    page = bench.page
    if place == "notebook":
        page.keyboard.press("W")
    before = settled(page)
    for dark in (True, False):
        page.evaluate("dark => opnavTheme(dark)", dark)
        assert settled(page, before.__eq__) == before, f"dark: {dark}"
    if place == "notebook":
        page.keyboard.press("W")
        settled(page)


def test_the_picture_keeps_to_what_the_bars_leave(bench):
    """A theme's style sheet makes the bars taller for a while, and nothing else: the picture gives way, and comes back."""
    page = bench.page
    before = settled(page)
    page.evaluate(
        """() => { const sheet = document.head.appendChild(document.createElement('style'));
        sheet.id = 'between-themes'; sheet.textContent = '.opnav-switches { min-height: 320px !important; }'; }"""
    )
    pressed = settled(page, lambda now: now["frame"][1] < before["frame"][1] - 50)
    assert pressed["figure"][3] <= 800
    assert pressed["frame"][1] < before["frame"][1] - 50
    page.evaluate("() => document.querySelector('#between-themes').remove()")
    assert settled(page, before.__eq__) == before


# Everything that the window, or what scrolls in it, cuts off: (words, by how many px).
CUT_OFF = """() => {
  const scrolls = (node) => /auto|scroll/.test(getComputedStyle(node).overflow);
  const held = (node) => {
    let at = node.parentElement;
    while (at && !at.matches(".opnav-workbench") && !scrolls(at)) at = at.parentElement;
    return Boolean(at) && !at.matches(".opnav-workbench");
  };
  return [...document.querySelectorAll('.ow-window :is(button, select, .name, .message, .opnav-figure)')].filter((node) => {
    const r = node.getBoundingClientRect();
    if (!r.width || getComputedStyle(node).visibility === 'hidden' || held(node) || node.closest('[hidden]')) return false;
    return r.left < -1 || r.top < -1 || r.right > innerWidth + 1 || r.bottom > innerHeight + 1;
  }).map((node) => node.textContent || node.className);
}"""


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize(("size", "least"), [((1920, 1080), 800), ((1280, 800), 480), ((640, 400), 180)])
def test_all_of_it_is_in_the_window(bench, size, least, dark):
    """At 1920 and 1280 px, and at 1280 with 200 %, which leaves a page 640 x 400 of its own px; in light and dark."""
    page = bench.page
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.evaluate("dark => opnavTheme(dark)", dark)
    try:
        for tab in "12345":
            show_tab(page, tab)
            seen = settled(page, lambda now: now["inside"] and min(now["frame"]) >= least)
            assert seen["bench"] == [0, 0, *size]
            assert min(seen["frame"]) >= least
            assert seen["inside"]
            assert seen["figure"][3] <= size[1]
            assert page.evaluate(CUT_OFF) == [], tab
        page.keyboard.press("1")
        assert readout_is_seen(page)
        page.keyboard.press("F")
        wide = 0.7 * size[1]
        assert min(settled(page, lambda now: min(now["frame"]) >= wide)["frame"]) >= wide
        assert readout_is_seen(page)
        page.keyboard.press("F")
        back, ground = page.evaluate(
            """() => { const style = getComputedStyle(document.querySelector('.ow-window .ow-status .status'));
            return [style.color, style.backgroundColor]; }"""
        )
        assert abs(brightness(back) - brightness(ground)) > 0.4  # words are read
        assert (brightness(ground) < 0.5) is dark
    finally:
        page.keyboard.press("1")
        page.keyboard.press("h")
        page.set_viewport_size({"width": 1280, "height": 800})
        page.evaluate("() => opnavTheme(false)")


def readout_is_seen(page):
    """Whether all that is told of the place under the cursor stands in the room of the picture, and on nothing else."""
    picture = page.locator(".ow-window .opnav-stage .opnav-figure").first.bounding_box()
    page.mouse.move(picture["x"] + 0.6 * picture["width"], picture["y"] + 0.5 * picture["height"])
    page.wait_for_function(
        "() => document.querySelector('.ow-window .opnav-read-place').textContent.startsWith('pixel')"
    )
    return page.evaluate("""() => {
      const shown = document.querySelector('.ow-window');
      const room = shown.querySelector('.opnav-picture').getBoundingClientRect();
      const rows = [...shown.querySelectorAll('.opnav-readout > *')].filter((one) => one.textContent && one.offsetWidth);
      return rows.every((one) => {
        const { left, top, right, bottom } = one.getBoundingClientRect();
        const seen = document.elementFromPoint(left + 3, (top + bottom) / 2);
        return right <= room.right + 1 && bottom <= room.bottom + 1 && (one === seen || one.contains(seen));
      });
    }""")


def brightness(css):
    """Share of a color (rgb or gray) that is bright."""
    numbers = [float(number) for number in re.findall(r"[\d.]+", css)[:3]]
    return sum(numbers) / 3.0 / 255.0


def test_notebook_stands_behind_it_and_the_window_comes_back(bench):
    page = bench.page
    page.keyboard.press("W")
    seen = settled(page, lambda now: now["bench"][1] > 60)
    assert seen["bench"][1] > 60  # below JupyterLab's bars
    assert page.evaluate(BEHIND) == "visible"
    assert seen["bench"][3] <= 800
    assert min(seen["frame"]) >= 200  # beside JupyterLab's files
    page.keyboard.press("W")
    assert settled(page, lambda now: now["bench"] == [0, 0, 1280, 800])["bench"] == [0, 0, 1280, 800]


def test_another_tab_has_a_page_of_its_own(bench):
    """What nothing is kept of is not changed node by node; what a key changes a part of is."""
    page = bench.page
    go(page, "lorri_4x4.fit")
    for key, tab, stays in (("2", "2", False), ("j", "2", True), ("Escape", "2", True), ("1", "1", False)):
        page.evaluate("() => { window.owPage = document.querySelector('.ow-window .ow-panel .page'); }")
        before = page.inner_html(".ow-window .ow-panel")
        page.keyboard.press(key)
        page.wait_for_function(
            "html => document.querySelector('.ow-window .ow-panel').innerHTML !== html", arg=before
        )
        page.locator(".ow-panel .tabs button[aria-pressed=true]", has_text=tab).wait_for()
        assert page.evaluate("() => owPage.isConnected") is stays, key


def test_a_tab_brings_its_object_into_view(bench):
    page = bench.page
    center = """() => { const p = Bokeh.documents.at(-1).get_model_by_name('opnav-picture');
      const middle = (r) => (r.start + r.end) / 2, { x_range: x, y_range: y } = p;
      return [middle(x), middle(y), Math.abs(x.end - x.start)]; }"""
    go(page, "lorri_4x4.fit")
    page.keyboard.press("3")
    page.wait_for_function(
        "() => JSON.parse(Bokeh.documents.at(-1).get_model_by_name('opnav-state').bodies).length > 0"
    )
    settled(page)
    pixel, line, width = page.evaluate(center)
    marks = page.evaluate("() => JSON.parse(Bokeh.documents.at(-1).get_model_by_name('opnav-state').bodies)")
    (pluto,) = [mark for mark in marks if mark["name"] == "PLUTO"]
    assert (pixel, line) == pytest.approx((pluto["pixel"], pluto["line"]), abs=1.0)
    assert width <= 64.0  # of 256
    page.keyboard.press("1")
    page.wait_for_function(f"at => Math.abs(({center})()[0] - at) > 5", arg=pixel)
    page.keyboard.press("h")


def test_a_file_that_fails_shows_no_other_picture(bench):
    page = bench.page
    go(page, "third.fit")
    said(page, "third.fit cannot be opened")
    in_place_of_picture(page, "third.fit cannot be opened")
    seen = settled(page)
    assert seen["on_top"] == "opnav-message"
    left, top, right, bottom = page.evaluate(
        "() => { const r = document.querySelector('.opnav-message').getBoundingClientRect();"
        " return [r.left, r.top, r.right, r.bottom].map(Math.round); }"
    )
    assert (left, top, right, bottom) == tuple(seen["figure"])  # all of it
    assert not page.locator(".opnav-bar").is_visible()
    cause = page.inner_text(".ow-panel .cause")
    assert page.inner_text(".opnav-workbench").count(cause) == 1
    # Mended, and tried again.
    shutil.copy(bench.good, bench.broken)
    page.get_by_role("button", name="Try again").click()
    said(page, "third.fit: ")
    page.locator(".opnav-bar").wait_for()
    page.locator(".opnav-message").wait_for(state="hidden")
    assert settled(page, lambda now: now["inside"])["inside"]


def test_next_picture_is_there_at_once(bench, record_property):
    """It was opened ahead: no word of opening, no blank view on the way."""
    page = bench.page
    go(page, "lorri_4x4.fit")
    said(page, "lorri_4x4.fit: ")
    page.locator(".ow-queue .sign.open, .ow-queue .sign.stars").nth(2).wait_for()
    took, seen = page.evaluate("""() => new Promise(done => {
      const text = (s) => document.querySelector(s)?.textContent ?? '', seen = new Set();
      const pixels = () => Bokeh.documents.at(-1)?.get_model_by_name('opnav-shown')?.data.image[0];
      const start = performance.now(), before = pixels();
      const look = () => {
        seen.add(text('.opnav-message') + (text('.ow-status').includes('opening') ? ' opening' : ''));
        const there = text('.ow-header b') === 'mvic_framing.fit' && pixels() && pixels() !== before;
        there ? done([performance.now() - start, [...seen]]) : requestAnimationFrame(look);
      };
      const key = new KeyboardEvent('keydown', { key: 'PageDown', bubbles: true });
      document.querySelector('.opnav-workbench').dispatchEvent(key);
      look();
    })""")
    assert seen == [""]
    record_property("key_to_next_picture_ms", took)


SILENCE_S = 8.0  # without a beat for so long the page says that nothing is heard (static/region.js)
RUN = """(code) => new Promise(done => {
  const { kernel } = jupyterapp.shell.currentWidget.sessionContext.session;
  let out = '';
  const future = kernel.requestExecute({ code, store_history: false });
  future.onIOPub = (message) => { if (message.header.msg_type === 'stream') out += message.content.text; };
  future.done.then(() => done(out));
})"""


# The page's clock goes ahead; what the kernel's beat then tells of is counted from there.
TIME_PASSES = """(ms) => { const now = Date.now; Date.now = () => now() + ms; }"""
HEARD_SINCE = "since => document.querySelector('.opnav-workbench').owLife.heard >= since"


def ask_while(page, seconds, word):
    """Press a key that only Python can answer, and wait for what the page says of the kernel so long after."""
    page.evaluate("() => document.querySelector('.opnav-workbench').focus()")
    page.keyboard.press("?")
    page.evaluate(TIME_PASSES, 1000.0 * seconds)
    page.wait_for_function(
        "t => (document.querySelector('.opnav-workbench').dataset.owWait ?? '').includes(t)", arg=word
    )


def answered(page):
    """The key waited, and was not lost; nothing was called dead."""
    page.locator(".ow-panel .keys").wait_for()
    page.wait_for_function("() => !document.querySelector('.opnav-workbench').dataset.owWait")
    assert page.locator(".ow-dead, .ow-grave").count() == 0
    page.keyboard.press("?")


def test_a_busy_kernel_beats_and_is_not_called_dead(bench):
    """Its main thread is at something else for longer than silence may be: it is busy, since its beat is heard."""
    page = bench.page
    page.evaluate(f"code => void ({RUN})(code)", "import time; globals().update(begun=1); time.sleep(6.0)")
    page.wait_for_function(
        "() => jupyterapp.shell.currentWidget.sessionContext.session.kernel.status === 'busy'"
    )
    ask_while(page, SILENCE_S + 2.0, "")
    page.wait_for_function(HEARD_SINCE, arg=page.evaluate("() => Date.now()"))  # a beat after all that time
    word = page.locator(".opnav-workbench").get_attribute("data-ow-wait")
    assert word == "The kernel is busy; what you do is queued."
    answered(page)


def test_a_kernel_that_nothing_is_heard_of_is_waited_for(bench):
    """Its process stands still, so that it does not beat: the page tells how long, and goes on when it does."""
    page = bench.page
    process = int(page.evaluate(RUN, "import os; print(os.getpid())"))
    os.kill(process, signal.SIGSTOP)
    try:
        ask_while(page, SILENCE_S + 2.5, "Nothing was heard of the kernel for")
    finally:
        os.kill(process, signal.SIGCONT)
    answered(page)


@pytest.mark.parametrize("waits", ["not", "to type", "to end"])  # for the field, which the key brings
def test_what_is_typed_after_the_notes_key_is_the_note(bench, waits):
    """No letter of it is a command: `c` takes another color map, `r` rejects a star."""
    page, words = bench.page, f"carrier {waits}"
    show_tab(page, "4")
    field = page.locator(".ow-panel input[data-take]")
    before = page.evaluate("() => Bokeh.documents.at(-1).get_model_by_name('opnav-state').colormap")
    page.keyboard.press("z")
    if waits == "to type":
        field.wait_for()
    page.keyboard.type(words)
    if waits == "to end":
        field.wait_for()
    page.keyboard.press("Enter")
    page.locator(".ow-panel .observables li", has_text=words).wait_for()
    page.keyboard.press("z")
    page.wait_for_function("() => document.activeElement?.dataset.take !== undefined")
    page.keyboard.press("Escape")
    field.wait_for(state="detached")
    assert page.evaluate("() => Bokeh.documents.at(-1).get_model_by_name('opnav-state').colormap") == before


def test_a_kernel_that_ended_says_so_and_starts_again(bench):
    page = bench.page
    page.evaluate("() => { void jupyterapp.shell.currentWidget.sessionContext.session.kernel.restart() }")
    grave = page.locator(".ow-grave")
    grave.wait_for()
    assert "Every decision is on disk" in grave.inner_text()
    page.keyboard.press("Enter")  # it has the focus
    page.locator(".ow-dead").wait_for(state="detached")
    page.locator(".ow-window .opnav-bridge[data-ready]").wait_for()
    said(page, "lorri_4x4.fit")
    assert page.evaluate(GEOMETRY)["bench"] == [0, 0, 1280, 800]


# -- a list with a picture that is slow and one that fails ---------------------------------------------------------

# Pictures named so wait for a gate when they are opened, as those of a slow disk or of 8192 x 8192 pixels do.
GATE = """
import threading
from opnav_workbench.session import ImageSession
gate, usual = threading.Event(), ImageSession.open
def slow(picture, *others, **named):
    if "slow" in str(picture):
        gate.wait(120.0)
    return usual(picture, *others, **named)
ImageSession.open = slow
"""
# What is seen of the list, the picture's place, the panel and the status line.
LIST_SEEN = """() => {
  const text = (s) => document.querySelector(`.ow-window ${s}`)?.innerText.trim() ?? '';
  const shown = (s) => getComputedStyle(document.querySelector(`.ow-window ${s}`)).visibility === 'visible';
  const words = document.querySelector('.ow-window .opnav-message'), style = getComputedStyle(words);
  const box = (e) => { const r = e.getBoundingClientRect(); return [r.left, r.top, r.right, r.bottom].map(Math.round); };
  return { here: text('.ow-queue li.here'), name: text('.ow-header b'), bar: shown('.opnav-bar'), panel: text('.ow-panel'),
    status: text('.ow-status'), colors: [style.color, style.backgroundColor], message_box: box(words),
    figure: box(document.querySelector('.ow-window .opnav-stage .opnav-figure')), window: [innerWidth, innerHeight],
    bench: box(document.querySelector('.ow-window')) };
}"""


LOOKS = [(size, dark) for size in ((1280, 800), (1920, 1080)) for dark in (False, True)]


def test_slow_and_failing_pictures_of_a_list(lab, open_bench, demo_truths):
    """The list goes on while one is opened; neither shows the picture before, and both say what they are at.

    In both sizes of the window, in light and dark.
    """
    folder = lab.root / "list"
    folder.mkdir()
    good = [shutil.copy(truth.picture, folder) for truth in demo_truths]
    broken = folder / "broken.fit"
    broken.write_bytes(b"no picture")
    slow = shutil.copy(demo_truths[0].picture, folder / "slow.fit")
    how = Processing(mission="new_horizons", kernels=DEMO_KERNELS, catalog=DEMO_CATALOG)
    opened = open_bench("list", LabParameters((*map(str, good), str(broken), str(slow)), how))
    page = opened.page
    opened.said("lorri_4x4.fit: ")
    page.evaluate(RUN, GATE)
    opened.press("PageDown", "PageDown")
    opened.said("broken.fit cannot be opened")
    in_place_of_picture(page, "broken.fit cannot be opened")
    for seen in in_all_looks(page, "broken.fit"):
        assert "Try again" in seen["panel"]
        assert "cannot be opened" in seen["here"]
    opened.press("PageDown")
    in_place_of_picture(page, "opening slow.fit")
    for seen in in_all_looks(page, "slow.fit"):
        assert "being opened" in seen["here"]
        assert "opening slow.fit" in seen["status"]
    # The analyst need not wait: another picture is worked on meanwhile.
    opened.press("PageUp", "PageUp")
    opened.said("mvic_framing.fit: ")
    page.locator(".ow-window .opnav-message").wait_for(state="hidden")
    assert page.evaluate(LIST_SEEN)["bar"]
    page.evaluate(RUN, "gate.set()")
    page.locator(".ow-window .ow-queue li", has_text="slow.fit").locator(".sign.open, .sign.stars").wait_for()
    opened.press("PageDown", "PageDown")
    opened.said("slow.fit: ")
    page.locator(".ow-window .opnav-message").wait_for(state="hidden")
    assert settled(page, lambda now: now["inside"])["inside"]
    opened.check_errors()


def in_all_looks(page, file):
    """What is seen of a picture that is not there, in each size and theme; what must be so of any is asserted."""
    for size, dark in LOOKS:
        page.set_viewport_size({"width": size[0], "height": size[1]})
        page.evaluate("dark => opnavTheme(dark)", dark)
        settled(page)
        seen = page.evaluate(LIST_SEEN)
        shot(page, f"list_{file}_{size[0]}_{dark}")
        assert seen["name"] == file
        assert file in seen["here"]
        assert seen["bench"] == [0, 0, *size]
        assert not seen["bar"]  # no control of a picture that is not there
        assert seen["message_box"] == seen["figure"]  # nothing of the picture before is seen
        back, ground = seen["colors"]
        assert abs(brightness(back) - brightness(ground)) > 0.4
        assert (brightness(ground) < 0.5) is dark
        assert page.evaluate(CUT_OFF) == []
        yield seen


def in_place_of_picture(page, text):
    """Wait until a text stands where the picture would be, and the page is at rest."""
    page.wait_for_function(
        "t => document.querySelector('.ow-window .opnav-message')?.textContent === t", arg=text
    )
    settled(page)


def shot(page, name):
    """Keep a screenshot where ``OPNAV_SHOTS`` says."""
    if folder := os.environ.get("OPNAV_SHOTS"):
        page.screenshot(path=f"{folder}/{name}.png")


# -- two pages on one session ----------------------------------------------------------------------------------------


def test_two_pages_on_one_session(bench):
    """What is decided in one page is seen in the other; each has its own zoom of the window, and both answer keys."""
    first, context = bench.page, bench.page.context
    go(first, "lorri_4x4.fit")
    said(first, "lorri_4x4.fit: ")
    first.keyboard.press("1")
    first.keyboard.press("f")
    said(first, "stars found")
    second = bench.opened.open()
    try:
        for page in (first, second):
            page.locator(".ow-window .ow-panel .focus b.id").wait_for()
        star = first.inner_text(".ow-window .ow-panel .focus b.id")
        assert second.inner_text(".ow-window .ow-panel .focus b.id") == star
        second.bring_to_front()
        second.keyboard.press("a")
        said(second, f"{star} accepted")
        tally = second.inner_text(".ow-window .ow-panel .counts")
        for page in (first, second):
            page.wait_for_function(
                "t => document.querySelector('.ow-window .ow-panel .counts').innerText === t", arg=tally
            )
            page.locator(f'.ow-window .ow-panel .card.accepted[data-star="{star}"]').wait_for()
        first.bring_to_front()
        first.keyboard.press("Control+z")
        for page in (first, second):
            said(page, "undone")
            assert page.locator(f'.ow-window .ow-panel .card.accepted[data-star="{star}"]').count() == 0
        # The picture of the second shows what the first one does to it.
        first.keyboard.press("C")
        for page in (first, second):
            page.wait_for_function(
                "() => Bokeh.documents.at(-1).get_model_by_name('opnav-state').inverted === true"
            )
        second.keyboard.press("C")
        first.wait_for_function(
            "() => Bokeh.documents.at(-1).get_model_by_name('opnav-state').inverted === false"
        )
    finally:
        second.close()
    assert len(context.pages) == 1
