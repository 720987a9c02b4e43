"""Cameras and light: zero points against LORRI's published ones, electrons, sunlight, PSF models from YAML."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from opnav_workbench.camera import UNKNOWN_COLOR, Camera
from opnav_workbench.errors import CameraError
from opnav_workbench.photometry import SUN, SUN_V_MAG, Bandpass, ColorResponse, electron_rate
from opnav_workbench.psf import EmpiricalPsf, GaussianPsf, MoffatPsf
from opnav_workbench.resources import kernels_meta_dir

CAMERAS = sorted(kernels_meta_dir().glob("*/cameras/*.yaml"))
SUN_ERG = 176.0  # erg / (s cm^2 Angstrom) at 1 au and LORRI's pivot wavelength, 607.6 nm
PUBLISHED = {  # header keywords PHOTZPT (V of a star that gives 1 DN/s) and PSOLAR, (DN/s) / (erg / (s cm^2 Angstrom))
    "lorri_1x1": (18.94, 1.066e16),
    "lorri_4x4": (18.97, 1.038e16),
}
PUBLISHED_AGREE_MAG = 0.1  # the two keywords agree with each other to 0.07 mag


def camera_named(name):
    return Camera.from_yaml(next(path for path in CAMERAS if path.stem == name))


def computed(camera):
    """The camera with the zero point that Vega, aperture, throughput and gain give."""
    return replace(camera, zero_point_mag=None)


@pytest.mark.parametrize("name", PUBLISHED)
def test_lorri_zero_point_from_vega_is_the_published_one(name):
    camera, (published, _) = camera_named(name), PUBLISHED[name]
    vega = computed(camera)
    solar_stars = vega.zero_point_mag - float(vega.color.offset(camera.zero_point_b_v))
    assert solar_stars == pytest.approx(published, abs=PUBLISHED_AGREE_MAG / 2)
    assert vega.zero_point_mag == pytest.approx(published, abs=1.2 * PUBLISHED_AGREE_MAG)


@pytest.mark.parametrize("name", PUBLISHED)
def test_lorri_sees_the_sun_as_its_headers_say(name):
    camera, (_, psolar) = camera_named(name), PUBLISHED[name]
    for one in (camera, computed(camera)):
        rate_dn = one.sunlight_e(1.0) / camera.gain_e_per_dn
        assert -2.5 * np.log10(rate_dn / (psolar * SUN_ERG)) == pytest.approx(0.0, abs=PUBLISHED_AGREE_MAG)


@pytest.mark.parametrize("name", PUBLISHED)
def test_lorri_pivot_wavelength_is_that_of_its_headers(name):
    assert camera_named(name).bandpass.pivot_nm == pytest.approx(607.62, abs=1.5)


def test_mvic_sees_the_sun_as_its_headers_say():
    """PSOLAR 2.506e14, the value the zero point of the file was made from."""
    camera = camera_named("mvic_framing")
    assert camera.sunlight_e(1.0) / camera.gain_e_per_dn / SUN_ERG == pytest.approx(2.506e14, rel=0.03)
    assert computed(camera).sunlight_e(1.0) == pytest.approx(camera.sunlight_e(1.0), rel=0.05)


# These measure flight pictures only: nothing of their response is stated.
WITHOUT_RESPONSE = ("iss_nac", "onc_w2", "msi", "leisa")


@pytest.mark.slow(keep=["fc2", "lorri_1x1", "lorri_4x4", "mapcam", "mvic_framing", "pinhole", "polycam"])
@pytest.mark.parametrize(
    "path", [p for p in CAMERAS if p.stem not in WITHOUT_RESPONSE], ids=lambda path: path.stem
)
def test_every_camera_can_be_simulated(path):
    camera = Camera.from_yaml(path)
    for name in (
        "gain_e_per_dn",
        "read_noise_dn",
        "full_well_e",
        "zero_point_mag",
        "aperture_m",
        "bits",
        "prnu",
    ):
        assert camera.require(name) > 0.0
    assert float(camera.electrons(10.0, 1.0)) > 0.0
    assert camera.sunlight_e(1e-6) > 0.0
    assert camera.psf_model.half_size_px > 1.0
    assert isinstance(camera.color, ColorResponse)


def test_electrons_of_the_zero_point():
    camera = camera_named("pinhole")
    np.testing.assert_allclose(camera.electrons([18.0, 15.5, np.nan], 2.0), [20.0, 200.0, np.nan], rtol=1e-12)


def test_sunlight_is_the_spectrum_of_the_sun_through_the_band():
    camera = computed(camera_named("lorri_4x4"))
    expected = electron_rate(camera.bandpass, 0.208, 0.0, SUN) * 0.25
    assert computed(replace(camera, zero_point_b_v=0.0)).sunlight_e(0.25) == pytest.approx(
        expected, rel=1.5e-3
    )


def test_a_camera_without_a_band_sees_v():
    camera = replace(camera_named("pinhole"), color_response=None)
    assert camera.color is UNKNOWN_COLOR
    assert camera.sun_mag == SUN_V_MAG


def test_without_zero_point_and_band_there_is_a_remedy():
    camera = replace(camera_named("pinhole"), zero_point_mag=None)
    with pytest.raises(
        CameraError, match=r"zero_point_mag is not known.*or a bandpass with aperture and gain"
    ):
        camera.electrons(10.0, 1.0)


def test_a_measured_color_response_goes_before_the_computed():
    measured = ColorResponse(-0.5, 0.01)
    camera = replace(camera_named("lorri_1x1"), color_response=measured)
    assert camera.color is measured
    assert camera.sun_mag == pytest.approx(SUN_V_MAG - 0.5 * 0.65)


def test_obscuration_takes_its_share():
    camera = computed(camera_named("polycam"))
    half = computed(replace(camera, obscuration=0.5))
    assert camera.zero_point_mag - half.zero_point_mag == pytest.approx(2.5 * np.log10(2.0))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("gain_e_per_dn", 0.0),
        ("full_well_e", -1.0),
        ("obscuration", 1.0),
        ("prnu", -0.1),
        ("frame_transfer_s", np.nan),
        ("dark_current_e_s", np.inf),
    ],
)
def test_numbers_no_camera_has_are_refused(field, value):
    with pytest.raises(CameraError, match=f"Generic pinhole: {field} is"):
        replace(camera_named("pinhole"), **{field: value})


def written(tmp_path, **sections):
    """Write the pinhole's file with some sections changed; return its path."""
    data = yaml.safe_load((kernels_meta_dir() / "generic/cameras/pinhole.yaml").read_text())
    for name, section in sections.items():
        data[name] = {**data[name], **section}
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def test_psf_models_from_a_camera_file(tmp_path):
    EmpiricalPsf(GaussianPsf(0.8, 0.8).kernel(4), 4).save(tmp_path / "template.npz")
    moffat = {"model": {"model": "moffat", "fwhm_px": 2.0, "beta": 3.0}}
    assert Camera.from_yaml(written(tmp_path, psf=moffat)).psf_model == MoffatPsf(2.0, 3.0)
    template = {"model": {"model": "empirical", "file": "template.npz"}}
    assert Camera.from_yaml(written(tmp_path, psf=template)).psf_model.oversampling == 4
    assert Camera.from_yaml(written(tmp_path)).psf_model == GaussianPsf(0.8, 0.8)


def test_band_pass_from_a_camera_file(tmp_path):
    band = {"wavelength_nm": [400, 401, 899, 900], "response": [0, 1, 1, 0], "peak": 0.3}
    camera = Camera.from_yaml(
        written(tmp_path, photometry={"zero_point_mag": None, "bandpass": band, "color": None})
    )
    assert isinstance(camera.bandpass, Bandpass)
    assert camera.bandpass.peak == pytest.approx(0.3)
    assert camera.zero_point_mag == pytest.approx(17.45, abs=0.01)
    assert camera.color.slope_mag_per_bv < 0.0


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ({"psf": {"model": {"model": "moffat", "fwhm": 2.0, "beta": 3.0}}}, "psf.model.fwhm"),
        ({"psf": {"model": {"model": "empirical", "file": "none.npz"}}}, "none.npz cannot be read"),
        (
            {"photometry": {"bandpass": {"wavelength_nm": [500, 400], "response": [1, 1]}}},
            "must be positive and incr",
        ),
        ({"photometry": {"bandpass": {"wavelength_nm": [400], "response": [1]}}}, "bandpass.wavelength_nm"),
        ({"detector": {"prnu": 1.5}}, "detector.prnu"),
        ({"optics": {"obscuration": 1.0}}, "optics.obscuration"),
    ],
)
def test_errors_name_the_file_and_the_field(tmp_path, sections, message):
    with pytest.raises(CameraError, match=message) as caught:
        Camera.from_yaml(written(tmp_path, **sections))
    assert "camera.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)
