"""Bodies on the focal plane: from their models to electrons per pixel, with what is true about each.

Flow   models -> surfaces before the camera -> radiance along rays -> pixels, divided at edges -> PSF -> electrons
Frame  J2000; (pixel, line) on the detector
Units  km, rad, px, electrons

A ray has the body's true direction: distortion and stellar aberration are undone for every pixel, so that a body lies
where `opnav_workbench.scene.predict_body` puts it. Bodies hide each other and cast shadows on each other.

regime  diameter   how
point   < 1 px     four points that have the light, the center of light and the second moments of the disk
small   1..4 px    every pixel divided: 4 x 4 cells, edges 32 x 32 (AAS 13-443: 5 x 5); light and center are the body's
disk    > 4 px     pixels divided where limb, terminator, shadow or pattern ask for it

The light itself (flux, center, moments) is integrated over the surface, independent of the pixels, so that it does not
change from regime to regime.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.geometry import geometric_direction
from opnav_workbench.psf import Psf
from opnav_workbench.render.body import BodyModel
from opnav_workbench.render.disk import View
from opnav_workbench.render.drawing import RenderedBody, draw, set_stage
from opnav_workbench.render.grid import Window

__all__ = ["BodyModel", "MovingBody", "RenderedBody", "Rendering", "render_bodies", "render_moving"]


@dataclass(frozen=True, slots=True, eq=False)
class Rendering:
    """Electrons of all bodies on the focal plane, and what is true about each body.

    Attributes
    ----------
    electrons : (n_line, n_pixel) array
        Over the window.
    window : (int, int, int, int)
        First pixel, first line, pixels, lines.
    bodies : tuple of RenderedBody
        In the order of the models.
    """

    electrons: FloatArray
    window: Window
    bodies: tuple[RenderedBody, ...]
    _view: "View"

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def occults(self, directions: ArrayLike) -> BoolArray:
        """Tell which stars hide behind a body.

        Parameters
        ----------
        directions : (n, 3) array_like
            Apparent directions (stellar aberration applied), J2000, as `scene.predict_stars` gives them.
        """
        apparent = np.asarray(directions, dtype=np.float64).reshape(-1, 3)
        rays = geometric_direction(apparent, self._view.velocity_km_s).T
        hidden = np.zeros(rays.shape[1], dtype=bool)
        for body in self._view.placed:
            toward = body.position_km / np.linalg.norm(body.position_km)
            near = np.flatnonzero(toward @ rays >= np.cos(min(1.01 * body.angular_radius_rad, np.pi)))
            hidden[near] |= body.blocks(rays[:, near], np.full(len(near), np.inf))
        return hidden


@dataclass(frozen=True, slots=True, eq=False)
class MovingBody:
    """One body's electrons over a window, and their derivatives as it moves without turning.

    Attributes
    ----------
    electrons : (n_line, n_pixel) array
    slopes : (2, n_line, n_pixel) array
        Electrons per px of motion along pixel and along line; (0, ...) where none were asked for.
    body : RenderedBody
    """

    electrons: FloatArray
    slopes: FloatArray
    body: RenderedBody

    def __post_init__(self) -> None:
        freeze_arrays(self)


def render_bodies(
    models: Sequence[BodyModel],
    camera: Camera,
    camera_from_j2000: ArrayLike,
    observer_velocity_km_s: ArrayLike,
    *,
    psf: Psf | Sequence[Psf],
    sunlight_e: float,
    window: Window | None = None,
) -> Rendering:
    """Render bodies: the noiseless light that each pixel collects.

    Parameters
    ----------
    models : sequence of BodyModel
    camera : Camera
    camera_from_j2000 : (3, 3) array_like
    observer_velocity_km_s : (3,) array_like
        With respect to the solar-system barycenter, J2000; zero switches stellar aberration off.
    psf : Psf, or one for each model
        Taken at each body's center (`Psf.at`).
    sunlight_e : float
        Electrons that the Sun at 1 au would give as a point (``camera.sunlight_e(exposure_s)``). A pixel of solid angle
        w that sees a reflectance I/F at r au collects ``sunlight_e / r^2 * I/F * w / pi``.
    window : (int, int, int, int), optional
        First pixel, first line, pixels and lines to render; the whole detector if not given.

    Returns
    -------
    Rendering
        The same inputs give the same bits.

    Raises
    ------
    CameraError
        An empty window, or a camera inside a body.

    Examples
    --------
    Charon, 40 px wide at half phase, before a pinhole camera.

    >>> from opnav_workbench.psf import GaussianPsf
    >>> from opnav_workbench.resources import kernels_meta_dir
    >>> from opnav_workbench.bodies import TargetState
    >>> camera = Camera.from_yaml(kernels_meta_dir() / "generic/cameras/pinhole.yaml")
    >>> charon = TargetState("CHARON", [0, 0, 3.03e6], radii_km=[606.0] * 3, sun_position_km=[4.9e9, 0, 0])
    >>> rendering = render_bodies(
    ...     [BodyModel(charon, albedo=0.4)], camera, np.eye(3), np.zeros(3), psf=GaussianPsf(0.8, 0.8), sunlight_e=1e15
    ... )
    >>> body = rendering.bodies[0]
    >>> body.regime, body.center_px.tolist(), body.light_px.round(2).tolist()
    ('disk', [511.5, 511.5], [523.28, 511.5])
    >>> round(float(rendering.electrons.sum() / body.flux_e), 4)
    1.0

    Notes
    -----
    Pixels of bodies are exact to 0.1 % of the peak. Radiance is taken at each pixel's geometric direction; the change of
    brightness with the observer's motion (2 v/c, 1e-4) is left out.
    """
    stage = set_stage(models, camera, camera_from_j2000, observer_velocity_km_s, psf, window)
    picture = np.zeros((stage.view.window[3], stage.view.window[2]))
    bodies = tuple(draw(stage, i, picture[None], sunlight_e) for i in range(len(stage.models)))
    np.maximum(picture, 0.0, out=picture)  # rounding of the FFT
    return Rendering(picture, stage.view.window, bodies, stage.view)


def render_moving(
    models: Sequence[BodyModel],
    camera: Camera,
    camera_from_j2000: ArrayLike,
    observer_velocity_km_s: ArrayLike,
    *,
    psf: Psf | Sequence[Psf],
    sunlight_e: float,
    window: Window | None = None,
    derivatives: bool = True,
) -> tuple["MovingBody", ...]:
    """Render bodies each by itself, and how their light changes as they move.

    Parameters are those of `render_bodies`; `derivatives` tells whether derivatives are wanted. A body's light still
    lacks what others hide or shade. Each surface is looked at once; its light is then spread with the PSF and with the
    PSF's derivatives, so that this takes about twice the time of `render_bodies`.

    Returns
    -------
    tuple of MovingBody
        In the order of the models.
    """
    stage = set_stage(models, camera, camera_from_j2000, observer_velocity_km_s, psf, window)
    moving = []
    for index in range(len(stage.models)):
        pictures = np.zeros((3 if derivatives else 1, stage.view.window[3], stage.view.window[2]))
        body = draw(stage, index, pictures, sunlight_e)
        moving.append(MovingBody(np.maximum(pictures[0], 0.0), pictures[1:], body))
    return tuple(moving)
