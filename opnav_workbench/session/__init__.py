"""ImageSession: the stateful way through one picture, with its journal, its files and its undo."""

from opnav_workbench.session.context import Context
from opnav_workbench.session.gather import ATTITUDE_SOURCES
from opnav_workbench.session.journal import JournalEntry
from opnav_workbench.session.session import RESULT_FILE, ImageSession
from opnav_workbench.session.settings import Settings
from opnav_workbench.session.state import MEASURED_STATUSES, SessionState, StarStatus

__all__ = [
    "ATTITUDE_SOURCES",
    "MEASURED_STATUSES",
    "RESULT_FILE",
    "Context",
    "ImageSession",
    "JournalEntry",
    "SessionState",
    "Settings",
    "StarStatus",
]
