"""Center of figure of a small body at phase: measured as a star, corrected with the light of its own model.

Flow   picture -> star fit -> place of the light; model rendered there -> the same fit -> light minus figure; -> center

The rendered model is measured just as the picture is, so that whatever the star fit makes of a small crescent (its light
is beside its center of figure, and it is no Gaussian) is taken out, for any size, phase and place between the pixels.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodies import center_of_light_radii
from opnav_workbench.bodycenters.circle import Circle
from opnav_workbench.bodycenters.model_picture import model_picture
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.results import BodyCenter, BodyPictures
from opnav_workbench.bodycenters.subarray import choose_subarray, search_radius
from opnav_workbench.bodycenters.unresolved import find_unresolved
from opnav_workbench.starcenters import ShapePrior, default_box_px

__all__ = ["find_unresolved_body", "law_covariance", "light_prior"]

MAX_ROUNDS = 5  # the correction depends on the place by less than half of itself
STILL_PX = 5e-4
MARGIN_PX = 3.0
PSF_KNOWN_TO = 0.03  # of a PSF that the picture is given with
CLEAR_SNR = 30.0  # to which the model of a fainter body is raised, so that its fit is sure to find it
Final = Literal["least_squares", "matched_filter", "cross_correlation"]


def find_unresolved_body(
    picture: BodyPicture,
    name: str,
    *,
    circle: Circle | None = None,
    search_radius_px: float | None = None,
    prior: ShapePrior | None = None,
    psf_error: float = 0.0,
    neighbours_px: ArrayLike = (),
    final: Final = "least_squares",
    law_sigma: float = 0.0,
) -> BodyCenter:
    """Find the center of figure of a body too small to show a disk.

    Parameters
    ----------
    picture : BodyPicture
    name : str
    circle : Circle, optional
        Where an analyst sees it.
    search_radius_px : float, optional
        How far from there it may be; by default that of the full-disk methods.
    prior : ShapePrior, optional
        The frame's PSF; by default that of the picture.
    psf_error, neighbours_px, final
        As in `find_unresolved`; other bodies of the scene are neighbours anyway.
    law_sigma : float
        How well the surface's scattering law is known: 0, as the model has it; 1, no better than that it lies between
        Lambert's and Lommel and Seeliger's. Its effect on the light's place enters the covariance.

    Raises
    ------
    CenterfindingError
        The body is not in the scene, or `final` is unknown.
    """
    expected = picture.center_px(name) if circle is None else circle.center_px
    diameter = picture.diameter_px(name)
    others = [picture.center_px(m.target.name) for m in picture.models if m.target.name != name]
    task = _Task(
        picture=picture,
        name=name,
        prior=prior or light_prior(picture),
        psf_error=psf_error,
        search_px=search_radius(0.5 * diameter, circle, search_radius_px),
        diameter_px=diameter,
        neighbours_px=np.concatenate([np.reshape(others, (-1, 2)), np.reshape(neighbours_px, (-1, 2))]),
        final=final,
        law_px2=law_covariance(picture, name, law_sigma),
    )
    found = task.measured(picture.signal_dn, expected, np.zeros(2))
    if picture.model(name).is_point or found.status in ("off_detector", "saturated", "failed"):
        return found
    for _ in range(MAX_ROUNDS):
        if found.pixel_line is None:
            break
        before, found = found.pixel_line, _corrected(task, found, expected)
        if found.pixel_line is not None and np.abs(found.pixel_line - before).max() < STILL_PX:
            break
    return found


def light_prior(picture: BodyPicture) -> ShapePrior:
    """Return the picture's PSF as the star fit wants it."""
    sigma = float(np.sqrt(np.mean(np.square(picture.psf.sigma_px))))
    return ShapePrior.round_psf(sigma, PSF_KNOWN_TO, PSF_KNOWN_TO)


def law_covariance(picture: BodyPicture, name: str, law_sigma: float) -> FloatArray:
    """Return what the choice of a scattering law does to the place of a sphere's light (2, 2), px^2, along the Sun."""
    sun, phase = picture.model(name).target.sun_position_km, picture.phase_rad(name)
    if law_sigma == 0.0 or sun is None or not picture.diameter_px(name) > 0.0:
        return np.zeros((2, 2))
    _, sigma = center_of_light_radii(phase)
    in_camera = picture.camera_from_j2000 @ picture.prediction(name).direction
    sunward = picture.camera.project_jacobian(in_camera[None])[0] @ (picture.camera_from_j2000 @ sun)
    length = float(np.hypot(*sunward))
    along = sunward / length if length > 0.0 else np.zeros(2)
    return np.asarray((law_sigma * sigma * 0.5 * picture.diameter_px(name)) ** 2 * np.outer(along, along))


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    picture: BodyPicture
    name: str
    prior: ShapePrior
    psf_error: float
    search_px: float
    diameter_px: float
    neighbours_px: FloatArray
    final: Final
    law_px2: FloatArray

    def measured(self, image_dn: FloatArray, expected: FloatArray, offset: FloatArray) -> BodyCenter:
        """Measure the body in an image of the picture's size."""
        picture = self.picture
        flux_e = picture.model(self.name).flux_e
        return find_unresolved(
            np.where(np.isfinite(image_dn), image_dn, 0.0),
            picture.noise_dn,
            picture.bad | ~np.isfinite(image_dn),
            expected,
            self.prior,
            name=self.name,
            search_radius_px=self.search_px,
            saturated=picture.saturated,
            noise_model=picture.noise_model,
            psf_error=self.psf_error,
            excess_sigma_px=picture.excess_sigma_px,
            diameter_px=self.diameter_px,
            light_offset_px=offset,
            light_offset_covariance_px2=self.law_px2,
            neighbours_px=self.neighbours_px,
            final=self.final,
            predicted_flux_dn=None if flux_e is None else flux_e / picture.gain_e_per_dn,
        )


def _corrected(task: _Task, found: BodyCenter, expected: FloatArray) -> BodyCenter:
    """Measure the body again, with what its rendered light at the place found shows."""
    assert found.pixel_line is not None
    picture, center = task.picture, found.pixel_line
    margin = default_box_px(task.prior.sigma_px) + MARGIN_PX
    radius = max(0.5 * task.diameter_px, 0.5)
    part = choose_subarray(picture, task.name, Circle(center, radius), margin)
    light = model_picture(picture, part.window, {task.name: center}, only=(task.name,))
    if part.empty or not light.sum() > 0.0:
        return found
    raised = max(1.0, CLEAR_SNR / found.snr)
    first = np.array(part.window[:2], dtype=np.float64)
    model = find_unresolved(
        light * (raised * found.flux_dn / light.sum()),
        picture.noise_dn[part.slices],
        picture.bad[part.slices],
        center - first,
        task.prior,
        name=task.name,
        search_radius_px=radius + MARGIN_PX,
        saturated=picture.saturated[part.slices],
        noise_model=picture.noise_model,
        diameter_px=task.diameter_px,
        final=task.final,
    )
    if model.pixel_line is None:
        return found
    image = picture.signal_dn
    if task.final == "least_squares" and model.pictures is not None:
        image = _without(image, model.pictures, part.window, raised)
    return task.measured(image, expected, model.pixel_line + first - center)


def _without(
    image: FloatArray, own: BodyPictures, window: tuple[int, int, int, int], raised: float
) -> FloatArray:
    """Return the image less what the body's light has beyond the Gaussian that is fitted to it."""
    pixel, line = own.window[0] + window[0], own.window[1] + window[1]
    n_line, n_pixel = own.difference_dn.shape
    top, left = max(0, -line), max(0, -pixel)
    into = np.array(image)
    place = into[max(line, 0) : line + n_line, max(pixel, 0) : pixel + n_pixel]
    place -= own.difference_dn[top : top + place.shape[0], left : left + place.shape[1]] / raised
    return into
