"""Picture planning: what pictures will show, how well they will tell where the target is, and which are worth taking.

sequence, sequence_parts   YAML files that say what is to be photographed
desk                       mission, catalog and surfaces opened once; pointing of each picture
light                      the expected picture: what the simulation draws, without noise, and its variance
stars, attitude            usable stars, and the attitude's expected error
bodies, company            the targets' expected errors; other bodies that enter the field
verdict, picture, plan     good, marginal or bad, and why; one picture, all of them
approach, exposure         first detection of a target; the exposure that tells most
depth                      how deep the catalog goes
table, confirm             tables and files; pictures simulated to confirm a plan
"""

from opnav_workbench.planning.approach import Approach, Detection, search_approach
from opnav_workbench.planning.attitude import PointingPlan, plan_pointing
from opnav_workbench.planning.bodies import TargetPlan, plan_target
from opnav_workbench.planning.company import Visitor
from opnav_workbench.planning.confirm import confirming_inputs
from opnav_workbench.planning.desk import Desk
from opnav_workbench.planning.exposure import BestExposure, best_exposure
from opnav_workbench.planning.light import ExpectedLight, expected_light
from opnav_workbench.planning.picture import PicturePlan, Prospect, plan_picture
from opnav_workbench.planning.plan import Plan, opened, plan_sequence
from opnav_workbench.planning.sequence import PictureSequence, load_sequence, sequence_names
from opnav_workbench.planning.sequence_parts import ApproachSearch, Limits, PlannedPicture, Pointing, SunRule
from opnav_workbench.planning.stars import StarPlan, plan_stars
from opnav_workbench.planning.table import catalog_words, plan_document, plan_table, write_plan
from opnav_workbench.planning.verdict import Verdict

__all__ = [
    "Approach",
    "ApproachSearch",
    "BestExposure",
    "Desk",
    "Detection",
    "ExpectedLight",
    "Limits",
    "PicturePlan",
    "PictureSequence",
    "Plan",
    "PlannedPicture",
    "Pointing",
    "PointingPlan",
    "Prospect",
    "StarPlan",
    "SunRule",
    "TargetPlan",
    "Verdict",
    "Visitor",
    "best_exposure",
    "catalog_words",
    "confirming_inputs",
    "expected_light",
    "load_sequence",
    "opened",
    "plan_document",
    "plan_picture",
    "plan_pointing",
    "plan_sequence",
    "plan_stars",
    "plan_table",
    "plan_target",
    "search_approach",
    "sequence_names",
    "write_plan",
]
