"""Flight frames of four missions, and the Sun's place against DE440."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import spiceypy as spice

from opnav_workbench.constants import AU_KM
from opnav_workbench.errors import ImageError
from opnav_workbench.geometry import radec_from_unit
from opnav_workbench.image import KeywordMap, barycentric_from_heliocentric, estimate_background, read_image

pytestmark = pytest.mark.realdata

MM_S = 1e-6  # km/s
LORRI = KeywordMap(
    exposure_s="EXPTIME",
    et="SPCSCET",
    utc="SPCUTCAL",
    sclk="SPCSCLK",
    quaternion=("SPCQA", "SPCQX", "SPCQY", "SPCQZ"),
    sun_position=("SPCSSCX", "SPCSSCY", "SPCSSCZ"),
    sun_velocity=("SPCSSCVX", "SPCSSCVY", "SPCSSCVZ"),
    target="SPCTCB",
    geometry_quality="SPCQUAL",
    error_extension="LORRI Error image",
    quality_extension="LORRI Quality flag image",
    quality_table="new_horizons_lorri",
    dark_columns={257: 1, 1028: 4},
    required={"INSTRU": "lor"},
)
MVIC = replace(
    LORRI,
    error_extension=2,
    quality_extension=3,
    quality_table="new_horizons_mvic",
    required={"INSTRU": "mvi"},
)
NEAR = KeywordMap(exposure_s="NEAR-010", exposure_scale=1e-3, sclk="NEAR-018", target="NEAR-047")
CASSINI = KeywordMap(
    exposure_s="EXPOSURE_DURATION",
    exposure_scale=1e-3,
    utc="IMAGE_MID_TIME",
    sclk="SPACECRAFT_CLOCK_STOP_COUNT",
    target="TARGET_NAME",
    required={"INSTRUMENT_ID": ["ISSNA", "ISSWA"]},
)


@pytest.fixture
def images(data_dir) -> Path:
    return data_dir / "images"


@pytest.fixture
def kernels(data_dir):
    """Load the planets, New Horizons and the leap seconds for one test."""
    folder = data_dir / "spice"
    names = (
        "generic/naif0012.tls",
        "derived/de440_excerpt_2006_2030.bsp",
        "derived/new_horizons_from_horizons.bsp",
    )
    paths = [str(folder / name) for name in names]
    spice.furnsh(paths)
    yield spice
    spice.unload(paths)


INTERSTELLAR = {  # exposure in seconds and number of saturated pixels, counted in the quality planes
    "0449855930": (0.5006, 0),
    "0449855931": (0.5006, 0),
    "0449855932": (0.5006, 0),
    "0449933827": (4.9676, 2),
    "0449933832": (4.9676, 0),
    "0449933837": (4.9676, 2),
}


@pytest.mark.parametrize("met", INTERSTELLAR)
def test_lorri_interstellar(images, kernels, met):
    exposure_s, n_saturated = INTERSTELLAR[met]
    frame = read_image(images / "lorri_interstellar" / f"lor_{met}_0x633_pwcs2.fits", LORRI)
    assert frame.image_dn.shape == (256, 256)
    assert frame.exposure_s == exposure_s
    assert kernels.str2et(frame.utc) == pytest.approx(frame.et, abs=1e-3)
    assert LORRI.value(frame.header, "target") is None  # the header says UNKNOWN
    # The 34 pixels that carry housekeeping, and nothing else; saturated ones stand at 4095 DN minus the bias.
    assert np.argwhere(frame.bad).tolist() == [[0, pixel] for pixel in range(34)]
    assert np.count_nonzero(frame.saturated) == n_saturated
    assert np.all(np.abs(frame.image_dn[frame.saturated] + frame.header["BIASLEVL"] - 4095.0) < 20.0)
    assert np.all(frame.error_dn > 1.0)  # where the file has 0 too
    assert frame.header_geometry.quality == "PREDICT"


@pytest.mark.parametrize("met", ["0449933827", "0449933832", "0449933837"])
def test_background_of_flight_frames(images, met):
    """The fainter half of the residuals, which has no stars, scatters as the noise map says."""
    frame = read_image(images / "lorri_interstellar" / f"lor_{met}_0x633_pwcs2.fits", LORRI)
    background = estimate_background(frame.image_dn, frame.bad | frame.saturated)
    residual = ((frame.image_dn - background.level_dn) / background.noise_dn)[~frame.bad]
    assert np.sqrt((residual[(residual < 0.0) & (residual > -5.0)] ** 2).mean()) == pytest.approx(
        1.0, abs=0.07
    )
    assert abs(np.median(residual)) < 0.1
    assert np.median(background.noise_dn) == pytest.approx(np.median(frame.error_dn), rel=0.25)


@pytest.mark.parametrize(
    ("name", "keywords", "boresight"),
    [
        ("lor_0034974380_0x630_sci_1_cropped.fit", LORRI, (0, 0, -1)),
        ("mc1_0034942918_0x536_eng_1_cropped.fits", MVIC, (-1, 0, 0)),
        ("mc3_0034948318_0x536_sci_1_cropped.fits", MVIC, (-1, 0, 0)),
        ("mp1_0042515645_0x530_sci_1_cropped.fits", MVIC, (-1, 0, 0)),
    ],
)
def test_quaternion_gives_the_header_boresight(images, name, keywords, boresight):
    frame = read_image(images / "cropped" / name, keywords)
    ra, dec = radec_from_unit(np.array(boresight, float) @ frame.header_geometry.camera_from_j2000)
    assert np.degrees(ra) == pytest.approx(frame.header["SPCBRRA"], abs=1e-9)
    assert np.degrees(dec) == pytest.approx(frame.header["SPCBRDEC"], abs=1e-9)
    assert frame.header_geometry.quality == "RECONSTRUCTED"


@pytest.mark.parametrize(
    ("name", "keywords"),
    [
        ("lor_0034974380_0x630_sci_1_cropped.fit", LORRI),
        ("mc3_0034948318_0x536_sci_1_cropped.fits", MVIC),
    ],
)
def test_header_trajectory_agrees_with_spice(images, kernels, name, keywords):
    """Signs and frame of the Sun vector: the trajectories differ by 100 km, the barycenters by 118 km."""
    frame = read_image(images / "cropped" / name, keywords)
    geometry = frame.header_geometry
    position, velocity = barycentric_from_heliocentric(
        geometry.spacecraft_from_sun_km, geometry.spacecraft_velocity_km_s, frame.et
    )
    truth, _ = kernels.spkez(-98, frame.et, "J2000", "NONE", 0)
    assert np.linalg.norm(position - truth[:3]) < 400.0
    assert np.linalg.norm(velocity - truth[3:]) < 1000.0 * MM_S


def test_frame_of_the_sister_instrument_is_refused(images):
    with pytest.raises(ImageError, match="INSTRU = 'mvi', expected 'lor'"):
        read_image(images / "cropped" / "mc3_0034948318_0x536_sci_1_cropped.fits", LORRI)
    with pytest.raises(ImageError, match="cube of 3 x 25 x 25"):
        read_image(images / "cropped" / "mpf_0035126517_0x539_sci_1_cropped.fits", MVIC)


def test_hayabusa2(images):
    keywords = KeywordMap(
        exposure_s="XPOSURE", utc="DATE-OBS", target="OBJECT", required={"TELESCOP": "HAYABUSA2"}
    )
    frame = read_image(images / "resolved" / "hyb2_onc_20151203_000006_w2f_l2a.fit", keywords)
    assert frame.image_dn.shape == (1024, 1024)
    assert (frame.exposure_s, frame.utc) == (0.0041, "2015-12-03T00:00:06.639")
    assert frame.image_dn.max() == frame.header["DATAMAX"]
    assert keywords.value(frame.header, "target") == "EARTH"


def test_near_with_and_without_label(images):
    """The FITS header knows the spacecraft clock only; the detached label beside it knows UTC."""
    fit = read_image(images / "resolved" / "m0126865998f4_2p_iof.fit", NEAR)
    assert fit.image_dn.shape == (244, 537)
    assert fit.exposure_s == pytest.approx(0.089, abs=1e-12)
    assert (fit.et, fit.sclk) == (None, "126865998.8745")
    label = replace(NEAR, utc="START_TIME", time_reference="start")
    labelled = read_image(images / "resolved" / "m0126865998f4_2p_iof.lbl", label)
    np.testing.assert_array_equal(labelled.image_dn, fit.image_dn)
    assert labelled.utc[:22] == "2000-02-25T05:16:12.70"
    assert labelled.sha256 == fit.sha256


@pytest.mark.parametrize(
    ("name", "exposure_s", "utc", "target"),
    [
        ("N1489034146_2.IMG", 1.2, "2005-03-09T04:09:09.568", "ENCELADUS"),
        ("N1493613276_1.IMG", 0.18, "2005-05-01T04:07:30.718", "SATURN"),
    ],
)
def test_cassini_vicar(images, name, exposure_s, utc, target):
    frame = read_image(images / "resolved" / name, CASSINI, saturation_dn=255.0)
    assert frame.image_dn.shape == (1024, 1024)
    assert frame.exposure_s == pytest.approx(exposure_s, abs=1e-12)
    assert frame.utc == utc
    assert CASSINI.value(frame.header, "target") == target
    assert np.array_equal(frame.saturated, frame.image_dn >= 255.0)


def test_sky_beside_a_resolved_body(images):
    """Enceladus fills a good part of the frame; the level under it stays that of the empty corners."""
    frame = read_image(images / "resolved" / "N1489034146_2.IMG", CASSINI)
    background = estimate_background(frame.image_dn)
    corners = np.concatenate([frame.image_dn[:64, :64].ravel(), frame.image_dn[-64:, -64:].ravel()])
    body = frame.image_dn > 100.0
    assert body.mean() > 0.1
    assert np.all(np.abs(background.level_dn[body] - np.median(corners)) < 10.0)


def test_barycenter_of_the_sun_against_de440(kernels):
    et = np.linspace(kernels.str2et("2006-02-01"), kernels.str2et("2029-12-01"), 1500)
    truth = np.array([kernels.spkez(10, t, "J2000", "NONE", 0)[0] for t in et])
    position, velocity = barycentric_from_heliocentric(np.zeros((len(et), 3)), np.zeros((len(et), 3)), et)
    assert (
        np.linalg.norm(position - truth[:, :3], axis=1).max() < 1e-6 * AU_KM
    )  # measured: 118 km = 0.79e-6 au
    assert np.linalg.norm(velocity - truth[:, 3:], axis=1).max() < 1.0 * MM_S  # measured: 0.29 mm/s
