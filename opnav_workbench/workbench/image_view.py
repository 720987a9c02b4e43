"""The picture of a session in the notebook: stretch, zoom, magnifier, readout, overlays and blink.

Flow      session -> pixels once, overlays at each `refresh` -> page;  page -> clicks and drags in (pixel, line)
Pictures  the image itself, what the session's solutions explain (background, fitted stars, fitted bodies), and the
          difference; the latter two are made when first asked for. Each one's pixels go to a page once, as uint16
          where they are counts, else float32, and those of the neighbors ahead while there is time

Everything that needs no session happens in the page (static/image_view.js): no pixel is sent twice, and the readout
never asks Python.
"""

import itertools
import json
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.errors import OpNavError
from opnav_workbench.report.scales import STRIP_ASPECT, round_scale
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench.actions import VIEW_ACTIONS
from opnav_workbench.workbench.bridge import Bridge
from opnav_workbench.workbench.inspection import compass_arrows, measure_aperture
from opnav_workbench.workbench.laying import laid_over
from opnav_workbench.workbench.overlays import (
    LONGEST_VECTOR,
    BodyMarks,
    Columns,
    SkyGrid,
    body_marks,
    expected_attitude,
    expected_camera,
    mask_runs,
    sky_grid,
    star_facts,
    star_marks,
)
from opnav_workbench.workbench.readout import sky_readout
from opnav_workbench.workbench.recent import Recent
from opnav_workbench.workbench.sent_arrays import ArrayStore, SentPicture
from opnav_workbench.workbench.status_line import Status
from opnav_workbench.workbench.stretch import DEFAULT_LIMITS, limits_of, picture_png
from opnav_workbench.workbench.view_models import (
    DEFAULT_THEME,
    THEMES,
    PictureModels,
    ViewState,
    body_label_columns,
    label_columns,
    layer_columns,
    lines_columns,
    page_setup,
    ring_columns,
)
from opnav_workbench.workbench.viewer import Layer

__all__ = ["ImageView", "difference_picture", "modeled_picture"]


# ---- What showing a session costs beyond its overlays, done once, and ahead where there is time.


@dataclass(frozen=True, slots=True, eq=False)
class PreparedPicture:
    """A picture's pixels as they are sent, its limits by name (DN), and its masks as runs."""

    sent: SentPicture
    limits: dict[str, Any]
    bad: dict[str, Any]
    saturated: dict[str, Any]


def prepared_picture(session: ImageSession, arrays: ArrayStore) -> PreparedPicture:
    """Return what is sent of a session's picture."""
    frame = session.context.picture
    usable = ~(frame.bad | frame.saturated)
    return PreparedPicture(
        arrays.put(frame.image_dn),
        limits_of(frame.image_dn, usable),
        mask_runs(frame.bad),
        mask_runs(frame.saturated),
    )


# ---- The pictures of a view: the image itself, and others to blink it against; each one's pixels are sent once.

DATA_KEY = "data"  # key of the image itself
OTHER = "other:"  # how keys of other images begin


class PictureSet:
    """Pictures by key; what pages must know of them stands in the view's state.

    Parameters
    ----------
    state : ViewState
    """

    def __init__(self, bridge: Bridge, state: Any) -> None:
        self._bridge, self._state = bridge, state
        self._sent: dict[str, SentPicture] = {}
        self._entries: dict[str, dict[str, Any]] = {}
        self._makers: dict[str, tuple[Callable[[], FloatArray], bool]] = {}

    def limits(self, name: str) -> tuple[float, float]:
        """Limits of the image by their name, DN."""
        low, high = self._entries[DATA_KEY]["limits"][name]
        return low, high

    def put(
        self, key: str, image_dn: ArrayLike, label: str, usable: BoolArray | None, same_limits: bool
    ) -> None:
        """Add or replace a picture; see `ImageView.set_image`."""
        image = np.asarray(image_dn)
        n_pixel, n_line = json.loads(self._state.setup)["size"]
        if image.shape != (n_line, n_pixel):
            raise OpNavError(f"picture {key!r} has shape {image.shape}; the image has {n_pixel} x {n_line}.")
        limits = self._entries[DATA_KEY]["limits"] if same_limits else limits_of(image, usable)
        self.put_prepared(key, self._bridge.arrays.put(image), label, limits)

    def put_prepared(self, key: str, sent: SentPicture, label: str, limits: dict[str, Any]) -> None:
        """Add or replace a picture whose limits are known."""
        self._sent[key] = sent
        entry = {"label": label or key, "limits": limits, "ready": True, "pixels": sent.as_page_values()}
        self._publish({key: entry})

    def offer(self, key: str, label: str, make: Callable[[], FloatArray], same_limits: bool) -> None:
        """Offer a picture that is made when the analyst first asks for it."""
        self._makers[key] = make, same_limits
        self._publish({key: {"label": label, "limits": {}, "ready": False}})

    def make(self, key: str) -> None:
        """Make a picture that was offered, if it is not up to date."""
        if key in self._makers and not self._entries[key]["ready"]:
            make, same_limits = self._makers[key]
            self.put(key, make(), self._entries[key]["label"], None, same_limits)

    def pixels(self, key: str) -> np.ndarray:
        """Return a picture's pixels, as they were sent."""
        return self._sent[key].full.values

    def outdate(self, begins: str = "") -> None:
        """The session has changed: what is made from it is made anew when it is asked for.

        Parameters
        ----------
        begins
            Only keys that begin so.
        """
        for key in self._makers:
            if key.startswith(begins):
                self._entries[key]["ready"] = False
        self._publish({})
        self.make(self._state.image)
        if self._state.compare:
            self.make(self._state.partner)

    def withdraw(self, begins: str) -> None:
        """Offer pictures no more whose keys begin so."""
        for key in [key for key in self._makers if key.startswith(begins)]:
            del self._makers[key], self._entries[key]
            self._sent.pop(key, None)
        if self._state.image.startswith(begins):
            self._state.image = DATA_KEY
        self._publish({})

    def forget(self) -> None:
        """Drop all pictures."""
        self._sent, self._entries, self._makers = {}, {}, {}
        self._state.image = DATA_KEY

    def _publish(self, images: dict[str, dict[str, Any]]) -> None:
        self._entries |= images
        self._state.images = json.dumps(self._entries)


# ---- The image as the session's solutions explain it: background, fitted stars, fitted bodies.


def modeled_picture(session: ImageSession) -> FloatArray:
    """Return the modelled picture (n_line, n_pixel), DN.

    A star's model counts in its own box, a body's in its sub-array; where boxes overlap each pixel takes the larger
    star, because each box holds its star alone.
    """
    model = np.zeros_like(session.context.signal_dn)
    if session.state.a_priori is not None and session.state.centers is not None:
        for box in session.star_boxes():
            _add_model(model, box.first_px, box.model_dn)
    for body in session.state.bodies:
        if body.pictures is not None:
            _add_model(model, body.pictures.window[:2], body.pictures.model_dn)
    return model + session.context.background.level_dn


def difference_picture(session: ImageSession) -> FloatArray:
    """Return picture minus model (n_line, n_pixel), DN; nan in bad pixels."""
    frame = session.context.picture
    return np.where(frame.bad, np.nan, frame.image_dn - modeled_picture(session))


def _add_model(model: FloatArray, first_px: tuple[int, int], part: FloatArray) -> None:
    pixel, line = first_px
    rows = np.arange(line, line + part.shape[0])
    columns = np.arange(pixel, pixel + part.shape[1])
    ok_rows = (rows >= 0) & (rows < model.shape[0])
    ok_columns = (columns >= 0) & (columns < model.shape[1])
    there = np.ix_(rows[ok_rows], columns[ok_columns])
    values = part[np.ix_(ok_rows, ok_columns)]
    model[there] = np.fmax(model[there], np.nan_to_num(values))


# ---- The picture of a session in the notebook: stretch, zoom, magnifier, readout, overlays and blink.

SHOWN_AT_FIRST = ["predicted", "observed", "magnitudes", "bodies", "compass"]
AHEAD_BYTES = 160_000_000  # of neighbors' pixels in a page: two of 4096 x 4096
EMPTY_SIZE = 512  # a view without a session shows a blank square
# Of a strip as it is shown: width over height, and what is shown over its lines.
STRIP_SHAPE, STRIP_MARGIN = 3.0, 1.15


# ---- What lies over the picture of a session as it stands.


@dataclass(frozen=True, slots=True, eq=False)
class Overlays:
    """Marks by the name of what shows them, residual vectors, and what the page evaluates by itself, as JSON."""

    columns: dict[str, Columns]
    vectors: Columns
    camera: str
    compass: str
    bodies: str
    body_names: tuple[str, ...]


def overlays_of(session: ImageSession) -> Overlays:
    """Return what lies over a session's picture."""
    camera, attitude = expected_camera(session), expected_attitude(session)
    without_sky = session.is_without_sky
    readout = None if without_sky else sky_readout(camera, attitude).as_page_values()
    grid = SkyGrid([], [], []) if without_sky else sky_grid(camera, attitude)
    stars, bodies = star_marks(session), body_marks(session)
    shape = session.context.picture.image_dn.shape
    kinds = ("predicted", "missing", "used", "rejected")
    places = np.stack([stars.labels["pixel"], stars.labels["line"]], axis=1)
    columns = {kind: {axis: getattr(stars, kind)[axis] for axis in ("pixel", "line")} for kind in kinds}
    columns |= {
        "star_labels": label_columns(places, stars.labels["text"], (9.0, -5.0), shape[::-1]),
        "facts": star_facts(session),
        "grid": lines_columns(grid.lines_px),
        "grid_labels": label_columns(grid.places_px, grid.labels, (3.0, -3.0)),
    }
    return Overlays(
        columns=columns | _body_columns(bodies, shape),
        vectors=stars.vectors,
        camera=json.dumps(readout),
        compass=json.dumps(compass_arrows(session)),
        bodies=json.dumps([mark.as_page_values() for mark in bodies]),
        body_names=tuple(mark.name for mark in bodies),
    )


def _body_columns(marks: Sequence[BodyMarks], shape: tuple[int, ...]) -> dict[str, Columns]:
    points = np.array([mark.center_px for mark in marks if not len(mark.predicted_limb_px)]).reshape(-1, 2)
    return {
        "body_predicted": lines_columns([mark.predicted_limb_px for mark in marks]),
        "body": lines_columns([mark.limb_px for mark in marks]),
        "terminator": lines_columns([mark.terminator_px for mark in marks]),
        "pole": lines_columns([mark.pole_px for mark in marks]),
        "body_point": {"pixel": points[:, 0], "line": points[:, 1]},
        "body_labels": body_label_columns(marks, shape),
    }


class ImageView:
    """A picture that shows a session; see `viewer.Viewer` for what the workbench asks of it.

    Parameters
    ----------
    status
        Where failures are told; default a line below the picture.
    theme : {"standard", "CAVIAR"}

    Examples
    --------
    ::

        view = ImageView(session)
        view.on_click(lambda pixel, line: print(pixel, line))
        view                                  # as a cell's value
    """

    actions = VIEW_ACTIONS

    def __init__(
        self, session: ImageSession | None = None, *, status: Status | None = None, theme: str = DEFAULT_THEME
    ) -> None:
        self.session: ImageSession | None = None
        self.state: Any = ViewState(name="opnav-state", groups=list(SHOWN_AT_FIRST), theme=theme)
        self.models = PictureModels()
        self.models.use_theme(theme)
        self._vectors: Mapping[str, Any] = {}
        self._own_scale = 0.0  # of residual vectors, as long as the analyst takes no other
        self._prepared: WeakKeyDictionary[ImageSession, PreparedPicture] = WeakKeyDictionary()
        self._layers: dict[str, Layer] = {}
        self._overlays: Recent[Overlays] = Recent()
        self.bridge = Bridge(
            *self.models.roots, self.state, picture=self.picture, status=status, parts=("bokeh",)
        )
        self.images = PictureSet(self.bridge, self.state)
        self._listen_to_page()
        for action in VIEW_ACTIONS:
            for key in action.keys:
                self.bridge.bind_key(key, page=action.name)
        self.bridge.bind_key("Escape", page="put_away")
        if session is None:
            self.blank("no image")
        else:
            self.show(session)

    def _listen_to_page(self) -> None:
        reactions: dict[str, Callable[[Any], object]] = {
            "image": self.images.make,
            "theme": self.models.use_theme,
            "partner": lambda _: self._make_partner(),
            "compare": lambda _: self._make_partner(),
            "lock": lambda _: self._lay_anew(),
        }
        for name, react in reactions.items():
            self.state.on_change(name, self.bridge.guarded(_on_new_value(react)))
        self.bridge.on_event("aperture", self._measure)

    @property
    def widget(self) -> Any:
        """The notebook widget."""
        return self.bridge.widget

    def _repr_mimebundle_(self, **kwargs: Any) -> Any:
        return self.bridge._repr_mimebundle_(**kwargs)

    def picture(self) -> bytes:
        """Return the picture as a small PNG, for front ends without a live kernel."""
        if self.session is None:
            return picture_png(np.zeros((EMPTY_SIZE, EMPTY_SIZE)), 0.0, 1.0)
        low, high = self.images.limits(DEFAULT_LIMITS)
        return picture_png(self.session.context.picture.image_dn, low, high)

    @property
    def lock(self) -> threading.RLock:
        """Held while the picture is changed, and while a click or a drag is answered."""
        return self.bridge.lock

    def batch(self) -> AbstractContextManager[None]:
        """Let the changes of the block reach the pages together."""
        return self.bridge.batch()

    # -- what is shown -----------------------------------------------------------------------------------------

    def show(self, session: ImageSession) -> None:
        """Show a session: its pixels, and everything that it knows."""
        self.prepare(session)
        ready = self._prepared[session]
        with self.bridge.batch():
            self.session = session
            self._begin_anew(session.context.picture.image_dn.shape)
            self.state.title = session.context.picture.path.stem
            self.images.put_prepared(DATA_KEY, ready.sent, "image", ready.limits)
            self.models.fill("bad", ready.bad)
            self.models.fill("saturated", ready.saturated)
            self.provide("model", "model", lambda: modeled_picture(session), same_limits=True)
            self.provide("difference", "image − model", lambda: difference_picture(session))
            self.refresh()

    def prepare(self, session: ImageSession) -> None:
        """Do ahead what showing a session costs; may be called in another thread."""
        if session not in self._prepared:
            self._prepared[session] = prepared_picture(session, self.bridge.arrays)

    def send_ahead(self, sessions: Sequence[ImageSession]) -> None:
        """Let the pages ask for other sessions' pixels too, once they have what is shown; as many as `AHEAD_BYTES` hold."""
        ready = [self._prepared[one].sent for one in sessions if one in self._prepared]
        held = itertools.accumulate(sent.n_bytes for sent in ready)
        ahead = [sent.as_page_values() for sent, n in zip(ready, held, strict=True) if n <= AHEAD_BYTES]
        self.state.ahead = json.dumps(ahead)

    def blank(self, message: str = "") -> None:
        """Show no picture but a message in its place."""
        with self.bridge.batch():
            self.session = None
            self._begin_anew((EMPTY_SIZE, EMPTY_SIZE))
            self.set_image(DATA_KEY, np.zeros((EMPTY_SIZE, EMPTY_SIZE)), label="no image")
            for name, source in self.models.sources.items():
                self.models.fill(name, {column: [] for column in source.data})
            self.state.update(message=message, camera="null", bodies="[]", body="", compass="[]")

    def _begin_anew(self, shape: tuple[int, ...]) -> None:
        """Forget the picture before, its tools' drawings, and how it alone was looked at."""
        self.images.forget()
        self._begin(shape)
        self._layers.clear()
        self.layer("", Layer())
        self.circle(None)
        self.focus(None)
        manual = {"limits": DEFAULT_LIMITS} if self.state.limits == "manual" else {}
        self.state.update(message="", contrast=1.0, bias=0.5, partner="", aperture="null", **manual)
        self._vectors, self._own_scale = {}, 0.0
        self.state.vector_scale = 0.0  # chosen anew

    def _begin(self, shape: tuple[int, ...]) -> None:
        n_line, n_pixel = shape
        strip = n_pixel > STRIP_ASPECT * n_line
        if strip != json.loads(self.state.setup).get("strip", strip):
            self.bridge.redraw()  # its page is laid out otherwise
        self.state.setup = json.dumps({"size": [n_pixel, n_line], "strip": strip} | page_setup())
        self._look_at_all(n_pixel, n_line)

    def _look_at_all(self, n_pixel: int, n_line: int) -> None:
        """Show the whole image, of a strip all lines; a page of another shape adds or drops lines."""
        strip = n_pixel > STRIP_ASPECT * n_line
        width = STRIP_MARGIN * STRIP_SHAPE * n_line if strip else max(n_pixel, n_line)
        height = width / STRIP_SHAPE if strip else width
        x, y = 0.5 * n_pixel - 0.5, 0.5 * n_line - 0.5
        self.models.x_range.update(start=x - 0.5 * width, end=x + 0.5 * width)
        self.models.y_range.update(start=y + 0.5 * height, end=y - 0.5 * height)

    def refresh(self) -> None:
        """Bring the overlays to the session's present state; the pixels are not sent again."""
        session = self.session
        if session is None:
            return
        with self.bridge.batch():
            known = session.inputs, session.state
            drawn = self._overlays.of(known, lambda: overlays_of(session))
            self.state.camera, self.state.compass, self.state.bodies = (
                drawn.camera,
                drawn.compass,
                drawn.bodies,
            )
            for name, columns in drawn.columns.items():
                self.models.fill(name, columns)
            if self.state.body not in drawn.body_names:
                self.state.body = next(iter(drawn.body_names), "")
            self._vectors = drawn.vectors
            self._draw_vectors()
            self.images.outdate()

    def _draw_vectors(self) -> None:
        if not len(self._vectors) or self.session is None:
            return
        if (
            self.state.vector_scale == self._own_scale
        ):  # a round one that suits, until the analyst takes another
            shape = self.session.context.picture.image_dn.shape
            self._own_scale = _vector_scale(self._vectors, shape)
            self.state.vector_scale = self._own_scale
        self.models.fill("vectors", dict(self._vectors))

    # -- pictures to blink between -----------------------------------------------------------------------------

    def set_image(
        self,
        key: str,
        image_dn: ArrayLike,
        *,
        label: str = "",
        usable: BoolArray | None = None,
        same_limits: bool = False,
    ) -> None:
        """Add or replace a picture of the image's size.

        Parameters
        ----------
        image_dn : (n_line, n_pixel) array
        label
            What the menu calls it; default the key.
        usable : (n_line, n_pixel) array of bool, optional
            Pixels that choose the limits.
        same_limits
            Use the limits of the image itself, so that blinking shows what differs.
        """
        self.images.put(key, image_dn, label, usable, same_limits)

    def provide(
        self, key: str, label: str, make: Callable[[], FloatArray], *, same_limits: bool = False
    ) -> None:
        """Offer a picture that is made when the analyst first asks for it."""
        self.images.offer(key, label, make, same_limits)

    def compare_with(self, others: Sequence[tuple[str, ImageSession]]) -> None:
        """Offer other images to be laid over this one, each under its name; they replace those offered before."""
        with self.bridge.batch():
            self.images.withdraw(OTHER)
            for number, (name, other) in enumerate(others):
                self.provide(f"{OTHER}{number}:{name}", name, lambda o=other: self._laid_over(o))  # type: ignore[misc]
            self._make_partner()

    def _laid_over(self, other: ImageSession) -> FloatArray:
        assert self.session is not None
        return laid_over(other, self.session, self.state.lock)

    def _lay_anew(self) -> None:
        self.images.outdate(OTHER)
        self._make_partner()

    def _make_partner(self) -> None:
        """Make the picture that is compared with, where one is."""
        if self.state.compare:
            self.images.make(self.state.partner)

    def _measure(self, key: str, pixel: float, line: float, radius_px: float) -> None:
        """Measure an aperture of the picture that the page shows, and tell the page."""
        picture = None if self.session is None else self.session.context.picture
        image = self.images.pixels(key)
        usable = np.ones(image.shape, bool) if picture is None else ~(picture.bad | picture.saturated)
        try:
            found = measure_aperture(image, usable, (pixel, line), radius_px).as_page_values()
        except OpNavError as error:
            found = {"message": str(error)}
        self.state.aperture = json.dumps(found)

    # -- what the tools draw -----------------------------------------------------------------------------------

    def layer(self, name: str, layer: Layer) -> None:
        """Draw a tool's lines and labels, replacing what it had drawn."""
        self._layers[name] = layer
        segments, labels = layer_columns(self._layers.values(), THEMES[self.state.theme])
        with self.bridge.batch():
            self.models.fill("segments", segments)
            self.models.fill("tool_labels", labels)

    def circle(self, center_px: ArrayLike | None, radius_px: float = 0.0) -> None:
        """Draw the analyst's circle; None takes it away."""
        self.models.fill("circle", ring_columns(center_px, radius_px))

    def focus(self, place_px: ArrayLike | None, radius_px: float = 0.0) -> None:
        """Ring the object under decision, and bring it into view; None takes the ring away."""
        with self.bridge.batch():
            self.models.fill("focus", ring_columns(place_px, radius_px))
            if place_px is not None:
                self._bring_into_view(np.asarray(place_px, float))

    def look(self, place_px: ArrayLike, span_px: float | None = None, *, unless_seen: bool = False) -> None:
        """Bring a place into the middle, with a span so many pixels across; without one a whole picture stays as it is.

        With `unless_seen` nothing is moved where the place is in sight.
        """
        if self.session is None or (unless_seen and self._is_seen(np.asarray(place_px, float))):
            return
        n_line, n_pixel = self.session.context.picture.image_dn.shape
        now = abs(self.models.x_range.end - self.models.x_range.start)
        width = now if span_px is None else min(float(span_px), max(n_pixel, n_line))
        if width >= max(n_pixel, n_line):
            if span_px is not None:
                self._look_at_all(n_pixel, n_line)
            return
        x, y = (  # no more beside the picture than there must be
            np.clip(at, min(0.5 * (width - 1.0), 0.5 * n), max(n - 0.5 * (width + 1.0), 0.5 * n))
            for at, n in zip(np.asarray(place_px, float), (n_pixel, n_line), strict=True)
        )
        height = width * abs((self.models.y_range.end - self.models.y_range.start) / now)
        with self.bridge.batch():
            self.models.x_range.update(start=x - 0.5 * width, end=x + 0.5 * width)
            self.models.y_range.update(start=y + 0.5 * height, end=y - 0.5 * height)

    def _is_seen(self, place: FloatArray) -> bool:
        sides = zip(place, (self.models.x_range, self.models.y_range), strict=True)
        return all(min(side.start, side.end) <= at <= max(side.start, side.end) for at, side in sides)

    def _bring_into_view(self, place: FloatArray) -> None:
        for at, view in zip(place, (self.models.x_range, self.models.y_range), strict=True):
            low, high = sorted((view.start, view.end))
            if not low <= at <= high:
                shift = at - 0.5 * (low + high)
                view.start, view.end = view.start + shift, view.end + shift

    # -- what the analyst does ---------------------------------------------------------------------------------

    def do(self, name: str) -> str:
        """Carry out one of `actions` in the page that was used last; return what to say."""
        self.bridge.do(name)
        return ""

    def drag_mode(self, on: bool, shape: str = "box") -> None:
        """Let a left drag draw a `shape` (box, circle or line) and report its ends (on), or move the picture (off)."""
        self.state.drag = shape if on else ""

    def on_click(self, callback: Callable[[float, float], object]) -> None:
        """Call ``callback(pixel, line)`` at each click."""
        self.bridge.on_event("tap", callback)

    def on_drag(self, callback: Callable[[float, float, float, float], object]) -> None:
        """Call ``callback(pixel0, line0, pixel1, line1)`` at the end of each drag in drag mode."""
        self.bridge.on_event("drag", callback)

    def listen(
        self,
        tapped: Callable[[float, float], None],
        dragged: Callable[[float, float, float, float], None],
    ) -> None:
        """Report clicks and drags; see `on_click` and `on_drag`."""
        self.on_click(tapped)
        self.on_drag(dragged)


def _on_new_value(react: Callable[[Any], object]) -> Callable[[str, Any, Any], None]:
    """Return what bokeh calls (its three names count) for what needs the new value alone."""

    def changed(attr: str, old: Any, new: Any) -> None:  # noqa: ARG001
        react(new)

    return changed


def _vector_scale(vectors: Mapping[str, Any], shape: tuple[int, ...]) -> float:
    """A round number that makes the longest vector a good part of the picture."""
    longest = float(np.hypot(vectors["d_pixel"], vectors["d_line"]).max(initial=0.0))
    return round_scale(LONGEST_VECTOR * min(shape) / longest) if longest > 0.0 else 1.0
