"""The bridge in a real page: both ways, reload, two pages, dead kernel, keys, failing callbacks."""

import os
import signal
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

SETUP = """
from bokeh.models import Button, ColumnDataSource, Div, TextInput, Row, Column
from bokeh.plotting import figure
from opnav_workbench.workbench import Bridge
log = []
plot = figure(name="plot", frame_width=300, frame_height=200, tools="tap,pan,wheel_zoom")
source = ColumnDataSource(dict(x=[1, 2, 3], y=[1, 2, 3]))
plot.scatter("x", "y", source=source, size=20)
div = Div(text="first", name="div")
button = Button(label="count")
def count():
    div.text = f"counted {len(log)}"
    log.append("count")
button.on_click(count)
def fail():
    raise ZeroDivisionError("division by zero")
bridge = Bridge(Column(plot, Row(button, div)))
bridge.bind_key("a", lambda: log.append("a"))
bridge.bind_key("x", fail)
source.selected.on_change("indices", lambda attr, old, new: log.append(list(new)))
"""
DIV = "name => { for (const d of Bokeh.documents) { const m = d.get_model_by_name(name); if (m) return m.text } }"


@pytest.fixture(scope="module")
def nb(module_notebook):
    """One page for both tests, for each of which a kernel ends."""
    return module_notebook(SETUP, "bridge", "extra = 1")


def test_bridge(nb) -> None:
    nb.run_all()
    nb.view()
    # page -> Python: a button, a selection by tap
    nb.page.get_by_role("button", name="count").click()
    nb.until("'count' in log")
    nb.page.wait_for_function(f"() => ({DIV})('div') === 'counted 0'")
    nb.page.mouse.click(*nb.xy(2, 2, "plot"))
    nb.until("[1] in log")
    # keys: heard, and no cell is cut
    n_cells = nb.page.evaluate("() => jupyterapp.shell.currentWidget.content.widgets.length")
    nb.press("a", "d", "d", "a", "j")
    nb.until("log.count('a') == 2")
    assert nb.page.evaluate("() => jupyterapp.shell.currentWidget.content.widgets.length") == n_cells
    # Python -> page
    nb.python("setattr(div, 'text', 'from Python') or 1")
    nb.page.wait_for_function(f"() => ({DIV})('div') === 'from Python'")
    # a failing callback
    nb.press("x")
    nb.status("unforeseen ZeroDivisionError")
    nb.shot("bridge_light")
    nb.dark()
    nb.shot("bridge_dark")
    nb.dark(False)
    # reload: the state of now
    nb.save()
    nb.open()
    nb.view()
    assert nb.page.evaluate(DIV, "div") == "from Python"
    nb.page.get_by_role("button", name="count").click()
    nb.until("log.count('count') == 2")
    # dead kernel
    nb.restart()
    nb.page.wait_for_selector(".opnav-dead")
    assert "Run the notebook's cells again" in nb.page.inner_text(".opnav-banner")
    nb.save()
    assert Path(nb.path).stat().st_size < 100_000


def test_killed_kernel_looks_dead(nb) -> None:
    nb.run_all()
    nb.view()
    os.kill(nb.python("__import__('os').getpid()"), signal.SIGKILL)
    nb.page.wait_for_selector(".opnav-dead")
    assert "every decision is on disk" in nb.page.inner_text(".opnav-banner")
    nb.expected = ["Kernel", "kernel", "Canceled"]  # JupyterLab's own words for a kernel that died
