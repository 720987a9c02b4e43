"""Center of a disk: measured by its likelihood, read a second time in another way, and judged.

Flow   measured disk -> crossings of the limb at half of the local brightness: a second reading that knows neither weights
       nor albedo -> judgement (`opnav_workbench.bodies.judgement`) -> `BodyCenter`
"""

from dataclasses import replace

import numpy as np

from opnav_workbench.bodies.disk.columns import Unknown
from opnav_workbench.bodies.disk.fitted import DiskFit
from opnav_workbench.bodies.disk.measurement import MeasuredDisk, alike, measure_disk
from opnav_workbench.bodies.judgement import (
    POOR_CHI2,
    CenterReading,
    crossing_reading,
    difference_covariance,
    disk_reading,
    judged_center,
)
from opnav_workbench.bodies.picture import BodyPicture, Circle
from opnav_workbench.bodies.results import BodyCenter, DiskReading, SecondReading
from opnav_workbench.threads import one_thread

__all__ = ["METHOD", "find_disk", "judged_disk"]

METHOD = "disk"
# Variance of the crossings' center over what they say, as patterns and relief reach neighbouring crossings in common:
# measured on 240 disks (`tests/bodies/disk_exam.py`, grids full and odd).
CROSSING_EXCESS = 2.0


def find_disk(
    picture: BodyPicture,
    name: str,
    *,
    circle: Circle | None = None,
    solve_range: bool = True,
    search_radius_px: float | None = None,
    quick: bool = False,
) -> BodyCenter:
    """Find a body's center of figure from all pixels about its limb.

    Parameters
    ----------
    name
        A sphere, a triaxial ellipsoid or a shape model of `picture.models`.
    circle
        An analyst's; None: predicted place and size.
    solve_range
        Tell the range as well: that of a body of the model's size, with the uncertainty of that size.
    search_radius_px
        How far from the expected place to look; None: anywhere.
    quick
        Fit the disk only where it is found, and leave out the fits that begin elsewhere: for what is asked of a picture
        once more, such as where the center lies if the Sun stands beside its place.

    Returns
    -------
    BodyCenter
        Method ``disk``; `detail` is a `DiskReading`. Status ``ok`` where a second reading of the same pixels confirms
        the center; ``uncertain`` (see `flags` and `messages`), ``not_detected``, ``saturated`` or ``failed`` else.

    Raises
    ------
    CenterfindingError
        No such body in the picture.

    Notes
    -----
    The covariance is marginal over the body's albedo (a Gaussian random field whose strength and correlation length
    follow from the picture), size, axes, topography of the limb, scattering law, PSF and background.
    """
    disk = measure_disk(picture, name, METHOD, circle, search_radius_px, quick=quick)
    return disk if isinstance(disk, BodyCenter) else judged_disk(disk, solve_range=solve_range)


@one_thread()
def judged_disk(disk: MeasuredDisk, *, solve_range: bool = True) -> BodyCenter:
    """Return the center of a measured disk, read a second time and judged; parameters as of `find_disk`."""
    second = crossing_reading(disk, disk.fit.center_px, disk.fit.covariance_px2)
    reading = disk_reading(disk, METHOD, second)
    if second is not None:
        patterned = disk.crossing is not None and disk.crossing.patterned  # by the likelihood's own albedo
        if alike(disk.fit, disk.crossing) and not patterned:
            reading = _of_both(reading, second)
        elif patterned or _better_supported(reading, second):
            reading = _with_difference(reading, second)
        else:
            reading = _crossings_instead(reading, second)
    return judged_center(disk, reading, _detail(disk.fit), solve_range=solve_range)


def _better_supported(reading: CenterReading, second: SecondReading) -> bool:
    """Tell whether a likelihood is to be believed where the crossings differ.

    It has come to rest at an image that is the picture's, within noise and grain, and knows the center better.
    """
    explained = reading.converged and not reading.chi2_reduced > POOR_CHI2
    other = CROSSING_EXCESS * second.covariance_px2
    return bool(explained and np.trace(reading.covariance_px2) <= np.trace(other))


def _of_both(reading: CenterReading, second: SecondReading) -> CenterReading:
    """Return the weighted center of two readings that agree.

    The crossings know neither weights nor albedo: they hold what a likelihood leaves open, such as the center along the
    Sun where law and shading are not the picture's.
    """
    own, other = reading.covariance_px2, CROSSING_EXCESS * second.covariance_px2
    share = own @ np.linalg.inv(own + other)  # of the second
    away = second.pixel_line - reading.center_px
    apart = _with_difference(reading, second)
    return replace(
        apart, center_px=reading.center_px + share @ away, covariance_px2=apart.covariance_px2 - share @ own
    )


def _with_difference(reading: CenterReading, second: SecondReading) -> CenterReading:
    """Return a center with the difference of two readings of the same pixels in its covariance.

    What a likelihood knows rests on its model; half of the difference from a reading without one stands for where no model
    is right, as far as it is more than both expect.
    """
    more = difference_covariance(second.pixel_line - reading.center_px, second.difference_sigmas)
    return replace(reading, covariance_px2=reading.covariance_px2 + more)


def _crossings_instead(reading: CenterReading, second: SecondReading) -> CenterReading:
    """Return the crossings' center where a likelihood that is less to be believed differs from it.

    Half of the local brightness is never far from the limb. That they differ is in the covariance.
    """
    covariance = second.covariance_px2 + difference_covariance(second.pixel_line - reading.center_px)
    other = SecondReading(
        "the likelihood of the disk", reading.center_px, reading.covariance_px2, second.difference_sigmas
    )
    return replace(reading, center_px=second.pixel_line, covariance_px2=covariance, second=other)


def _detail(fit: DiskFit) -> DiskReading:
    return DiskReading(
        outline_px=fit.smooth_outline.points(fit.outline.angle_rad),
        size_ratio=float(np.exp(fit.shape.log_size)),
        size_ratio_sigma=float(np.exp(fit.shape.log_size)) * fit.sigma(Unknown.SIZE),
        strain=fit.shape.strain[:2],
        law_shares=fit.solution.theta[[Unknown.LAW, Unknown.LAW_2]],
        albedo_sigma=fit.prior.albedo,
        albedo_length_rad=fit.prior.length_rad,
        limb_roughness_px=fit.prior.rough_px,
        steps_px=np.array(fit.lengths_px),
    )
