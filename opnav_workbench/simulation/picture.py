"""One simulated picture: stars and bodies through optics and detector, and what it really shows.

Flow   `PictureInputs` -> true places of stars and bodies -> electrons without noise -> detector -> `SimulatedPicture`
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from opnav_workbench.arrays import BoolArray, FloatArray, freeze_arrays
from opnav_workbench.camera import Camera
from opnav_workbench.camera.distortion import NoDistortion
from opnav_workbench.catalog import StarTable
from opnav_workbench.errors import CameraError
from opnav_workbench.psf import Psf
from opnav_workbench.psf.trailed import TrailedPsf
from opnav_workbench.render import Rendering, render_bodies
from opnav_workbench.scene import Observer, StarPrediction, predict_stars
from opnav_workbench.simulation.detector import Exposed, expose
from opnav_workbench.simulation.inputs import PictureInputs
from opnav_workbench.simulation.scenario_parts import Switches
from opnav_workbench.simulation.starlight import Trails, add_stars, trails

__all__ = ["SimulatedPicture", "expose_picture"]


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedPicture:
    """A picture and its truth; arrays are read-only and indexed ``[line, pixel]``.

    Attributes
    ----------
    inputs : PictureInputs
    exposed : Exposed
        The picture in DN, and the electrons before and after the detector's effects.
    stars : StarPrediction
        True places of the stars in or just outside the picture.
    star_flux_e : (n,) array
        Electrons of each star over the exposure; 0 without a magnitude.
    star_hidden : (n,) array of bool
        Behind a body, and therefore not drawn.
    star_trails : Trails
    rendering : Rendering
        The bodies: true centers, sizes and light.
    """

    inputs: PictureInputs
    exposed: Exposed
    stars: StarPrediction
    star_flux_e: FloatArray
    star_hidden: BoolArray
    star_trails: Trails
    rendering: Rendering

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def image_dn(self) -> FloatArray:
        """The picture as the file has it (n_line, n_pixel)."""
        return self.exposed.image_dn

    @property
    def noiseless_electrons(self) -> FloatArray:
        """The light of stars and bodies, without detector (n_line, n_pixel)."""
        return self.exposed.noiseless_electrons

    @property
    def camera_from_j2000(self) -> FloatArray:
        """The true attitude (3, 3) at mid-exposure."""
        return self.inputs.path.middle

    @property
    def body_trails(self) -> Trails:
        """How each body moves, as offsets from its place at mid-exposure."""
        each = [trails(track[None]) for track in _body_tracks(self.inputs)]
        return Trails(
            middle_px=np.zeros((len(each), 2)),
            mean_px=np.reshape([t.mean_px for t in each], (-1, 2)),
            length_px=np.ravel([t.length_px for t in each]),
        )

    @property
    def star_drawn(self) -> BoolArray:
        """Which stars (n,) are on the detector and not hidden."""
        return np.asarray(self.stars.on_detector & ~self.star_hidden & (self.star_flux_e > 0.0))


def expose_picture(inputs: PictureInputs) -> SimulatedPicture:
    """Simulate one picture.

    The same inputs give the same picture, bit for bit.

    Raises
    ------
    CameraError
        The camera does not know a number that is needed.
    """
    optics, observer = _optics(inputs.camera, inputs.switches), _observer(inputs.observer, inputs.switches)
    rendering = _bodies(inputs, optics, observer)
    stars = _stars(inputs, optics, observer)
    places = inputs.path.places(optics, stars.directions)
    hidden = rendering.occults(stars.directions)
    flux = np.nan_to_num(inputs.camera.electrons(stars.mag, inputs.exposure_s))
    electrons = np.array(rendering.electrons)
    seen = ~hidden
    add_stars(electrons, places[seen], flux[seen], inputs.psf, inputs.path.weights)
    exposed = expose(
        electrons,
        inputs.camera,
        inputs.effects,
        exposure_s=inputs.exposure_s,
        seed=inputs.seed,
        level=inputs.level,
        dark_columns=inputs.dark_columns,
    )
    return SimulatedPicture(
        inputs, exposed, stars, flux, hidden, trails(places, inputs.path.weights), rendering
    )


def _optics(camera: Camera, switches: Switches) -> Camera:
    return camera if switches.distortion else replace(camera, distortion=NoDistortion())


def _observer(observer: Observer, switches: Switches) -> Observer:
    """Return the observer that aberration is computed with."""
    return observer if switches.aberration else replace(observer, velocity_km_s=np.zeros(3))


def _stars(inputs: PictureInputs, optics: Camera, observer: Observer) -> StarPrediction:
    """Predict the stars whose light reaches the detector."""
    moved = np.abs(inputs.path.offsets_px(optics)).max()
    margin = float(inputs.psf.half_size_px + moved + 1.0)
    table = _switched(inputs.stars, inputs.switches)
    return predict_stars(table, inputs.et, observer, optics, inputs.path.middle, margin_px=margin)


def _switched(stars: StarTable, switches: Switches) -> StarTable:
    """Take parallax or motion from the stars where they are switched off."""
    zero = np.zeros(len(stars))
    update: dict[str, Any] = {} if switches.parallax else {"parallax_rad": zero}
    if not switches.proper_motion:
        update |= {"pmra_rad_yr": zero, "pmdec_rad_yr": zero, "rv_km_s": np.full(len(stars), np.nan)}
    return replace(stars, **update) if update else stars


def _bodies(inputs: PictureInputs, optics: Camera, observer: Observer) -> Rendering:
    return render_bodies(
        inputs.bodies,
        optics,
        inputs.path.middle,
        observer.velocity_km_s,
        psf=[_smeared(inputs.psf, track) for track in _body_tracks(inputs)],
        sunlight_e=inputs.camera.sunlight_e(inputs.exposure_s),
    )


def _smeared(psf: Psf, track_px: FloatArray) -> Psf:
    """Return the PSF, drawn out along the way that a body takes during the exposure."""
    return psf if len(track_px) == 1 else TrailedPsf(psf, track_px, np.ones(len(track_px)))


def _body_tracks(inputs: PictureInputs) -> list[FloatArray]:
    """Return where each body is in equal parts of the exposure (k, 2), px from mid-exposure."""
    given = inputs.body_tracks_px or (None,) * len(inputs.bodies)
    if len(given) != len(inputs.bodies):
        raise CameraError(f"{len(given)} tracks for {len(inputs.bodies)} bodies; give one for each, or none.")
    sky = inputs.path.offsets_px(_optics(inputs.camera, inputs.switches))
    return [sky if track is None else track for track in given]
