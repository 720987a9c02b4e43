"""The tab of the observables: what orbit determination gets, the export, the notes, and the journal."""

import getpass
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from opnav_workbench import report  # loads what draws when it is asked to
from opnav_workbench.errors import SessionError
from opnav_workbench.files import make_folder
from opnav_workbench.observables import Observable
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench.actions import NOTE_MENU, ActionRegistry
from opnav_workbench.workbench.exports import write_fits_with_wcs, write_regions
from opnav_workbench.workbench.markup import render
from opnav_workbench.workbench.tabs import Handler, PageEvent, StepRunner, Tab

__all__ = ["ObservablesTab"]

FIGURE_FILE, DECISIONS_FILE = "summary.png", "decisions.yaml"
LISTED_ENTRIES = 14  # entries of the journal that are shown


def export_session(session: ImageSession, folder: Path) -> list[str]:
    """Write everything of a session into `folder`; return the names of the files.

    Raises
    ------
    SessionError
        The folder cannot be written.
    """
    make_folder(folder)
    if session.state.bodies:
        session.compute_observables()
    session.save(folder)
    session.write_decisions(folder / DECISIONS_FILE, who=_user())
    report.write_summary(session, folder / FIGURE_FILE)
    return sorted(path.name for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # no name in the environment nor in the user list
        return ""


class ObservablesTab(Tab):
    """The tab of the observables."""

    name = "observables"

    def __init__(self, runner: StepRunner, registry: ActionRegistry, out: Path | None) -> None:
        super().__init__(runner, registry)
        self.out = out
        self.exported: dict[str, tuple[str, ...]] = {}  # files written, by image
        self.whole_journal = False

    def handlers(self) -> dict[str, Handler]:
        """Return what it does, by action name."""
        return {
            "export": lambda _: self.export(),
            "note": lambda _: self._ask_note(),
            "note_text": self._note,
            "write_regions": lambda _: self._write("regions.reg", write_regions),
            "write_fits": lambda _: self._write("picture_wcs.fits", write_fits_with_wcs),
            "older_entries": lambda _: self._toggle_older(),
        }

    def export(self) -> None:
        """Write all files of this image."""
        folder = self._folder_or_raise()
        session, name = self.runner.session, self.runner.queue.item.name

        def work() -> None:
            self.runner.examined()
            self.exported[name] = tuple(export_session(session, folder))

        self.runner.run("exporting", work, lambda: f"{len(self.exported[name])} files written into {folder}.")

    def _write(self, name: str, write: Callable[[ImageSession, Path], Path]) -> None:
        """Write one file for other programs."""
        session, target = self.runner.session, self._folder_or_raise() / name
        self.runner.run(
            f"writing {name}", lambda: write(session, make_folder(target.parent) / name), f"{target} written."
        )

    def _folder_or_raise(self) -> Path:
        folder = self.runner.queue.item.folder or self.out
        if folder is None:
            raise SessionError("there is no folder to export into: workbench(..., out=FOLDER).")
        return folder

    def _toggle_older(self) -> None:
        self.whole_journal = not self.whole_journal

    def _ask_note(self) -> None:
        self.runner.menu = "" if self.runner.menu == NOTE_MENU else NOTE_MENU

    def _note(self, event: PageEvent) -> None:
        words = str(event["value"]).strip()
        self.runner.menu = ""
        if words:
            self.runner.run("noting", lambda: self.runner.session.note(words), "note written.")

    def html(self) -> str:
        """Return the page."""
        session, item = self.runner.session, self.runner.queue.item
        return render(
            "observables.html",
            actions=self.registry,
            folder=item.folder or self.out,
            files=self.exported.get(item.name, ()),
            rows=[observable_row(observable) for observable in session.current_observables],
            messages=session.state.messages,
            notes=session.state.user_notes,
            journal=list(reversed(session.journal[0 if self.whole_journal else -LISTED_ENTRIES :])),
            n_earlier=len(session.journal) - LISTED_ENTRIES,
            whole_journal=self.whole_journal,
        )


@dataclass(frozen=True, slots=True)
class ObservableRow:
    """A row of the table: O, O − C, sigma and O − C in arcsec as texts; none where nothing is observed, but a message."""

    name: str
    method: str
    status: str
    numbers: tuple[str, ...]
    message: str


def observable_row(o: Observable) -> ObservableRow:
    """Return an observable as a row of the table."""
    numbers: tuple[str, ...] = ()
    if o.observed_px is not None:
        sigma = np.sqrt(np.diag(o.total_covariance_px2))
        arcsec = (
            "" if o.residual_arcsec is None else f"{o.residual_arcsec[0]:+.3f}, {o.residual_arcsec[1]:+.3f}"
        )
        numbers = (
            f"{o.observed_px[0]:.3f}, {o.observed_px[1]:.3f}",
            "" if o.residual_px is None else f"{o.residual_px[0]:+.3f}, {o.residual_px[1]:+.3f}",
            f"{sigma[0]:.3f}, {sigma[1]:.3f}",
            arcsec,
        )
    return ObservableRow(o.name, o.method, o.status, numbers, "; ".join(o.messages))
