"""The list of images: where each stands, opened when its turn comes, resumed where it was left.

A list is made of open sessions, of picture files, or of folders of saved sessions; with a folder each decision is on disk
when it is shown. Those that were looked at longest ago are closed again once all that are open are large (`KEPT_PIXELS`),
where every step of theirs is on disk. What is listed is chosen by words and by status, and put in an order.
"""

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from opnav_workbench.errors import OpNavError, SelectionPending, SessionError
from opnav_workbench.files import inside
from opnav_workbench.image.picture_files import picture_files, picture_names
from opnav_workbench.kernels import KernelSet
from opnav_workbench.session import ImageSession
from opnav_workbench.session.storage import session_owner
from opnav_workbench.templating import png_url
from opnav_workbench.workbench.status_line import plain_words
from opnav_workbench.workbench.stretch import thumbnail_png

__all__ = ["KEPT_PIXELS", "ORDERS", "SHOWN", "ImageQueue", "QueueItem"]

# Sign and word of each status: neither color nor sign stands alone.
PROGRESS_SIGNS = {
    "new": "○",
    "opening": "◌",
    "open": "◔",
    "stars": "◑",
    "pointed": "◕",
    "done": "●",
    "failed": "✕",
}
PROGRESS_WORDS = {
    "new": "not opened",
    "opening": "being opened",
    "open": "opened",
    "stars": "stars found",
    "pointed": "pointing solved",
    "done": "observables ready",
    "failed": "cannot be opened",
}


def session_progress(session: ImageSession) -> str:
    """Return how far a session has come: ``open``, ``stars``, ``pointed`` or ``done``."""
    state = session.state
    if state.observables:
        return "done"
    if state.pointing is not None:
        return "pointed"
    return "open" if state.centers is None else "stars"


# Of all open images together: beyond, those looked at longest ago are closed. Two of 4096 x 4096, or 32 of 1024 x 1024;
# an open image holds some 40 bytes a pixel.
KEPT_PIXELS = 32 * 1024 * 1024
ORDERS = ("as given", "by name", "by status")
SHOWN = ("all", "to do", "done", "failed")


@dataclass(slots=True)
class QueueItem:
    """One image of the list.

    Attributes
    ----------
    open
        Opens or resumes its session.
    folder
        Where its decisions are saved at once; None: nowhere.
    error
        Why it could not be opened, in plain words; it is not tried again by itself.
    opening
        Held while it is being opened: by the analyst's wish, or ahead.
    reopens
        Whether `open` can be called again, so that it may be closed meanwhile.
    left
        Where it stood when it was closed; empty: it was not.
    left_doubts
        Which facts of its header contradicted each other when it was closed.
    thumbnail
        PNG of the picture, small, once it was open.
    seen_s
        When it was at hand last.
    """

    name: str
    open: Callable[[], ImageSession]
    folder: Path | None = None
    session: ImageSession | None = None
    error: str = ""
    opening: threading.Lock = field(default_factory=threading.Lock, repr=False)
    reopens: bool = False
    left: str = ""
    left_doubts: tuple[str, ...] = ()
    thumbnail: bytes = b""
    seen_s: float = 0.0

    @property
    def status(self) -> str:
        """Where it stands; one of `PROGRESS_WORDS`."""
        if self.error:
            return "failed"
        if self.session is None and self.opening.locked():
            return "opening"
        return self.left or "new" if self.session is None else session_progress(self.session)

    @property
    def thumbnail_url(self) -> str:
        """Data URL of the thumbnail; empty where there is none yet."""
        return png_url(self.thumbnail) if self.thumbnail else ""

    @property
    def n_pixel(self) -> int:
        """Pixels that it holds in memory."""
        return 0 if self.session is None else self.session.context.picture.image_dn.size

    def close(self) -> bool:
        """Let its session go, if it can be opened again as it is; False where it stays."""
        session = self.session
        if session is None or not (self.reopens and self.folder is not None and session.is_on_disk):
            return False
        self.left, self.left_doubts = session_progress(session), session.state.contradictions
        self.session = None
        session.autosave(None)
        return True

    @property
    def status_sign(self) -> str:
        """The sign of where it stands."""
        return PROGRESS_SIGNS[self.status]

    @property
    def status_words(self) -> str:
        """Where it stands, in words, and that its header contradicts itself or the kernels."""
        return PROGRESS_WORDS[self.status] + (", header contradicted" if self.doubts else "")

    @property
    def doubts(self) -> tuple[str, ...]:
        """Which facts of its header contradict each other or the kernels, once it was open."""
        return self.left_doubts if self.session is None else self.session.state.contradictions


class ImageQueue:
    """Images in order, one of them at hand.

    Raises
    ------
    SessionError
        There is none.
    """

    def __init__(self, items: Sequence[QueueItem]) -> None:
        if not items:
            raise SessionError("the workbench needs at least one image or session.")
        self.items = list(items)
        self.index = 0
        self.opening: Callable[[ImageSession], None] = lambda _: None  # told of every session that is opened
        self.words, self.shown_kind, self.order = "", SHOWN[0], ORDERS[0]

    @property
    def item(self) -> QueueItem:
        """The image at hand."""
        return self.items[self.index]

    @property
    def opened(self) -> ImageSession | None:
        """The session at hand, if it is open."""
        return self.item.session

    @property
    def session(self) -> ImageSession:
        """The session at hand, opened now if it was not.

        Raises
        ------
        OpNavError
            The image cannot be opened; the list shows it.
        """
        return self.open(self.item)

    def open(self, item: QueueItem) -> ImageSession:
        """Return an image's session, opened now if it was not; one thread opens it, others wait for that.

        Raises
        ------
        Exception
            The image cannot be opened; the list shows why.
        """
        with item.opening:
            if item.session is None:
                try:
                    session = item.open()
                    if item.folder is not None and session.folder is None:
                        session.autosave(item.folder)
                except Exception as error:
                    item.error = plain_words(error)
                    raise
                self.opening(session)
                item.thumbnail = item.thumbnail or thumbnail_png(session.context.picture.image_dn)
                item.session, item.error = session, ""
            item.seen_s = time.monotonic()
            return item.session

    def close_far(self) -> list[QueueItem]:
        """Close what was looked at longest ago, until the rest is no larger than `KEPT_PIXELS`; return what was closed.

        The image at hand and its neighbors stay open.
        """
        near = {id(self.items[number]) for number in (*self.neighbors(), self.index)}
        held = sum(item.n_pixel for item in self.items)
        closed = []
        for item in sorted(self.items, key=lambda one: one.seen_s):
            if held <= KEPT_PIXELS:
                break
            size = item.n_pixel
            if id(item) not in near and not item.opening.locked() and item.close():
                held -= size
                closed.append(item)
        return closed

    # -- what is listed, and in which order

    def listed(self) -> list[int]:
        """Return the numbers of the images that are listed, in the order asked for; the one at hand is always among them."""
        numbers = [
            number for number, item in enumerate(self.items) if self._is_listed(item) or number == self.index
        ]
        keys: dict[str, Callable[[int], Any]] = {
            "by name": lambda number: self.items[number].name.casefold(),
            "by status": lambda number: list(PROGRESS_WORDS).index(self.items[number].status),
        }
        return sorted(numbers, key=keys[self.order]) if self.order in keys else numbers

    def _is_listed(self, item: QueueItem) -> bool:
        kinds = {
            "done": ("done",),
            "failed": ("failed",),
            "to do": tuple({*PROGRESS_WORDS} - {"done", "failed"}),
        }
        text = f"{item.name} {item.status_words}".casefold()
        return (
            item.status in kinds.get(self.shown_kind, (item.status,))
            and self.words.strip().casefold() in text
        )

    def neighbors(self) -> list[int]:
        """Return the numbers of the next and of the previous image of those listed."""
        listed = self.listed()
        at = listed.index(self.index)
        return [listed[one] for one in (at + 1, at - 1) if 0 <= one < len(listed)]

    def step(self, step: int) -> int:
        """Return the number of the image so many places on in the list; at its ends the last one."""
        listed = self.listed()
        return listed[min(max(listed.index(self.index) + step, 0), len(listed) - 1)]

    def next_to_open(self) -> QueueItem | None:
        """Return the neighbor of the image at hand that is to be opened ahead: the next one, then the one before."""
        waiting = (self.items[number] for number in self.neighbors())
        return next(
            (i for i in waiting if i.session is None and not i.error and not i.opening.locked()), None
        )

    def go(self, index: int) -> None:
        """Take another image; beyond the ends it stays."""
        self.index = min(max(index, 0), len(self.items) - 1)

    def sessions(self) -> Iterator[ImageSession]:
        """Open one image after the other; the one at hand stays the same."""
        for item in self.items:
            yield self.open(item)
            self.close_far()

    def require(self, *needs: str) -> None:
        """Stop where a decision is still to be made in any of the images; see `ImageSession.require`.

        Raises
        ------
        SelectionPending
            One line: which image, and what is missing; also while one is still being opened.
        """
        opening = next((item.name for item in self.items if item.status == "opening"), "")
        if opening:
            raise SelectionPending(
                f"{opening} is being opened; what is to be decided in it is not known yet."
            )
        for session in self.sessions():
            try:
                session.require(*needs)
            except SelectionPending as error:
                raise SelectionPending(f"{session.context.picture.name}: {error}") from None

    @classmethod
    def of_sessions(cls, sessions: Iterable[ImageSession], out: str | Path | None = None) -> "ImageQueue":
        """Make a list of open sessions; with `out` each saves its decisions into ``OUT/<stem>`` from now on."""
        items = []
        for session in sessions:
            stem = session.context.picture.path.stem
            folder = session.folder or (None if out is None else inside(out, stem))
            item = QueueItem(session.context.picture.name, lambda s=session: s, folder)  # type: ignore[misc]
            items.append(item)
        return cls(items)

    @classmethod
    def of_images(
        cls,
        images: Iterable[str | Path],
        mission: Any,
        out: str | Path,
        *,
        folders: Sequence[str] = (),
        targets: Sequence[str] | None = None,
        predict: bool = True,
        **options: Any,
    ) -> "ImageQueue":
        """Make a list of picture files; each is resumed from its folder in `out` where it was worked on before.

        Parameters
        ----------
        images
            Pictures; a folder stands for all pictures in it.
        mission : str, path or Mission
        out
            Folder of the sessions' folders.
        folders
            Names of the sessions' folders, one a picture; left out: as `picture_names` gives them.
        targets
            Bodies expected in every picture; None: the mission's own, with kernels.
        predict
            Predict stars and targets when a picture is opened for the first time.
        **options
            As for `ImageSession.open`.

        Raises
        ------
        SessionError
            A picture is not there, two would share a folder, or a folder lies outside `out`.
        """

        def opener(path: Path, folder: Path) -> Callable[[], ImageSession]:
            def opened() -> ImageSession:
                session = ImageSession.open_or_resume(folder, path, mission, **options)
                if predict and not session.journal:
                    predict_scene(session, targets)
                return session

            return opened

        paths = picture_files(images)
        if folders and len(folders) != len(paths):
            raise SessionError(
                f"{len(folders)} folders were given for {len(paths)} pictures; give one each, or none."
            )
        items = []
        names = folders or picture_names(paths, lambda name: session_owner(inside(out, name))).values()
        for path, name in zip(paths, names, strict=True):
            folder = inside(out, name)
            items.append(QueueItem(path.name, opener(path, folder), folder, reopens=True))
        return cls(items)

    @classmethod
    def of_folders(cls, folders: Iterable[str | Path]) -> "ImageQueue":
        """Make a list of sessions that were saved, each in its folder; they go on there."""

        def opener(folder: Path) -> Callable[[], ImageSession]:
            return lambda: ImageSession.resume(folder)

        return cls([QueueItem(Path(f).name, opener(Path(f)), Path(f), reopens=True) for f in folders])


def predict_scene(session: ImageSession, targets: Sequence[str] | None = None) -> None:
    """Predict the stars and take the targets into the scene; a target that nothing is known of is left out, and said so.

    Parameters
    ----------
    targets
        None: the mission's own, where kernels are open.
    """
    session.predict()
    if targets is None:
        targets = session.context.mission.default_targets if KernelSet.active() is not None else ()
    for name in targets:
        try:
            session.add_target(name)
        except OpNavError as error:
            session.skip_target(name, str(error))
