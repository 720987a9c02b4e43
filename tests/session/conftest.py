"""A session taken the whole way, and sessions at their start."""

from collections.abc import Callable, Iterator

import pytest

from opnav_workbench.rehearsal import DEMO_KERNELS, DEMO_TARGETS, Truth
from opnav_workbench.session import ImageSession
from opnav_workbench.spice import KernelSet


@pytest.fixture(scope="session")
def truth(demo_truths: tuple[Truth, Truth]) -> Truth:
    """The MVIC demo picture: 15 stars, Pluto and Charon."""
    return demo_truths[1]


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


@pytest.fixture(scope="module")
def finished(truth: Truth, go: Callable[[ImageSession], ImageSession]) -> ImageSession:
    """A finished session that tests only read."""
    with KernelSet(DEMO_KERNELS):
        return go(ImageSession.open(truth.picture, "new_horizons"))
