"""Mean motion of stars without one of their own, against measured motions."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from opnav_workbench.catalog import open_catalog
from opnav_workbench.catalog.proper_motion import mean_motion_rad_yr, with_mean_motion
from opnav_workbench.constants import RAD_PER_MAS
from opnav_workbench.geometry import tangent_basis, unit_from_radec

FIELDS = [
    (217.36, -62.68),
    (164.1, 7.0),
    (270.7, -14.6),
    (80.0, 20.0),
    (0.0, -60.0),
    (40.0, 60.0),
    (180.0, 80.0),
]


@pytest.mark.slow
def test_agrees_with_hipparcos_motions_over_the_sky():
    """Hipparcos stars of magnitude 6 to 8, where Hipparcos was complete: the model explains their common motion.

    Their mean motion projected on the model is one model's length, or up to half more: Hipparcos stars are nearer.
    """
    stars = open_catalog("bundled").cone(0.0, 0.0, np.pi, mag_limit=8.0)
    measured = np.stack([stars.pmra_rad_yr, stars.pmdec_rad_yr], axis=-1) / RAD_PER_MAS
    stars_used = stars.motion_known & (stars.mag > 6.0) & (np.hypot(*measured.T) < 100.0)
    assert stars_used.sum() > 30_000
    model = mean_motion_rad_yr(stars.ra_rad, stars.dec_rad, stars.mag)[stars_used] / RAD_PER_MAS
    for axis in (0, 1):
        slope = np.sum(model[:, axis] * measured[stars_used, axis]) / np.sum(model[:, axis] ** 2)
        assert 1.0 < slope < 1.6


@pytest.fixture(scope="module")
def tycho(data_dir):
    return open_catalog(f"npz:{data_dir / 'stars' / 'tycho2.npz'}")


@pytest.mark.realdata
@pytest.mark.parametrize("field", FIELDS)
def test_agrees_with_tycho_to_gaia_displacements(field, tycho):
    """Stars without a known motion really drift this way: within 3 mas/yr (and the noise of the median)."""
    old = tycho.cone(*np.radians(field), np.radians(4.0), 10.5)
    new = open_catalog("bundled").cone(*np.radians(field), np.radians(4.0))
    new = new.take(~new.motion_known)
    before, after = unit_from_radec(old.ra_rad, old.dec_rad), unit_from_radec(new.ra_rad, new.dec_rad)
    distance, partner = cKDTree(after).query(before)
    same = distance < np.radians(1.5 / 3600.0)
    moved = (after[partner[same]] - before[same]) / 16.0 / RAD_PER_MAS
    east, north = tangent_basis(old.ra_rad[same], old.dec_rad[same])
    measured = np.median(np.stack([np.sum(moved * east, -1), np.sum(moved * north, -1)], -1), axis=0)
    model = mean_motion_rad_yr(old.ra_rad[same], old.dec_rad[same], old.mag[same]).mean(axis=0) / RAD_PER_MAS
    assert same.sum() > 100
    assert np.all(np.abs(model - measured) < 3.0 + 3.0 * 20.0 / np.sqrt(same.sum()))


def test_known_motions_are_left_alone_and_unknown_ones_stay_marked():
    stars = open_catalog("bundled").cone(1.0, 0.3, np.radians(3.0))
    again = with_mean_motion(stars)
    np.testing.assert_array_equal(
        again.pmra_rad_yr[stars.motion_known], stars.pmra_rad_yr[stars.motion_known]
    )
    unknown = ~stars.motion_known
    assert unknown.any()
    assert np.all(np.hypot(stars.pmra_rad_yr, stars.pmdec_rad_yr)[unknown] > 0.0)
