"""The CCSDS Tracking Data Message: read by an independent program, by our own reader, and by the standard's rules."""

import re
from dataclasses import replace

import ccsds_ndm  # independent: the Rust library of J. Maene, from PyPI ccsds-ndm-py
import numpy as np
import pytest
from astropy import units as u

from opnav_workbench.errors import SessionError
from opnav_workbench.observables import TdmOptions, parse_tdm, read_tdm, tdm_table, tdm_text, write_tdm

ANGLE_DEG = 1e-13  # half a digit of thirteen decimals, and rounding
# Table 3-3: the order of keywords that our messages use is fixed (3.3.1.8).
ORDER = (
    """
TRACK_ID DATA_TYPES TIME_SYSTEM START_TIME STOP_TIME PARTICIPANT_1 PARTICIPANT_2 MODE PATH TIMETAG_REF RANGE_UNITS
ANGLE_TYPE REFERENCE_FRAME DATA_QUALITY
""".strip()
    .replace("\n", " ")
    .split(" ")
)
# The standard's own example of angles (503.0-B-2, figure E-12), shortened.
FIGURE_E_12 = """
CCSDS_TDM_VERS = 2.0
COMMENT TDM example created by yyyyy-nnnA Nav Team (NASA/JPL)
COMMENT StarTrek: one minute of launch angles from DSS-16
CREATION_DATE = 2005-157T18:25:00
ORIGINATOR = NASA
META_START
TIME_SYSTEM = UTC
START_TIME = 2004-216T07:44:00
STOP_TIME = 2004-216T07:45:00
PARTICIPANT_1 = DSS-16
PARTICIPANT_2 = yyyy-nnnA
MODE = SEQUENTIAL
PATH = 2,1
ANGLE_TYPE = XSYE
CORRECTION_ANGLE_1 = -0.09
CORRECTION_ANGLE_2 = 0.18
CORRECTIONS_APPLIED = NO
META_STOP
DATA_START
ANGLE_1 = 2004-216T07:44:00 -23.62012
ANGLE_2 = 2004-216T07:44:00 -73.11035
ANGLE_1 = 2004-216T07:44:10 -23.04004
ANGLE_2 = 2004-216T07:44:10 -72.74316
DATA_STOP
"""


@pytest.fixture(scope="module")
def text(approach_observables):
    return tdm_text(
        approach_observables,
        TdmOptions(
            originator="KINETX", message_id="7", comments=("a rehearsal",), validated_by="A. Navigator"
        ),
    )


def test_independent_reader_finds_every_angle(approach_observables, text):
    message = ccsds_ndm.Tdm.from_str(text)
    message.validate()
    assert (message.version, message.header.originator, message.header.message_id) == ("2.0", "KINETX", "7")
    found = {}
    for segment in message.segments:
        data = segment.metadata
        assert (data.participant_1, data.path, data.angle_type) == ("NEW_HORIZONS", "2,1", "RADEC")
        assert (data.reference_frame, data.time_system, data.mode) == ("ICRF", "UTC", "SEQUENTIAL")
        assert any("Stellar aberration is removed" in comment for comment in data.comment)
        for record in segment.data.observations:
            found[data.participant_2, data.data_quality, record.epoch[:10], record.keyword] = record.value
    expected = {}
    for o in approach_observables:
        if o.observed_px is not None:
            key = o.name, {"ok": "VALIDATED", "uncertain": "DEGRADED"}[o.status], o.utc[:10]
            expected[*key, "ANGLE_1"], expected[*key, "ANGLE_2"] = o.ra_deg, o.dec_deg
            if o.name == "PLUTO" and o.status == "ok":  # of a center in doubt no range is given out
                assert o.range_sigma_km == 3e3
                expected[*key, "RANGE"] = o.measured_range_km
    assert found.keys() == expected.keys()
    for key, value in expected.items():
        assert found[key] == pytest.approx(value, abs=ANGLE_DEG, rel=1e-15), key


def test_only_a_person_validates(approach_observables, text):
    assert "VALIDATED" not in tdm_text(approach_observables)
    assert text.count("COMMENT Validated by A. Navigator\n") == text.count("DATA_QUALITY = VALIDATED\n") > 0
    assert text.count("DATA_QUALITY = DEGRADED\n") == tdm_text(approach_observables).count("= DEGRADED\n") > 0


def test_independent_reader_would_complain(text):
    """It is no reader that accepts anything."""
    for line, damaged in (
        ("TIME_SYSTEM = UTC\n", ""),
        ("DATA_STOP\n", ""),
        ("ANGLE_TYPE = RADEC", "ANGLE_TYPE = RA"),
        ("META_START", "META_BEGIN"),
    ):
        with pytest.raises(Exception, match=r"\w"):
            ccsds_ndm.Tdm.from_str(text.replace(line, damaged)).validate()


def test_our_reader_gives_angles_covariances_and_ranges(approach_observables, tmp_path):
    path = tmp_path / "approach.tdm"
    write_tdm(approach_observables, path)
    table = tdm_table(read_tdm(path))
    usable = [o for o in approach_observables if o.observed_px is not None]
    assert len(table) == len(usable) == 8
    quality = {"ok": "RAW", "uncertain": "DEGRADED"}  # nobody has looked at them, and nobody says so
    rows = {(row["target"], row["quality"], row["image"]): row for row in table}
    for o in usable:
        row = rows[o.name, quality[o.status], o.image]
        assert row["observer"] == "NEW HORIZONS"
        assert row["ra"].to_value(u.deg) == pytest.approx(o.ra_deg, abs=ANGLE_DEG)
        assert row["dec"].to_value(u.deg) == pytest.approx(o.dec_deg, abs=ANGLE_DEG)
        assert row["et"].to_value(u.s) == pytest.approx(o.et, abs=6e-7)  # half a microsecond
        np.testing.assert_array_equal(row["covariance"].to_value(u.arcsec**2), o.residual_covariance_arcsec2)
        np.testing.assert_allclose(row["range"].to_value(u.km), o.measured_range_km, rtol=1e-15)
        assert np.isnan(row["sigma_range"]) == np.isnan(o.range_sigma_km)


def test_syntax_of_the_standard(text):
    """Sections 3 and 4: printable ASCII, line length, order of keywords, one value a time, numbers of 16 digits."""
    lines = text.splitlines()
    assert lines[0] == "CCSDS_TDM_VERS = 2.0"
    assert lines[1] == "COMMENT a rehearsal"
    assert all(line.isascii() and (not line or line.isprintable()) and len(line) <= 254 for line in lines)
    for block in re.findall(r"META_START\n(.*?)META_STOP", text, re.DOTALL):
        keys = [line.split(" = ")[0] for line in block.splitlines() if not line.startswith("COMMENT")]
        assert keys == [key for key in ORDER if key in keys]
    for block in re.findall(r"DATA_START\n(.*?)DATA_STOP", text, re.DOTALL):
        records = [line.split() for line in block.splitlines() if not line.startswith("COMMENT")]
        assert len({(r[0], r[2]) for r in records}) == len(records)
        for keyword in {r[0] for r in records}:
            times = [r[2] for r in records if r[0] == keyword]
            assert times == sorted(times)
        assert all(sum(c.isdigit() for c in r[3].split("E")[0]) <= 16 for r in records)


def test_angles_as_seen_and_frame_are_options(approach_observables):
    options = TdmOptions(aberration="kept", frame="EME2000", creation_date="2015-07-13T00:00:00")
    message = parse_tdm(tdm_text(approach_observables[:1], options))
    (segment,) = message.segments
    assert message.header["CREATION_DATE"] == "2015-07-13T00:00:00"
    assert segment.metadata["REFERENCE_FRAME"] == "EME2000"
    assert any("aberration is not removed" in comment for comment in segment.comments)
    assert segment.records[0].value == pytest.approx(approach_observables[0].apparent_ra_deg, abs=ANGLE_DEG)
    assert abs(segment.records[0].value - approach_observables[0].ra_deg) > 5e-4  # aberration; arcseconds
    for wrong in ({"frame": "B1950"}, {"aberration": "yes"}):
        with pytest.raises(SessionError, match="choose one of"):
            TdmOptions(**wrong)


def test_two_centers_at_one_time_are_in_two_segments(approach_observables):
    """3.4.11: a keyword with the same time may not stand twice in a section."""
    twice = [approach_observables[0], replace(approach_observables[0], image="copy.fit")]
    assert len(parse_tdm(tdm_text(twice)).segments) == 2


def test_nothing_to_tell_is_an_error(approach_observables, tmp_path):
    path = tmp_path / "none.tdm"
    with pytest.raises(SessionError, match="none of 1 observables has a center"):
        write_tdm([approach_observables[7]], path)
    with pytest.raises(SessionError, match="do not name their spacecraft"):
        write_tdm([replace(approach_observables[0], observer="")], path)
    assert not path.exists()


def test_reader_reads_the_example_of_the_standard():
    message = parse_tdm(FIGURE_E_12)
    (segment,) = message.segments
    assert message.comments[1].startswith("StarTrek")
    assert segment.participants() == ("yyyy-nnnA", "DSS-16")
    assert [record.value for record in segment.records] == [-23.62012, -73.11035, -23.04004, -72.74316]
    assert len(tdm_table(message)) == 0  # no right ascension in it
    radec = parse_tdm(FIGURE_E_12.replace("XSYE", "RADEC"))
    table = tdm_table(radec)
    assert table["ra"][0].to_value(u.deg) == pytest.approx(360.0 - 23.62012)
    assert np.isnan(table["covariance"]).all()
    assert table["et"][1] - table["et"][0] == 10.0 * u.s


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("META_STOP\n", "", "line 19: DATA_START in the metadata section"),
        ("DATA_STOP\n", "", "ends in the data section"),
        ("-23.62012", "", "line 21: ANGLE_1 needs a time and a number"),
        ("-23.62012", "west", "line 21: ANGLE_1 needs a time and a number"),
        ("MODE = ", "MODE ", "line 13: 'MODE SEQUENTIAL' is no assignment"),
        ("PATH = 2,1", "PATH = 2,1\nPATH = 1,2", "line 15: PATH is given twice"),
        ("CCSDS_TDM_VERS = 2.0", "", "no complete tracking data message"),
    ],
)
def test_damage_is_named_with_its_line(old, new, message):
    with pytest.raises(SessionError, match=re.escape(message)):
        parse_tdm(FIGURE_E_12.replace(old, new))


def test_file_that_is_no_text(tmp_path):
    (tmp_path / "x.tdm").write_bytes(b"\xff\xfe")
    for name in ("x.tdm", "missing.tdm"):
        with pytest.raises(SessionError, match=name):
            read_tdm(tmp_path / name)
