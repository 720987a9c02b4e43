"""Center of a body by scans across its limb, which albedo features on its disk do not move.

Flow   expected place -> coarse search -> scans over a wide range (`scan_capture`) -> rendered model at the center ->
       data and model along each scan -> offset of each (`scan_matching`) -> scans chosen (`scan_choice`) -> center by
       least squares (`scan_center`) -> model at the new center, until that moves by less than 0.01 px

Reference: Jackman & Dumont (2013), AAS 13-443, "Limb-Scanning Algorithm for Target Centerfinding".
"""

from collections.abc import Sequence

import numpy as np

from opnav_workbench.bodycenters.circle import Circle
from opnav_workbench.bodycenters.expectation import Expectation, Found, expect, find_place
from opnav_workbench.bodycenters.picture import BodyPicture
from opnav_workbench.bodycenters.results import BodyCenter
from opnav_workbench.bodycenters.scan_capture import capture
from opnav_workbench.bodycenters.scan_choice import Choice, check_numbers
from opnav_workbench.bodycenters.scan_fan import N_SCANS
from opnav_workbench.bodycenters.scan_iteration import FEWEST, iterate
from opnav_workbench.bodycenters.scan_report import ScanRun, report
from opnav_workbench.bodycenters.silhouette import Silhouette
from opnav_workbench.errors import CenterfindingError

__all__ = ["METHOD", "find_limb_scan"]

METHOD = "limb_scan"
WELL_EXPLAINED = 0.6  # share of the light under the model; an albedo map of Pluto's contrast leaves 0.9


def find_limb_scan(
    picture: BodyPicture,
    name: str,
    *,
    circle: Circle | None = None,
    scans: Sequence[int] | None = None,
    n_scans: int = N_SCANS,
    solve_range: bool = False,
    search_radius_px: float | None = None,
) -> BodyCenter:
    """Find a body's center of figure with scans across its limb.

    Brightness and background of every scan are free, and the albedo near the limb is taken for a random function whose
    roughness the data tell; so neither an albedo map nor a wrong scattering law moves the center much.

    Parameters
    ----------
    picture : BodyPicture
    name : str
    circle : Circle, optional
        Where an analyst sees the body.
    scans : sequence of int, optional
        Numbers of the scans to use; scan k leaves the center at ``360 k / n_scans`` degrees from +pixel toward +line.
        None: they are chosen automatically.
    n_scans : int
        How many there are.
    solve_range : bool
        Solve for the range from the size of the image. Without, the body has the size of its model unless the limb
        clearly says otherwise.
    search_radius_px : float, optional
        How far from its prediction (or circle) the body may be.

    Returns
    -------
    BodyCenter
        `detail` is a `LimbScans`: every scan with its offset and the reason why it was used or not. Status ``ok``;
        ``uncertain`` (see its messages); ``not_detected``, ``off_detector``, ``saturated`` or ``failed`` without a
        center. `diameter_px` is measured with the same scans.

    Raises
    ------
    CenterfindingError
        The body is not in the scene, has no size, or a scan number does not exist.
    """
    if n_scans < FEWEST:
        raise CenterfindingError(
            f"{n_scans} scans cannot give a center; use {FEWEST} at least, such as {N_SCANS}."
        )
    numbers = None if scans is None else check_numbers(scans, n_scans)
    silhouette = Silhouette(picture, name)
    expected = expect(picture, name, METHOD, circle, search_radius_px)
    if isinstance(expected, BodyCenter):
        return expected
    found = _found(picture, expected, solve_range=solve_range)
    if isinstance(found, BodyCenter):
        return found
    try:
        captured = capture(picture, silhouette, found.sized_place.center_px, 1.0 / found.size_ratio, n_scans)
        rounds = iterate(picture, name, captured, numbers, solve_size=solve_range)
    except CenterfindingError as error:
        return BodyCenter.without_center(name, METHOD, "failed", str(error))
    if rounds.last is None:
        return _undetermined(name, rounds.choice)
    return report(ScanRun(picture, found, captured, rounds, numbers is not None, solve_range), METHOD)


def _found(picture: BodyPicture, expected: Expectation, *, solve_range: bool) -> Found | BodyCenter:
    """Search with the size that is expected; with other sizes, which takes longer, only if that explains little."""
    found = find_place(picture, expected, METHOD, solve_range=solve_range, other_sizes=False)
    unseen = isinstance(found, BodyCenter) and found.status == "not_detected"
    if unseen or (isinstance(found, Found) and found.place.explained < WELL_EXPLAINED):
        return find_place(picture, expected, METHOD, solve_range=solve_range)
    return found


def _undetermined(name: str, choice: Choice) -> BodyCenter:
    reasons, counts = np.unique(choice.reason[~choice.chosen], return_counts=True)
    said = [f"{n} scans: {text}" for n, text in sorted(zip(counts, reasons, strict=True), reverse=True)]
    message = f"{int(choice.chosen.sum())} usable scans do not determine a center"
    return BodyCenter.without_center(name, METHOD, "failed", message, *said[:3])
