"""The distortion of a raw vidicon picture, from its reseau marks.

A vidicon reads its picture with a beam of electrons, which bends otherwise from frame to frame by pixels. The marks stand on
the glass before it: where they are in the ideal picture is known for good (`ideal_mm` of `opnav_workbench.camera.Reseau`),
and about where in a raw one (`marks_px`).

Flow   nominal places -> one shift of all -> each mark sought near its place -> a smooth change of the nominal places ->
       polynomials from ideal to raw, as `SipDistortion`
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy

from opnav_workbench.arrays import BoolArray, FloatArray
from opnav_workbench.camera.distortion import SipDistortion, sip_powers, sip_terms
from opnav_workbench.camera.model import Camera
from opnav_workbench.camera.reseau import FEWEST_MARKS
from opnav_workbench.constants import MAD_TO_SIGMA
from opnav_workbench.errors import CameraError

__all__ = ["ReseauFit", "fit_reseau"]

DEGREE = 5  # of the polynomials: the third leaves twice as much of nominal places as the fifth, which leaves their digits
CHANGE_DEGREE = 3  # of what a frame's marks differ from the nominal places
MARK_SIGMA_PX = 1.0  # of a mark's shape, three pixels wide
WIDER_PX = 9  # than a smoothed mark: what is darker than all that is as wide about it
REACH_PX, NEAR_PX = 9, 3  # in which a mark is sought at first, and about its place when most are known
MARGIN_PX = 2
SEEN_SIGMAS = 5.0  # a minimum of 49 places that deep is noise once in 70,000 marks
OUTLIER_SIGMAS = 4.0
REJECTIONS, REJECTED_WEIGHT = 4, 1e-3
# Of a mark whose place is nominal, changed as the seen ones': it keeps polynomials from running away.
UNSEEN_WEIGHT = 0.1
ALIKE_PX = 2.0  # of marks that are shifted together
COMMON_SHARE = 0.5  # of them: more than half, or they are none
MASK_PX = 2.6  # radius of what a mark hides


@dataclass(frozen=True, slots=True, eq=False)
class ReseauFit:
    """What a picture's marks say.

    Attributes
    ----------
    camera
        With this picture's distortion; with the nominal one where too few marks are seen.
    seen : (n,) array of bool
        Which marks were found.
    rms_px
        Of their places, one axis, about the polynomials; nan where too few are seen.
    hidden : (n_line, n_pixel) array of bool
        Pixels that lie behind marks.
    """

    camera: Camera
    seen: BoolArray
    rms_px: float
    hidden: BoolArray

    @property
    def is_solved(self) -> bool:
        """Whether the picture's own marks tell its distortion."""
        return bool(np.isfinite(self.rms_px))


def fit_reseau(camera: Camera, image_dn: FloatArray) -> ReseauFit:
    """Return the camera with the distortion that a raw picture's marks tell.

    Raises
    ------
    CameraError
        The camera has no reseau.
    """
    reseau = camera.reseau
    if reseau is None:
        raise CameraError(f"{camera.name} has no reseau marks; it needs no fit to them.")
    contrast, noise = _contrast(np.asarray(image_dn, dtype=np.float64))
    first, depth = _sought(contrast, reseau.marks_px, REACH_PX)
    deep = np.isfinite(depth) & (depth > SEEN_SIGMAS * noise)
    shift = np.median((first - reseau.marks_px)[deep], axis=0) if deep.any() else np.zeros(2)
    alike = deep & (np.hypot(*(first - reseau.marks_px - shift).T) < ALIKE_PX)
    if np.count_nonzero(alike) < max(FEWEST_MARKS, COMMON_SHARE * np.count_nonzero(deep)):
        hidden = _hidden(reseau.marks_px, image_dn.shape)
        return ReseauFit(camera, np.zeros(len(depth), dtype=bool), float("nan"), hidden)
    change = _change(camera, reseau.marks_px, first, alike)
    again, depth = _sought(contrast, reseau.marks_px + change(reseau.marks_px), NEAR_PX)
    seen = np.isfinite(depth) & (depth > SEEN_SIGMAS * noise)
    for _ in range(2):  # the second time without outliers
        change = _change(camera, reseau.marks_px, again, seen)
        off = again - reseau.marks_px - change(reseau.marks_px)
        scale = MAD_TO_SIGMA * np.median(np.abs(off[seen]))
        seen = seen & (np.abs(off).max(axis=1) < OUTLIER_SIGMAS * max(scale, 1e-3))
    places = np.where(seen[:, None], again, reseau.marks_px + change(reseau.marks_px))
    solved, used = _solved(camera, places, seen)
    rms = float(np.sqrt(np.mean(_off(solved, places)[used] ** 2)))
    return ReseauFit(solved, used, rms, _hidden(places, image_dn.shape))


def _solved(camera: Camera, places: FloatArray, seen: BoolArray) -> tuple[Camera, BoolArray]:
    """Return the camera with the polynomials of marks, and which of those seen they pass: corners have odd ones."""
    assert camera.reseau is not None
    used = seen
    for _ in range(REJECTIONS):
        weight = np.where(used, 1.0, np.where(seen, REJECTED_WEIGHT, UNSEEN_WEIGHT))
        solved = replace(camera, distortion=_lens(camera, places, camera.reseau.ideal_mm, weight))
        off = np.abs(_off(solved, places)).max(axis=1)
        scale = MAD_TO_SIGMA * np.median(off[used])
        used = seen & (off < OUTLIER_SIGMAS * scale)
    return solved, used


def _off(camera: Camera, places: FloatArray) -> FloatArray:
    """Return how far marks (n, 2) are from where a camera has them, px."""
    assert camera.reseau is not None
    there = camera.distortion.distort(camera.reseau.ideal_mm) @ camera.pixel_from_mm.T
    return np.asarray(places - camera.center_pixel_line - there)


def _contrast(image: FloatArray) -> tuple[FloatArray, float]:
    """Return how dark each place is against its surroundings, in the shape of a mark, and the scatter of that."""
    smooth = scipy.ndimage.gaussian_filter(np.nan_to_num(image), MARK_SIGMA_PX, mode="nearest")
    dark = scipy.ndimage.grey_closing(smooth, size=(WIDER_PX, WIDER_PX), mode="nearest") - smooth
    dark -= np.median(dark)
    return dark, float(MAD_TO_SIGMA * np.median(np.abs(dark))) or 1e-6


def _sought(contrast: FloatArray, places: FloatArray, reach: int) -> tuple[FloatArray, FloatArray]:
    """Return the darkest places (n, 2) near others, to a part of a pixel, and how dark they are; nan beside the picture."""
    found, depth = np.full(places.shape, np.nan), np.full(len(places), np.nan)
    n_line, n_pixel = contrast.shape
    for number, (pixel, line) in enumerate(np.round(places).astype(int)):
        low, high = reach + MARGIN_PX, reach + MARGIN_PX + 1
        if not (low <= pixel <= n_pixel - high and low <= line <= n_line - high):
            continue
        box = contrast[line - reach : line + reach + 1, pixel - reach : pixel + reach + 1]
        down, across = np.unravel_index(int(box.argmax()), box.shape)
        at = np.array([pixel - reach + across, line - reach + down])
        depth[number] = box[down, across]
        found[number] = at + _vertex(contrast[at[1] - 1 : at[1] + 2, at[0] - 1 : at[0] + 2])
    return found, depth


def _vertex(box: FloatArray) -> FloatArray:
    """Return where the parabolas through a maximum and its neighbors have theirs, (pixel, line), within half a pixel."""
    steps = []
    for before, here, after in (box[1], box[:, 1]):
        bend = before - 2.0 * here + after
        steps.append(float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0.0 else 0.0)
    return np.array(steps)


def _change(
    camera: Camera, nominal: FloatArray, found: FloatArray, use: BoolArray
) -> Callable[[FloatArray], FloatArray]:
    """Return the smooth change of nominal places that marks show: a function of places (n, 2)."""
    middle, half = 0.5 * np.array([camera.n_pixel, camera.n_line]), 0.5 * camera.n_pixel

    def terms(places: FloatArray) -> FloatArray:
        return sip_terms((places - middle) / half, CHANGE_DEGREE)

    factors = np.linalg.lstsq(terms(nominal[use]), (found - nominal)[use], rcond=None)[0]
    return lambda places: np.asarray(terms(places) @ factors)


def _lens(camera: Camera, places: FloatArray, ideal_mm: FloatArray, weight: FloatArray) -> SipDistortion:
    """Return the polynomials of pixel offsets that take ideal places of marks to raw ones."""
    ideal_px = ideal_mm @ camera.pixel_from_mm.T
    scale = float(np.abs(ideal_px).max())
    moved = places - camera.center_pixel_line - ideal_px
    factors = np.linalg.lstsq(
        sip_terms(ideal_px / scale, DEGREE) * weight[:, None], moved * weight[:, None], rcond=None
    )[0]
    along, down = (
        {pq: float(f / scale ** sum(pq)) for pq, f in zip(sip_powers(DEGREE), column, strict=True)}
        for column in factors.T
    )
    return SipDistortion.from_coefficients(camera.pixel_from_mm, along, down)


def _hidden(places: FloatArray, shape: tuple[int, ...]) -> BoolArray:
    """Return the pixels behind marks."""
    hidden = np.zeros(shape, dtype=bool)
    reach = int(np.ceil(MASK_PX))
    down, across = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    for place in places:
        pixel, line = np.round(place).astype(int)
        near = np.hypot(pixel + across - place[0], line + down - place[1]) <= MASK_PX
        lines, pixels = (line + down)[near], (pixel + across)[near]
        inside = (lines >= 0) & (lines < shape[0]) & (pixels >= 0) & (pixels < shape[1])
        hidden[lines[inside], pixels[inside]] = True
    return hidden
