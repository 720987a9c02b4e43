"""What a person looks at to judge a landmark: the picture's patch, the maplet as it was fitted, and their correlation."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from opnav_workbench.arrays import FloatArray, freeze_arrays
from opnav_workbench.bodies.picture import BodyPicture
from opnav_workbench.landmarks.drawing import Templates
from opnav_workbench.landmarks.finder import drawn_templates, picture_planes, with_pose
from opnav_workbench.landmarks.maplets import Maplets
from opnav_workbench.landmarks.matching import PicturePlanes, correlate, fit_patch
from opnav_workbench.landmarks.prediction import WholeBody
from opnav_workbench.landmarks.results import LandmarkSolution

__all__ = ["LandmarkPatch", "landmark_patches"]

SHOWN_RADIUS_PX = 8  # of the correlation about the place with the solved pose


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkPatch:
    """A landmark's pixels and how it was drawn; arrays are [line, pixel] and read-only.

    Attributes
    ----------
    first_px : (2,) array
        (pixel, line) of the first pixel.
    data_dn : (size, size) array
        Above the sky; nan where not usable.
    model_dn : (size, size) array
        The maplet as fitted, with its gain, bias and slope; as drawn, scaled to the data, where no fit holds. nan where it
        says nothing.
    correlation : (2 r + 1, 2 r + 1) array
        Normalized, for shifts of -r .. r px about where the pose has the landmark.
    shift_px : (2,) array
        Of the measured center, (pixel, line) from there; nan where none was measured.
    """

    id: str
    first_px: FloatArray
    data_dn: FloatArray
    model_dn: FloatArray
    correlation: FloatArray
    shift_px: FloatArray

    def __post_init__(self) -> None:
        freeze_arrays(self)


def landmark_patches(
    picture: BodyPicture, maplets: Maplets, solution: LandmarkSolution, ids: Sequence[str]
) -> tuple[LandmarkPatch, ...]:
    """Return the patches of some landmarks of a solution, drawn from its pose where there is one.

    Parameters
    ----------
    picture, maplets
        Those that `find_landmarks` was given.
    ids
        Among the solution's.
    """
    if not ids:
        return ()
    model = picture.model(maplets.body)
    if solution.pose is not None:
        picture, model = with_pose(picture, model, solution.pose)
    row_of = {identity: row for row, identity in enumerate(maplets.id.tolist())}
    wanted = maplets.take(np.array([row_of[identity] for identity in ids]))
    templates = drawn_templates(picture, wanted, model, WholeBody.of(model), int(solution.centers.window_px))
    templates = templates.with_share(solution.centers.law_share)
    planes = picture_planes(picture)
    place_of = {identity: row for row, identity in enumerate(solution.centers.id.tolist())}
    observed = solution.centers.observed_px[[place_of[identity] for identity in ids]]
    shift = observed - templates.first - templates.offset_px
    return tuple(_patch(identity, planes, templates, row, shift[row]) for row, identity in enumerate(ids))


def _patch(
    identity: str, planes: PicturePlanes, templates: Templates, row: int, shift_px: FloatArray
) -> LandmarkPatch:
    score = correlate(planes, templates, row, SHOWN_RADIUS_PX)
    line, pixel = np.unravel_index(int(score.argmax()), score.shape)
    whole = np.array([pixel - SHOWN_RADIUS_PX, line - SHOWN_RADIUS_PX])
    fit = fit_patch(planes, templates, row, whole)
    if fit is None:
        whole = np.zeros(2, dtype=np.int64)
    data, variance, good = planes.window(templates.first[row] + whole, templates.size)
    if fit is not None:
        model = np.where(fit.weight > 0.0, data - fit.residual * np.sqrt(variance), np.nan)
    else:
        model = _scaled(templates.at(row, np.zeros(2))[0], data, good & templates.covered[row])
    return LandmarkPatch(
        identity,
        np.asarray(templates.first[row] + whole, dtype=float),
        np.where(good, data, np.nan),
        model,
        score,
        shift_px,
    )


def _scaled(template: FloatArray, data: FloatArray, used: FloatArray) -> FloatArray:
    """Return a template with the gain and bias that bring it nearest to the data."""
    if np.count_nonzero(used) < 2:
        return np.where(used, template, np.nan)
    columns = np.stack([template[used], np.ones(np.count_nonzero(used))], axis=1)
    gain, bias = np.linalg.lstsq(columns, data[used], rcond=None)[0]
    return np.where(used, gain * template + bias, np.nan)
