"""Center of a body by non-linear least squares of its rendered picture to the data.

Reference: Jackman & Dumont (2013), AAS 13-443, "Non-linear Least Squares Target Centerfinding".
"""

from opnav_workbench.bodycenters.circle import Circle
from opnav_workbench.bodycenters.joint import METHOD, find_jointly
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.results import BodyCenter

__all__ = ["METHOD", "find_least_squares"]


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
    picture : BodyPicture
    name : str
    circle : Circle, optional
        Where an analyst sees the body.
    solve_range : bool
        Solve for its range from the size of its image.
    search_radius_px : float, optional
        How far from its prediction (or circle) the body may be; see `find_jointly`.

    Returns
    -------
    BodyCenter
        `detail` is a `ModelFit`. The covariance holds the noise and what the residuals say of a pattern that the model
        lacks (`opnav_workbench.bodycenters.pattern`).

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
