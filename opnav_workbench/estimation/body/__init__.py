"""A body from a sequence of pictures: size and axes, pole, spin and prime meridian, center of figure against center of mass.

Enter by `solve_body_from_pictures`, or by `solve_body` with what pictures said already.

``pictures``
    Outlines read, the batch solved, outlines read again with the body that came out.
``solution``
    `solve_body`: the batch, its outliers, and the body that comes out; its PCK.
``knowledge``
    What is solved for, and what is believed of it before.
``sightings``
    What one picture says: its outline as five numbers, its landmarks.
``design``
    Residuals and partials of outlines and landmarks.
``rotation``
    A body that spins evenly about a fixed axis.
``albedo``
    The albedo map that the same pictures show of the body as solved.
``words``
    What is observed and what is not, in plain words.
"""

from opnav_workbench.estimation.body.albedo import SurfaceMap, albedo_from_pictures
from opnav_workbench.estimation.body.design import BodyState
from opnav_workbench.estimation.body.knowledge import BodyKnowledge
from opnav_workbench.estimation.body.pictures import SequencePicture, solve_body_from_pictures
from opnav_workbench.estimation.body.rotation import BodyRotation
from opnav_workbench.estimation.body.sightings import (
    BodySighting,
    LandmarkReading,
    OutlineReading,
    landmark_reading,
    read_outline,
)
from opnav_workbench.estimation.body.solution import BodySolution, SightingResidual, solve_body

__all__ = [
    "BodyKnowledge",
    "BodyRotation",
    "BodySighting",
    "BodySolution",
    "BodyState",
    "LandmarkReading",
    "OutlineReading",
    "SequencePicture",
    "SightingResidual",
    "SurfaceMap",
    "albedo_from_pictures",
    "landmark_reading",
    "read_outline",
    "solve_body",
    "solve_body_from_pictures",
]
