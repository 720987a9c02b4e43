"""The part of `ImageSession` that deals with files: autosave, save, resume, CK."""

import uuid
from functools import partial
from pathlib import Path
from typing import Any, Self

from opnav_workbench.catalog import Catalog
from opnav_workbench.errors import SessionError
from opnav_workbench.files import sha256_of, write_json
from opnav_workbench.mission import Mission
from opnav_workbench.session import storage
from opnav_workbench.session.autosave import Autosave
from opnav_workbench.session.context import Context
from opnav_workbench.session.core import SessionCore
from opnav_workbench.session.decisions import Decisions, load_decisions, write_decisions
from opnav_workbench.session.folder_lock import check_unlocked
from opnav_workbench.session.gather import InputSource
from opnav_workbench.session.journal_file import JOURNAL_FILE
from opnav_workbench.session.loading import StoredSession, load_session, stored_session
from opnav_workbench.session.reconstruction import Reconstruction, write_reconstructed_ck
from opnav_workbench.session.result import result_dict
from opnav_workbench.session.snapshot import read_state
from opnav_workbench.session.state import Inputs

__all__ = ["FileMethods"]

ID_DIGITS = 16


class FileMethods(SessionCore):
    """Saving and resuming.

    Attributes
    ----------
    id : str
        Names this session in its files.
    resume_note : str
        What `resume` had to leave out, such as a line that a crash cut short; empty as a rule.
    """

    def __init__(
        self, context: Context, source: InputSource, inputs: Inputs, catalog: Catalog | None = None
    ) -> None:
        super().__init__(context, source, inputs, catalog)
        self.id = uuid.uuid4().hex[:ID_DIGITS]
        self.resume_note = ""

    @property
    def folder(self) -> Path | None:
        """Where every step is saved; None without autosave."""
        return None if self._autosave is None else self._autosave.folder

    def autosave(self, folder: str | Path | None) -> None:
        """From now on have every step on disk when its method returns: ``session.json`` and ``journal.jsonl``.

        Parameters
        ----------
        folder : path or None
            None: no longer.

        Raises
        ------
        SessionError
            The folder cannot be written, another process writes into it, or it holds another session or newer steps of
            this one (resume it instead).
        """
        with self.lock:
            if self._autosave is not None:
                self._autosave.close()
                self._autosave = None
            if folder is not None:
                self._autosave = self._started(Autosave(Path(folder), self.id, self.context.frame.sha256))

    def _started(self, writer: Autosave) -> Autosave:
        try:
            stored = stored_session(writer.folder)
            if stored is None or (stored.sha256 == self.context.frame.sha256 and not stored.journal):
                write_json(writer.folder / storage.SESSION_FILE, self._dict())
                writer.start(self._history, len(self.journal), 0)
            else:
                self._check_mine(stored, writer.folder)
                writer.start(self._history, len(stored.journal), stored.tail_bytes)
                writer.follow(self._history)
        except BaseException:
            writer.close()
            raise
        return writer

    def _check_mine(self, stored: StoredSession, folder: Path) -> None:
        """Refuse a folder whose session is not this one, or knows more."""
        count = len(stored.journal)
        if stored.session == self.id and stored.journal == self.journal[:count]:
            return
        what = "newer steps of this session" if stored.session == self.id else "another session"
        raise SessionError(
            f"{folder} holds {what} ({count} entries in its journal); continue it with ImageSession.resume, or choose "
            "another folder."
        )

    def _dict(self) -> dict[str, Any]:
        return storage.session_dict(self.context, self.source, self.inputs, self.journal, self.id)

    def save(self, folder: str | Path) -> Path:
        """Write ``result.json``, ``observables.ecsv`` and ``session.json`` into `folder`, and return it.

        Raises
        ------
        SessionError
            The folder cannot be written, or another process writes into it; older files in it are unchanged.
        """
        target = Path(folder)
        with self.lock:
            own = self._autosave is not None and target.resolve() == self._autosave.folder
            if not own:
                check_unlocked(target)
            result = result_dict(self.context, self.source, self.inputs, self.state)
            storage.write_session(target, result, self.state.observables, self._dict())
            if own:
                assert self._autosave is not None
                self._autosave.start(self._history, len(self.journal), 0)
            else:
                (target / JOURNAL_FILE).unlink(missing_ok=True)  # session.json holds the whole journal
        return target

    def write_decisions(self, path: str | Path, who: str = "") -> Path:
        """Write the decisions of this session as a file that headless runs carry out; return its path.

        Decisions on other pictures that the file holds stay there.

        Parameters
        ----------
        path : path
        who : str
            The analyst.

        Raises
        ------
        SessionError
            The file cannot be written, or what is there is no decisions file.
        """
        older = [load_decisions(path)] if Path(path).exists() else []
        return write_decisions(path, [*older, Decisions.from_session(self, who)])  # type: ignore[arg-type]

    def write_ck(self, path: str | Path, *, without_twist: bool = False) -> Reconstruction:
        """Write the solved pointing as a CK; see `opnav_workbench.session.reconstruction`.

        Raises
        ------
        SessionError, KernelError
            No pointing is solved yet; or LSK and SCLK are not open.
        """
        result = result_dict(self.context, self.source, self.inputs, self.state)
        return write_reconstructed_ck([result], path, self.context.mission, without_twist=without_twist)

    @classmethod
    def resume(cls, folder: str | Path, image: str | Path | None = None) -> Self:
        """Continue a saved session: the steps that stand are taken again on the picture; kernels are not needed.

        Parameters
        ----------
        folder : path that `save` or `autosave` wrote
        image : path, optional
            Where the picture is now, if it has moved.

        Raises
        ------
        SessionError
            No readable ``session.json``, or the picture is missing or another one (SHA-256 differs).
        """
        saved = load_session(Path(folder), image)
        session = cls(saved.context, saved.source, saved.inputs)
        session.id = saved.session or session.id
        kept = partial(read_state, Path(folder), saved.context.frame.sha256)
        session._history.load(saved.journal, storage.SESSION_FILE, kept)
        session.resume_note = saved.tail.note
        return session

    @classmethod
    def open_or_resume(
        cls, folder: str | Path, path: str | Path, mission: str | Path | Mission, **options: Any
    ) -> Self:
        """Continue the session of a picture that `folder` holds, else open the picture; autosave there in both cases.

        Parameters
        ----------
        folder : path
        path, mission, **options
            As `open` takes them; options of a session that is continued stay as they were.

        Raises
        ------
        SessionError
            The folder holds a session of another picture, or another process writes into it.
        """
        stored = stored_session(Path(folder))
        if stored is None:
            session: Self = cls.open(path, mission, **options)  # type: ignore[attr-defined]
        elif stored.sha256 != sha256_of(path):
            raise SessionError(
                f"{folder} holds the session of another picture than {path}; choose another folder."
            )
        else:
            session = cls.resume(folder, image=path)
        session.autosave(folder)
        return session
