"""Centers of one or several bodies in a picture by non-linear least squares of their rendered light to the data.

Flow   search (correlation) -> bodies that touch each other fitted together (`fit_scene`) -> `JointCenters`

Bodies that hide each other or mix their light are rendered together, as their places demand. What ties their errors to each
other is in the normal matrix: light that overlaps, an edge that one cuts into the other, the level under both. Bodies apart
are fits of their own, with a level of their own, and their errors are independent.

Reference: Jackman & Dumont (2013), AAS 13-443, "Non-linear Least Squares Target Centerfinding".
"""

from collections.abc import Mapping, Sequence

from opnav_workbench.bodies.detection import SearchRequest
from opnav_workbench.bodies.fit_report import measure_bodies
from opnav_workbench.bodies.picture import BodyPicture, Circle
from opnav_workbench.bodies.results import BodyCenter, JointCenters
from opnav_workbench.errors import CenterfindingError

__all__ = ["find_jointly", "find_least_squares"]

METHOD = "least_squares"


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
    circles
        Where an analyst sees the bodies.
    solve_range
        Solve for the range of each from the size of its image.
    search_radius_px
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
    if isinstance(names, str) or not names or len(set(names)) != len(names):
        raise CenterfindingError(f"names of bodies are {names!r}; give a list of different names.")
    return measure_bodies(
        picture,
        names,
        SearchRequest(METHOD, circles or {}, solve_range, search_radius_px),
        lambda fit: fit,
    )


def find_least_squares(
    picture: BodyPicture,
    name: str,
    *,
    circle: Circle | None = None,
    solve_range: bool = False,
    search_radius_px: float | None = None,
) -> BodyCenter:
    """Find a body's center of figure: center, brightness and a level fitted, and its range if wanted.

    Bodies that hide it or mix their light with it are fitted along; pixels of the others are left out.

    Parameters
    ----------
    circle
        Where an analyst sees the body.
    solve_range
        Solve for its range from the size of its image.
    search_radius_px
        How far from its prediction (or circle) the body may be; see `find_jointly`.

    Returns
    -------
    BodyCenter
        `detail` is a `ModelFit`. The covariance holds the noise, what size, figure, law and PSF are uncertain by, and a
        pattern that the model lacks (`opnav_workbench.bodies.scene_fit`).

    Raises
    ------
    CenterfindingError
        The body is not in the scene.
    """
    circles = {} if circle is None else {name: circle}
    joint = find_jointly(
        picture, (name,), circles=circles, solve_range=solve_range, search_radius_px=search_radius_px
    )
    return joint.centers[0]
