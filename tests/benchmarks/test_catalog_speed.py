"""Speed of a cone of 0.3 deg in UCAC4 zone files as a ratio against rms-starcat, measured in the same run."""

import math

import pytest

from opnav_workbench.catalog import open_catalog

RADIUS = math.radians(0.3)
CENTERS = [(0.5 + 0.7 * step, 0.0015) for step in range(7)]
REQUIRED_RATIO = 20.0
OURS_A_ROUND = 20  # half a millisecond each


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
