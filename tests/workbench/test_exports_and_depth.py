"""What the workbench writes for other programs, what it says of the catalog's depth, and lost in space by one button."""

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS

from opnav_workbench.geometry import geometric_direction, radec_from_unit
from opnav_workbench.kernels import KernelSet
from opnav_workbench.rehearsal import DEMO_KERNELS
from opnav_workbench.session import ImageSession
from opnav_workbench.workbench import field_depth as depth

pytestmark = pytest.mark.slow


def test_marks_and_picture_for_other_programs(hands_on, demo_truths, tmp_path):
    hands = hands_on(demo_truths[0].picture, out=tmp_path)
    hands.press("4")
    hands.send("write_fits")
    assert "no pointing is solved" in hands.said
    hands.press("1", "f", "A", "p", "4")
    hands.send("write_fits")
    assert hands.kind == "done", hands.said
    hands.send("write_regions")
    folder, session = hands.controller.queue.item.folder, hands.session
    # The WCS says of every pixel what the camera's model says with the solved attitude, aberration taken out.
    with fits.open(folder / "picture_wcs.fits") as file:
        wcs = WCS(file[0].header)
        np.testing.assert_allclose(file[0].data, session.context.picture.image_dn, rtol=1e-6)
    places = np.array([[0.0, 0.0], [255.0, 3.0], [100.2, 200.7]])
    rays = session.context.camera.unproject(places) @ session.camera_from_j2000
    ra, dec = np.degrees(radec_from_unit(geometric_direction(rays, session.inputs.observer.velocity_km_s)))
    found = wcs.all_pix2world(places, 0)
    np.testing.assert_allclose(
        (found[:, 0] - ra) * np.cos(np.radians(dec)), 0.0, atol=0.01 / 3600.0
    )  # 4 arcsec a pixel
    np.testing.assert_allclose(found[:, 1], dec, atol=0.01 / 3600.0)
    # DS9 counts from 1.
    regions = (folder / "regions.reg").read_text().splitlines()
    circles = {line.split("text={")[1].rstrip("}"): line for line in regions if line.startswith("circle")}
    used = [star for star in session.result()["stars"] if star["status"] == "used"]
    assert len(circles) == len(used) == 4
    for star in used:
        pixel, line = (float(number) for number in circles[star["id"]][len("circle(") :].split(",")[:2])
        np.testing.assert_allclose((pixel, line), np.array(star["observed"]) + 1.0, atol=1e-3)


def test_depth_that_is_missing_is_told_with_its_command(demo_truths, monkeypatch):
    with KernelSet(DEMO_KERNELS):
        session = ImageSession.open(demo_truths[0].picture, "new_horizons")
    monkeypatch.setattr(depth, "faintest_magnitude", lambda context: 14.2)
    missing = depth.field_depth(session)
    assert "the picture shows stars to about 14.2 mag" in missing.line
    ra, dec, radius, mag = (float(missing.command.split()[i]) for i in (5, 6, 7, 9))
    boresight = session.camera_from_j2000.T @ session.context.camera.boresight
    np.testing.assert_allclose(np.degrees(radec_from_unit(boresight)), (ra, dec), atol=1e-3)
    assert mag == 14.5
    assert radius > np.degrees(session.context.camera.half_diagonal_rad)
    monkeypatch.setattr(depth, "faintest_magnitude", lambda context: 8.0)
    assert depth.field_depth(session).command == ""


def test_whole_sky_is_searched_by_one_key_and_says_why_not(hands_on, demo_truths):
    hands = hands_on(demo_truths[0].picture)
    before = hands.steps
    hands.press("2", "L")
    assert hands.kind == "error"
    assert "8 detections or more" in hands.said  # this picture has 6
    assert hands.steps == before
