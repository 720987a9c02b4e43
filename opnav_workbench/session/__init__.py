"""ImageSession: the stateful way through one picture, with its journal, its files and its undo.

Enter by `ImageSession.open` or `ImageSession.resume`.  A method of `ImageSession` is one step: `history` calls the pure
function of that name, keeps the state it makes, and writes the journal.

``session``
    `ImageSession`: all public steps, and where the work of each is done.
``history``
    States and journal, undo and redo, the table of steps, the journal file.
``state``
    The frozen state, the analyst's decisions on its stars, and what is still to be decided.
``context``
    What stays the same through a session: picture, camera, background, noise.
``beside``
    Image support data beside a picture: attitude, states and body without kernels.
``inputs``
    What kernels, header, catalog and target lists gave.
``lost``
    The attitude from the stars alone, where header and kernels are silent or wrong.
``settings``
    Thresholds of a session.
``contradictions``
    What the header says against the kernels: clock, trajectory, attitude.
``orientation``
    How a picture lies against what was expected: turned by a quarter, mirrored, or far off.
``star_field``
    Which detection is which star: by pattern, by two marked stars, by hand.
``star_measurement``
    Star centers at expected places, and the status of each.
``star_steps``
    Steps with stars: predict, find, fit again, place, accept, reject.
``star_boxes``
    What a person looks at to confirm a star.
``pointing``
    Best known attitude, its solution from the stars, and the observables that rest on it.
``body_models``
    How the bodies of the scene look, and the picture that centerfinders take.
``body_steps``
    Steps with bodies: expect, circle, find, choose limb scans, observables.
``landmark_steps``
    Steps with landmarks: find, accept, reject; judged anew after a new pointing.
``decisions``
    Decisions of analysts as a YAML file: recorded, written, carried out.
``result``
    The layout of ``result.json``.
``mapping``
    Solved pictures as image support data of the Community Sensor Model.
``reconstruction``
    Solved pointings as a "reconstructed" CK.
``storage``
    ``session.json`` written and read.
``autosave``
    Every step on disk when its method returns; the kept state.
``folder_lock``
    One writer per session folder.
"""

from typing import TYPE_CHECKING

from opnav_workbench.lazy_names import names_on_demand

if TYPE_CHECKING:
    from opnav_workbench.session.context import Context
    from opnav_workbench.session.decisions import Decisions, load_decisions, write_decisions
    from opnav_workbench.session.history import JournalEntry
    from opnav_workbench.session.inputs import ATTITUDE_SOURCES
    from opnav_workbench.session.mapping import support_data_of_result
    from opnav_workbench.session.reconstruction import Reconstruction, write_reconstructed_ck
    from opnav_workbench.session.session import ImageSession
    from opnav_workbench.session.settings import Settings
    from opnav_workbench.session.star_boxes import StarBox
    from opnav_workbench.session.state import BODY_METHODS, MEASURED_STATUSES, SessionState, StarStatus
    from opnav_workbench.session.storage import RESULT_FILE, SESSION_FILE
else:  # loaded on first use: most calls need a few of these
    __getattr__ = names_on_demand(
        __name__,
        {
            "Context": "context",
            "Decisions": "decisions",
            "load_decisions": "decisions",
            "write_decisions": "decisions",
            "JournalEntry": "history",
            "ATTITUDE_SOURCES": "inputs",
            "support_data_of_result": "mapping",
            "Reconstruction": "reconstruction",
            "write_reconstructed_ck": "reconstruction",
            "ImageSession": "session",
            "Settings": "settings",
            "StarBox": "star_boxes",
            "BODY_METHODS": "state",
            "MEASURED_STATUSES": "state",
            "SessionState": "state",
            "StarStatus": "state",
            "RESULT_FILE": "storage",
            "SESSION_FILE": "storage",
        },
    )

__all__ = [
    "ATTITUDE_SOURCES",
    "BODY_METHODS",
    "MEASURED_STATUSES",
    "RESULT_FILE",
    "SESSION_FILE",
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
    "support_data_of_result",
    "write_decisions",
    "write_reconstructed_ck",
]
