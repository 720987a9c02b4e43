"""Warm processes: nothing of a picture reaches the next, and a lost process costs nothing."""

import json
import threading
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import nbformat
import psutil
import pytest

from opnav_workbench.headless import starting
from opnav_workbench.headless.night import Night, plan_night, run_night
from opnav_workbench.headless.night_spec import NightSpec
from opnav_workbench.headless.night_workers import LocalPool, NotebookRequest, process_picture
from opnav_workbench.headless.warm_server import WarmServerError, can_fork
from opnav_workbench.resources import notebooks_dir

# Leaves something wherever a picture can leave it, and tells what it finds of the one before.
TRACES = """
import json, os, pathlib, sys, types
import matplotlib, numpy, spiceypy
import opnav_workbench.mission
seen = ["LEFT" in os.environ, hasattr(numpy, "left"), "left" in sys.modules, spiceypy.ktotal("ALL") > 0]
seen += [spiceypy.expool("LEFT"), hasattr(opnav_workbench.mission, "left"), matplotlib.rcParams["lines.linewidth"] == 7]
os.environ["LEFT"] = "1"
numpy.left = opnav_workbench.mission.left = True
sys.modules["left"] = types.ModuleType("left")
spiceypy.pdpool("LEFT", [1.0])
matplotlib.rcParams["lines.linewidth"] = 7
os.chdir("/")
chance = numpy.random.random()
pathlib.Path(out, "result.json").write_text(json.dumps({
    "image": pathlib.Path(image).name, "mission": mission, "status": "ok", "sha256": "", "bodies": [], "stars": [],
    "pointing": None, "messages": [str(any(seen)), str(chance), str(os.getppid())]}))
"""

pytestmark = pytest.mark.skipif(not can_fork(), reason="processes are copied on Linux only")


@pytest.fixture
def traces(tmp_path):
    """A night of four pictures whose notebook leaves traces."""
    real = nbformat.read(notebooks_dir() / "process_image.ipynb", 4)
    parameters = next(cell for cell in real.cells if "parameters" in cell.metadata.get("tags", []))
    real.cells = [parameters, nbformat.v4.new_code_cell(TRACES, id="work")]
    nbformat.write(real, tmp_path / "traces.ipynb")
    (tmp_path / "in").mkdir()
    for name in "abcd":
        (tmp_path / "in" / f"{name}.fit").write_text(name)
    notebook, images = str(tmp_path / "traces.ipynb"), (str(tmp_path / "in"),)
    return plan_night(NightSpec(images=images, mission="new_horizons", notebook=notebook), tmp_path / "out")


def servers_here() -> list[psutil.Process]:
    found = []
    for process in psutil.Process().children():
        with suppress(psutil.Error):  # of other tests, ending
            found += [process] * ("warm_server" in " ".join(process.cmdline()))
    return found


def said(out: Path) -> list[list[str]]:
    return [json.loads((out / name / "result.json").read_text())["messages"] for name in "abcd"]


@pytest.mark.slow
def test_nothing_reaches_the_next_picture_and_a_lost_server_is_replaced(traces):
    night, verdicts = Night(traces), []

    def lose(verdict):
        verdicts.append(verdict)
        if len(verdicts) == 2:
            (server,) = servers_here()
            server.kill()

    run_night(night, LocalPool(1), say=lose)
    assert [verdict.fault for verdict in verdicts] == [""] * 4
    found, chances, parents = zip(*said(traces.out), strict=True)
    assert found == ("False",) * 4
    assert len(set(chances)) == 4  # nor do pictures share their chance
    assert len(set(parents)) == 2
    assert servers_here() == []


def test_where_nothing_can_be_copied_a_night_goes_the_cold_way_and_says_so(tmp_path, monkeypatch):
    def refused(*_):
        raise WarmServerError("libraries started 3 threads")

    monkeypatch.setattr(starting, "WarmServer", refused)
    monkeypatch.setattr(starting.ColdStarter, "start", lambda *_: "a cold process")
    told = []
    starter = starting.WarmStarter(told.append)
    assert [starter.start(tmp_path / "job", {}, tmp_path / "log") for _ in range(3)] == ["a cold process"] * 3
    assert len(told) == 1
    assert "libraries started 3 threads" in told[0]


def test_what_is_loaded_serves_as_long_as_its_contents_are_the_same(tmp_path, monkeypatch):
    """A cluster's worker lives for many nights, and a catalog may be another under its old name."""
    used = []

    class Loaded:
        alive = True

        def __init__(self, how, _environment):
            self.contents = how["contents"]

        def start(self, _job):
            used.append(self.contents)
            return SimpleNamespace(pid=0, returncode=1, poll=lambda: 1, wait=lambda _: 1)

        def close(self):
            used.append("closed")

    monkeypatch.setattr(starting, "WarmServer", Loaded)
    starter = starting.WarmStarter()
    for contents in ("one", "one", "another"):
        job = NotebookRequest(
            "a.fit", "a", str(tmp_path), "n", {"mission": "m"}, "m", 1.0, 500.0, contents=contents
        )
        assert process_picture(job.to_dict(), starter=starter)["fault"] == "machine"
    assert list(tmp_path.rglob("result.json")) == []  # which would be the picture's
    assert used == ["one", "one", "closed", "another"]


class Warming:
    """A server that is still loading when it is closed."""

    made: ClassVar[list["Warming"]] = []
    alive = True

    def __init__(self, *_):
        self.made.append(self)
        self.asked, self.closed = threading.Event(), threading.Event()

    def start(self, _job):
        self.asked.set()
        self.closed.wait(10.0)
        raise WarmServerError("the warm process ended")

    def close(self):
        self.closed.set()


def test_a_night_that_is_stopped_starts_no_other_server(tmp_path, monkeypatch):
    monkeypatch.setattr(starting, "WarmServer", Warming)
    monkeypatch.setattr(starting.ColdStarter, "start", lambda *_: pytest.fail("a cold process"))
    starter, said = starting.WarmStarter(), []

    def begin():
        with pytest.raises(WarmServerError, match="stopped"):
            starter.start(tmp_path / "job", {}, tmp_path / "log")
        said.append("refused")

    thread = threading.Thread(target=begin)
    thread.start()
    while not Warming.made:
        time.sleep(0.01)
    Warming.made[0].asked.wait(10.0)
    starter.close()
    thread.join(10.0)
    assert said == ["refused"]
    assert len(Warming.made) == 1
