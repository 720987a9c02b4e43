"""Speed of a cone of 0.3 deg in UCAC4 zone files as a ratio against rms-starcat, measured in the same run."""

import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from opnav_workbench.catalog import open_catalog
from opnav_workbench.geometry import unit_from_radec

RADIUS = math.radians(0.3)
CENTERS = [(0.5 + 0.7 * step, 0.0015) for step in range(7)]
REQUIRED_RATIO = 20.0
OURS_A_ROUND = 20  # half a millisecond each
SKY_STARS = 300_000


def peer_cone(catalog, ra, dec):
    """The stars of a cone, brightest first: starcat knows boxes, so that its user has to cut the corners."""
    box = catalog.find_stars(
        ra_min=ra - RADIUS,
        ra_max=ra + RADIUS,
        dec_min=dec - RADIUS,
        dec_max=dec + RADIUS,
        return_everything=True,
    )
    sin_dec, cos_dec, limit = math.sin(dec), math.cos(dec), math.cos(RADIUS)
    inside = [
        star
        for star in box
        if sin_dec * math.sin(star.dec) + cos_dec * math.cos(star.dec) * math.cos(star.ra - ra) >= limit
    ]
    return sorted(inside, key=lambda star: star.vmag)


@pytest.mark.benchmark(group="catalog cone")
def test_a_cone_in_ucac4_zones_is_twenty_times_faster_than_a_python_reader(
    ucac4_folder, fastest, benchmark
) -> None:
    from starcat.ucac4 import UCAC4StarCatalog  # half a second

    ours, peer = open_catalog(f"ucac4:{ucac4_folder}"), UCAC4StarCatalog(ucac4_folder)
    assert {star.id_str for star in peer_cone(peer, *CENTERS[0])} == set(ours.cone(*CENTERS[0], RADIUS).id)
    peer_s = ours_s = 0.0
    for center in CENTERS:
        (one_peer_s, _), (one_s, _) = fastest(
            lambda center=center: peer_cone(peer, *center),
            lambda center=center: ours.cone(*center, RADIUS),
            enough=lambda peer_s, ours_s: peer_s > REQUIRED_RATIO * ours_s,
            times=(1, OURS_A_ROUND),
        )
        peer_s, ours_s = peer_s + one_peer_s, ours_s + one_s
    ratio = peer_s / ours_s
    benchmark.extra_info["ratio to rms-starcat"] = round(ratio, 1)
    stars = benchmark(ours.cone, *CENTERS[0], RADIUS)
    assert len(stars) > 400
    assert ratio > REQUIRED_RATIO


@pytest.mark.slow
@pytest.mark.parametrize(
    ("radius_deg", "most"), [(0.3, 3.0), (1.0, 2.5), (5.0, 2.3), (20.0, 2.0), (60.0, 2.0)]
)
def test_cones_against_a_tree_of_the_same_stars(tmp_path, fastest, radius_deg, most):
    """Places and magnitudes of a cone's stars, brightest first, against the bare rows of a KD-tree, in any order.

    At small radii both are fixed costs, 0.023 and 0.013 ms: twice the tree's, and a margin for a loaded machine.
    """
    rng = np.random.default_rng(18)
    ra, dec = rng.uniform(0.0, 360.0, SKY_STARS), np.degrees(np.arcsin(rng.uniform(-1.0, 1.0, SKY_STARS)))
    mag = np.round(rng.uniform(5.0, 12.0, SKY_STARS), 2)  # many are alike
    path = tmp_path / "sky.npz"
    np.savez(path, ra_deg=ra, dec_deg=dec, mag=mag)
    catalog = open_catalog(f"npz:{path}")
    vectors = unit_from_radec(np.radians(ra), np.radians(dec))
    tree, radius = cKDTree(vectors), math.radians(radius_deg)
    centers = [(0.7 * k, 0.3 * k - 0.5) for k in range(4)]
    catalog.cone(0.0, 0.0, 0.5 * math.pi)  # the first large cone finds what the next ones need

    def of_tree():
        chord = 2.0 * math.sin(0.5 * radius)
        return [np.array(tree.query_ball_point(unit_from_radec(*c), chord), int) for c in centers]

    def ours():
        found = [catalog.cone(*c, radius) for c in centers]
        return [(stars.ra_rad, stars.dec_rad, stars.mag) for stars in found]

    (tree_s, rows), (ours_s, columns) = fastest(
        of_tree, ours, enough=lambda tree_s, ours_s: ours_s <= most * tree_s
    )
    for row, (found_ra, found_dec, found_mag) in zip(rows, columns, strict=True):
        expected = row[np.lexsort((row, mag[row]))]
        np.testing.assert_array_equal(found_mag, mag[expected])
        np.testing.assert_allclose(found_ra, np.radians(ra[expected]), rtol=1e-15)
        np.testing.assert_allclose(found_dec, np.radians(dec[expected]), rtol=1e-15)
    assert ours_s <= most * tree_s
