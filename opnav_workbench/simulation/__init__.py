"""Simulated pictures: what a flight camera would have sent, with a truth that only the truth file knows.

effects         settings of the detector       detector        light -> data numbers, by way of
shot_noise blooming frame_transfer cosmic_rays fixed_pattern lost_data
starlight       stars and their trails         attitude_path   how the camera moves while it exposes
flight_header flight_fits flight_wcs           files that flight readers take for their own
truth           what a picture really shows
scenario, scenario_parts, scenario_surfaces    picture scenarios: YAML files and their schema
scenario_file   what these share with sequences and rehearsals
mottled, surfaces, true_attitude, true_targets what a scenario's bodies look like, and where all truly is
workshop inputs picture output sequence processes  a scenario's pictures, one or many, in files
preview variations                             for people: PNG previews, a scenario with a few things changed
"""

from opnav_workbench.simulation.detector import expose
from opnav_workbench.simulation.effects import DetectorEffects
from opnav_workbench.simulation.inputs import PictureInputs
from opnav_workbench.simulation.output import BodyReport, PictureReport, truth_of, write_picture
from opnav_workbench.simulation.picture import SimulatedPicture, expose_picture
from opnav_workbench.simulation.preview import stretched, write_preview
from opnav_workbench.simulation.scenario import (
    PictureScenario,
    load_picture_scenario,
    picture_scenario_names,
)
from opnav_workbench.simulation.scenario_parts import Switches
from opnav_workbench.simulation.sequence import chosen_tasks, simulate
from opnav_workbench.simulation.truth import Truth, read_truth
from opnav_workbench.simulation.variations import varied
from opnav_workbench.simulation.workshop import Task, Workshop

__all__ = [
    "BodyReport",
    "DetectorEffects",
    "PictureInputs",
    "PictureReport",
    "PictureScenario",
    "SimulatedPicture",
    "Switches",
    "Task",
    "Truth",
    "Workshop",
    "chosen_tasks",
    "expose",
    "expose_picture",
    "load_picture_scenario",
    "picture_scenario_names",
    "read_truth",
    "simulate",
    "stretched",
    "truth_of",
    "varied",
    "write_picture",
    "write_preview",
]
