"""The list of images: where each stands, opened when its turn comes, resumed where it was left.

A list is made of open sessions, of picture files, or of folders of saved sessions; with a folder each decision is on disk
when it is shown.
"""

import threading
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
from opnav_workbench.workbench.status_line import plain_words

__all__ = ["ImageQueue", "QueueItem"]

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
    """

    name: str
    open: Callable[[], ImageSession]
    folder: Path | None = None
    session: ImageSession | None = None
    error: str = ""
    opening: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def status(self) -> str:
        """Where it stands; one of `PROGRESS_WORDS`."""
        if self.error:
            return "failed"
        if self.session is None and self.opening.locked():
            return "opening"
        return "new" if self.session is None else session_progress(self.session)

    @property
    def status_sign(self) -> str:
        """The sign of where it stands."""
        return PROGRESS_SIGNS[self.status]

    @property
    def status_words(self) -> str:
        """Where it stands, in words."""
        return PROGRESS_WORDS[self.status]


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
                item.session, item.error = session, ""
            return item.session

    def next_to_open(self) -> QueueItem | None:
        """Return the neighbor of the image at hand that is to be opened ahead: the next one, then the one before."""
        near = (self.index + 1, self.index - 1)
        neighbors = [self.items[number] for number in near if 0 <= number < len(self.items)]
        return next((item for item in neighbors if item.status == "new"), None)

    def go(self, index: int) -> None:
        """Take another image; beyond the ends it stays."""
        self.index = min(max(index, 0), len(self.items) - 1)

    def sessions(self) -> Iterator[ImageSession]:
        """Open one image after the other; the one at hand stays the same."""
        for item in self.items:
            yield self.open(item)

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
            items.append(QueueItem(path.name, opener(path, folder), folder))
        return cls(items)

    @classmethod
    def of_folders(cls, folders: Iterable[str | Path]) -> "ImageQueue":
        """Make a list of sessions that were saved, each in its folder; they go on there."""

        def opener(folder: Path) -> Callable[[], ImageSession]:
            return lambda: ImageSession.resume(folder)

        return cls([QueueItem(Path(f).name, opener(Path(f)), Path(f)) for f in folders])


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
