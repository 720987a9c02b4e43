"""What runs without a person: pictures by the automatic policy, nights of many pictures, blind rehearsal runs.

Enter by `process_image` for one picture, `picture_job` in the notebook ``process_image.ipynb``, and `plan_night` and
`run_night` of ``night`` for many.

``policy``
    `Policy`: how pictures are processed.
``picture_job``
    The parameters of the processing notebook, checked.
``picture_run``
    One picture: the automatic steps, the farther search for bodies, the folder of results.
``star_frames``
    Star frames for a calibration: pictures solved one after the other.
``rehearsal_run``
    All pictures of a rehearsal package.
``night_spec``
    The YAML file of a night.
``night``
    A night planned, run, recorded and archived.
``night_workers``
    One process per picture with its limits; the pools of this machine and of a Dask cluster.
``night_summary``
    The morning's summary, page and queue.
``notebook_run``
    The program that executes one notebook; it imports nothing of this package.
"""

from opnav_workbench.headless.picture_job import PictureJob, picture_job
from opnav_workbench.headless.picture_run import Outcome, open_picture, process_image, run_policy
from opnav_workbench.headless.policy import Policy
from opnav_workbench.session.decisions import Decisions, load_decisions, write_decisions

__all__ = [
    "Decisions",
    "Outcome",
    "PictureJob",
    "Policy",
    "load_decisions",
    "open_picture",
    "picture_job",
    "process_image",
    "run_policy",
    "write_decisions",
]
