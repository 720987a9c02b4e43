"""Centers of several bodies in one picture, found together by least squares, and their joint covariance.

Flow   search (correlation) -> one fit of all bodies, their brightness and a level -> patterns -> `JointCenters`

The bodies are rendered together, so that they hide and shade each other as their places demand. What ties their errors
to each other is in the normal matrix: light that overlaps, an edge that one cuts into the other, the level under both.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from opnav_workbench.arrays import FloatArray
from opnav_workbench.bodycenters.circle import Circle
from opnav_workbench.bodycenters.company import Company, Search, find_company, fit_pixels
from opnav_workbench.bodycenters.flags import BodyFlag
from opnav_workbench.bodycenters.model_fit import measured_bodies
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.results import BodyCenter, JointCenters
from opnav_workbench.bodycenters.scene_fit import fit_scene
from opnav_workbench.bodycenters.scene_light import SceneState
from opnav_workbench.errors import CenterfindingError

__all__ = ["METHOD", "find_jointly"]

METHOD = "least_squares"
NO_PIXELS = "no usable pixels about its place"
MIN_PIXELS_PER_PARAMETER = 2


def find_jointly(
    picture: BodyPicture,
    names: Sequence[str],
    *,
    circles: Mapping[str, Circle] | None = None,
    solve_range: bool = False,
    search_radius_px: float | None = None,
) -> JointCenters:
    """Find the centers of several bodies of one picture together.

    Parameters
    ----------
    picture : BodyPicture
    names : sequence of str
    circles : mapping of str to Circle, optional
        Where an analyst sees the bodies.
    solve_range : bool
        Solve for the range of each from the size of its image.
    search_radius_px : float, optional
        How far from their predictions (or circles) the bodies may be; by default 1.2 radii, at least 12 px, of an
        analyst's circle half its radius.

    Returns
    -------
    JointCenters
        In the order of `names`; bodies that were not found have a status and no center.

    Raises
    ------
    CenterfindingError
        No names, a name twice, or one that is not in the scene.
    """
    _check(picture, names)
    search = Search(METHOD, circles or {}, solve_range, search_radius_px)
    company = find_company(picture, names, search)
    if not company.found:
        return _collected(names, company.missed, {}, np.empty((0, 0)))
    cutout = fit_pixels(picture, company)
    fitted = (*company.found, *company.overlapping)
    enough = MIN_PIXELS_PER_PARAMETER * (4 * len(fitted) + 1)
    if cutout is None or np.count_nonzero(cutout.use) < enough:
        return _collected(names, {**company.missed, **_empty(company)}, {}, np.empty((0, 0)))
    wanted = np.array([solve_range and name in company.found for name in fitted])
    fit = fit_scene(picture, cutout, _start(company, solve_range=solve_range), solve_range=wanted)
    centers, covariance = measured_bodies(picture, cutout, company, fit, METHOD, wanted)
    return _collected(names, company.missed, centers, covariance)


def _check(picture: BodyPicture, names: Sequence[str]) -> None:
    if isinstance(names, str) or not names or len(set(names)) != len(names):
        raise CenterfindingError(f"names of bodies are {names!r}; give a list of different names.")
    for name in names:
        picture.model(name)


def _start(company: Company, *, solve_range: bool) -> SceneState:
    names = (*company.found, *company.overlapping)
    found = company.found.values()
    places = [(body.sized_place if solve_range else body.place).center_px for body in found]
    log_range = [-np.log(body.size_ratio) if solve_range else 0.0 for body in found]
    places += list(company.overlapping.values())
    log_range += [0.0] * len(company.overlapping)
    return SceneState(names, np.array(places), np.array(log_range), np.ones(len(names)))


def _empty(company: Company) -> dict[str, BodyCenter]:
    return {
        name: BodyCenter.without_center(name, METHOD, "failed", NO_PIXELS, flags=int(BodyFlag.EMPTY))
        for name in company.found
    }


def _collected(
    names: Sequence[str],
    missed: Mapping[str, BodyCenter],
    centers: Mapping[str, BodyCenter],
    covariance: FloatArray,
) -> JointCenters:
    """Put centers and covariances in the order of the names; `covariance` is in that of `centers`."""
    joint = np.full((2 * len(names), 2 * len(names)), np.nan)
    known = [name for name in centers if centers[name].pixel_line is not None]
    at = np.ravel([[2 * names.index(name), 2 * names.index(name) + 1] for name in known]).astype(int)
    order = list(centers)
    rows = np.ravel([[2 * order.index(name), 2 * order.index(name) + 1] for name in known]).astype(int)
    joint[np.ix_(at, at)] = covariance[np.ix_(rows, rows)]
    return JointCenters(tuple({**missed, **centers}[name] for name in names), joint)
