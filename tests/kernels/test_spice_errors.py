"""Failures in one clear line: what was asked, when, what is missing, what helps, and what is loaded."""

import re

import pytest
import spiceypy

from opnav_workbench.errors import KernelError
from opnav_workbench.kernels import (
    KernelSet,
    body_attitude,
    body_id,
    body_radii_km,
    camera_attitude,
    et_from_sclk,
    et_from_utc,
    instrument_values,
    sclk_from_et,
    state,
    utc_from_et,
)
from opnav_workbench.kernels.calls import (
    FAILURE_MESSAGES,
    VARIABLE_REMEDIES,
    Diagnosis,
    SpiceRequest,
    spice_call,
)

pytestmark = pytest.mark.usefixtures("empty_pool")


def message_of(call):
    with pytest.raises(KernelError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message
    assert "===" not in message  # spiceypy's own banner
    return message


def test_without_kernels_every_function_says_how_to_open_some():
    for call in (
        lambda: state("PLUTO", 0.0, "SUN"),
        lambda: body_radii_km("PLUTO"),
        lambda: camera_attitude("NH_LORRI", 0.0),
        lambda: body_attitude("PLUTO", 0.0),
        lambda: et_from_utc("2015-07-14"),
        lambda: utc_from_et(0.0),
        lambda: et_from_sclk(-98, "1/0"),
        lambda: sclk_from_et(-98, 0.0),
        lambda: instrument_values(-98301),
    ):
        assert "no kernels are loaded; open some: with KernelSet(" in message_of(call)


def test_a_time_outside_the_ck_names_structure_windows_and_remedy(toy):
    with KernelSet(toy.files):
        message = message_of(lambda: camera_attitude("TOY_CAMERA", 150.0))
    assert message.startswith(
        "attitude of TOY_CAMERA at 2000-01-01T12:01:25.816 UTC: outside the loaded CKs of TOY_BUS"
    )
    assert "2000-01-01T11:58:55.816 to 2000-01-01T12:00:35.816" in message  # et 0 to 100
    assert "2000-01-01T12:02:15.816 to 2000-01-01T12:03:55.816" in message  # et 200 to 300
    assert "load a CK that covers 2000-01-01T12:01:25.816 UTC" in message
    assert all(p.name in message for p in toy.files)
    with KernelSet(toy.files):
        early = message_of(lambda: camera_attitude("TOY_CAMERA", -2e6))  # before the clock's first partition
    assert "outside the loaded CKs of TOY_BUS" in early


def test_the_gap_is_told_for_the_structure_that_has_it(toy):
    """At et 75 the bus is covered, the platform on it is not."""
    with KernelSet(toy.files):
        assert "CKs of TOY_PLATFORM (-999200)" in message_of(lambda: camera_attitude("TOY_PLATFORM", 75.0))
        assert "CKs of TOY_PLATFORM (-999200)" in message_of(lambda: camera_attitude("TOY_PLATFORM", 250.0))


def test_only_the_nearest_windows_are_shown(toy, tmp_path):
    path = tmp_path / "many.bsp"
    handle = spiceypy.spkopn(str(path), "many", 0)
    for start in range(0, 100, 10):
        states = [[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]] * 4
        et = [start + i for i in range(4)]
        spiceypy.spkw13(handle, -5, 0, "J2000", et[0], et[-1], "s", 3, 4, states, et)
    spiceypy.spkcls(handle)
    with KernelSet(path):  # no LSK: times as et
        message = message_of(lambda: state(-5, 45.0, 0))
    assert (
        "which cover et 30.000 s to et 33.000 s, et 40.000 s to et 43.000 s, et 50.000 s to et 53.000 s"
        in message
    )
    assert "and 7 windows farther away" in message


def test_no_ck_no_sclk_no_lsk_no_fk(toy):
    def asked(*missing):
        with KernelSet(toy.without(*missing)):
            return message_of(lambda: camera_attitude("TOY_CAMERA", 10.0))

    assert (
        "no loaded CK holds the structure TOY_BUS (-999000); load a CK that covers it at 2000-01-01"
        in asked(".bc")
    )
    assert "clock -999 is unknown; add the SCLK kernel of clock -999" in asked(".tsc")
    assert "the frame TOY_CAMERA is unknown; correct its name or load the FK that defines it" in asked(".tf")
    with KernelSet(toy.without(".tls")):
        assert "UTC time '2015-07-14': no LSK loaded; load a leapseconds kernel" in message_of(
            lambda: et_from_utc("2015-07-14")
        )
        message = message_of(lambda: state("TOYBODY", 9e9, 0))
        assert "at et 9000000000.000 s" in message  # UTC is unknown without LSK


def test_states_name_the_body_that_is_missing(toy):
    with KernelSet(toy.files):
        gap = message_of(lambda: state("TOYBODY", 1500.0, "TOYCRAFT"))
        assert "outside the loaded SPKs of TOYCRAFT (-999), which cover" in gap
        assert "TOYBODY (2999999)" not in gap  # covered then
        assert "load an SPK that covers TOYCRAFT (-999) at 2000-01-01T12:23:55.816 UTC" in gap
        both = message_of(lambda: state("TOYBODY", 9999.0, "TOYCRAFT"))
        assert "load an SPK that covers TOYBODY (2999999) and TOYCRAFT (-999)" in both
        none = message_of(lambda: state("PLUTO", 0.0, "TOYCRAFT"))
        assert "no loaded SPK holds PLUTO (999); load an SPK that covers PLUTO (999)" in none
        early = message_of(lambda: state("TOYBODY", -5000.0, 0, correction="LT"))
        assert "not as early as one light time before" in early
    with KernelSet(toy.without(".bsp")):
        assert "no loaded SPK holds TOYBODY" in message_of(lambda: state("TOYBODY", 0.0, "TOYCRAFT"))


def test_names_that_nobody_knows_get_suggestions(toy):
    with KernelSet(toy.files):
        assert "'TOYCRAFFT' is unknown (close: TOYCRAFT" in message_of(
            lambda: state("TOYBODY", 0.0, "TOYCRAFFT")
        )
        assert "'PLUTTO' is unknown (close: PLUTO" in message_of(lambda: body_id("PLUTTO"))
        assert "(close: TOY_CAMERA" in message_of(lambda: camera_attitude("TOY_CAMRA", 0.0))
        assert "the frame NOWHERE is unknown" in message_of(
            lambda: state("TOYBODY", 0.0, "TOYCRAFT", "NOWHERE")
        )
        assert "use NONE, LT, CN, LT+S, CN+S" in message_of(lambda: state("TOYBODY", 0.0, 0, "J2000", "CNS"))
        assert "INS-5_*" in message_of(lambda: instrument_values(-5))


def test_missing_body_constants(toy, tmp_path):
    with KernelSet(toy.files):
        message = message_of(lambda: body_radii_km("PLUTO"))
        assert (
            "BODY999_RADII is not in the loaded kernels; load the PCK that defines BODY999_RADII" in message
        )
        assert "TOYCRAFT (-999) has no body-fixed frame" in message_of(lambda: body_attitude("TOYCRAFT", 0.0))
        assert "load the PCK that holds its pole and rotation" in message_of(
            lambda: body_attitude("PLUTO", 0.0)
        )
    flat = tmp_path / "flat.tpc"
    flat.write_text(
        "KPL/PCK\n\\begindata\nBODY999_RADII = ( 1188 0 1188 )\nBODY901_RADII = 606\n\\begintext\n"
    )
    with KernelSet(flat):
        assert "not three positive km" in message_of(lambda: body_radii_km("PLUTO"))
        assert "not three positive km" in message_of(lambda: body_radii_km("CHARON"))


@pytest.mark.parametrize("text", ["hello", "2015-13-01", "2015-07-14T25:00:00", "2015-366", ""])
def test_times_that_cannot_be_read(toy, text):
    with KernelSet(toy.lsk):
        message = message_of(lambda: et_from_utc(text))
    assert repr(text) in message
    assert "write it like 2015-07-14T11:49:57" in message or "is empty; give one" in message


@pytest.mark.parametrize("et", [float("nan"), float("inf"), -float("inf")])
def test_times_that_are_not_finite(toy, et):
    with KernelSet(toy.files):
        for call in (
            lambda: utc_from_et(et),
            lambda: state("TOYBODY", et, 0),
            lambda: camera_attitude("TOY_CAMERA", et),
            lambda: sclk_from_et(-999, et),
        ):
            assert "is not finite" in message_of(call)


def test_clock_readings_that_cannot_be_used(toy):
    with KernelSet(toy.files):
        assert "clock reading cannot be used" in message_of(lambda: et_from_sclk(-999, "abc"))
        assert "clock reading cannot be used" in message_of(lambda: et_from_sclk(-999, "7/12"))
        assert "clock reading cannot be used" in message_of(lambda: sclk_from_et(-999, -1e9))
        assert "add the SCLK kernel of clock -98" in message_of(lambda: sclk_from_et(-98, 0.0))
        assert "add the SCLK kernel of clock -98" in message_of(lambda: et_from_sclk(-98, "1/0"))
        with pytest.raises(KernelError, match="0 to 9"):
            utc_from_et(0.0, precision=15)


def test_many_kernels_are_cut_short_in_messages(tmp_path):
    for i in range(20):
        (tmp_path / f"k{i:02}.tf").write_text(f"KPL/FK\n\\begindata\nX{i} = 1\n\\begintext\n")
    with KernelSet(tmp_path):
        message = message_of(lambda: camera_attitude("NOWHERE", 0.0))
    assert message.endswith("k10.tf, k11.tf and 8 more.")


def test_spice_works_on_after_a_failure(toy):
    with KernelSet(toy.files):
        message_of(lambda: camera_attitude("TOY_CAMERA", 1e5))
        assert not spiceypy.failed()
        assert camera_attitude("TOY_CAMERA", 10.0).shape == (3, 3)


def test_a_failure_that_the_table_does_not_know_still_says_something(toy):
    with KernelSet(toy.lsk):
        message = message_of(_strange)
    assert message.startswith("counting: SPICE reports STRANGE: no such thing; check the kernels")


def _strange():
    with spice_call(SpiceRequest("counting")):
        raise spiceypy.SpiceyError(short="SPICE(STRANGE)", long="no such thing. More words.")


def test_a_look_that_fails_does_not_hide_the_failure(toy, monkeypatch):
    def broken(*_args):
        raise spiceypy.SpiceyError(short="SPICE(OTHER)", long="other")

    monkeypatch.setattr("opnav_workbench.kernels.calls.windows_of", broken)
    with KernelSet(toy.files):
        message = message_of(lambda: state("TOYBODY", 9999.0, "TOYCRAFT"))
    assert "Insufficient ephemeris data" in message
    assert "load an SPK that covers these bodies" in message


def test_the_table_of_messages_is_well_formed():
    for short, message in FAILURE_MESSAGES.items():
        assert re.fullmatch(r"[A-Z0-9]+", short)
        for text in (message.cause, message.remedy):
            assert text
            assert set(re.findall(r"{(\w+)}", text)) <= {"detail"}
        assert not message.remedy.endswith(".")
    assert {m.diagnosis for m in FAILURE_MESSAGES.values()} - {None} == set(Diagnosis)
    known = set(spiceypy.utils.exceptions.exceptions)
    unknown = {s for s in FAILURE_MESSAGES if f"SPICE({s})" not in known}
    assert len(unknown) < len(FAILURE_MESSAGES) / 4, sorted(unknown)  # most are SPICE's own words, not ours


@pytest.mark.parametrize(
    ("variable", "remedy"),
    [
        ("SCLK_DATA_TYPE_98", "add the SCLK kernel of clock -98"),
        ("SCLK01_N_FIELDS_64", "add the SCLK kernel of clock -64"),
        ("SCLK_PARTITION_START_98", "add the SCLK kernel of clock -98"),
        ("DELTET/DELTA_T_A", "load a leapseconds kernel (no LSK loaded)"),
        ("BODY999_RADII", "load the PCK that defines BODY999_RADII"),
        ("BODY-98_GM", "load the PCK that defines BODY-98_GM"),
        ("INS-98301_BORESIGHT", "load the IK that defines INS-98301_BORESIGHT"),
        ("TKFRAME_-98301_SPEC", "load the FK that defines it"),
        ("CK_-98000_SCLK", "load the FK that ties the CK structure -98000 to its clock"),
    ],
)
def test_each_missing_variable_has_its_remedy(variable, remedy):
    for pattern, text in VARIABLE_REMEDIES:
        found = re.search(rf"\b{pattern}\b", f"Kernel variable {variable} was not found")
        if found:
            assert found[0] == variable
            assert text.format(*found.groups()) == remedy
            return
    pytest.fail(f"no remedy for {variable}")
