"""A live JupyterLab and a headless Chromium, once a session; a notebook a test.

Errors on the browser's console fail the test.  Without Chromium the tests skip, except where CI is set.
"""

import itertools
import json
import os
import re
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nbformat
import pytest

from opnav_workbench.cli.lab import LabParameters, put_notebook
from opnav_workbench.cli.lab_server import LabServer

CHROMIUM_NAMES = ("chromium", "chromium-browser", "google-chrome")
CHROMIUM_ARGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--font-render-hinting=none",
]
QUIET = {"doNotDisturbMode": True}
WAIT_MS = 240_000  # a wait ends when what it is for is there: this is for a busy machine
# JupyterLab's own words where a kernel is restarted, or the page closed, while its debugger asks something; and where
# it takes its splash screen away twice, of which the only frame is its core.
LAB_NOISE = re.compile(
    r"Could not restore the debugger state|Canceled future for"
    r"|'removeChild' on 'Node'[^\n]*\n[^\n]*\n    at \S+/static/lab/jlab_core\S+$"
)
NUMBERS = itertools.count()
SIZE = {"width": 1280, "height": 800}

# Walks all of a page's bokeh views; `found` tells which one is wanted.
FIND_FIGURE = """
function* opnavViews(view, seen = new Set()) {
  if (!view || seen.has(view)) return;
  seen.add(view); yield view;
  for (const child of view.child_views ?? []) yield* opnavViews(child, seen);
}
function opnavFigure(name) {
  for (const root of Bokeh.index.roots) for (const view of opnavViews(root))
    if (view.model?.name === name && view.frame && view.canvas_view?.el.getBoundingClientRect().width) return view;
}
"""


# In every page: `opnavDrawn()` waits until what the page has heard is drawn, which is in its next frame, and what follows
# from that in the one after; `opnavTheme(dark)` takes a theme and waits for its style sheet, which comes after its name.
HELPERS = """
window.opnavDrawn = () => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 0))));
window.opnavTheme = async (dark) => {
  const theme = `JupyterLab ${dark ? 'Dark' : 'Light'}`;
  await jupyterapp.commands.execute('apputils:change-theme', { theme }).catch(() => {});
  const ground = () => getComputedStyle(document.body).getPropertyValue('--jp-layout-color1').trim().toLowerCase();
  const told = () => (document.body.dataset.jpThemeLight === 'false') === dark;
  while (!told() || ground() === '' || ['#fff', '#ffffff', 'white'].includes(ground()) === dark)
    await new Promise(done => setTimeout(done, 20));
  while (document.querySelector('#jupyterlab-splash')) await new Promise(done => setTimeout(done, 20));
  await opnavDrawn();
};
"""
DRAWN = "() => opnavDrawn()"


def _context(chromium: Any, **options: Any) -> Any:
    """Return a browser context whose pages have the helpers."""
    context = chromium.new_context(**({"viewport": SIZE} | options))
    context.add_init_script(HELPERS)
    return context


def _missing(what: str) -> None:
    if os.environ.get("CI"):
        pytest.fail(f"{what}; CI must run the browser tests.")
    pytest.skip(f"{what}; apt-get install chromium, pip install playwright")


class Lab(LabServer):
    """The JupyterLab that ``opnav lab`` starts, with settings of its own and its application open to scripts."""

    def __init__(self, root: Path) -> None:
        own = root / ".jupyter"
        quiet = own / "settings/@jupyterlab/apputils-extension/notification.jupyterlab-settings"
        quiet.parent.mkdir(parents=True)
        quiet.write_text(json.dumps(QUIET))
        folders = {
            "JUPYTERLAB_SETTINGS_DIR": "settings",
            "JUPYTER_CONFIG_DIR": "config",
            "JUPYTER_DATA_DIR": "data",
            "JUPYTER_RUNTIME_DIR": "runtime",
            "IPYTHONDIR": "ipython",
        }
        super().__init__(
            root / "any.ipynb",
            options=["--LabApp.expose_app_in_browser=True"],
            environment={name: str(own / folder) for name, folder in folders.items()},
        )
        self.root = root


class Notebook:
    """One browser page with one notebook open.

    Tests read `page` (Playwright), `errors` (console) and use the methods; `expected` lists parts of console errors that
    the test provokes on purpose.
    """

    def __init__(self, lab: Lab, context: Any, name: str) -> None:
        self.lab, self.name, self.context = lab, name, context
        self.errors: list[str] = []
        self.expected: list[str] = []
        self.others: list[Notebook] = []
        self.page = context.new_page()
        self.page.set_default_timeout(WAIT_MS)
        self.page.on("pageerror", lambda error: self.errors.append(f"{error}\n{error.stack}"))
        self.page.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        self.open("&reset")

    def second(self) -> "Notebook":
        """Open the same notebook, with its kernel, in a second tab."""
        other = Notebook(self.lab, self.context, self.name)
        self.others.append(other)
        return other

    @property
    def path(self) -> Path:
        return self.lab.root / self.name

    def open(self, extra: str = "") -> None:
        """Load, or reload, the notebook and wait for its kernel."""
        self.page.goto("about:blank")
        self.page.goto(f"{self.lab.address}/lab/tree/{self.name}?token={self.lab.token}{extra}")
        self.page.wait_for_function(
            "() => window.jupyterapp?.shell?.currentWidget?.sessionContext?.session?.kernel?.status === 'idle'"
        )
        self.page.evaluate(f"() => {{ {FIND_FIGURE} Object.assign(window, {{ opnavViews, opnavFigure }}); }}")

    def command(self, name: str, **arguments: Any) -> None:
        self.page.evaluate("([n, a]) => jupyterapp.commands.execute(n, a).catch(() => {})", [name, arguments])

    def idle(self) -> None:
        self.page.wait_for_function(
            "() => jupyterapp.shell.currentWidget.sessionContext.session?.kernel?.status === 'idle'"
        )

    def run_all(self) -> None:
        self.command("notebook:run-all-cells")
        self.idle()

    def restart(self) -> None:
        """Restart the kernel, without running anything."""
        self.page.evaluate("() => jupyterapp.shell.currentWidget.sessionContext.session.kernel.restart()")
        self.idle()

    def save(self) -> None:
        self.command("docmanager:save")
        self.page.wait_for_function("() => !jupyterapp.shell.currentWidget.context.model.dirty")

    def dark(self, on: bool = True) -> None:
        self.page.evaluate("dark => opnavTheme(dark)", on)

    def python(self, expression: str) -> Any:
        """Evaluate an expression in the notebook's kernel; the value must be JSON."""
        script = """async code => {
          const kernel = jupyterapp.shell.currentWidget.sessionContext.session.kernel;
          const future = kernel.requestExecute({ code, store_history: false });
          let out = '', failed = '';
          future.onIOPub = m => {
            if (m.header.msg_type === 'stream') out += m.content.text;
            if (m.header.msg_type === 'error') failed = m.content.ename + ': ' + m.content.evalue;
          };
          await future.done;
          return [out, failed];
        }"""
        code = f"import json as _json; print('@@' + _json.dumps({expression}) + '@@')"
        out, failed = self.page.evaluate(script, code)
        assert not failed, failed
        return json.loads(out.split("@@")[1])

    def until(self, expression: str) -> Any:
        """Evaluate in the kernel until it is true, and return it."""
        end = time.monotonic() + 1e-3 * WAIT_MS
        while not (value := self.python(expression)):
            assert time.monotonic() < end, f"{expression} is still {value!r}"
            time.sleep(0.05)
        return value

    def settle(self) -> None:
        """Wait until Python has answered everything that the views sent."""
        self.page.wait_for_function(
            "() => [...document.querySelectorAll('.opnav-bridge')].every(e => (e.dataset.pending ?? '0') === '0')"
        )
        self.page.evaluate(DRAWN)

    def view(self, number: int = 0) -> Any:
        """Wait for a view and return its root element, scrolled into sight."""
        root = self.page.locator(".opnav-bridge[data-ready]").nth(number)
        try:
            root.wait_for()
        except Exception:
            shown = self.page.inner_text(".jp-Notebook")[-1500:]
            raise AssertionError(f"no view; console: {self.errors}; notebook: {shown}") from None
        root.scroll_into_view_if_needed()
        return root

    def xy(self, pixel: float, line: float, figure: str = "opnav-picture") -> tuple[float, float]:
        """Return where a place in a figure's data coordinates is on the page."""
        at = self.page.evaluate(
            """([x, y, name]) => { const view = opnavFigure(name); if (!view) return null;
            const box = view.canvas_view.el.getBoundingClientRect();
            return [box.left + view.frame.x_scale.compute(x), box.top + view.frame.y_scale.compute(y)]; }""",
            [pixel, line, figure],
        )
        assert at is not None, f"no figure {figure}"
        return at[0], at[1]

    def click(self, pixel: float, line: float, **options: Any) -> None:
        self.page.mouse.click(*self.xy(pixel, line), **options)

    def drag(self, start: tuple[float, float], end: tuple[float, float], button: str = "left") -> None:
        """Drag in data coordinates of the picture."""
        self.page.mouse.move(*self.xy(*start))
        self.page.mouse.down(button=button)
        here, there = self.xy(*start), self.xy(*end)
        for share in (0.3, 0.7, 1.0):
            self.page.mouse.move(*(a + share * (b - a) for a, b in zip(here, there, strict=True)))
        self.page.mouse.up(button=button)

    def press(self, *keys: str) -> None:
        for key in keys:
            self.page.keyboard.press(key)

    def status(self, text: str) -> None:
        """Wait until the view's status line contains a text, and what came with it is drawn."""
        self.page.wait_for_function(
            "t => [...document.querySelectorAll('.opnav-status')].some(e => e.textContent.includes(t))",
            arg=text,
        )
        self.page.evaluate(DRAWN)

    def shot(self, name: str) -> Path:
        """Save a screenshot where ``OPNAV_SHOTS`` says, else beside the notebook."""
        folder = Path(os.environ.get("OPNAV_SHOTS", self.lab.root / "shots"))
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{name}.png"
        self.page.screenshot(path=str(path))
        return path

    def close(self) -> None:
        self.page.evaluate("() => jupyterapp.shell.currentWidget?.sessionContext?.shutdown()")
        self.context.close()
        self.errors += [error for other in self.others for error in other.errors]
        left = [
            error
            for error in self.errors
            if not (LAB_NOISE.search(error) or any(part in error for part in self.expected))
        ]
        assert not left, f"errors on the console: {left}"


class Bench:
    """The workbench that `opnav lab` opens alone in the window: keys arrive without a click, and are counted.

    Tests read `page` (Playwright), `errors` (the page's exceptions) and `actions`.
    """

    def __init__(self, lab: Lab, chromium: Any, name: str, parameters: LabParameters, **options: Any) -> None:
        folder = lab.root / name
        folder.mkdir(exist_ok=True)
        put_notebook(folder, parameters)
        self.folder, self.actions = folder, 0
        self.address = f"{lab.address}/lab/tree/{name}/workbench.ipynb?token={lab.token}"
        self.context = _context(chromium, **options)
        self.errors: list[str] = []
        self.page = self.open()

    def open(self) -> Any:
        """Open it in a page of its own, and wait until it runs."""
        page = self.context.new_page()
        page.set_default_timeout(WAIT_MS)
        page.on("pageerror", lambda error: self.errors.append(f"{error}\n{error.stack}"))
        page.goto(self.address)
        page.locator(".ow-window .opnav-bridge[data-ready]").wait_for()
        return page

    def press(self, *keys: str) -> None:
        for key in keys:
            self.actions += 1
            self.page.keyboard.press(key)

    def said(self, text: str) -> None:
        """Wait until the status line contains a text, and what came with it is drawn."""
        self.page.wait_for_function(
            "t => document.querySelector('.ow-window .ow-status')?.textContent.includes(t)",
            arg=text,
        )
        self.page.evaluate(DRAWN)

    def close(self) -> None:
        self.page.evaluate("() => jupyterapp.shell.currentWidget?.sessionContext?.shutdown()")
        self.context.close()

    def check_errors(self) -> None:
        """No exception in the page but JupyterLab's, of a kernel that ends."""
        assert not [error for error in self.errors if "Canceled future" not in error]


@pytest.fixture(scope="session")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    with Lab(tmp_path_factory.mktemp("lab")) as server:
        yield server


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    sync_api = pytest.importorskip("playwright.sync_api") if not os.environ.get("CI") else None
    if sync_api is None:
        import playwright.sync_api as sync_api
    program = next((path for name in CHROMIUM_NAMES if (path := shutil.which(name))), None)
    if program is None:
        _missing("no Chromium on this machine")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=CHROMIUM_ARGS)
        yield browser
        browser.close()


@pytest.fixture
def wait_ms() -> int:
    """What pages that a test opens by itself wait for anything, at most."""
    return WAIT_MS


class Notebooks:
    """Opens notebooks, each in a page of its own, and closes them all."""

    def __init__(self, chromium: Any, lab: Lab) -> None:
        self.chromium, self.lab, self.opened = chromium, lab, []

    def __call__(self, *cells: str, file: Path | None = None, size: dict[str, int] = SIZE) -> Notebook:
        """Open a notebook of the given cells (source texts), or a copy of an .ipynb file."""
        name = f"notebook_{next(NUMBERS)}.ipynb"
        if file is not None:
            shutil.copy(file, self.lab.root / name)
        else:
            book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
            book.metadata["kernelspec"] = {
                "name": "python3",
                "display_name": "Python 3",
                "language": "python",
            }
            nbformat.write(book, self.lab.root / name)
        self.opened.append(Notebook(self.lab, _context(self.chromium, viewport=size), name))
        return self.opened[-1]

    def visit(self, server: Any, name: str) -> Notebook:
        """Open a notebook of another server (with `address`, `token` and `root`)."""
        self.opened.append(Notebook(server, _context(self.chromium), name))
        return self.opened[-1]

    def close(self) -> None:
        for one in self.opened:
            one.close()


@pytest.fixture
def notebook(chromium: Any, lab: Lab) -> Iterator[Notebooks]:
    """Open notebooks that live as long as the test."""
    notebooks = Notebooks(chromium, lab)
    yield notebooks
    notebooks.close()


@pytest.fixture(scope="module")
def module_notebook(chromium: Any, lab: Lab) -> Iterator[Notebooks]:
    """Open notebooks that all tests of a module share: a kernel and a page cost seconds."""
    notebooks = Notebooks(chromium, lab)
    yield notebooks
    notebooks.close()


@pytest.fixture(scope="module")
def open_bench(chromium: Any, lab: Lab) -> Iterator[Any]:
    """Open benches that all tests of a module may share: `open_bench(folder, parameters, **context)`."""
    opened: list[Bench] = []

    def open_one(name: str, parameters: LabParameters, **options: Any) -> Bench:
        opened.append(Bench(lab, chromium, name, parameters, **options))
        return opened[-1]

    yield open_one
    for bench in opened:
        bench.close()
