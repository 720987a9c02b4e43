"""Table 3 of AAS 13-443: Pluto on 2015-07-12, its albedo unknown; limb scans against correlation of the full disk."""

import numpy as np
import pytest
from PIL import Image
from table_3 import PlutoScene, table

from opnav_workbench.bodies import find_cross_correlation
from opnav_workbench.bodies.limb_scan.centerfinder import find_limb_scan
from opnav_workbench.render import AlbedoMap
from opnav_workbench.simulation.surfaces import mottled_map

RA_ARCSEC, DEC_ARCSEC = 0.12, 0.03  # of the paper's hand-picked scans
BETTER = 8.0  # the median's ratio that is asked for
DISKS = 4  # of the pictures have their whole disk measured too


@pytest.fixture(scope="module")
def pluto():
    return PlutoScene()


def _table(pluto, maps):
    scans, disks = [], []
    for seed, albedo in enumerate(maps):
        picture = pluto.picture(albedo, seed)
        scan = find_limb_scan(picture, "PLUTO")
        assert scan.status == "ok", scan.messages
        scans.append(pluto.error_arcsec(scan))
        # A whole disk of another pattern than the model's may be doubted, and is an arcsecond off: four tell its order.
        if seed < DISKS:
            disks.append(pluto.error_arcsec(find_cross_correlation(picture, "PLUTO")))
    return np.array(scans), np.array(disks)


def _check(scans, disks):
    assert np.abs(scans[:, 0]).max() < RA_ARCSEC
    assert np.sqrt(np.mean(scans[:, 1] ** 2)) < DEC_ARCSEC
    disk = np.median(np.hypot(*disks.T))
    assert 0.3 < disk < 3.0  # the order of an arcsecond
    assert np.median(np.hypot(*scans.T)) * BETTER < disk


@pytest.mark.slow
def test_ten_mottled_maps(pluto):
    """The paper's errors are those of one picture; of ten surfaces, the rms is held beside that of declination.

    The law, the PSF and the albedo's strength are unknowns of the scans: each of ten within 0.03 arcsec would ask for a
    sigma of 0.012; theirs is 0.04.
    """
    _check(*_table(pluto, [AlbedoMap(mottled_map(seed, 0.2, 0.8)) for seed in range(1, 11)]))


@pytest.mark.slow
@pytest.mark.realdata
def test_the_published_map_of_hubble(pluto, data_dir):
    """The pattern of Buie et al. (2010), stretched to albedos 0.1 to 0.8, at four longitudes."""
    with Image.open(data_dir / "maps" / "hs-2010-06-g-full_jpg.jpg") as published:
        gray = np.asarray(published.convert("L").resize((768, 384))) / 255.0
    maps = [AlbedoMap(0.1 + 0.7 * gray, first_longitude_deg=east) for east in (0.0, 90.0, 180.0, 270.0)]
    _check(*_table(pluto, maps))


@pytest.mark.slow
def test_the_table_by_command_has_a_line_for_each_method():
    head, line = table(1, methods=("limb_scan",))
    assert "RA rms" in head
    assert line.split()[0] == "limb_scan"
    assert float(line.split()[3]) < RA_ARCSEC
