"""Bodies as the camera sees them: surfaces, scattering laws, albedo maps, and their light spread over pixels.

scattering, roughness, laws   how bright a surface element is, per unit albedo; laws by name
maps                          albedo against longitude and latitude
surface, ellipsoid            what a ray meets: the protocol, and triaxial ellipsoids
plates, shape                 shape models of triangular plates, with the shadows they cast
body, light                   one body before the camera; its flux, center and spread
grid, sampling                directions of pixels; pixels divided where edges pass
convolution                   the PSF
disk, drawing, bodies         a resolved body in the picture; any body; `render_bodies`: all of it
"""

from opnav_workbench.render.bodies import MovingBody, RenderedBody, Rendering, render_bodies, render_moving
from opnav_workbench.render.body import BodyModel
from opnav_workbench.render.laws import law_from_mapping
from opnav_workbench.render.maps import AlbedoMap
from opnav_workbench.render.scattering import (
    Hapke,
    Lambert,
    LommelSeeliger,
    LunarLambert,
    Minnaert,
    ScatteringLaw,
)
from opnav_workbench.render.shape import ShapeModel

__all__ = [
    "AlbedoMap",
    "BodyModel",
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
