"""What runs without a person: the automatic policy for one picture, and recorded decisions."""

from opnav_workbench.headless.decisions import Decisions, load_decisions
from opnav_workbench.headless.policy import Outcome, Policy, process_image

__all__ = ["Decisions", "Outcome", "Policy", "load_decisions", "process_image"]
