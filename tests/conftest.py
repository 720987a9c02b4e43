"""Shared fixtures: which tests run, where flight data is found, what is made once a run, and a cache of the run's own."""

import gc
import os
import pickle
import shutil
import signal
import sys
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from hashlib import blake2b
from math import sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from filelock import FileLock

# The package is imported where it is used: xdist's first process, which runs no tests, reads this file too.
if TYPE_CHECKING:
    from opnav_workbench.simulation.truth import Truth

DATA_VARIABLE = "OPNAV_DATA"
BROWSER = "tests/browser/"
SHORT_SHARE = 0.2  # of their trials is what statistical tests make in the short run, and of hostile inputs what is tried
LEFT_OUT = pytest.StashKey[int]()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--all", action="store_true", help="the long tests too, and every trial: what CI runs")
    parser.addoption("--fuzz", type=int, help="how many hostile inputs each reader and command is given")
    parser.addoption("--fuzz-seed", type=int, default=22, help="another seed gives other hostile inputs")


def pytest_configure() -> None:
    """One thread of linear algebra in each of xdist's processes, which inherit this: there is one a core already."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # jsonschema, which papermill loads, builds parsers of Internet names for a second if it finds this; nobody asks them
    sys.modules.setdefault("rfc3987_syntax", None)  # type: ignore[arg-type]
    # Notebooks' kernels and programs that tests start would each compile the whole package where nothing keeps it compiled.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    # What Debian's packages put on a machine is part of `bundled`; tests, modules that they load and programs that they
    # start have what pip brings.
    os.environ["OPNAV_ASTROMETRY"] = os.devnull
    sys.dont_write_bytecode = False
    # A shell that runs tests in the background has them ignore Ctrl-C, and they the programs that they start and stop by it.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Generator[None, Any, Any]:
    """What collection loads stays to the end: the garbage collector need not look through it again and again."""
    if not session.config.pluginmanager.hasplugin("dsession"):  # xdist's first process, which runs no tests
        from hypothesis import settings

        # How long an example takes says how busy the machine is: 0.2 s, hypothesis' deadline, is soon over beside others.
        settings.register_profile("unhurried", settings.default, deadline=None)
        settings.load_profile("unhurried")
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(10_000, 10, 10)
        gc.enable()


# ---- The short run and the whole: `slow` marks what the short run leaves out


def is_whole(config: pytest.Config) -> bool:
    """Whether every test asked for runs with every trial: with --all, and where tests are named or chosen by -m."""
    named = any("::" in argument for argument in config.args)
    return bool(config.getoption("--all") or config.getoption("markexpr") or named)


def takes_long(item: pytest.Item) -> bool:
    """Whether a test is marked slow, or is a case of a test so marked that its `keep` does not name."""
    case = item.callspec.id if hasattr(item, "callspec") else None
    return any(case is None or case not in mark.kwargs.get("keep", ()) for mark in item.iter_markers("slow"))


@pytest.fixture(scope="session")
def is_long() -> Callable[[pytest.Item], bool]:
    return takes_long


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    config.stash[LEFT_OUT] = 0
    if is_whole(config):
        return
    left_out = [item for item in items if takes_long(item)]
    items[:] = [item for item in items if not takes_long(item)]
    config.hook.pytest_deselected(items=left_out)
    config.stash[LEFT_OUT] = len(left_out)


def pytest_sessionfinish(session: pytest.Session) -> None:
    if hasattr(session.config, "workeroutput"):  # one of xdist's processes, which tell the first one
        session.config.workeroutput["left_out"] = session.config.stash.get(LEFT_OUT, 0)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    node.config.stash[LEFT_OUT] = getattr(node, "workeroutput", {}).get("left_out", 0)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    if number := config.stash.get(LEFT_OUT, 0):
        terminalreporter.write_line(f"{number} long tests left out; run all with --all")


@dataclass(frozen=True)
class Sample:
    """How many trials a statistical test makes, and bounds that follow: all with --all, a share in the short run."""

    share: float

    def trials(self, number: int) -> int:
        return max(round(number * self.share), 1)

    def within(self, bound: float) -> float:
        """Return a bound on a mean's distance from its expectation, set for all trials: chance goes as 1 / sqrt(N)."""
        return bound / sqrt(self.share)


@pytest.fixture(scope="session")
def sample(pytestconfig: pytest.Config) -> Sample:
    return Sample(1.0 if is_whole(pytestconfig) else SHORT_SHARE)


@dataclass(frozen=True)
class Fuzz:
    """How many hostile inputs a test tries, its own number (a share of it in the short run) or as told; from which seed."""

    told: int | None
    seed: int
    sample: Sample

    def count(self, number: int) -> int:
        return self.sample.trials(number) if self.told is None else self.told

    def random(self, reader: str) -> np.random.Generator:
        return np.random.default_rng([self.seed, *reader.encode()])


@pytest.fixture(scope="session")
def fuzz(pytestconfig: pytest.Config, sample: Sample) -> Fuzz:
    options = pytestconfig.getoption
    return Fuzz(options("--fuzz"), options("--fuzz-seed"), sample)


# ---- Which process runs what


@pytest.hookimpl(optionalhook=True, wrapper=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> Generator[None, int, int]:
    """The whole run has a process more than there are cores: notebooks, servers and a browser are often waited for."""
    cores = yield
    return cores + 1 if config.getoption("--all") else cores


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """A file runs in one process, and the browser's files all in the same: one server and one browser serve them."""
    if config.getoption("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return BROWSER if nodeid.startswith(BROWSER) else super()._split_scope(nodeid)

    return Scheduling(config, log)


# ---- Flight data, and what is made once a run


def _find_data() -> Path | None:
    named = os.environ.get(DATA_VARIABLE)
    candidates = [Path(named)] if named else [Path(__file__).parents[2] / "shared" / "data"]
    return next((c for c in candidates if (c / "images").is_dir()), None)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder with flight frames, kernels and catalogs; tests that need it skip where it is absent."""
    found = _find_data()
    if found is None:
        pytest.skip(f"no flight data: set {DATA_VARIABLE} to a folder with images/, spice/ and stars/")
    return found


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Any]:
    """Return a function that makes something costly once a run, whichever of xdist's processes comes first.

    `made_once(name, make)` calls `make(folder)` and returns what it returned, in all processes; files in the folder are
    shared by all of them, so tests only read them.
    """
    own = tmp_path_factory.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own

    def get(name: str, make: Callable[[Path], Any]) -> Any:
        folder, kept = shared / f"shared_{name}", shared / f"shared_{name}.pickle"
        with FileLock(f"{folder}.lock"):
            if not kept.exists():  # the pickle comes last: a folder without one is what a failure left
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir()
                kept.with_suffix(".new").write_bytes(pickle.dumps(make(folder)))
                kept.with_suffix(".new").replace(kept)
        return pickle.loads(kept.read_bytes())

    return get


@pytest.fixture(scope="session")
def demo_truths(made_once: Callable[..., Any]) -> "tuple[Truth, Truth]":
    """The two demo pictures (LORRI 4x4 with 4 stars, MVIC with 15), simulated once, and what they really show."""
    from opnav_workbench.kernels import KernelSet
    from opnav_workbench.mission import load_mission
    from opnav_workbench.rehearsal import (
        DEMO_CATALOG,
        DEMO_KERNELS,
        DEMO_MISSION,
        DEMO_PICTURES,
        simulate_picture,
    )

    def make(folder: Path) -> "tuple[Truth, Truth]":
        mission = load_mission(DEMO_MISSION)
        with KernelSet(DEMO_KERNELS):
            lorri, mvic = (simulate_picture(r, mission, DEMO_CATALOG, folder) for r in DEMO_PICTURES)
        return lorri, mvic

    return made_once("demo", make)


@pytest.fixture(scope="session")
def known_backgrounds() -> dict[Any, Any]:
    return {}


@pytest.fixture(scope="module")
def backgrounds_once(known_backgrounds: dict[Any, Any]) -> Iterator[None]:
    """The background of a picture that many tests open is estimated once: that is most of the work of opening it."""
    from opnav_workbench.session import context

    estimate, known = context.sky_and_bodies, known_backgrounds

    def once(*pixels: np.ndarray, **sizes: float) -> Any:
        key = (*(blake2b(np.ascontiguousarray(p)).digest() for p in pixels), pixels[0].shape, *sizes.items())
        if key not in known:
            if len(known) == 8:  # some 20 MB each
                del known[next(iter(known))]
            known[key] = estimate(*pixels, **sizes)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(context, "sky_and_bodies", once)
        yield


@pytest.fixture(scope="session")
def ucac4_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """UCAC4 zones 449 to 453 (dec -0.4 to +0.6 deg), written by the documented layout, as dense as the real zone 451."""
    from opnav_workbench.catalog.ucac4 import UCAC4_RECORD

    folder = tmp_path_factory.mktemp("ucac4")
    (folder / "u4b").mkdir()
    rng = np.random.default_rng(451)
    for zone in range(449, 454):
        n = 133_410
        stars = np.zeros(n, dtype=UCAC4_RECORD)
        stars["ra"] = np.sort(rng.integers(0, 1_296_000_000, n))
        stars["spd"] = rng.integers((zone - 1) * 720_000, zone * 720_000, n)
        stars["maga"] = np.maximum(
            16_500 - rng.exponential(1_150.0, n), 6_000
        )  # 2.4 times as many a magnitude
        stars["magm"], stars["sigmag"] = stars["maga"] + rng.integers(-50, 50, n), rng.integers(1, 40, n)
        stars["sigra"], stars["sigdc"] = rng.integers(-127, 127, n), rng.integers(-127, 127, n)
        stars["na1"] = stars["nu1"] = 2
        stars["cep"] = rng.integers(9_000, 10_200, (n, 2))
        stars["pm"], stars["sigpm"] = rng.integers(-3000, 3000, (n, 2)), rng.integers(-118, 122, (n, 2))
        stars["jhk"] = stars["maga"][:, None] - rng.integers(500, 2_500, (n, 3))
        apass = rng.random(n)[:, None] < 0.45  # as many as in the real catalog
        stars["apasm"] = np.where(apass, stars["maga"][:, None] + rng.integers(-500, 1_500, (n, 5)), 20_000)
        stars["apase"] = np.where(apass, rng.integers(1, 20, (n, 5)), 99)
        stars["apase"][apass[:, 0] & (stars["maga"] < 8_500), :2] = 0  # Tycho magnitudes in their place
        stars["rnm"] = zone * 1_000_000 + np.arange(n)
        stars.tofile(folder / "u4b" / f"z{zone:03d}")
    return folder
