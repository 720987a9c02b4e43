"""Simulated pictures: what a flight camera would have sent, with a truth that only the truth file knows.

Enter by `simulate`, which makes the pictures of a scenario (`load_picture_scenario`) and writes them; by
`OpenedScenario` and `expose_picture` for single pictures in memory; by `read_truth` for what a picture really
shows.

``effects``
    Settings of the detector, as they stand in scenario files: one switch and a few numbers per effect.
``randomness``
    A stream of random numbers for every effect, by its name.
``charge``
    Photon noise, frame-transfer smear, cosmic rays and blooming, in electrons.
``detector_properties``
    A detector's numbers and fixed maps in one exposure.
``detector``
    From light to data numbers, in the order of the effects; lost data.
``attitude_path``
    How the camera moves while it exposes.
``picture``
    One picture: its inputs, stars and their trails, bodies, and the exposure.
``truth``
    What a picture really shows: the files beside it, and their table.
``flight_header``
    Cards of a flight header: quantities, templates, world coordinates.
``flight_fits``
    FITS files that flight readers take for their own, with error and quality planes.
``cautions``
    What will spoil a picture, or was guessed to draw it: saturation, laws, nothing that solves it.
``output``
    A picture, its truth and its previews in files, and a report of them.
``scenario_file``
    What scenario files of every kind share, with the description of bodies.
``scenario``
    Picture scenarios, their parts, and variations of them.
``surfaces``
    Surfaces of bodies for the renderer; mottled maps from a seed.
``terrain``
    Shapes from a seed: hills, a ridge and boulders on an ellipsoid.
``true_state``
    Predicted and true attitude; where spacecraft and bodies truly are.
``opened_scenario``
    A scenario with all opened that its pictures need: the inputs of each picture.
``batch``
    A scenario's pictures one after the other, or on several processes.
"""

from opnav_workbench.simulation.batch import chosen_pictures, simulate
from opnav_workbench.simulation.detector import expose
from opnav_workbench.simulation.effects import DetectorEffects
from opnav_workbench.simulation.opened_scenario import OpenedScenario, ScenarioPicture
from opnav_workbench.simulation.output import (
    BodyReport,
    PictureReport,
    stretched,
    truth_of,
    write_picture,
    write_preview,
)
from opnav_workbench.simulation.picture import PictureInputs, SimulatedPicture, expose_picture
from opnav_workbench.simulation.scenario import (
    ApparentPlaceEffects,
    PictureScenario,
    load_picture_scenario,
    picture_scenario_names,
    varied,
)
from opnav_workbench.simulation.truth import Truth, read_truth

__all__ = [
    "ApparentPlaceEffects",
    "BodyReport",
    "DetectorEffects",
    "OpenedScenario",
    "PictureInputs",
    "PictureReport",
    "PictureScenario",
    "ScenarioPicture",
    "SimulatedPicture",
    "Truth",
    "chosen_pictures",
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
