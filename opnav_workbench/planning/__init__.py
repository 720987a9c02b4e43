"""Picture planning: what pictures will show, how well they will tell where the target is, and which are worth taking.

Enter by `plan_sequence`, which plans the pictures of a sequence (`load_sequence`); `plan_picture` plans one of an
`OpenedSequence`; `write_plan` writes table and document.

``sequence``
    YAML files that say what is to be photographed.
``opened_sequence``
    Mission, catalog and surfaces opened once; what each picture is made of; inputs of pictures that confirm a plan.
``light``
    The expected picture: what the simulation draws, without noise, and its variance.
``stars``
    Usable stars and their bounds; how deep picture and catalog go.
``attitude``
    The attitude's expected error.
``bodies``
    The targets' expected errors; other bodies that enter the field.
``exposure``
    The exposure that tells most.
``approach``
    First detection of a target that comes nearer.
``picture``
    One picture: what is expected of it, and whether it is good.
``plan``
    A whole sequence planned.
``table``
    A plan as table and files.
"""

from opnav_workbench.planning.approach import Approach, Detection, search_approach
from opnav_workbench.planning.attitude import PointingPlan, plan_pointing
from opnav_workbench.planning.bodies import OtherBody, TargetPlan, plan_target
from opnav_workbench.planning.exposure import BestExposure, best_exposure
from opnav_workbench.planning.light import ExpectedLight, expected_light
from opnav_workbench.planning.opened_sequence import OpenedSequence, confirming_inputs, open_sequence
from opnav_workbench.planning.picture import PicturePlan, PicturePrediction, PlanVerdict, plan_picture
from opnav_workbench.planning.plan import Plan, plan_sequence
from opnav_workbench.planning.sequence import (
    ApproachSearch,
    PictureSequence,
    PlanLimits,
    PlannedPicture,
    PlannedPointing,
    SunRule,
    load_sequence,
    sequence_names,
)
from opnav_workbench.planning.stars import StarPlan, plan_stars
from opnav_workbench.planning.table import catalog_words, plan_document, plan_table, write_plan

__all__ = [
    "Approach",
    "ApproachSearch",
    "BestExposure",
    "Detection",
    "ExpectedLight",
    "OpenedSequence",
    "OtherBody",
    "PicturePlan",
    "PicturePrediction",
    "PictureSequence",
    "Plan",
    "PlanLimits",
    "PlanVerdict",
    "PlannedPicture",
    "PlannedPointing",
    "PointingPlan",
    "StarPlan",
    "SunRule",
    "TargetPlan",
    "best_exposure",
    "catalog_words",
    "confirming_inputs",
    "expected_light",
    "load_sequence",
    "open_sequence",
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
