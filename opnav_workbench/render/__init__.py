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

from typing import TYPE_CHECKING

from opnav_workbench.lazy_names import names_on_demand

if TYPE_CHECKING:
    from opnav_workbench.render.body import BodyModel, FigureUncertainty
    from opnav_workbench.render.focal_plane import (
        MovingBody,
        RenderedBody,
        Rendering,
        render_bodies,
        render_moving,
        render_one,
        render_touched,
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
else:  # loaded on first use: most calls need a few of these
    __getattr__ = names_on_demand(
        __name__,
        {
            "BodyModel": "body",
            "FigureUncertainty": "body",
            "MovingBody": "focal_plane",
            "RenderedBody": "focal_plane",
            "Rendering": "focal_plane",
            "render_bodies": "focal_plane",
            "render_moving": "focal_plane",
            "render_one": "focal_plane",
            "render_touched": "focal_plane",
            "AlbedoMap": "maps",
            "Hapke": "scattering",
            "Lambert": "scattering",
            "LommelSeeliger": "scattering",
            "LunarLambert": "scattering",
            "Minnaert": "scattering",
            "ScatteringLaw": "scattering",
            "law_from_mapping": "scattering",
            "ShapeModel": "shape",
        },
    )

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
    "render_one",
    "render_touched",
]
