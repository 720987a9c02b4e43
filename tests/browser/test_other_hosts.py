"""The workbench in Notebook 7 and under voila, where they are installed: keys, marks and steps as in JupyterLab."""

import importlib.util
import os
import secrets
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import nbformat
import pytest

from opnav_workbench.rehearsal import DEMO_CATALOG, DEMO_KERNELS

pytestmark = pytest.mark.slow

STARTS_IN_S = 60.0
BENCH = """
import opnav_workbench as opnav
from opnav_workbench.workbench import workbench
from opnav_workbench.workbench.image_queue import ImageQueue
kernels = opnav.KernelSet({kernels!r}); kernels.__enter__()
options = dict(catalog={catalog!r}, targets=["PLUTO"])
bench = workbench(ImageQueue.of_images([{picture!r}], "new_horizons", {out!r}, **options))
bench
"""
# Of each, which is a module of its own: how it is started, and where it shows a notebook.
HOSTS = {
    "notebook": (["--allow-root", "--IdentityProvider.token={token}"], "/notebooks/{name}"),
    "voila": (["--Voila.token={token}", "--theme=light"], "/voila/render/{name}"),
}


def free_port():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


@pytest.fixture(params=HOSTS)
def address(request, demo_truths, tmp_path):
    """Start a host on a notebook with the workbench; its page's address."""
    if importlib.util.find_spec(request.param) is None:
        pytest.skip(f"{request.param} is not installed: pip install {request.param}")
    source = BENCH.format(
        kernels=str(DEMO_KERNELS),
        catalog=DEMO_CATALOG,
        picture=str(demo_truths[1].picture),
        out=str(tmp_path),
    )
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(source)])
    book.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    nbformat.write(book, tmp_path / "bench.ipynb")
    words, path = HOSTS[request.param]
    token, port = secrets.token_hex(8), free_port()
    words = [word.format(token=token) for word in words]
    folders = {f"JUPYTER_{name}_DIR": str(tmp_path / name) for name in ("CONFIG", "DATA", "RUNTIME")}
    log = (tmp_path / "log.txt").open("w")
    host = subprocess.Popen(
        [sys.executable, "-m", request.param, "--no-browser", f"--port={port}", *words],
        cwd=tmp_path,
        stdout=log,
        stderr=log,
        env=os.environ | folders,
    )
    try:
        wait_for(f"http://127.0.0.1:{port}/api/status?token={token}", host, Path(log.name))
        yield request.param, f"http://127.0.0.1:{port}{path.format(name='bench.ipynb')}?token={token}"
    finally:
        host.send_signal(signal.SIGTERM)
        host.wait(timeout=120)
        log.close()


def wait_for(url, host, log):
    end = time.monotonic() + STARTS_IN_S
    while True:
        assert host.poll() is None, log.read_text()
        assert time.monotonic() < end, log.read_text()
        try:
            return urllib.request.urlopen(url, timeout=5.0)
        except urllib.error.HTTPError as error:
            if error.code < 500:  # it is there, though it has no such page
                return error
        except OSError:
            time.sleep(0.1)


def test_stars_are_found_and_decided_by_keys(address, chromium):
    host, url = address
    context = chromium.new_context(viewport={"width": 1280, "height": 900})
    page, errors = context.new_page(), []
    page.set_default_timeout(60_000)
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(f"{error}\n{error.stack}"))
    page.goto(url)
    if host == "notebook":  # voila runs it by itself
        page.locator(".jp-CodeCell .jp-InputArea-editor").first.click()
        page.keyboard.press("Shift+Enter")
    try:
        page.locator(".opnav-workbench .opnav-bridge[data-ready]").wait_for()
    except Exception:
        raise AssertionError(
            f"no workbench; console: {said}; page: {page.inner_text('body')[-1500:]}"
        ) from None
    told = "t => document.querySelector('.ow-status')?.textContent.includes(t)"
    page.wait_for_function(told, arg="Press ? for the keys")
    page.locator(".ow-header").click(position={"x": 3, "y": 3})
    page.keyboard.press("f")
    page.wait_for_function(told, arg="15 of 15 stars found")
    star = page.inner_text(".ow-panel .focus b.id")
    page.keyboard.press("a")
    page.wait_for_function(told, arg="14 undecided")
    page.locator(f'.ow-panel .card.accepted[data-star="{star}"]').wait_for()
    page.wait_for_function("() => document.querySelector('.opnav-bridge').dataset.painted.startsWith('data')")
    width, height = page.evaluate(
        "() => { const r = document.querySelector('.opnav-workbench').getBoundingClientRect();"
        " return [r.width, r.height]; }"
    )
    assert width > 900
    assert height > 600
    if folder := os.environ.get("OPNAV_SHOTS"):
        page.screenshot(path=f"{folder}/host_{host}.png")
    assert not [error for error in errors if "blob:" in error]  # ours; the hosts have some of their own
    context.close()
