"""ImageSession: the stateful way through one picture, with its journal, its files and its undo."""

from opnav_workbench.session.body_finding import BODY_METHODS
from opnav_workbench.session.context import Context
from opnav_workbench.session.decisions import Decisions, load_decisions, write_decisions
from opnav_workbench.session.gather import ATTITUDE_SOURCES
from opnav_workbench.session.journal import JournalEntry
from opnav_workbench.session.reconstruction import Reconstruction, write_reconstructed_ck
from opnav_workbench.session.session import ImageSession
from opnav_workbench.session.settings import Settings
from opnav_workbench.session.star_boxes import StarBox
from opnav_workbench.session.state import MEASURED_STATUSES, SessionState, StarStatus
from opnav_workbench.session.storage import RESULT_FILE

__all__ = [
    "ATTITUDE_SOURCES",
    "BODY_METHODS",
    "MEASURED_STATUSES",
    "RESULT_FILE",
    "Context",
    "Decisions",
    "ImageSession",
    "JournalEntry",
    "Reconstruction",
    "SessionState",
    "Settings",
    "StarBox",
    "StarStatus",
    "load_decisions",
    "write_decisions",
    "write_reconstructed_ck",
]
