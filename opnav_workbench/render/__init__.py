"""Bodies as the camera sees them: surfaces, scattering laws, albedo maps, and their light spread over pixels.

Enter by `BodyModel` and `render_bodies` (all bodies in one array of electrons), or `render_moving` (each by itself, with
derivatives).

``scattering``
    How bright a surface element is, per unit albedo; laws by name.
``maps``
    Albedo against longitude and latitude.
``ellipsoid``
    What a renderer asks of a surface, and triaxial ellipsoids.
``shape``
    Shape models of triangular plates, with the shadows they cast.
``body``
    One body before the camera, how far its figure may be wrong, its flux, center and spread.
``grid``
    Directions of pixels.
``sampling``
    Pixels divided where edges pass.
``disk``
    A resolved body in the picture, through the PSF.
``focal_plane``
    All bodies: from models to electrons per pixel.
"""

from opnav_workbench.render.body import BodyModel, FigureUncertainty
from opnav_workbench.render.focal_plane import (
    MovingBody,
    RenderedBody,
    Rendering,
    render_bodies,
    render_moving,
)
from opnav_workbench.render.maps import AlbedoMap
from opnav_workbench.render.scattering import (
    Hapke,
    Lambert,
    LommelSeeliger,
    LunarLambert,
    Minnaert,
    ScatteringLaw,
    law_from_mapping,
)
from opnav_workbench.render.shape import ShapeModel

__all__ = [
    "AlbedoMap",
    "BodyModel",
    "FigureUncertainty",
    "Hapke",
    "Lambert",
    "LommelSeeliger",
    "LunarLambert",
    "Minnaert",
    "MovingBody",
    "RenderedBody",
    "Rendering",
    "ScatteringLaw",
    "ShapeModel",
    "law_from_mapping",
    "render_bodies",
    "render_moving",
]
