"""A workbench without a browser: a fake picture, and the demo's pictures."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from opnav_workbench.kernels import KernelSet
from opnav_workbench.rehearsal import DEMO_KERNELS, DEMO_MISSION
from opnav_workbench.session import ImageSession
from opnav_workbench.simulation.truth import Truth
from opnav_workbench.workbench.controller import WorkbenchController
from opnav_workbench.workbench.image_queue import ImageQueue


class FakeViewer:
    """Remembers what it was told; `tap` and `drag` are what the analyst does in the picture."""

    actions = ()

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.shown: list[ImageSession] = []
        self.layers: dict[str, Any] = {}
        self.circled: Any = None
        self.focused: Any = None
        self.dragging = False
        self.refreshed = 0
        self.message = ""
        self.looked_at: Any = None
        self.in_sight: Callable[[Any], bool] = lambda _: False

    def batch(self) -> Any:
        return self.lock

    def prepare(self, session: ImageSession) -> None:
        pass

    def send_ahead(self, sessions: Any) -> None:
        self.ahead = list(sessions)

    def blank(self, message: str) -> None:
        self.message = message

    def compare_with(self, others: Any) -> None:
        self.others = [name for name, _ in others]

    def look(self, place_px: Any, span_px: float | None = None, *, unless_seen: bool = False) -> None:
        if not (unless_seen and self.in_sight(place_px)):
            self.looked_at = (*place_px, span_px)

    def show(self, session: ImageSession) -> None:
        self.shown.append(session)
        self.message = ""

    def refresh(self) -> None:
        self.refreshed += 1

    def do(self, name: str) -> str:
        return ""

    def drag_mode(self, on: bool, shape: str = "box") -> None:
        self.dragging = on

    def layer(self, name: str, layer: Any) -> None:
        self.layers[name] = layer

    def circle(self, center_px: Any, radius_px: float = 0.0) -> None:
        self.circled = None if center_px is None else (*center_px, radius_px)

    def focus(self, place_px: Any, radius_px: float = 0.0) -> None:
        self.focused = place_px

    def listen(self, tapped: Callable[..., None], dragged: Callable[..., None]) -> None:
        self.tap, self.drag = tapped, dragged


class Hands:
    """An analyst without a browser: presses keys, clicks, types; everything waits until it is done."""

    def __init__(self, controller: WorkbenchController, viewer: FakeViewer) -> None:
        self.controller, self.viewer = controller, viewer

    @property
    def session(self) -> ImageSession:
        return self.controller.queue.session

    @property
    def said(self) -> str:
        return self.controller.runner.status.message

    @property
    def kind(self) -> str:
        return self.controller.runner.status.kind

    @property
    def panel(self) -> str:
        return self.controller.regions()["panel"]

    @property
    def steps(self) -> list[str]:
        return [entry.step for entry in self.session.standing]

    def press(self, *keys: str) -> None:
        for key in keys:
            self.send("key", arg=key)

    def send(self, act: str, **event: Any) -> None:
        self.controller.handle({"act": act} | event)
        self.controller.runner.wait()

    def tap(self, pixel: float, line: float) -> None:
        self.viewer.tap(pixel, line)
        self.controller.runner.wait()

    def drag(self, *ends: float) -> None:
        self.viewer.drag(*ends)
        self.controller.runner.wait()


@pytest.fixture(scope="module", autouse=True)
def _open_quickly(backgrounds_once: None) -> None:
    """Most tests here open the same few pictures."""


@pytest.fixture
def kernels() -> Iterator[None]:
    with KernelSet(DEMO_KERNELS):
        yield


@pytest.fixture(scope="module")
def solved_sessions(demo_truths: tuple[Truth, Truth]) -> list[ImageSession]:
    """Both demo pictures, their pointing solved, Pluto among the targets."""
    opened = []
    with KernelSet(DEMO_KERNELS):
        for truth in demo_truths:
            session = ImageSession.open(truth.picture, DEMO_MISSION)
            session.add_target("PLUTO")
            session.predict()
            session.find_stars()
            session.repoint()
            opened.append(session)
    return opened


@pytest.fixture
def hands_on(kernels: None) -> Callable[..., Hands]:
    """Open a workbench on pictures, with autosave below `out` if given."""

    def opened(*pictures: Path, out: Path | None = None) -> Hands:
        sessions = [ImageSession.open(picture, "new_horizons") for picture in pictures]
        viewer = FakeViewer()
        hands = Hands(WorkbenchController(ImageQueue.of_sessions(sessions, out), viewer), viewer)
        hands.controller.runner.wait()
        return hands

    return opened


@pytest.fixture
def star_hands(hands_on: Callable[..., Hands], demo_truths: tuple[Truth, Truth], tmp_path: Path) -> Hands:
    """The MVIC demo picture with its 15 stars found."""
    hands = hands_on(demo_truths[1].picture, out=tmp_path)
    hands.press("f")
    return hands
