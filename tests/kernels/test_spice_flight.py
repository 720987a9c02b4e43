"""Flight kernels: attitudes against picture headers, and targets where the pictures show them."""

import numpy as np
import pytest
from astropy.io import fits

from opnav_workbench.errors import KernelError
from opnav_workbench.kernels import (
    KernelSet,
    body_radii_km,
    camera_attitude,
    et_from_sclk,
    et_from_utc,
    instrument_values,
    sclk_from_et,
    state,
    utc_from_et,
)

pytestmark = [pytest.mark.realdata, pytest.mark.usefixtures("empty_pool")]


def files_of(data_dir, one, without=()):
    generic = [data_dir / "spice/generic" / name for name in one.generic if name not in without]
    return [*generic, data_dir / "spice/slices" / one.folder]


def direction_in_camera(one, et):
    position = state(one.target, et, one.spacecraft, correction="CN+S").position_km
    return camera_attitude(one.frame, et) @ (position / np.linalg.norm(position))


@pytest.fixture
def lorri_header(data_dir):
    return fits.getheader(data_dir / "images/cropped/lor_0034974380_0x630_sci_1_cropped.fit")


def test_lorri_boresight_at_io_agrees_with_the_picture_header(data_dir, flight_slices, lorri_header):
    one = flight_slices["lorri"]
    et = lorri_header["SPCSCET"]
    with KernelSet(files_of(data_dir, one)):
        boresight = -camera_attitude(one.frame, et)[2]  # LORRI looks along its -z
    ra_deg = np.degrees(np.arctan2(boresight[1], boresight[0])) % 360.0
    dec_deg = np.degrees(np.arcsin(boresight[2]))
    assert abs(ra_deg - lorri_header["SPCBRRA"]) < 1e-6
    assert abs(dec_deg - lorri_header["SPCBRDEC"]) < 1e-6


def test_lorri_header_times_agree(data_dir, flight_slices, lorri_header):
    with KernelSet(files_of(data_dir, flight_slices["lorri"])):
        et = et_from_utc(lorri_header["SPCUTCAL"])
        assert abs(et - lorri_header["SPCSCET"]) < 1e-3  # SPCUTCAL has milliseconds
        assert utc_from_et(lorri_header["SPCSCET"]) == "2007-02-28T13:14:22.331"
        reading = sclk_from_et(-98, lorri_header["SPCSCET"])
        assert reading == "1/0034974379:47125"
        assert abs(et_from_sclk(-98, reading) - lorri_header["SPCSCET"]) < 2.0 / 50_000  # a tick is 20 us


def test_io_stands_in_the_lorri_field(data_dir, flight_slices):
    one = flight_slices["lorri"]
    with KernelSet(files_of(data_dir, one)):
        x, y, z = direction_in_camera(one, et_from_utc(one.utc))
    half_field = np.radians(0.1456)
    assert z < 0.0
    assert max(abs(x), abs(y)) < half_field


def test_bennu_stands_in_the_mapcam_field(data_dir, flight_slices):
    one = flight_slices["mapcam"]
    with KernelSet(files_of(data_dir, one)):
        et = et_from_utc(one.utc)
        x, y, z = direction_in_camera(one, et)
        range_km = np.linalg.norm(state("BENNU", et, -64).position_km)
        half_field_deg = instrument_values(one.instrument)[f"INS{one.instrument}_FOV_REF_ANGLE"][0]
    assert abs(half_field_deg - 1.985) < 1e-9
    assert max(abs(np.degrees(np.arctan2(x, z))), abs(np.degrees(np.arctan2(y, z)))) < half_field_deg
    assert abs(np.degrees(np.arctan2(x, z)) + 1.050) < 2e-3  # snapshot: 1.05 deg off the boresight
    assert abs(range_km - 6.594) < 1e-3  # snapshot; the data's note says 6.6 km


def test_pluto_stands_in_the_mvic_framing_field(data_dir, flight_slices):
    one = flight_slices["mvic"]
    with KernelSet(files_of(data_dir, one)):
        et = et_from_utc(one.utc)
        x, y, z = direction_in_camera(one, et)
        values = instrument_values(one.instrument)
        radius_km = body_radii_km("PLUTO")[0]
    half_narrow_deg = values[f"INS{one.instrument}_FOV_REF_ANGLE"][0]  # about camera y
    half_wide_deg = values[f"INS{one.instrument}_FOV_CROSS_ANGLE"][0]  # about camera z
    assert (half_narrow_deg, half_wide_deg) == (0.0725, 2.835)
    assert abs(np.degrees(np.arctan2(y, -x))) < half_narrow_deg  # the array looks along -x
    assert abs(np.degrees(np.arctan2(z, -x))) < half_wide_deg
    assert 1180.0 < radius_km < 1200.0


@pytest.mark.parametrize("name", ["leisa", "mvic_jupiter", "dawn", "cassini", "hayabusa2"])
def test_every_other_slice_gives_attitude_and_state(data_dir, flight_slices, name):
    one = flight_slices[name]
    with KernelSet(files_of(data_dir, one)) as kernels:
        et = et_from_utc(one.utc)
        assert kernels.has_attitude(one.frame)
        assert kernels.covers_attitude(one.frame, et)
        assert kernels.covers_state(one.target, one.spacecraft, et, "CN+S")
        seen = direction_in_camera(one, et)
        boresight = np.array(instrument_values(one.instrument)[f"INS{one.instrument}_BORESIGHT"])
    half_field_deg = {"leisa": 0.63, "mvic_jupiter": 2.84, "dawn": 3.9, "cassini": 0.6, "hayabusa2": 32.7}[
        name
    ]
    angle = np.arccos(seen @ boresight / np.linalg.norm(boresight))
    assert (
        np.degrees(angle) < half_field_deg
    )  # half diagonal; for Enceladus (0.59 deg radius) part of the disc


def test_mapcam_needs_its_own_ck_and_the_spacecrafts(data_dir, flight_slices):
    one = flight_slices["mapcam"]
    folder = data_dir / "spice/slices" / one.folder
    bus_only = [*files_of(data_dir, one)[:-1], *folder.glob("*_-64000.bc")]
    with KernelSet(bus_only) as kernels:
        et = et_from_utc(one.utc)
        assert kernels.has_attitude("ORX_SPACECRAFT")
        assert not kernels.has_attitude(one.frame)
        assert not kernels.covers_attitude(one.frame, et)
        with pytest.raises(
            KernelError, match=r"no loaded CK holds the structure ORX_OCAMS_MAPCAM \(-64361\)"
        ):
            camera_attitude(one.frame, et)


def test_one_clear_line_for_a_time_outside_the_ck(data_dir, flight_slices):
    one = flight_slices["lorri"]
    with KernelSet(files_of(data_dir, one)), pytest.raises(KernelError) as caught:
        camera_attitude(one.frame, et_from_utc("2007-02-28T13:16:02"))
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(
        "attitude of NH_LORRI at 2007-02-28T13:16:02.000 UTC: outside the loaded CKs of NH_SPACECRAFT (-98000), "
        "which cover 2007-02-28T12:29:49.441 to 2007-02-28T12:30:01.857, "
        "2007-02-28T13:14:17.331 to 2007-02-28T13:14:27.361; load a CK that covers 2007-02-28T13:16:02.000 UTC."
    )
    assert "merged_nhpc_2007_v006_1_sliced_-98000.bc" in message


@pytest.mark.parametrize(
    ("missing", "remedy"),
    [
        ("new_horizons_1454.tsc", "add the SCLK kernel of clock -98"),
        ("naif0012.tls", "no LSK loaded; load a leapseconds kernel"),
        ("nh_v220.tf", "load the FK that defines it"),
    ],
)
def test_one_clear_line_for_each_missing_kernel(data_dir, flight_slices, lorri_header, missing, remedy):
    files = files_of(data_dir, flight_slices["lorri"], without=(missing,))
    with KernelSet(files) as kernels:
        with pytest.raises(KernelError) as caught:
            camera_attitude("NH_LORRI", lorri_header["SPCSCET"])
        with pytest.raises(KernelError, match=remedy):  # "no" would hide what is missing
            kernels.covers_attitude("NH_LORRI", lorri_header["SPCSCET"])
    assert remedy in str(caught.value)
    assert "\n" not in str(caught.value)


def test_all_binary_kernels_of_the_data_folder_are_found_whole(data_dir):
    binaries = [p for p in (data_dir / "spice").rglob("*") if p.suffix in (".bsp", ".bc")]
    kinds = [k.kind for k in KernelSet(binaries).kernels()]
    assert len(kinds) > 30
    assert kinds == ["SPK" if p.suffix == ".bsp" else "CK" for p in binaries]
