"""Our cameras against flight frames and flight kernels."""

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS

from opnav_workbench.camera import Camera
from opnav_workbench.geometry.rotations import matrix_from_quaternion, pointing_angles
from opnav_workbench.resources import kernels_meta_dir

pytestmark = pytest.mark.realdata

NEW_HORIZONS = ("generic/naif0012.tls", "generic/nh_v220.tf", "generic/new_horizons_1454.tsc")
SLICE_MVIC = "slices/mpf_0295610274_0x539_sci"
SLICE_MAPCAM = "slices/20190303T100344S990_map_iofL2pan_V001"
FRAMES = (
    "lor_0449855930_0x633_pwcs2.fits",
    "lor_0449855931_0x633_pwcs2.fits",
    "lor_0449933827_0x633_pwcs2.fits",
)


def shipped(name):
    return Camera.from_yaml(kernels_meta_dir() / name)


@pytest.fixture
def furnish(data_dir):
    """Function that loads kernels; the pool is empty before and after."""
    import spiceypy

    spiceypy.kclear()

    def load(*patterns):
        for pattern in patterns:
            files = sorted((data_dir / "spice").glob(pattern))
            assert files, pattern
            for file in files:
                spiceypy.furnsh(str(file))
        return spiceypy

    yield load
    spiceypy.kclear()


def best_rotation(source, target):
    """Rotation m with target = m @ source for matched unit vectors (Wahba, SVD)."""
    u, _, vt = np.linalg.svd(target.T @ source)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


@pytest.mark.parametrize("name", FRAMES)
def test_lorri_4x4_agrees_with_the_wcs_of_flight_frames(data_dir, name):
    """The frames carry a TAN-SIP solution from Gaia stars; one rotation takes its sky to our pixels."""
    camera = shipped("new_horizons/cameras/lorri_4x4.yaml")
    axes = (np.linspace(0.0, size - 1.0, 21) for size in (camera.n_pixel, camera.n_line))
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    wcs = WCS(fits.getheader(data_dir / "images/lorri_interstellar" / name))
    lon, lat = np.radians(wcs.all_pix2world(points, 0)).T
    sky = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)
    camera_from_j2000 = best_rotation(sky, camera.unproject(points))
    shift_px = camera.project(sky @ camera_from_j2000.T) - points
    assert np.hypot(*shift_px.T).max() < 0.005  # px; the budget is 0.05


@pytest.mark.parametrize(
    ("image", "camera"),
    [
        ("cropped/lor_0034974380_0x630_sci_1_cropped.fit", "lorri_1x1"),
        ("cropped/mpf_0035126517_0x539_sci_1_cropped.fits", "mvic_framing"),
    ],
)
def test_boresight_and_detector_axes_of_headers(data_dir, image, camera):
    """Headers give quaternion and angles; +Y increases with line in both, MVIC's pixels run along -Z."""
    header = fits.getheader(data_dir / "images" / image)
    camera = shipped(f"new_horizons/cameras/{camera}.yaml")
    camera_from_j2000 = matrix_from_quaternion([header[f"SPCQ{k}"] for k in "AXYZ"]).T
    ra, dec, twist = np.degrees(pointing_angles(camera_from_j2000, camera.focal_from_camera))
    assert ra == pytest.approx(header["SPCBRRA"], abs=1e-9)
    assert dec == pytest.approx(header["SPCBRDEC"], abs=1e-9)
    assert twist == pytest.approx(header["SPCPAYIN"], abs=1e-9)
    pixel_axis = camera.focal_from_camera[0]
    axis, sign = "XYZ"[int(np.abs(pixel_axis).argmax())], pixel_axis.sum()
    position_angle = header[f"SPCPA{axis}IN"] + (0.0 if sign > 0 else 180.0)
    assert (twist - position_angle) % 360.0 == pytest.approx(90.0, abs=1e-9)  # upright sky, lines upward


def test_mvic_sees_pluto_in_june_2015(furnish):
    """Pluto stays within 20 px of the boresight through the nine frames of one file."""
    spice = furnish(*NEW_HORIZONS, "generic/nh_soc_misc_v002.tf", f"{SLICE_MVIC}/*.bc", f"{SLICE_MVIC}/*.bsp")
    camera = shipped("new_horizons/cameras/mvic_framing.yaml")
    for utc in ("2015-06-03T04:05:59.624", "2015-06-03T04:06:16.236", "2015-06-03T04:06:32.848"):
        et = spice.str2et(utc)
        position, _ = spice.spkpos("999", et, "J2000", "LT", "-98")
        pixel_line = camera.project(spice.pxform("J2000", camera.frame, et) @ position)
        assert camera.on_detector(pixel_line)
        assert np.abs(pixel_line - camera.center_pixel_line).max() < 20.0


def test_mvic_axes_are_those_of_the_isis_addendum(furnish):
    """In ISIS's turned frame, sample runs along -X and line along +Y, with +Z toward the sky."""
    spice = furnish(*NEW_HORIZONS, "generic/mvicAddendum004.ti")
    camera = shipped("new_horizons/cameras/mvic_framing.yaml")
    isis_from_camera = spice.pxform(camera.frame, "ISIS_NH_RALPH_MVIC_FT", spice.str2et("2015-06-03"))
    expected = np.diag([-1.0, 1.0, 1.0]) @ isis_from_camera
    np.testing.assert_allclose(camera.focal_from_camera, expected, rtol=0, atol=1e-12)
    for axis, key in enumerate("XY"):
        values = spice.gdpool(f"INS-98900_DISTORTION_COEF_{key}", 0, 20)
        ours = (camera.distortion.x_coefficients, camera.distortion.y_coefficients)[axis]
        np.testing.assert_allclose(ours, values, rtol=0, atol=1e-15)


def test_mvic_plate_scale_of_the_flight_header(data_dir):
    """PIXFOV 19.8065 microrad was measured: our center has it with distortion, and not without."""
    header = fits.getheader(data_dir / "images/cropped/mpf_0035126517_0x539_sci_1_cropped.fits")
    camera = shipped("new_horizons/cameras/mvic_framing.yaml")
    per_pixel = np.linalg.norm(camera.unproject_jacobian(camera.center_pixel_line)[:, 0]) * 1e6
    assert per_pixel == pytest.approx(header["PIXFOV"], rel=0.001)
    assert camera.pixel_scale_rad * 1e6 != pytest.approx(header["PIXFOV"], rel=0.001)


def test_mapcam_sees_bennu_in_march_2019(furnish):
    """6.6 km away Bennu is 1100 px across; its center lies 270 px from the boresight, inside the picture."""
    spice = furnish(
        "generic/naif0012.tls", "generic/orx_v14.tf", "generic/orx_sclkscet_00065.tsc",
        f"{SLICE_MAPCAM}/*.bc", f"{SLICE_MAPCAM}/*.bsp",
    )  # fmt: skip
    camera = shipped("osiris_rex/cameras/mapcam.yaml")
    et = spice.str2et("2019-03-03T10:59:40.279") - 0.032
    position, _ = spice.spkpos("2101955", et, "J2000", "NONE", "-64")
    assert np.linalg.norm(position) == pytest.approx(6.594, abs=0.001)
    pixel_line = camera.project(spice.pxform("J2000", camera.frame, et) @ position)
    assert camera.on_detector(pixel_line)
    np.testing.assert_allclose(pixel_line, [508.0, 242.0], rtol=0, atol=2.0)


def test_frames_of_every_flight_camera_are_known_to_the_flight_kernels(furnish):
    spice = furnish("generic/nh_v220.tf", "generic/orx_v14.tf")
    flight = ("new_horizons", "osiris_rex")  # the missions whose frame kernels are at hand
    for path in sorted(p for name in flight for p in kernels_meta_dir().glob(f"{name}/cameras/*.yaml")):
        assert spice.namfrm(Camera.from_yaml(path).frame) < 0, path


def test_lorri_frame_is_the_same_for_both_binnings(furnish):
    spice = furnish(*NEW_HORIZONS)
    et = spice.str2et("2015-06-03")
    for name in ("NH_LORRI_1X1", "NH_LORRI_4X4"):
        np.testing.assert_allclose(spice.pxform("NH_LORRI", name, et), np.eye(3), rtol=0, atol=1e-14)
