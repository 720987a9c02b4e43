"""Centers of one or several bodies in a picture by non-linear least squares of their rendered light to the data.

Flow   places, disks (`opnav_workbench.bodies.detection`) -> groups that share pixels -> one fit of each group, their
       brightness and a level -> patterns, the disks' likelihoods beside -> `JointCenters`

The bodies are rendered together, so that they hide and shade each other as their places demand. What ties their errors
to each other is in the normal matrix: light that overlaps, an edge that one cuts into the other, the level under both.

Reference: Jackman & Dumont (2013), AAS 13-443, "Non-linear Least Squares Target Centerfinding".
"""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from opnav_workbench.arrays import FloatArray, IntArray
from opnav_workbench.bodies.detection import (
    DetectedScene,
    SearchRequest,
    detect_bodies,
    fit_figures,
    fit_pixels,
    groups_in_contact,
    start_state,
)
from opnav_workbench.bodies.fit_report import report_fitted_bodies, without_pixels
from opnav_workbench.bodies.picture import BodyPicture, Circle
from opnav_workbench.bodies.results import BodyCenter, JointCenters
from opnav_workbench.bodies.scene_fit import SceneFit, fit_scene
from opnav_workbench.errors import CenterfindingError
from opnav_workbench.threads import one_thread

__all__ = ["find_jointly", "find_least_squares"]


# ---- Centers of several bodies in one picture, found together by least squares, and their joint covariance.

METHOD = "least_squares"
MIN_PIXELS_PER_PARAMETER = 2


@one_thread()
def find_jointly(
    picture: BodyPicture,
    names: Sequence[str],
    *,
    circles: Mapping[str, Circle] | None = None,
    solve_range: bool = False,
    search_radius_px: float | None = None,
    known_surfaces: Collection[str] = (),
) -> JointCenters:
    """Find the centers of several bodies of one picture together.

    The largest is looked for first; the others are expected as far beside their predictions as it is.

    Parameters
    ----------
    circles
        Where an analyst sees the bodies.
    solve_range
        Solve for the range of each from the size of its image.
    search_radius_px
        How far from where they are expected (or from circles) the bodies may be; by default anywhere, nearer places
        first; half the radius of an analyst's circle.
    known_surfaces
        Bodies whose model is truer than the likelihood of their disk, which knows no map of an albedo: their centers
        stand for themselves.

    Returns
    -------
    JointCenters
        In the order of `names`, each as `find_least_squares` has it; bodies that were not found have a status and no
        center.

    Raises
    ------
    CenterfindingError
        No names, a name twice, or one that is not in the scene.
    """
    _check(picture, names)
    search = SearchRequest(METHOD, circles or {}, search_radius_px, known_surfaces)
    detected = detect_bodies(picture, names, search)
    if not detected.found:
        return _collected(names, detected.missed, [])
    groups = [_fitted_group(group, solve_range=solve_range) for group in groups_in_contact(detected)]
    return _collected(names, detected.missed, groups)


class _Group(NamedTuple):
    """Centers of bodies that were fitted together, and their covariance (2 n, 2 n)."""

    centers: Mapping[str, BodyCenter]
    covariance: FloatArray


def _fitted_group(detected: DetectedScene, *, solve_range: bool) -> _Group:
    cutout = fit_pixels(detected)
    fitted = (*detected.found, *detected.overlapping)
    enough = MIN_PIXELS_PER_PARAMETER * (4 * len(fitted) + 1)
    if cutout is None or np.count_nonzero(cutout.use) < enough:
        size = 2 * len(detected.found)
        return _Group(_empty(detected), np.full((size, size), np.nan))
    wanted = np.array([solve_range and name in detected.found for name in fitted])

    def fit(scene: DetectedScene) -> SceneFit:
        start = start_state(scene, solve_range=solve_range)
        return fit_scene(scene.picture, cutout, start, solve_range=wanted)

    return _Group(*report_fitted_bodies(cutout, *fit_figures(detected, fit), METHOD, wanted))


def _check(picture: BodyPicture, names: Sequence[str]) -> None:
    if isinstance(names, str) or not names or len(set(names)) != len(names):
        raise CenterfindingError(f"names of bodies are {names!r}; give a list of different names.")
    for name in names:
        picture.model(name)


def _empty(detected: DetectedScene) -> dict[str, BodyCenter]:
    return {name: without_pixels(name, METHOD) for name in detected.found}


def _collected(
    names: Sequence[str], missed: Mapping[str, BodyCenter], groups: Sequence[_Group]
) -> JointCenters:
    """Put centers and covariances in the order of the names; groups share nothing."""
    centers, joint = dict(missed), np.full((2 * len(names), 2 * len(names)), np.nan)
    for group in groups:
        centers |= group.centers
    known = [name for name in names if centers[name].pixel_line is not None]
    everywhere = _rows(names, known)
    joint[np.ix_(everywhere, everywhere)] = 0.0
    for group in groups:
        own = [name for name in known if name in group.centers]
        at, order = _rows(names, own), _rows(list(group.centers), own)
        joint[np.ix_(at, at)] = group.covariance[np.ix_(order, order)]
    return JointCenters(tuple(centers[name] for name in names), joint)


def _rows(order: Sequence[str], names: Sequence[str]) -> IntArray:
    """Return the rows (2 n,) that bodies have in a covariance of an order."""
    at = 2 * np.array([order.index(name) for name in names], dtype=np.int64)
    return np.ravel(at[:, None] + [0, 1])


# ---- Center of a body by non-linear least squares of its rendered picture to the data.


@one_thread()
def find_least_squares(
    picture: BodyPicture,
    name: str,
    *,
    circle: Circle | None = None,
    solve_range: bool = False,
    search_radius_px: float | None = None,
    known_surface: bool = False,
) -> BodyCenter:
    """Find a body's center of figure: center, brightness and a level fitted, and its range if wanted.

    Bodies that hide it or mix their light with it are fitted along; pixels of the others are left out. The disk is measured
    first (`opnav_workbench.bodies.disk`): where it has another size or other axes than the model, the body is rendered with
    those, unless its model explains the light as it is; and where its center is another one, the result is ``uncertain``.

    Parameters
    ----------
    circle
        Where an analyst sees the body.
    solve_range
        Solve for its range from the size of its image.
    search_radius_px
        How far from its prediction (or circle) the body may be; None: anywhere.
    known_surface
        The model is truer than the likelihood of the disk, which knows no map of an albedo: it is not asked.

    Returns
    -------
    BodyCenter
        `detail` is a `ModelFit`. The covariance holds the noise, what the residuals say of a pattern that the model lacks
        (`opnav_workbench.bodies.residuals`), and half of the difference from the likelihood's center (`second`).

    Raises
    ------
    CenterfindingError
        The body is not in the scene.
    """
    circles = {} if circle is None else {name: circle}
    joint = find_jointly(
        picture,
        (name,),
        circles=circles,
        solve_range=solve_range,
        search_radius_px=search_radius_px,
        known_surfaces=(name,) if known_surface else (),
    )
    return joint.centers[0]
