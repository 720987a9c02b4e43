"""A session taken the whole way, and sessions at their start."""

import sys
from collections.abc import Callable, Iterator
from copy import copy
from pathlib import Path

import pytest

from opnav_workbench.kernels import KernelSet
from opnav_workbench.rehearsal import DEMO_KERNELS, DEMO_TARGETS
from opnav_workbench.session import ImageSession
from opnav_workbench.simulation.truth import Truth

sys.path.insert(0, str(Path(__file__).parents[1]))
from exposed_pictures import APPROACH, exposed_pictures


@pytest.fixture(scope="session")
def truth(demo_truths: tuple[Truth, Truth]) -> Truth:
    """The MVIC demo picture: 15 stars, Pluto and Charon."""
    return demo_truths[1]


@pytest.fixture(scope="module", autouse=True)
def _open_quickly(backgrounds_once: None) -> None:
    """Most tests here open the same few pictures."""


@pytest.fixture
def kernels() -> Iterator[None]:
    with KernelSet(DEMO_KERNELS):
        yield


@pytest.fixture
def opened(truth: Truth, kernels: None) -> ImageSession:
    return ImageSession.open(truth.picture, "new_horizons")


@pytest.fixture(scope="session")
def go() -> Callable[[ImageSession], ImageSession]:
    """Take a session the whole way, bodies one after the other and unannounced, as an analyst does."""

    def whole_way(session: ImageSession) -> ImageSession:
        session.predict()
        session.find_stars()
        session.repoint()
        for name in DEMO_TARGETS:
            session.find_body(name)
        session.observables()
        return session

    return whole_way


@pytest.fixture(scope="session")
def finished(truth: Truth, go: Callable[[ImageSession], ImageSession]) -> ImageSession:
    """A finished session that tests only read."""
    with KernelSet(DEMO_KERNELS):
        return go(ImageSession.open(truth.picture, "new_horizons"))


@pytest.fixture
def done(finished: ImageSession, kernels: None) -> ImageSession:
    """A finished session of the test's own."""
    return copied(finished)


@pytest.fixture
def approach() -> Iterator[None]:
    """Kernels of the last days before the encounter."""
    with KernelSet(APPROACH):
        yield


@pytest.fixture(scope="session")
def resolved_truths(tmp_path_factory: pytest.TempPathFactory) -> tuple[Truth, Truth]:
    """Two LORRI 4x4 pictures: Pluto 47 px wide and alone; Pluto 19 and Charon 10 px wide, 157 px apart."""
    near, pair = exposed(tmp_path_factory.mktemp("resolved"), "near", "pair")
    return near, pair


@pytest.fixture(scope="session")
def starless_truth(tmp_path_factory: pytest.TempPathFactory) -> Truth:
    """The first of them under a sky without a star."""
    (near,) = exposed(tmp_path_factory.mktemp("starless"), "near", magnitude_limit=-2.0)
    return near


TAKEN = {"near": "2015-07-12T08:46:57", "pair": "2015-07-09T04:29:00"}


def exposed(folder: Path, *names: str, magnitude_limit: float = 13.0) -> list[Truth]:
    """Simulate pictures named in `TAKEN`."""
    made = exposed_pictures(
        folder, {name: (TAKEN[name], 0.02) for name in names}, bodies=["PLUTO", "CHARON"], seed=5,
        shift_px=[7.6, -3.1], twist_deg=0.1, magnitude_limit=magnitude_limit,
    )  # fmt: skip
    return list(made.values())


@pytest.fixture(scope="session")
def solved_sessions(resolved_truths: tuple[Truth, Truth]) -> tuple[ImageSession, ImageSession]:
    """Sessions of both pictures, their pointing solved; tests take copies."""
    with KernelSet(APPROACH):
        near, pair = (solved(truth) for truth in resolved_truths)
    return near, pair


@pytest.fixture
def near(solved_sessions: tuple[ImageSession, ImageSession], approach: None) -> ImageSession:
    """A session of the picture with one large disk, its pointing solved."""
    return copied(solved_sessions[0])


@pytest.fixture
def pair(solved_sessions: tuple[ImageSession, ImageSession], approach: None) -> ImageSession:
    """A session of the picture with two bodies, its pointing solved."""
    return copied(solved_sessions[1])


def solved(truth: Truth) -> ImageSession:
    session = ImageSession.open(truth.picture, "new_horizons")
    session.predict()
    session.find_stars()
    session.repoint()
    return session


def copied(session: ImageSession) -> ImageSession:
    """Return another session that stands where this one does: they share states and inputs, which nothing changes."""
    own = ImageSession(session.context, session.source, session.inputs, session._catalog)
    own._history = copy(session._history)
    for name in ("_standing", "_undone", "_journal"):
        setattr(own._history, name, list(getattr(own._history, name)))
    return own


@pytest.fixture(scope="session")
def copy_of() -> Callable[[ImageSession], ImageSession]:
    return copied
