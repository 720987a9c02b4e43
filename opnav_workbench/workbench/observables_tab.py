"""The tab of the observables: what orbit determination gets, the export, the notes, and the journal."""

import getpass
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from opnav_workbench.errors import SessionError
from opnav_workbench.files import make_folder
from opnav_workbench.observables import Observable
from opnav_workbench.report import write_summary
from opnav_workbench.session import ImageSession, JournalEntry
from opnav_workbench.workbench.actions import ActionRegistry
from opnav_workbench.workbench.markup import text
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
        session.observables()
    session.save(folder)
    session.write_decisions(folder / DECISIONS_FILE, who=_user())
    write_summary(session, folder / FIGURE_FILE)
    return sorted(path.name for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # no name in the environment nor in the user list
        return ""


class ObservablesTab(Tab):
    """The tab of the observables."""

    name = "observables"

    def __init__(self, bench: StepRunner, registry: ActionRegistry, out: Path | None) -> None:
        super().__init__(bench, registry)
        self.out = out
        self.exported: dict[str, tuple[str, ...]] = {}  # files written, by image

    def handlers(self) -> dict[str, Handler]:
        """Return what it does, by action name."""
        return {
            "export": lambda _: self.export(),
            "note": lambda _: self._ask_note(),
            "note_text": self._note,
        }

    def export(self) -> None:
        """Write all files of this image."""
        folder = self.bench.queue.item.folder or self.out
        if folder is None:
            raise SessionError("there is no folder to export into: workbench(..., out=FOLDER).")
        session, name = self.bench.session, self.bench.queue.item.name

        def work() -> None:
            self.bench.examined()
            self.exported[name] = tuple(export_session(session, folder))

        self.bench.run("exporting", work, lambda: f"{len(self.exported[name])} files written into {folder}.")

    def _ask_note(self) -> None:
        self.bench.menu = "" if self.bench.menu == "note" else "note"

    def _note(self, event: PageEvent) -> None:
        words = str(event["value"]).strip()
        self.bench.menu = ""
        if words:
            self.bench.run("noting", lambda: self.bench.session.note(words), "note written.")

    def html(self) -> str:
        """Return the page."""
        session = self.bench.session
        files = "".join(
            f"<li>{text(name)}</li>" for name in self.exported.get(self.bench.queue.item.name, ())
        )
        folder = self.bench.queue.item.folder or self.out
        where = f'<p class="hint">into {text(folder)}</p>' if folder is not None else ""
        listed = f'<ul class="files">{files}</ul>' if files else ""
        messages = "".join(f'<p class="hint">{text(message)}</p>' for message in session.state.messages)
        notes = "".join(f"<li>{text(note)}</li>" for note in session.state.user_notes)
        return (
            f'<div class="page observables"><div class="tools">{self.button("export")}{self.button("note")}</div>'
            f"{where}{listed}"
            f"{_table(session.state.observables)}{messages}{f'<h4>Notes</h4><ul>{notes}</ul>' if notes else ''}"
            f"<h4>Journal</h4>{_journal(session.journal)}</div>"
        )


def _table(observables: Sequence[Observable]) -> str:
    if not observables:
        return '<p class="hint">No observable yet: find a body first.</p>'
    rows = "".join(_row(o) for o in observables)
    return (
        "<table><thead><tr><th>body</th><th>status</th><th>O pixel, line</th><th>O − C, px</th><th>sigma, px</th>"
        f"<th>O − C, arcsec</th></tr></thead><tbody>{rows}</tbody></table>"
    )


def _row(o: Observable) -> str:
    head = f'<td title="{text(o.method)}">{text(o.name)}</td><td>{text(o.status.replace("_", " "))}</td>'
    if o.observed_px is None or o.residual_px is None:
        return f'<tr>{head}<td colspan="4">{text("; ".join(o.messages))}</td></tr>'
    sigma = np.sqrt(np.diag(o.total_covariance_px2))
    arcsec = "" if o.residual_arcsec is None else f"{o.residual_arcsec[0]:+.3f}, {o.residual_arcsec[1]:+.3f}"
    return (
        f"<tr>{head}<td>{o.observed_px[0]:.3f}, {o.observed_px[1]:.3f}</td>"
        f"<td>{o.residual_px[0]:+.3f}, {o.residual_px[1]:+.3f}</td>"
        f"<td>{sigma[0]:.3f}, {sigma[1]:.3f}</td><td>{arcsec}</td></tr>"
    )


def _journal(journal: Sequence[JournalEntry]) -> str:
    rows = "".join(
        f"<tr><td>{text(entry.time_utc[11:19])}</td><td>{text(entry.step.replace('_', ' '))}</td>"
        f"<td>{text(entry.outcome)}{f' ({text(entry.reason)})' if entry.reason else ''}</td></tr>"
        for entry in reversed(journal[-LISTED_ENTRIES:])
    )
    more = (
        f'<p class="hint">{len(journal) - LISTED_ENTRIES} earlier entries</p>'
        if len(journal) > LISTED_ENTRIES
        else ""
    )
    return f'<table class="journal"><tbody>{rows}</tbody></table>{more}'
