"""What commands reach for beyond this process, stood in for: the web, JupyterLab, Sphinx, a browser, a night's workers."""

import email.message
import gzip
import hashlib
import http.client
import io
import sys
import urllib.error
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

sys.path.extend(str(Path(__file__).parents[1] / part) for part in ("", "headless", "catalog"))

from hostile import mutant
from stub_night import StubPool
from test_catalog_tycho2 import ROWS, SUPPLEMENT, content

from opnav_workbench.files import write_json
from opnav_workbench.processing.pictures import failed_result

FETCHED = "k.tpc"
MANIFEST = """mission: probe
description: for a test
metakernel: probe.tm
template: probe.tm.template
kernels:
- {{kind: PCK, file: pck/k.tpc, url: "https://archive.invalid/pck/k.tpc", size: {size}, sha256: {sha256}, purpose: sizes}}
- {{kind: PCK, file: pck/more.tpc, url: "https://archive.invalid/pck/k.tpc", size: null, sha256: null, purpose: more}}
"""
TEMPLATE = """KPL/MK
\\begindata
PATH_VALUES  = ( '.' )
PATH_SYMBOLS = ( 'KERNELS' )
{PCK}
\\begintext
"""


class Web:
    """Answers every address: half of the time with what is asked for, else as broken archives do."""

    def __init__(self, kernel: bytes) -> None:
        self.kernel = kernel
        self.parts = {"tyc2": gzip.compress(content(ROWS[0])), "suppl": gzip.compress(content(SUPPLEMENT))}
        self.rng: np.random.Generator | None = None  # None: all is well

    def open(self, request: Any, data: None = None, timeout: float | None = None) -> Any:
        name = request.full_url.rpartition("/")[2]
        good = next((part for stem, part in self.parts.items() if name.startswith(stem)), self.kernel)
        if self.rng is None or self.rng.random() < 0.5:
            return self._answer(good, {"Content-Length": str(len(good))})
        way = int(self.rng.integers(0, 8))
        if way == 0:
            raise urllib.error.URLError(OSError(111, "Connection refused"))
        if way == 1:
            status = int(self.rng.choice([206, 301, 403, 404, 416, 500, 503]))
            raise urllib.error.HTTPError(
                request.full_url, status, "sn\x1bag", email.message.Message(), io.BytesIO()
            )
        if way == 2:
            raise http.client.BadStatusLine("\x00\r\n")
        if way == 3:
            return self._answer(good[: len(good) // 2], {"Content-Length": str(len(good))})
        if way == 4:
            return self._answer(good, {"Content-Length": str(self.rng.choice(["-1", "x", "9" * 30, "3"]))})
        if way == 5:
            return self._answer(good, {"Content-Range": "bytes 7-9/1"}, status=206)
        damaged = mutant(good, self.rng, text=False)
        return self._answer(damaged, {"Content-Length": str(len(damaged)), "ETag": '"\x07"'})

    @staticmethod
    def _answer(body: bytes, headers: dict[str, str], status: int = 200) -> Any:
        stream = _Answer(body)
        stream.status, stream.headers = status, headers
        return stream


class _Answer(io.BytesIO):
    """What comes from a server: bytes with a status and headers."""

    status: int
    headers: dict[str, str]


def write_manifest(home: Path) -> None:
    kernel = (home / FETCHED).read_bytes()
    (home / "fetch").mkdir()
    digest = hashlib.sha256(kernel).hexdigest()
    (home / "fetch/manifest.yaml").write_text(MANIFEST.format(size=len(kernel), sha256=digest))
    (home / "fetch/probe.tm.template").write_text(TEMPLATE)


def stand_in(patch: pytest.MonkeyPatch, home: Path) -> Web:
    """Replace what lies beyond this process."""
    web = Web((home / FETCHED).read_bytes())
    patch.setattr("opnav_workbench.downloads.web_opener", lambda: web)
    patch.setattr("opnav_workbench.downloads.PAUSE_S", 0.0)
    place: Callable[[], Path] = lambda: home / "out/cache"  # noqa: E731
    patch.setattr("opnav_workbench.catalog.whole_sky.cache_root", place)
    patch.setattr("opnav_workbench.catalog.whole_sky.cache_path", lambda name: place() / f"{name}.stars")
    patch.setattr("opnav_workbench.cli.lab.LabServer", _Lab)
    patch.setattr("webbrowser.open", lambda _: False)
    patch.setattr("opnav_workbench.cli.docs.need", lambda *_: None)
    patch.setattr("opnav_workbench.cli.docs.subprocess", SimpleNamespace(run=_sphinx))
    patch.setattr("opnav_workbench.cli.nightly.LocalPool", lambda *_, **__: StubPool(_left))
    return web


def _left(job: Any, folder: Path) -> None:
    write_json(folder / "result.json", failed_result(Path(job.image), "new_horizons", "no stars"))


def _sphinx(command: list[str], **_: Any) -> Any:
    html = Path(command[-1])
    html.mkdir(parents=True, exist_ok=True)
    (html / "index.html").write_text("<p>built</p>")
    return SimpleNamespace(returncode=0, stderr="")


class _Lab:
    """A JupyterLab that is stopped at once."""

    url = "http://127.0.0.1:1/lab"

    def __init__(self, notebook: Path, port: int = 0) -> None:
        assert notebook.is_file()

    def __enter__(self) -> "_Lab":
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def browser_page(self) -> str:
        return "page"

    def wait(self) -> None:
        return None
