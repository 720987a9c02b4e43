"""Limbs of real bodies, measured without their kernels: Enceladus, Earth and Eros."""

import numpy as np
import pytest
import spiceypy as spice

from opnav_workbench.bodies import BodyFlag, BodyPicture, Circle
from opnav_workbench.bodies.ellipse import find_ellipse
from opnav_workbench.bodies.lighting import fit_lighting
from opnav_workbench.bodies.picture import picture_from_circle
from opnav_workbench.bodies.silhouette import body_outline
from opnav_workbench.image import KeywordMap, column_level, estimate_background, read_image
from opnav_workbench.mission import load_mission
from opnav_workbench.psf import GaussianPsf
from opnav_workbench.render import BodyModel, LunarLambert
from opnav_workbench.targets import TargetState

pytestmark = pytest.mark.realdata

ENCELADUS_KM = (256.6, 251.4, 248.3)  # IAU 2009/2015, as in pck00010.tpc
EARTH_KM = (6378.137, 6378.137, 6356.752)
EROS_KM = (17.0, 5.5, 5.5)  # pck00011.tpc


def opened(data_dir, mission, name, **options):
    """A picture read with the mission's keywords, and the camera that took it."""
    loaded = load_mission(mission)
    frame = read_image(data_dir / "images" / "resolved" / name, KeywordMap(**loaded.keywords), **options)
    return frame, loaded.camera_for(frame.header)


@pytest.mark.slow
def test_enceladus_full_disk(data_dir):
    """Cassini on its way to Enceladus; the circle, the Sun and the equator's direction are the analyst's.

    The picture shows the side away from Saturn: the ellipse has the ratio of the second to the third radius.
    """
    frame, camera = opened(data_dir, "cassini", "N1489034146_2.IMG")
    circle = Circle([512.0, 600.0], 291.0)
    picture = picture_from_circle(
        frame.image_dn, camera, circle, radii_km=ENCELADUS_KM, phase_rad=np.radians(48.0),
        sun_angle_rad=np.radians(184.0), north_angle_rad=np.radians(-63.2), sub_observer_rad=(np.pi, 0.0),
        name="ENCELADUS",
    )  # fmt: skip
    found = find_ellipse(picture, "ENCELADUS", circle=circle)
    limb = found.detail
    assert found.status == "ok", found.messages
    assert limb.rms_px < 0.5  # measured: 0.28
    assert np.degrees(limb.lit_arc_rad) > 150.0
    np.testing.assert_allclose(limb.free.ratio, 1.0, rtol=0, atol=0.01)  # measured: 0.995, 0.998
    assert limb.free.residual_rms_px < 0.6
    assert limb.free.ellipse.semi_axes[0] / limb.free.ellipse.semi_axes[1] == pytest.approx(
        251.4 / 248.3, abs=0.01
    )
    # The size tells the range, as well as the radii are known; the covariance knows of the relief.
    assert found.range_km == pytest.approx(1.432e5, rel=0.005)
    assert 0.05 < np.sqrt(found.covariance_px2[0, 0]) < 1.5
    assert found.covariance_px2[0, 0] > 100.0 * found.noise_covariance_px2[0, 0]


def test_a_real_moon_tells_how_it_is_lit(data_dir):
    """The analyst's phase of 48 deg and Sun at 184 deg, of the test above, from a circle alone, even a poor one."""
    frame, _ = opened(data_dir, "cassini", "N1489034146_2.IMG")
    signal = frame.image_dn - np.median(frame.image_dn[:128])
    for circle in (Circle([512.0, 600.0], 291.0), Circle([530.0, 590.0], 310.0)):
        lit = fit_lighting(signal, np.zeros(signal.shape, dtype=bool), circle)
        assert np.degrees(lit.phase_rad) == pytest.approx(48.0, abs=4.0)  # measured: 48.5
        assert np.degrees(lit.sun_angle_rad) % 360.0 == pytest.approx(184.0, abs=8.0)  # measured: 178
        assert lit.unexplained < 0.02


@pytest.mark.slow
def test_earth_from_hayabusa2(data_dir):
    """A cloudy Earth of 52 px in a smeared wide-angle picture.

    The header has range (202 859 km) and attitude; with the trajectory of eight hours later, propagated back, they put Earth
    at pixel 566.3, line 773.0 and give phase, Sun and pole. None of the place is used here but a circle.
    """
    frame, camera = opened(
        data_dir, "hayabusa2", "hyb2_onc_20151203_000006_w2f_l2a.fit", saturation_dn=4095.0
    )
    circle = Circle([562.0, 774.0], 27.0)
    picture = picture_from_circle(
        frame.image_dn, camera, circle, radii_km=EARTH_KM, range_km=202_859.0, phase_rad=np.radians(56.1),
        sun_angle_rad=np.radians(168.1), north_angle_rad=np.radians(-18.5),
        sub_observer_rad=tuple(np.radians([-176.8, 33.8])), name="EARTH", saturated=frame.saturated,
        background_dn=column_level(frame.image_dn),
    )  # fmt: skip
    found = find_ellipse(picture, "EARTH", circle=circle)
    assert found.status in ("ok", "uncertain")
    np.testing.assert_allclose(found.pixel_line, [566.3, 773.0], rtol=0, atol=1.6)  # 567.8, 773.7
    assert found.detail.rms_px < 0.5
    assert np.degrees(found.detail.lit_arc_rad) > 140.0


@pytest.mark.slow
def test_eros_is_no_ellipsoid(data_dir):
    """A nose of Eros, cut by two edges; place, attitude and range from the header, its pole and radii from a PCK."""
    frame, camera = opened(data_dir, "near", "m0126865998f4_2p_iof.lbl")
    header = frame.header
    craft, body = (np.array([header[f"NEAR-{k:03d}"] for k in keys]) for keys in ((23, 24, 25), (27, 28, 29)))
    kernel = str(data_dir / "spice" / "generic" / "pck00011.tpc")
    spice.furnsh(kernel)
    turn = spice.tipbod("J2000", 2000433, frame.et)
    spice.unload(kernel)
    target = TargetState("EROS", body - craft, radii_km=EROS_KM, body_from_j2000=turn, sun_position_km=-body)
    sky = estimate_background(frame.image_dn, frame.image_dn > 0.002)
    picture = BodyPicture(
        frame.image_dn - sky.level_dn, np.maximum(sky.noise_dn, 1e-4), frame.bad, frame.saturated, camera,
        frame.header_geometry.camera_from_j2000, np.zeros(3), (BodyModel(target, LunarLambert(0.7)),),
        GaussianPsf(0.9, 0.9),
    )  # fmt: skip
    found = find_ellipse(picture, "EROS")
    limb = found.detail
    assert found.status == "uncertain"
    expected = BodyFlag.CUT_BY_EDGE | BodyFlag.WEAK_GEOMETRY
    assert found.flags & expected == expected
    # The limb itself is found along the lower side, as far as an ellipse follows it: half way between disk and sky.
    used = limb.points_px[limb.status == "used"]
    assert len(used) > 20
    assert np.ptp(used[:, 0]) > 200.0
    for pixel, line in used[5:-5:8]:
        column = picture.signal_dn[:, round(float(pixel))]
        inside, outside = column[round(float(line)) - 4], column[round(float(line)) + 4]
        assert outside < 0.55 * inside
        assert outside < column[round(float(line))] < 1.1 * inside
    # Two lobes are no ellipsoid: its center is doubted, and tens of px from where the header has it.
    assert np.hypot(*(found.pixel_line - picture.center_px("EROS"))) < 150.0
    assert np.all(np.isfinite(body_outline(picture, "EROS").radius_px))
