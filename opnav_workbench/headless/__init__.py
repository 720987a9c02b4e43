"""What runs without a person: the automatic policy for one picture, and recorded decisions."""

from opnav_workbench.headless.decisions import Decisions, load_decisions, write_decisions
from opnav_workbench.headless.outcome import Outcome, process_image
from opnav_workbench.headless.picture_job import PictureJob, picture_job
from opnav_workbench.headless.policy import Policy, open_picture, run_policy

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
